"""Warp, started quietly: standard output belongs to results, standard error to what matters."""

import ctypes
import os

import warp


def start_warp() -> None:
    """Start Warp; on a machine without NVIDIA's driver, without its warning that there is none."""
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
