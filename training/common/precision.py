"""Where training computes in bfloat16, and where it must not."""

from contextlib import AbstractContextManager, nullcontext

import torch


def mixed_precision(device: torch.device) -> AbstractContextManager[object]:
    """Use automatic mixed precision with bfloat16 on processors that support it.

    Without AVX-512 torch convolves bfloat16 number by number, some twenty times as slowly as
    float32.
    """
    made_for_it = device.type != "cpu" or "AVX512" in torch.backends.cpu.get_cpu_capability()
    return torch.autocast(device.type, torch.bfloat16, enabled=made_for_it)


def full_precision(device: torch.device) -> AbstractContextManager[object]:
    """Leave mixed precision: a rollout adds small changes, which bfloat16 would round away."""
    if torch.is_autocast_enabled(device.type):
        return torch.autocast(device.type, enabled=False)
    return nullcontext()
