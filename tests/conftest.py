"""What holds for all tests: one thread for each of the processes that run them."""

import os

# Before numpy is imported: two test processes with two BLAS threads each get in each other's way.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
