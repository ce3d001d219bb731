"""One thread for NumPy's and SciPy's linear algebra: with several, sums round differently.

The same numbers then come out wherever a verb is started. Where more threads pay (training,
rendering, hashing), the stage has a setting of its own, which this leaves alone. Standard library
only: it must come before NumPy.
"""

import os

#: What OpenBLAS, MKL and OpenMP read when they are loaded. OpenMP's threads wait for each other
#: asleep: awake, they take the processor from the one they wait for wherever something else runs,
#: and a recurrent layer of two threads then takes 300 times as long.
SETTINGS = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "OMP_WAIT_POLICY": "PASSIVE",
}


def use_one_thread() -> None:
    """Let libraries that are loaded from now on use one thread, whatever the environment says."""
    os.environ.update(SETTINGS)
