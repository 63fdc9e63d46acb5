"""The manifest of a deployed artefact ``models/NAME/VERSION/``: the service learns everything here.

Pixels are those of 128 x 128 frames, angular velocities rad/s, steps are counted from t = 0, the
last observed frame. The artefact's files and graphs are described in ``docs/decisions``.
"""

import math
from codecs import BOM_UTF8
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    model_validator,
)

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.files import read_regular_file
from rollcast.outputs import SPECS, OutputName
from rollcast.scene import COLORS, MAX_BALLS, MAX_FORECAST_OBJECTS, BallColor, Domain, Scenario
from rollcast.trajectory import OBSERVED_FRAMES

PERCEPTION_FILE = "perception.onnx"
"""Perception graph of networks that have one. Equal files are loaded once."""
ENCODER_FILE = "encoder.onnx"
ROLLOUT_FILE = "rollout.onnx"
"""Steps of the network, as many as are asked for in one call."""
MANIFEST_FILE = "manifest.json"
CARD_FILE = "MODEL_CARD.md"
GOLDEN_FILE = "golden.npz"
OOD_FILE = "ood.npz"
"""Statistics of the training frames (``rollcast.ood``); optional."""
DETECTOR_FILE, REFINER_FILE = "detector.onnx", "refiner.onnx"
"""Graphs of networks for any number of balls: detector of whole frames, refiner of patches."""
HASHED_FILES = (ENCODER_FILE, ROLLOUT_FILE, CARD_FILE, GOLDEN_FILE)
"""Files of every artefact."""
BALL_FILES = (DETECTOR_FILE, REFINER_FILE, *HASHED_FILES)
"""Files of an artefact for any number of balls."""

FRAMES_INPUT = "frames"
"""Input of the first graph, uint8 [B, frames, 128, 128, 3]; also the golden frames' name."""
PATCHES_INPUT = "patches"
"""Input of the refiner's graph, float32 [M, 4, 3, 32, 32] (``rollcast.patches``)."""
DETECTOR_OUTPUTS = ("places", "radii", "scores", "moving", "votes", "ground", "scene")
REFINER_OUTPUTS = ("offsets", "log_radius", "visible", "log_sigmas", "features")
BALL_INPUTS = ("places", "radii", "log_sigmas", "features")
"""Inputs of the encoder's graph for every ball, [B, N, ...]."""
SCENE_INPUTS = ("ground", "scene")
SPACING_INPUT = "spacing"
"""Input of the encoder's graph: time between two observed frames [B], in steps of the rollout."""
STEPS_INPUT = "steps"
"""Number of steps, an input of the rollout graph, int64 without axes."""
NEXT_PREFIX = "next_"
"""Prefix of the state's outputs: the rollout graph reads the state NAME and returns next_NAME."""


def _known(name: OutputName) -> OutputName:
    if name not in SPECS:
        raise ValueError(f"expected one of {', '.join(SPECS)}")
    return name


