"""Short trainings without validation, which end with learning rates of zero."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

MAX_GRADIENT_NORM = 0.5


def cosine_descent(
    loss_at: Callable[[np.random.Generator, float], Tensor],
    groups: Sequence[Mapping[str, Any]],
    *,
    batches: int,
    weight_decay: float,
    seed: int,
    mask_gradients: Callable[[], None] = lambda: None,
) -> Iterator[float]:
    """Minimise a loss with AdamW; yield the loss of every batch.

    Parameters
    ----------
    loss_at
        Loss of a batch, from its random generator and the fraction of the budget that has passed.
    groups
        Parameter groups of the optimiser: ``params`` and their initial learning rate ``lr``, which
        falls to 0 along half a cosine.
    batches
        Budget.
    mask_gradients
        Function that sets gradients of parameters that stay constant to 0.
    """
    optimiser = torch.optim.AdamW([dict(group) for group in groups], weight_decay=weight_decay)
    rates = [group["lr"] for group in optimiser.param_groups]
    parameters = [one for group in optimiser.param_groups for one in group["params"]]
    for number in range(batches):
        progress = number / batches
        for group, rate in zip(optimiser.param_groups, rates, strict=True):
            group["lr"] = rate * 0.5 * (1 + np.cos(np.pi * progress))
        loss = loss_at(np.random.default_rng([seed, number]), progress)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        mask_gradients()
        if torch.isfinite(torch.nn.utils.clip_grad_norm_(parameters, MAX_GRADIENT_NORM)):
            optimiser.step()
        yield loss.item()
