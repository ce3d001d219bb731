"""One thread for NumPy's and SciPy's linear algebra: with several, sums round differently.

The same numbers then come out wherever a verb is started. Where more threads pay (training,
rendering, hashing), the stage has a setting of its own, which this leaves alone. Standard library
only: it must come before NumPy.
"""

import os

#: What OpenBLAS, MKL and OpenMP read when they are loaded.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def use_one_thread() -> None:
    """Let libraries that are loaded from now on use one thread, whatever the environment says."""
    os.environ.update(ONE_THREAD)