KnownOutput = Annotated[OutputName, AfterValidator(_known)]
Matrix2 = tuple[tuple[float, float], tuple[float, float]]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Positive = Annotated[float, Field(gt=0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StateTensor(_Part):
    """One tensor of the recurrent state."""

    name: Annotated[str, Field(min_length=1)]
    shape: tuple[int, ...]
    """Shape without the batch axis."""
    dtype: Literal["float32"] = "float32"


class Output(_Part):
    """One output of the graphs, float32."""

    name: KnownOutput
    shape: tuple[int, ...]
    """Shape without the batch axis: [objects, ...]."""
    unit: str


def gaussian_radius(share: float) -> float:
    """Return the radius, in standard deviations, that holds a share of a plane's Gaussian."""
    return math.sqrt(-2 * math.log(1 - share))


GAUSSIAN_ELLIPSE50_RADIUS = gaussian_radius(0.5)


class CovarianceSource(_Part):
    """Source of the forecast's covariances (px^2)."""

    source: Literal["predicted", "empirical"]
    """Kind: ``predicted`` by the network, or ``empirical``, from residuals on validation data."""
    variance_scale: tuple[Positive, ...] | None = None
    """Factors on predicted covariances by step; the last one holds for all later steps."""
    empirical: tuple[Matrix2, ...] | None = None
    """Covariances of the residuals by step; the last one holds for all later steps."""
    ellipse50_radius: Annotated[tuple[Positive, ...], Field(min_length=1)] | None = None
    """Radii by step, in standard deviations, of the ellipse that contains half of the validation
    data; the last one holds for all later steps, None is a Gaussian's. Residuals with heavy tails
    have smaller radii."""

    @model_validator(mode="after")
    def _source_and_values_agree(self) -> "CovarianceSource":
        if (self.source == "empirical") != bool(self.empirical):
            raise ValueError(
                "empirical covariances belong to the source 'empirical', and only there"
            )
        if self.variance_scale is not None and self.source != "predicted":
            raise ValueError("variance_scale belongs to the source 'predicted'")
        return self


class MetricRow(_Part):
    """Accuracy on one split of one scenario up to one horizon."""

    split: Literal["validation", "test"]
    scenario: Domain
    horizon: Annotated[int, Field(ge=1)]
    """Number of steps; the error is that of step ``horizon - 1``."""
    sequences: Annotated[int, Field(ge=1)]
    position_error_px: float
    """Mean distance between forecast and truth."""
    standard_error_px: float | None = None
    angular_velocity_rmse: float | None = None
    """Root mean square error in rad/s."""
    nll_nats: float | None = None
    """Mean negative log likelihood, nats."""
    coverage_50: float | None = None
    """Share of truths inside the 50 % ellipse."""
    coverage_95: float | None = None
    constant_position_px: float | None = None
    """Error of the baseline that stays at the true position of t = 0, same scenes."""
    linear_extrapolation_px: float | None = None
    """Error of a line through the first 10 true positions, same scenes."""


class Parity(_Part):
    """Comparison of the outputs of the exported graphs with those of torch."""

    max_abs_error: dict[KnownOutput, float]
    """Maximum over batch sizes and horizons, in each output's own unit."""
    tolerance: dict[KnownOutput, float]


class OodThreshold(_Part):
    """Threshold of the out-of-distribution score of frames (``rollcast.ood``)."""

    threshold: Positive
    """Score above which frames are out of distribution."""
    false_alarm_rate: Annotated[float, Field(ge=0, le=1)]
    """Share of the in-distribution windows of the test split above the threshold."""
    test_windows: Annotated[int, Field(ge=1)]


class PlaceUncertainty(_Part):
    """Threshold of the standard deviation of a ball's position at t = 0 (decision 0145)."""

    threshold_px: Positive
    """Value above which a ball counts as lost, pixels of 128."""
    false_alarm_rate: Annotated[float, Field(ge=0, le=1)]
    """Share of the test split's windows without hidden balls above the threshold."""
    test_windows: Annotated[int, Field(ge=1)]


class CameraSetup(_Part):
    """The set-up whose footage a model was trained on."""

    colors: tuple[BallColor, ...]
    """Color of each ball, in the order of the tracks."""
    crop: tuple[int, int, Annotated[int, Field(ge=1)]]
    """Square of the camera's pictures that frames show: x, y and side in pixels."""


class KinematicSource(_Part):
    """Kinematic forecasts (:mod:`rollcast.kinematics`) beside those of a model's network."""

    acceleration_ratio: Annotated[float, Field(ge=0)]
    """Standard deviation of the change of velocity per step, relative to the speed."""
    level_slope: Annotated[float, Field(ge=0)]
    """Maximum mean slope of the ground under a ball's path for which "auto" returns the kinematic
    forecast; with 0 it always returns the forecast of the network."""


class Manifest(_Part):
    """Description of one version of one model."""

    format_version: Literal[3]
    """Version of these keys and of the names of an artefact's files (decision 0155)."""
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,63}$")]
    version: Annotated[int, Field(ge=1)]
    default: bool
    """Mark of the version that a name without version selects."""
    variant: Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
    preset: str
    scenarios: Annotated[tuple[Domain, ...], Field(min_length=1)]
    objects: Annotated[int, Field(ge=1, le=MAX_FORECAST_OBJECTS)]
    """Number of balls; if variable, the number without prompts."""
    max_objects: Annotated[int, Field(ge=1, le=MAX_BALLS)] | None = None
    """Maximum number of balls; None if the number is fixed. A variable number makes the second axis
    of state and outputs dynamic."""
    observed_frames: Literal[4]
    frames: Literal[4, 5]
    """Frames that the encoder reads: the observed ones and, with 5, the final one."""
    final_step: Annotated[int, Field(ge=1)] | None = None
    """Step that the final frame shows; None with 4 frames."""
    frame_rate_hz: Positive
    """Rate of the steps, and of the frames unless ``frame_rates_hz`` says otherwise."""
    frame_rates_hz: tuple[Positive, Positive] | None = None
    """Lowest and highest rate of frames whose spacing the encoder reads."""
    frame_size: Literal[128]
    trained_horizon: Annotated[int, Field(ge=1)]
    state: Annotated[tuple[StateTensor, ...], Field(min_length=1)]
    outputs: Annotated[tuple[Output, ...], Field(min_length=1)]
    covariance: CovarianceSource
    angular_velocity: bool
    training: dict[str, JsonValue]
    """Data seed and sizes, number of sequences, configuration, in free form for readers."""
    metrics: tuple[MetricRow, ...]
    validation_error_px: Annotated[float, Field(ge=0)]
    """Mean position error over all scenarios, validation split, at T = 20 for one ball and T = 15
    for several, independent of the trained horizon: "auto" compares only this number."""
    parity: Parity
    golden_tolerance: dict[KnownOutput, Positive]
    """Largest absolute difference from golden.npz at which the model is served."""
    setup: CameraSetup | None = None
    """Camera set-up of models for footage; None for all others."""
    random_appearances: bool = False
    """Training on frames of random appearance: "auto" uses such a model where the frames are out of
    distribution for the model that it would choose."""
    kinematic: KinematicSource | None = None
    """Kinematic forecasts of models for any number of balls; None for others."""
    place_uncertainty: PlaceUncertainty | None = None
    """Detection of lost balls, in models for a fixed number of balls that predict covariances."""
    ood: OodThreshold | None = None
    """Out-of-distribution threshold; None without the statistics of the training frames."""
    files: dict[str, Sha256]
    licence: str

    @model_validator(mode="after")
    def _parts_fit(self) -> "Manifest":
        shapes: dict[OutputName, tuple[int, ...]] = {
            output.name: output.shape for output in self.outputs
        }
        has: dict[OutputName, bool] = {
            "positions": True,
            "covariances": self.covariance.source == "predicted",
            "angular_velocities": self.angular_velocity,
            "final_positions": self.final_step is not None,
        }
        wanted = {name for name in SPECS if has.get(name, name in shapes)}
        if set(shapes) != wanted or len(self.outputs) != len(wanted):
            raise ValueError(f"outputs are {sorted(shapes)}, expected {sorted(wanted)}")
        for name, shape in shapes.items():
            if shape != (self.objects, *SPECS[name].shape):
                raise ValueError(f"output {name} has shape {shape} for {self.objects} objects")
        if (self.final_step is not None) != (self.frames == OBSERVED_FRAMES + 1):
            raise ValueError(f"final_step is {self.final_step} with {self.frames} frames")
        if (self.kinematic is None) != (self.max_objects is None):
            raise ValueError("kinematic belongs to models with max_objects")
        files = set(HASHED_FILES if self.max_objects is None else BALL_FILES)
        if set(self.files) - {PERCEPTION_FILE, OOD_FILE} != files:
            raise ValueError(f"files are {sorted(self.files)}, expected {sorted(files)}")
        if (self.setup is not None) != ("footage" in self.scenarios):
            raise ValueError(f"setup belongs to footage, the scenarios are {self.scenarios}")
        if len(self.colors) != self.objects:
            raise ValueError(f"setup has {len(self.colors)} colors for {self.objects} objects")
        if (self.ood is None) == (OOD_FILE in self.files):
            raise ValueError(f"{OOD_FILE} and ood belong together")
        if set(self.golden_tolerance) != wanted:
            raise ValueError(f"golden_tolerance names {sorted(self.golden_tolerance)}")
        return self

    @property
    def label(self) -> str:
        """NAME@VERSION."""
        return f"{self.name}@{self.version}"

    def follows(self, objects: int) -> bool:
        """Tell whether it forecasts so many balls."""
        return self.objects <= objects <= (self.max_objects or self.objects)

    def error_at(self, horizon: int) -> float:
        """Return the mean position error in px, validation split, at a horizon.

        Between measured horizons it is interpolated, beyond the last one it is that one's.
        """
        scenarios = {row.scenario for row in self.metrics if row.split == "validation"}
        if not scenarios:
            return self.validation_error_px
        errors: list[float] = []
        for scenario in scenarios:
            rows = sorted(
                (row.horizon, row.position_error_px)
                for row in self.metrics
                if (row.split, row.scenario) == ("validation", scenario)
            )
            known, measured = zip(*rows, strict=True)
            errors.append(float(np.interp(horizon, known, measured)))
        return sum(errors) / len(errors)

    @property
    def simulated(self) -> tuple[Scenario, ...]:
        """Its scenarios, all of them simulated.

        Raises
        ------
        ValueError
            When it knows footage, of which no scenes can be made.
        """
        known: list[Scenario] = []
        for scenario in self.scenarios:
            if scenario == "footage":
                raise ValueError(f"{self.label} knows footage: there are no scenes to try it on")
            known.append(scenario)
        return tuple(known)

    @property
    def colors(self) -> tuple[BallColor, ...]:
        """Colour of each ball, in the order of all outputs."""
        return COLORS[: self.objects] if self.setup is None else self.setup.colors

    @property
    def output_names(self) -> tuple[OutputName, ...]:
        """Names of the encoder's outputs, in the manifest's order."""
        return tuple(output.name for output in self.outputs)

    @property
    def step_output_names(self) -> tuple[OutputName, ...]:
        """Names of the rollout graph's outputs, those of every step."""
        return tuple(name for name in self.output_names if SPECS[name].is_per_step)

    @property
    def frames_shape(self) -> tuple[int, int, int, int]:
        """Shape of the encoder's input without the batch axis."""
        return (self.frames, NETWORK_FRAME_SIZE, NETWORK_FRAME_SIZE, 3)

    @classmethod
    def read(cls, path: Path) -> "Manifest":
        """Read a manifest file.

        Raises
        ------
        OSError
            When the file cannot be read.
        pydantic.ValidationError
            When it is not a manifest; the error names every field that is wrong.
        """
        return cls.model_validate_json(read_regular_file(path).removeprefix(BOM_UTF8))

    def write(self, path: Path) -> None:
        """Write the manifest as indented JSON, so that versions can be compared line by line.

        The file is replaced as a whole, and exporters write it last.
        """
        unfinished = path.with_name(f"{path.name}.tmp")
        unfinished.write_text(self.model_dump_json(indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)
