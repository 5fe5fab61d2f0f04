"""The measurements of a human on a force plate, and what a model predicts of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Steps = NDArray[np.intp]

DATA = "data/human_force_plate.npz"
PREDICTED = ("vertical force, N", "zero-moment x, cm", "zero-moment y, cm")
ROWS = 3  # of a step: moments about the plate's y and x, then the vertical force

# The data have no names; these are read off the places of the bodies. A and B are the two sides.
_LIMBS = [f"{name} {side}" for name in ("foot", "shank", "thigh") for side in "AB"]
_ARMS = [f"{name} {side}" for name in ("hand", "forearm") for side in "AB"]
NAMES = (*_LIMBS, "pelvis", *_ARMS, "abdomen", "chest", "upper arm A", "upper arm B", "head")


@dataclass(frozen=True, eq=False)
class Human:
    """The measurements.

    Attributes:
        A: (3 T, 160) regressor; b: (3 T,) measurements; sigma: (3 T,) their standard deviations.
        prior: (16, 10) inertial parameters of the mesh with uniform density.
        ellipsoids: (16, 4, 4) outer ellipsoids, positive inside.
        X_WB: (16, 4, 4) poses of the bodies, for pictures.
    """

    A: Array
    b: Array
    sigma: Array
    prior: Array
    ellipsoids: Array
    X_WB: Array

    @classmethod
    def read(cls, path: Path) -> Human:
        """The measurements of a file."""
        with np.load(path) as file:
            sigma = np.tile(file["sigma"], len(file["b"]) // ROWS)
            return cls(file["A"], file["b"], sigma, file["phi_prior"], file["Q"], file["X_WB"])

    @property
    def steps(self) -> int:
        """Number of time steps T."""
        return len(self.b) // ROWS

    @property
    def mass(self) -> float:
        """Mass of the whole human, kg, which is known and which the prior has."""
        return float(self.prior[:, 0].sum())

    def gamma(self, alpha: float) -> float:
        """γ = α tr(AᵀΣ⁻¹A)."""
        return alpha * float(np.square(self.A / self.sigma[:, None]).sum())

    def at(self, steps: Steps) -> Human:
        """The measurements of some steps."""
        rows = (ROWS * steps[:, None] + np.arange(ROWS)).ravel()
        return replace(self, A=self.A[rows], b=self.b[rows], sigma=self.sigma[rows])

    def errors(self, phi: Array) -> Array:
        """(T, 3) errors of the vertical force, N, and of the zero-moment point's x and y, cm."""
        wrenches = np.stack([self.A @ phi.ravel(), self.b]).reshape(2, -1, ROWS)
        points = 100.0 * wrenches[..., [1, 0]] / wrenches[..., 2:]
        predicted, measured = np.concatenate([wrenches[..., 2:], points], axis=-1)
        return np.asarray(predicted - measured)


def blocks(steps: int, number: int, gap: int) -> Iterator[tuple[Steps, Steps]]:
    """Steps to train on and to test on, for each of as many blocks of consecutive steps.

    Args:
        steps: Number of steps.
        number: Number of blocks.
        gap: Steps on both sides of the tested block that are left out: velocities and
            accelerations are differences of filtered poses, so that neighbours share noise.
    """
    every = np.arange(steps)
    for block in np.array_split(every, number):
        far = (every < block[0] - gap) | (every > block[-1] + gap)
        yield every[far], block
