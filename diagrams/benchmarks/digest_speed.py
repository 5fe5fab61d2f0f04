"""What a digest of a minute of a seven-joint arm costs: CPU time, bytes, and digits in a merger.

The arm's own model makes the log. Times are of one core, after compilation, next to the time of
reading the same log with columns for all candidates, as `diagnose` does first.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.digest_speed --json speed.json
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.harness import MODELS, cpu_times, script_parser, sines, tell
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
from geodrake.identification.logs.case import prepare_case, reduced
from geodrake.logs.motion import JointLog, Motion
from geodrake.model import RobotModel, load_model

NOISE = 0.05  # N·m


def swinging(model: RobotModel, rate: float, seconds: float, pace: float, seed: int) -> JointLog:
    """Return a log of sums of sines, up to 0.6 Hz times a pace, with efforts and noise."""
    rng, nv = np.random.default_rng(seed), len(model.joints)
    instants = np.arange(round(rate * seconds)) / rate
    rates = pace * 2 * np.pi * rng.uniform(0.05, 0.6, (6, 1, nv))
    angle, size = rng.uniform(0, 6, (6, 1, nv)), rng.uniform(0.1, 0.4, (6, 1, nv))
    q, v, vd = sines(instants, *(each[:, 0] for each in (size, rates, angle)))
    effort = model.effort(Motion(model.positions(q), v, vd)) + NOISE * rng.normal(size=q.shape)
    return JointLog(f"{seed}", model.joints, instants, q + 1e-7 * rng.normal(size=q.shape), effort)


def measure(
    model: RobotModel, rate: float, pace: float, *, seconds: float, times: int, seed: int
) -> dict[str, Any]:
    """Measure digests and readings of two logs.

    "reading" opens the same log with all candidates; "merged" is `merged_difference`.
    """
    first = swinging(model, rate, seconds, pace, seed)
    second = swinging(model, rate, seconds, 0.7 * pace, seed)  # slower, so that the first counts
    settings = make_settings(model, first)

    def digested(log: JointLog) -> Digest:
        return make_digest(model, log, settings, LogFacts(log.name, (Path(__file__),)))

    bands = {name: getattr(settings, name) for name in ("bandwidth", "motion_bandwidth")}
    digest = digested(first)
    content = digest_content(digest)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.digest"
        path.write_bytes(content)
        works = {
            "made": lambda: digested(first),
            "reading": lambda: prepare_case(model, [first], candidates=True, **bands),
            "read": lambda: read_digest(path),
        }
        least = {name: min(times) for name, times in cpu_times(works, times).items()}
    return {
        "rate": rate,
        "seconds": seconds,
        "bandwidth": digest.logs[0].bandwidth,
        "samples": int(digest.samples.max()),
        "columns": len(settings.columns),
        "bytes": len(content),
        **least,
        "merged": merged_difference(model, [first, second], [digest, digested(second)]),
    }


def merged_difference(
    model: RobotModel, logs: Sequence[JointLog], digests: Sequence[Digest]
) -> float:
    """Return the largest relative difference of merged digests from a reading of all logs."""
    settings, worst = digests[0].settings, 0.0
    case = prepare_case(
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


def main() -> None:
    """Measure, print and write."""
    options = script_parser(__doc__, "one short log of two joints").parse_args()
    name, cases = "arm7", [(100.0, 1.0), (500.0, 1.0), (1000.0, 3.0)]
    how = {"seconds": 60.0, "times": 3, "seed": options.seed}
    if options.quick:
        name, cases = "double_pendulum", cases[:1]
        how |= {"seconds": 15.0, "times": 1}
    model = load_model(MODELS / f"{name}.urdf")
    tell(options, [measure(model, rate, pace, **how) for rate, pace in cases])


if __name__ == "__main__":
    main()
