"""The device on which forces are evaluated."""

import numpy as np
import pytest
import warp as wp

from slipstitch.base.errors import BadInput
from slipstitch.config.simulation import SimulationSettings
from slipstitch.physics.cloth import bending, contact, elasticity, proximity, self_contact
from slipstitch.physics.simulation.drop_and_drag import DropAndDrag, simulate_drop_and_drag

RUN = DropAndDrag("gray-interlock", 0.5, 1)
SETTINGS = SimulationSettings(vertices_per_side=9, frames=4, frame_rate_hz=4, settle_s=0.2)


@pytest.mark.slow
def test_every_kernel_compiles_for_a_gpu(tmp_path):
    """Without one: to PTX for compute capability 8.0; sums into shared entries are atomic."""
    sources = {}
    for module in (elasticity, bending, proximity, self_contact, contact):
        # Not with strip_hash: it would stay on, and kernels of other versions be loaded.
        options = {"arch": 80, "module_dir": tmp_path, "use_ptx": True}
        (compiled,) = wp.compile_aot_module(wp.get_module(module.__name__), **options)
        sources[module] = compiled.read_text()
        assert ".target sm_80" in sources[module]
    for module in (elasticity, bending):
        source = sources[module]
        assert ".add.f64" in source and ("atom." in source or "red." in source)


@pytest.mark.skipif(wp.is_cuda_available(), reason="there is such a device")
def test_a_device_that_is_not_there_is_bad_input():
    message = "device cuda: not available on this machine; available: cpu"
    with pytest.raises(BadInput, match=message):
        simulate_drop_and_drag(RUN, SETTINGS, device="cuda")


@pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")
def test_a_gpu_gives_the_hanging_cloth_of_the_cpu_to_a_micrometre():
    (here, _), (there, _) = (
        simulate_drop_and_drag(RUN, SETTINGS, device=device) for device in ("cpu", "cuda")
    )
    assert np.abs(here.positions_m - there.positions_m).max() < 1e-6
