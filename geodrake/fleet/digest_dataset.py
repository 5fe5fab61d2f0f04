"""A digest as the `Dataset` that fits, comparisons and hypotheses are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances
from geodrake.effects import Effect
from geodrake.errors import DigestError
from geodrake.fleet.digest import Digest, JointDigest
from geodrake.fleet.model_hash import model_hash
from geodrake.fleet.settings import DigestSettings
from geodrake.identification.logs.dataset import Dataset, JointData
from geodrake.identification.logs.log_slices import Layout
from geodrake.identification.logs.reduce import gain_uncertainty
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def model_of_digests(model: RobotModel, settings: DigestSettings) -> RobotModel:
    """The model that digests have the columns of: without the joints that their logs lack.

    Args:
        model: The model as it was given when the settings were made.

    Raises:
        DigestError: It is another model.
    """
    instance(model, "model", RobotModel)
    instance(settings, "settings", DigestSettings)
    if (own := model_hash(model)) != settings.model:
        raise DigestError(
            f"The digests are of another model than {model.path.name}: its hash is {own[:12]}, "
            f"theirs {settings.model[:12]}.",
            advice="Give the model that they were made with, or digest the logs into a new folder.",
        )
    return holding(model, settings.held) if settings.held else model


def digest_dataset(
    digest: Digest, model: RobotModel, *, extra: Sequence[type[Effect]] = ()
) -> Dataset:
    """The `Dataset` that a reading of the digest's logs by its settings gives, without rows.

    Its folds are the digest's blocks, its inertial columns all ten of each body, so that fits and
    held-out errors are the same. Residuals cannot be computed of it: how much samples are worth is
    `Digest.effective`.

    Args:
        digest: The digest.
        model: The model as it was given when the settings were made.
        extra: Effect classes of the user's own that have columns.

    Raises:
        DigestError: It is another model, or an effect cannot be made.
    """
    settings, extra = instance(digest, "digest", Digest).settings, instances(extra, "extra", type)
    model = model_of_digests(model, settings)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    layout = Layout.of(model, effects, settings.sign_width, settings.still_speed)
    pairs = zip(digest.joints, layout.columns, strict=True)
    return Dataset(
        model.joints,
        model.bodies,
        effects,
        delays_of_joints(settings),
        digest.blocks,
        tuple(log.name for log in digest.logs),
        tuple(_joint_data(joint, columns, settings) for joint, columns in pairs),
        digest.effort_std,
        digest.noise_floor,
        digest.logs[0].bandwidth,
        digest.still,
        payload_reference(model.phi),
        gain_uncertainty(model, digest.logs),
    )


def delays_of_joints(settings: DigestSettings) -> Array:
    """(d, nv) the delays of settings, of every joint, s."""
    return np.array([np.full(len(settings.joints), delay) for delay in settings.delays])


def _joint_data(joint: JointDigest, columns: Indices, settings: DigestSettings) -> JointData:
    """What blocks say about a joint over all inertial columns that it feels."""
    inertial, base = settings.base_matrix.shape[1], len(settings.independent)
    bodies = columns[columns < inertial]
    own = joint.columns[joint.columns < base]
    kept, efforts = len(own), len(settings.delays)
    effects = len(joint.columns) - kept
    beside = np.eye(effects + efforts)
    spread = np.zeros((kept + len(beside), len(bodies) + len(beside)))
    spread[:kept, : len(bodies)] = settings.base_matrix[np.ix_(own, bodies)]
    spread[kept:, len(bodies) :] = beside
    peaks = np.zeros(len(columns))
    peaks[np.isin(columns, settings.independent)] = joint.peaks[:kept]
    peaks[len(bodies) :] = joint.peaks[kept:]
    width = len(columns)
    return JointData(
        columns,
        joint.factors @ spread,
        joint.samples,
        tuple(() for _ in joint.samples),
        joint.carried @ spread[: kept + effects, :width],
        joint.seen,
        joint.effort_sums,
        peaks,
    )
