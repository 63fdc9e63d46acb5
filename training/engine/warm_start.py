"""Initial weights of a training from trained networks, where names and shapes match."""

import math
from dataclasses import dataclass

import torch

from training.networks.recurrent import Network

CLOSER, ZOOMED = "perception.closer.", "perception.zoomed.refiner."

OF_EVERY_BALL = ("encoder.", "perception.first.where.")
"""Parameters whose outputs there are of every ball."""


@dataclass(frozen=True)
class Initial:
    """A trained network: its name, parameters, and the training sequences that they have seen."""

    name: str
    parameters: dict[str, torch.Tensor]
    sequences: int


def load_fitting(network: Network, initial: dict[str, torch.Tensor]) -> list[str]:
    """Copy the parameters whose names and shapes fit; return the names that were taken over.

    A network that sees a final frame, several balls or their interaction has wider layers than one
    without. Inputs that the smaller network lacks begin at zero; outputs that there are of every
    ball are repeated.

    Raises
    ------
    ValueError
        When none fits.
    """
    own = network.state_dict()
    fitting = {
        name: widened for name, value in _with_zoom(placed(network, initial), own).items()
        if name in own and (widened := _widened(name, value, own[name].shape)) is not None
    }  # fmt: skip
    if not fitting:
        raise ValueError("the initial parameters share no name and shape with the network")
    network.load_state_dict(own | fitting)
    return sorted(fitting)


def placed(network: Network, parameters: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Parameters by the names in a network: perception may be part of its encoder."""
    own = network.state_dict()
    return {n if n in own else f"encoder.{n}": value for n, value in parameters.items()}


def _with_zoom(
    parameters: dict[str, torch.Tensor], own: dict[str, torch.Tensor]
) -> dict[str, torch.Tensor]:
    """Begin a zoomed pass as the closer one, without corrections, where there was none."""
    if any(ZOOMED in name for name in parameters):
        return parameters
    added = {
        name.replace(CLOSER, ZOOMED): torch.zeros_like(value) if ".correction." in name else value
        for name, value in parameters.items()
        if CLOSER in name and name.replace(CLOSER, ZOOMED) in own
    }
    return parameters | added


def _widened(name: str, value: torch.Tensor, shape: torch.Size) -> torch.Tensor | None:
    """Parameter of a narrower layer in the shape of a wider one; None when it cannot be."""
    if value.ndim != len(shape) or value.shape[2:] != shape[2:]:
        return None
    if name.startswith(OF_EVERY_BALL) and shape[0] > value.shape[0]:
        times = math.ceil(shape[0] / value.shape[0])
        value = value.repeat(times, *(1 for _ in shape[1:]))[: shape[0]]
    if value.ndim > 1 and value.shape[1] < shape[1]:
        missing = value.new_zeros(len(value), shape[1] - value.shape[1], *shape[2:])
        value = torch.cat([value, missing], dim=1)
    return value if value.shape == shape else None
