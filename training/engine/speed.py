"""A few steps of a training without keeping anything, and how near they come to the peak speed."""

import time
from dataclasses import dataclass
from statistics import median
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from training.engine.loop import TrainingLoop

SIDE = 1024
"""Side of the matrices whose product measures the peak."""
PRODUCTS = 10


@dataclass(frozen=True)
class DryRun:
    """Measurements of a few steps.

    Attributes
    ----------
    losses
        Of every step.
    flop
        Floating-point operations of a step's products and convolutions, forwards and backwards.
    step_seconds, waiting_seconds
        Median over all steps but the first: computing, and waiting for the batch.
    peak_flop_s
        Of a large matrix product, before or after the steps, in float32 or bfloat16, whichever is
        fastest.
    """

    losses: tuple[float, ...]
    flop: int
    step_seconds: float
    waiting_seconds: float
    peak_flop_s: float

    @property
    def flop_s(self) -> float:
        """Operations a second while a step computes."""
        return self.flop / self.step_seconds


def dry_run(training: TrainingLoop[Any], batches: int, device: torch.device) -> DryRun:
    """Take some steps from the first batch on; nothing is validated, nothing written.

    Parameters
    ----------
    batches
        At least 2: the operations of the first step are counted, the others are timed.
    """
    peak_before = peak_flop_s(device)
    stream = iter(training.stream())
    losses: list[float] = []
    waited: list[float] = []
    stepped: list[float] = []
    counter = FlopCounterMode(display=False)
    with counter:
        losses.append(training.step(next(stream)))
    for _ in range(batches - 1):
        begin = time.perf_counter()
        batch = next(stream)
        middle = time.perf_counter()
        losses.append(training.step(batch))
        waited.append(middle - begin)
        stepped.append(time.perf_counter() - middle)
    return DryRun(
        tuple(losses),
        counter.get_total_flops(),
        median(stepped),
        median(waited),
        max(peak_before, peak_flop_s(device)),
    )


def peak_flop_s(device: torch.device) -> float:
    """Measure the operations a second of a matrix product on torch's threads."""
    seconds: list[float] = []
    for dtype in (torch.float32, torch.bfloat16):
        matrix = torch.randn(SIDE, SIDE, device=device).to(dtype)
        for _ in range(PRODUCTS):
            begin = time.perf_counter()
            float((matrix @ matrix)[0, 0])  # waits for a GPU
            seconds.append(time.perf_counter() - begin)
    return 2 * SIDE**3 / min(seconds)
