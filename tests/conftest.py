"""Settings of all tests: threads, the mark `quick`, and public measurements that may be absent."""

import gc
import os
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path

import hypothesis
import pytest
import typer.testing
from measurements import MEASUREMENTS, absent

# Before numpy is imported: two test processes with two BLAS threads each get in each other's way.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples on every machine, and no limits of time by the clock on the wall.
hypothesis.settings.register_profile(
    "any machine",
    deadline=None,
    derandomize=True,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("any machine")

# Typer's runner makes the commands anew for every call, though they are the same.
if hasattr(typer.testing, "_get_command"):
    typer.testing._get_command = cache(typer.testing._get_command)

# What is not quick: studies, files that mean harm, and modules that import what starts processes,
# runs commands, simulates or searches.
LONG_FOLDERS = {"diagrams", "hostile"}
LONG_MODULES = {
    "subprocess",
    "runpy",
    "typer.testing",
    "adaptive_loops",
    "pinocchio_logs",
    "servo_logs",
}
LONG_FUNCTIONS = {
    "check_columns",
    "compare_regularizers",
    "design_excitation",
    "explain",
    "diagnose",
    "add",
    "roll_out",
    "draft_effects",
    "export_to",
    "make_digest",
    "Simulator",
}
LONG_MARKS = ("thorough", "measurements")


def is_long(name, value):
    """Return whether a global of a test module takes long to run."""
    return name in LONG_FUNCTIONS or not LONG_MODULES.isdisjoint(
        (getattr(value, "__name__", None), getattr(value, "__module__", None))
    )


@cache
def is_quick(module):
    """Return whether a module tests parts of geodrake rather than whole commands."""
    return Path(module.__file__).parent.name not in LONG_FOLDERS and not any(
        is_long(name, value) for name, value in vars(module).items()
    )


def pytest_ignore_collect(collection_path, config):
    """Ignore folders without quick tests if only these are asked for."""
    asked = config.option.markexpr == "quick"
    return True if asked and collection_path.name in LONG_FOLDERS else None


@pytest.hookimpl(tryfirst=True)  # before marks decide what is run
def pytest_collection_modifyitems(items):
    cases = Counter()
    for item in items:
        if mark := item.get_closest_marker("sampled"):
            test = item.module, item.originalname
            if cases[test] % mark.args[0]:
                item.add_marker("thorough")
            cases[test] += 1
        takes_long = "browser" in item.fixturenames or any(map(item.get_closest_marker, LONG_MARKS))
        if is_quick(item.module) and not takes_long:
            item.add_marker("quick")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session):
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    session.items[:] = deal_out(session.items, workers)
    gc.freeze()  # what is imported and collected stays; no search for garbage needs to look there
    gc.set_threshold(20_000, 20, 20)  # what tests leave is mostly freed by counting references


def deal_out(items, workers):
    """Return the tests in the order in which processes with equal shares end soonest.

    Each process begins with its own modules that search and simulate, whose fixtures are then
    created once. At the end, they take small tests of hostile input from each other.
    """
    modules = defaultdict(list)
    for item in items:
        modules[item.module].append(item)
    long = [m for m in modules if not is_quick(m) and Path(m.__file__).parent.name != "hostile"]
    hands = [[i for m in long[k::workers] for i in modules[m]] for k in range(workers)]
    rest = [i for m in modules if m not in long for i in modules[m]]
    dealt = []
    for k, hand in enumerate(hands):
        share = max(0, (len(items) - len(dealt)) // (workers - k) - len(hand))
        dealt += hand + rest[:share]
        rest = rest[share:]
    return dealt + rest


def pytest_runtest_setup(item):
    for mark in item.iter_markers("measurements"):
        if missing := absent(mark.args):
            words = f"{', '.join(missing)} in {MEASUREMENTS} (or GEODRAKE_MEASUREMENTS)"
            pytest.skip(f"needs public measurements: {words}")
