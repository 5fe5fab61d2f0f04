"""What holds for all tests: one thread a process, and public measurements that may be absent."""

import os

import pytest
from measurements import MEASUREMENTS, absent

# Before numpy is imported: two test processes with two BLAS threads each get in each other's way.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ.setdefault("MPLBACKEND", "Agg")


def pytest_runtest_setup(item):
    for mark in item.iter_markers("measurements"):
        if missing := absent(mark.args):
            words = f"{', '.join(missing)} in {MEASUREMENTS} (or GEODRAKE_MEASUREMENTS)"
            pytest.skip(f"needs public measurements: {words}")
