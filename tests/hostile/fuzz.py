"""A fuzzer of the command line: files that were right once, changed at random places.

    python tests/hostile/fuzz.py --cases 5000 --seed 0 --json fuzz.json

Hypothesis draws the changes to a CSV or NPZ log, a URDF, SDF, MJCF, directives or saved model, or a
file of effects, and the command that reads it. Every case runs in a process of its own. None may be
called a bug of geodrake, end by a signal, take longer than 30 s, print or write a number that is
none, or change a file after it failed. What broke that is kept in a folder, to be looked at.
"""

import argparse
import json
import os
import shlex
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import hypothesis
from fuzz_cases import COMMANDS, FILES, cases, inside
from hostile import changed, check_words, contents, fill, read_json, run_forked, run_here
from rich.console import Console
from rich.progress import Progress
from rich.table import Table


def verdict(case, folder):
    """How a case ends in an empty folder: in words, whether that may be, and what was printed."""
    fill(folder)
    (folder / FILES[case.kind]).write_bytes(case.data)
    before = contents(folder)
    status, out, err = run_forked(shlex.split(case.words), folder)
    if status is None:
        return "hang", False, out + err
    if os.WIFSIGNALED(status):
        return signal.Signals(os.WTERMSIG(status)).name, False, out + err
    code = os.waitstatus_to_exitcode(status)
    try:
        assert code in (0, 2), f"exit code {code}"
        check_words(out, err)
        assert code == 0 or out == "", "results of a failure"
        written = {"kept.json", "kept.yaml"} if code == 0 else set()
        found = changed(before, contents(folder))
        if code:  # a mapping may be proposed for a log whose columns are not understood
            found = {name for name in found if not name.endswith(".mapping.yaml")}
        assert found <= written, "changed file"
        if code == 0:
            read_json(folder / "kept.json")
    except AssertionError as error:
        return str(error).partition(":")[0], False, out + err
    return ("result" if code == 0 else "refused"), True, out + err


def warm_up():
    """Run every command once, so that forked processes find all modules imported."""
    with tempfile.TemporaryDirectory() as name, inside(Path(name)) as folder:
        fill(folder)
        for command in dict.fromkeys(COMMANDS):
            code, _, err = run_here([*command.split(), "robot.urdf", "log.csv"])
            assert code == 0, (command, err)


def run(kind, count, *, seed, tell=lambda: None):
    """Draw so many cases of a kind of file and run them.

    Args:
        kind: Kind of file, a key of `FILES`.
        count: How many.
        seed: Of the draws.
        tell: Called after every case.

    Returns:
        How often each end came, and (end, case, what was printed) of those that may not be.
    """
    ends, broken = Counter(), []

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(cases(kind))
    def one(case):
        with tempfile.TemporaryDirectory() as name:
            end, held, printed = verdict(case, Path(name))
        ends[end] += 1
        if not held:
            broken.append((end, case, printed))
        tell()

    one()
    return ends, broken


def keep(broken, folder):
    """Write the files of broken cases, their commands and what was printed into a folder."""
    for number, (end, case, printed) in enumerate(broken):
        target = folder / f"{case.kind.replace(' ', '_')}_{number:03d}"
        target.mkdir(parents=True, exist_ok=True)
        (target / FILES[case.kind]).write_bytes(case.data)
        words = f"{end}\ngeodrake {case.words}\n{printed}"
        (target / "ended.txt").write_text(words, encoding="utf-8")


def main(arguments=None):
    """Run the fuzzer from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=5000, help="over all kinds of files")
    parser.add_argument("--quick", action="store_true", help="only 16 cases")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the counts here")
    parser.add_argument("--keep", type=Path, help="folder for what broke")
    parser.add_argument("--kind", action="append", choices=FILES, help="only this; repeatable")
    options = parser.parse_args(arguments)
    kinds = options.kind or list(FILES)
    each = -(-(16 if options.quick else options.cases) // len(kinds))
    counts, broken, begin = {}, 0, time.perf_counter()
    warm_up()
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("fuzzing", total=each * len(kinds))
        for kind in kinds:
            counts[kind], own = run(
                kind, each, seed=options.seed, tell=lambda: progress.advance(task)
            )
            broken += len(own)
            if options.keep:
                keep(own, options.keep)
            if options.json:  # of what is done, should the rest be interrupted
                total = sum(ends.total() for ends in counts.values())
                numbers = {"seed": options.seed, "cases": total, "broken": broken, "counts": counts}
                options.json.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
    endings = sorted({end for ends in counts.values() for end in ends})
    shown = Table("kind", *endings)
    for kind, ends in counts.items():
        shown.add_row(kind, *(str(ends[end]) for end in endings))
    Console(width=160).print(shown)
    total = sum(ends.total() for ends in counts.values())
    print(f"{total} cases, {broken} broken, {time.perf_counter() - begin:.0f} s")
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
