"""NumPy arrays in Warp kernels on the CPU, for compiled loops over rays.

On the CPU Warp runs a kernel's threads one after the other, in order.
"""

import numpy as np
import warp as wp

from slipstitch.base.warp_start import start_warp

start_warp()

_KINDS = {
    wp.int32: np.int32,
    wp.vec2i: np.int32,
    wp.vec3i: np.int32,
    wp.float32: np.float32,
    wp.vec3: np.float32,
    wp.vec4: np.float32,
    wp.float64: np.float64,
    wp.vec2d: np.float64,
}


def warp_array(values: np.ndarray, dtype) -> wp.array:
    """The same numbers for Warp; the same memory, where the types agree."""
    values = np.ascontiguousarray(values, _KINDS[dtype])
    return wp.array(values, dtype=dtype, device="cpu", copy=False)
