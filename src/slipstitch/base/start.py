"""How libraries are started: linear algebra on one thread, Warp without a word.

Nothing is imported here before a function needs it: threads are set before NumPy is loaded.
"""

import ctypes
import os

#: What OpenBLAS, MKL and OpenMP read when they are loaded. With several threads sums round
#: differently; where more pay (training, rendering, hashing) the stage has a setting of its own.
#: OpenMP's threads wait for each other asleep: awake, they take the processor from the one they
#: wait for wherever something else runs, and a recurrent layer takes 300 times as long.
SETTINGS = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "OMP_WAIT_POLICY": "PASSIVE",
}


def use_one_thread() -> None:
    """Let libraries that are loaded from now on use one thread, whatever the environment says."""
    os.environ.update(SETTINGS)


def start_warp() -> None:
    """Start Warp; on a machine without NVIDIA's driver, without its warning that there is none."""
    import warp

    warp.config.log_level = warp.LOG_WARNING
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        # The warning is printed by compiled code, to the file descriptor.
        kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, 2)
            warp.init()
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            os.close(nowhere)
