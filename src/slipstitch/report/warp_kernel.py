"""Compiles and runs one Warp kernel on the CPU; ``slipstitch doctor`` runs it as a process."""

import warp as wp

from slipstitch.base.warp_start import start_warp


@wp.kernel
def double(values: wp.array(dtype=wp.float64)):
    """values := 2 values, element by element."""
    i = wp.tid()
    values[i] = wp.float64(2.0) * values[i]


if __name__ == "__main__":
    start_warp()
    array = wp.full(3, 2.0, dtype=wp.float64, device="cpu")
    wp.launch(double, dim=3, inputs=[array], device="cpu")
    if not (array.numpy() == 4.0).all():
        raise SystemExit("a kernel gives wrong results")
    print(wp.config.version)
