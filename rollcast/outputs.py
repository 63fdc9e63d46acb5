"""Outputs of forecasts: one table for graphs, responses, tensors, clients and tables.

Everything that handles outputs loops over :data:`OUTPUTS`. Another output is another row here, and
a read-out with its name in ``training.networks``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

OutputName = str


class Units(NamedTuple):
    """Units of a frame relative to those of another one."""

    length: float = 1.0
    """Pixels per pixel of the other frame."""
    rate: float = 1.0
    """Frame rate divided by the one of the other frames."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Pixels by which coordinates are less."""


Rescale = Callable[[np.ndarray, Units], np.ndarray]


@dataclass(frozen=True)
class OutputSpec:
    """One output of forecasts, float32."""

    name: OutputName
    """Name, a plural."""
    shape: tuple[int, ...]
    """Shape of the values of one ball at one step."""
    unit: str
    """Unit in a manifest."""
    tolerance: float
    """Largest difference between torch and ONNX Runtime, in the output's unit."""
    quantised_tolerance: float
    """Largest difference between torch and 8-bit perception, in the output's unit."""
    rescale: Rescale
    """Conversion from 128-pixel frames at the model's frame rate."""
    columns: Mapping[str, tuple[int, ...]]
    """Columns of tables: index into the values of one ball at one step, by name."""
    description: str
    """Description for the API's documents."""
    is_required: bool = False
    """Presence in every forecast."""
    is_per_step: bool = True
    """Presence of a time axis; without it a forecast has one value per ball."""

    @property
    def step_name(self) -> str:
        """Name of the value at one step: the singular (the demo page forms the plural)."""
        if self.name.endswith("ies"):
            return f"{self.name.removesuffix('ies')}y"
        return self.name.removesuffix("s")


def _place(values: np.ndarray, units: Units) -> np.ndarray:
    return values * units.length - np.array(units.origin, np.float32)


def _area(values: np.ndarray, units: Units) -> np.ndarray:
    return values * units.length**2


def _rate(values: np.ndarray, units: Units) -> np.ndarray:
    return values * units.rate


OUTPUTS: Final[tuple[OutputSpec, ...]] = (
    OutputSpec(
        name="positions",
        shape=(2,),
        unit="px",
        tolerance=1e-2,
        quantised_tolerance=1.0,
        rescale=_place,
        columns={"x_px": (0,), "y_px": (1,)},
        description="x and y, pixels.",
        is_required=True,
    ),
    OutputSpec(
        name="covariances",
        shape=(2, 2),
        unit="px^2",
        tolerance=5e-2,
        quantised_tolerance=0.5,
        rescale=_area,
        columns={"xx_px2": (0, 0), "xy_px2": (0, 1), "yy_px2": (1, 1)},
        description="Covariance of the position, square pixels.",
        is_required=True,
    ),
    OutputSpec(
        name="angular_velocities",
        shape=(3,),
        unit="rad/s",
        tolerance=5e-2,
        quantised_tolerance=0.5,
        rescale=_rate,
        columns={"wx_rad_s": (0,), "wy_rad_s": (1,), "wz_rad_s": (2,)},
        description="x, y and z, rad/s; None when the model has none.",
    ),
    OutputSpec(
        name="final_positions",
        shape=(2,),
        unit="px",
        tolerance=1e-2,
        quantised_tolerance=1.0,
        rescale=_place,
        columns={},
        description="Position of each ball in the final frame, pixels; None without one.",
        is_per_step=False,
    ),
)
"""All outputs, in the order of graphs, tensors and columns."""

STEP_OUTPUTS: Final = tuple(spec for spec in OUTPUTS if spec.is_per_step)
FORECAST_OUTPUTS: Final = tuple(spec for spec in OUTPUTS if not spec.is_per_step)
SPECS: Final[Mapping[OutputName, OutputSpec]] = {spec.name: spec for spec in OUTPUTS}


def rescaled(values: Mapping[OutputName, np.ndarray], units: Units) -> dict[OutputName, np.ndarray]:
    """Return outputs [..., *shape] in other units."""
    return {name: SPECS[name].rescale(value, units) for name, value in values.items()}
