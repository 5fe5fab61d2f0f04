"""What a digest of a minute of a seven-joint arm costs: CPU time, bytes, and digits in a merger.

The log is made by the arm's own model. Times are of one core, once everything is compiled, beside
that of a reading of the same log with columns for all candidates, as `diagnose` begins.

    OMP_NUM_THREADS=1 python diagrams/digest_speed.py --json digest_speed.json --figures figures
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure

from geodrake.fleet import (
    Digest,
    LogFacts,
    digest_content,
    digest_dataset,
    make_digest,
    make_settings,
    merge,
    read_digest,
)
from geodrake.identification.logs.case import open_case, reduced
from geodrake.logs.motion import JointLog, Motion
from geodrake.model import RobotModel, load_model
from geodrake.report import style

MODELS = Path(__file__).parents[1] / "models"
NOISE = 0.05  # N·m

R = TypeVar("R")


@dataclass(frozen=True)
class DigestCost:
    """What a digest of one log took.

    Attributes:
        rate: Samples a second of the log, Hz.
        seconds: Its length, s.
        bandwidth: Bandwidth of the filter, Hz.
        samples: Filtered samples of each joint.
        columns: Columns of all joints.
        bytes: Size of the file.
        made: CPU time to make it from the log in memory, s.
        reading: CPU time to open the same log with all candidates, s.
        read: CPU time to read the file, s.
        merged: Largest difference of normal matrices of two merged digests from those of a reading
            of both logs, relative to the sizes of rows and columns.
    """

    rate: float
    seconds: float
    bandwidth: float
    samples: int
    columns: int
    bytes: int
    made: float
    reading: float
    read: float
    merged: float


def swinging(model: RobotModel, rate: float, seconds: float, pace: float, seed: int) -> JointLog:
    """A log of sums of sines, of efforts with noise.

    Args:
        model: The robot.
        rate: Samples a second, Hz.
        seconds: Length, s.
        pace: How fast it moves: 1 for up to 0.6 Hz.
        seed: Of motion and noise.
    """
    rng, nv = np.random.default_rng(seed), len(model.joints)
    instants = np.arange(round(rate * seconds)) / rate
    rates = pace * 2 * np.pi * rng.uniform(0.05, 0.6, (6, 1, nv))
    angle, size = rng.uniform(0, 6, (6, 1, nv)), rng.uniform(0.1, 0.4, (6, 1, nv))
    waves = size * np.exp(1j * (rates * instants[:, None] + angle))
    q, v, vd = ((waves * (1j * rates) ** k).sum(0).imag for k in range(3))
    effort = model.effort(Motion(model.positions(q), v, vd)) + NOISE * rng.normal(size=q.shape)
    return JointLog(f"{seed}", model.joints, instants, q + 1e-7 * rng.normal(size=q.shape), effort)


def timed(work: Callable[[], R], times: int) -> tuple[R, float]:
    """What some work gives, and its least CPU time, s.

    Args:
        work: The work.
        times: How often it is done, after once for what is compiled and kept.
    """
    result, least = work(), np.inf
    for _ in range(times):
        begin = time.process_time()
        result = work()
        least = min(least, time.process_time() - begin)
    return result, float(least)


def measure(
    model: RobotModel, rate: float, pace: float, *, seconds: float, times: int, seed: int
) -> DigestCost:
    """Digests of two logs, and readings of them.

    Args:
        model: The robot.
        rate: Samples a second of the logs, Hz.
        pace: How fast the robot moves.
        seconds: Length of a log, s.
        times: How often times are taken.
        seed: Of motion and noise.
    """
    first = swinging(model, rate, seconds, pace, seed)
    second = swinging(model, rate, seconds, 0.7 * pace, seed)  # slower, so that the first counts
    settings = make_settings(model, first)

    def digested(log: JointLog) -> Digest:
        return make_digest(model, log, settings, LogFacts(log.name, (Path(__file__),)))

    def opened() -> object:
        both = (settings.bandwidth, settings.motion_bandwidth)
        return open_case(
            model, [first], candidates=True, bandwidth=both[0], motion_bandwidth=both[1]
        )

    digest, made = timed(lambda: digested(first), times)
    _, reading = timed(opened, times)
    content = digest_content(digest)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "digest.npz"
        path.write_bytes(content)
        _, read = timed(lambda: read_digest(path), times)
    return DigestCost(
        rate,
        seconds,
        digest.logs[0].bandwidth,
        int(digest.samples.max()),
        len(settings.columns),
        len(content),
        made,
        reading,
        read,
        merged_difference(model, [first, second], [digest, digested(second)]),
    )


def merged_difference(
    model: RobotModel, logs: Sequence[JointLog], digests: Sequence[Digest]
) -> float:
    """Largest relative difference of merged digests from a reading of all logs.

    Args:
        model: The robot.
        logs: The logs, the fastest first.
        digests: Their digests.
    """
    settings, worst = digests[0].settings, 0.0
    case = open_case(
        model,
        logs,
        candidates=True,
        bandwidth=settings.bandwidth,
        motion_bandwidth=settings.motion_bandwidth,
        blocks=settings.blocks,
    )
    merged = digest_dataset(merge(digests), model)
    together = reduced(case, merged.effects)
    for own, other in zip(merged.data, together.data, strict=True):
        grams = other.grams
        size = np.sqrt(np.einsum("fii->fi", grams))
        size[size == 0.0] = 1.0
        change = np.abs(own.grams - grams) / (size[:, :, None] * size[:, None, :])
        worst = max(worst, float(change.max()))
    return worst


def cost_figure(costs: Sequence[DigestCost]) -> Figure:
    """CPU time of digests and readings of the same logs."""
    figure = style.new_figure(0.9 + 0.5 * len(costs))
    ax = style.polish(figure.subplots(), grid="x")
    labels = [f"{cost.rate:g} Hz, bandwidth {cost.bandwidth:.2g} Hz" for cost in costs]
    places = np.arange(len(costs))
    for shift, name, colour in ((-0.2, "made", style.AFTER), (0.2, "reading", style.MEASURED)):
        values = [getattr(cost, name) for cost in costs]
        bars = ax.barh(places + shift, values, color=colour, height=0.38)
        ax.bar_label(bars, [f"{name}: {v:.2g} s" for v in values], padding=4, **style.plain())
    ax.set_yticks(places, labels)
    ax.invert_yaxis()
    ax.margins(x=0.25)
    title = "CPU time of a digest, and of reading the same log with all candidates"
    ax.set_title(title, loc="left", **style.plain(fontweight="bold"))
    return figure


def main() -> None:
    """Measures, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one short log of two joints")
    parser.add_argument("--seed", type=int, default=0, help="of the motion and the noise")
    parser.add_argument("--times", type=int, default=3, help="how often times are taken")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    options = parser.parse_args()
    model = load_model(MODELS / ("double_pendulum.urdf" if options.quick else "arm7.urdf"))
    cases = [(100.0, 1.0)] if options.quick else [(100.0, 1.0), (500.0, 1.0), (1000.0, 3.0)]
    how = {"seconds": 15.0 if options.quick else 60.0, "seed": options.seed}
    times = 1 if options.quick else options.times
    costs = [measure(model, rate, pace, times=times, **how) for rate, pace in cases]
    table = [asdict(cost) for cost in costs]
    print(json.dumps(table, indent=2))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        cost_figure(costs).savefig(options.figures / "digest_speed.png")


if __name__ == "__main__":
    main()
