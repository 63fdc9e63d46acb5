"""Shows how hard the world is beside the paper's: its averages, re-measured (decision 0014)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.markdown import table
from rollcast.scene import SCENARIOS, Scenario
from rollcast.simulation import Simulator
from rollcast.simulation.recording import STOPPED_M_S, TEST_START
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ
from training.baselines.least_squares import POINTS, polynomial
from training.data.splits import seeds
from training.evaluation.paper import LINEAR_EXTRAPOLATION, angular_speed_rad_s, published

LONGEST_FRAMES = 900
"""Frames in which every ball has long stopped."""


@dataclass(frozen=True)
class Difficulty:
    """Averages over scenes of one scenario."""

    linear_extrapolation_px: tuple[float, float]
    angular_speed_rad_s: float
    """Mean angular speed until the ball stops."""


def measure(scenario: Scenario, scenes: int) -> Difficulty:
    """Simulate scenes of the validation split and measure them as the paper's tables do."""
    camera = camera_for(scenario, NETWORK_FRAME_SIZE)
    simulator = Simulator()
    start = TEST_START[scenario]
    errors: list[np.ndarray] = []
    speed_sum, frames = 0.0, 0
    for seed in seeds("validation", scenes):
        trajectory = simulator.sequence(scenario, 1, seed, LONGEST_FRAMES, 0).trajectory
        positions = camera.project(trajectory.positions_m[:, 0])
        line = polynomial(positions[None, None, start : start + POINTS], 1, 40)[0, 0]
        truth = positions[start + FIRST_FORECAST_FRAME :]
        errors.append(np.linalg.norm(line[[19, 39]] - truth[[19, 39]], axis=-1))
        moved = np.linalg.norm(np.diff(trajectory.positions_m[:, 0], axis=0), axis=-1)
        last = int(np.flatnonzero(moved * FRAME_RATE_HZ >= STOPPED_M_S)[-1]) + 1
        spin = np.linalg.norm(trajectory.angular_velocities_rad_s[:last, 0], axis=-1)
        speed_sum, frames = speed_sum + float(spin.sum()), frames + last
    simulator.close()
    at_20, at_40 = np.mean(errors, axis=0).tolist()
    return Difficulty((at_20, at_40), speed_sum / frames)


def report(scenes: int) -> str:
    """Markdown table of our world beside the paper's."""
    lines: list[Sequence[str]] = []
    for scenario in SCENARIOS:
        ours = measure(scenario, scenes)
        line = [
            f"{error:.1f} ({_line_of_the_paper(scenario, at)})"
            for error, at in zip(ours.linear_extrapolation_px, ("T=20", "T=40"), strict=True)
        ]
        speed = f"{ours.angular_speed_rad_s:.2f} ({angular_speed_rad_s(scenario)})"
        lines.append((scenario, *line, speed))
    head = ("linear T=20 px (paper)", "linear T=40 px (paper)", "angular speed rad/s (paper)")
    return table(("scenario", *head), lines)


def _line_of_the_paper(scenario: Scenario, at: str) -> str:
    cell = published(scenario, 1, LINEAR_EXTRAPOLATION, at)
    return "-" if cell is None else str(cell.position_error_px)
