"""Devices of torch that train."""

import torch


def chosen_device(name: str) -> torch.device:
    """Return a device by its name in torch, such as "cpu" or "cuda:1"; "auto" prefers a GPU.

    Raises
    ------
    ValueError
        If this torch does not have the device.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:  # torch without CUDA raises the latter
        reason = str(error).splitlines()[0].rstrip(".")
        raise ValueError(f"{name}: {reason}; every torch has the device cpu") from error
    return device
