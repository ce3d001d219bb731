"""Set-up of torch: bitwise reproducible, and without returning memory to the system."""

import ctypes

import torch

# Numbers of options in glibc's malloc.h.
GLIBC_M_TRIM_THRESHOLD, GLIBC_M_MMAP_THRESHOLD = -1, -3


def set_up_torch(threads: int) -> None:
    """Deterministic algorithms and a fixed number of threads (more of them, other roundings)."""
    torch.use_deterministic_algorithms(True)
    # Else every new tensor is filled with NaN first: an eighth of the time.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    # Let glibc keep large blocks, of which every step takes and frees the same: the system would
    # allocate them again, page by page, a twentieth to a twelfth of a step's time.
    if set_option := getattr(ctypes.CDLL(None), "mallopt", None):
        set_option(GLIBC_M_MMAP_THRESHOLD, 2**30)
        set_option(GLIBC_M_TRIM_THRESHOLD, 2**31 - 1)
    torch.set_num_threads(threads)


def computes_bfloat16(precision: str) -> bool:
    """Whether convolutions compute in bfloat16; ``auto``: if the processor does (AVX512-BF16)."""
    if precision == "auto":
        return bool(torch.cpu._is_avx512_bf16_supported())
    return precision == "bfloat16"
