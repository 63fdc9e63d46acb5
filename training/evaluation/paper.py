"""The paper's published figures; ``paper.json`` is their one home."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rollcast.scene import Scenario


@dataclass(frozen=True)
class Published:
    """One cell of the paper's tables (128-px units, rad/s, nats); None where it gives nothing."""

    position_error_px: float
    angular_velocity_rmse: float | None = None
    nll_nats: float | None = None


CONSTANT_POSITION = "constant position"
LINEAR_EXTRAPOLATION = "linear extrapolation"
"""The trivial baselines' names in tables."""


def published(
    scenario: Scenario, objects: int, method: str, at: str, condition: str = ""
) -> Published | None:
    """Return the published value of a method at a moment, "T=20" for example.

    Parameters
    ----------
    condition
        Condition of the scenes; "" for all scenes of the scenario.
    """
    return CELLS.get((scenario, objects, method, at, condition))


def angular_speed_rad_s(scenario: Scenario) -> float:
    """Mean angular speed over all scenes (paper, section 4)."""
    return _PAPER["angular_speed_rad_s"][scenario]


_PAPER: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
CELLS: Mapping[tuple[Scenario, int, str, str, str], Published] = {
    (
        cell["scenario"],
        cell["objects"],
        cell["method"],
        cell["at"],
        cell.get("condition", ""),
    ): Published(cell["position_error_px"], cell.get("angular_velocity_rmse"), cell.get("nll_nats"))
    for cell in _PAPER["cells"]
}
"""Every cell by scenario, number of balls, method, moment and condition."""
