"""The answers of ``rollcast.client.testing``: balls on lines, and refusals."""

import base64
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from pydantic import BaseModel, ValidationError

from rollcast.camera import camera_for
from rollcast.frames import encode_png
from rollcast.manifest import GAUSSIAN_ELLIPSE50_RADIUS
from rollcast.outputs import FORECAST_OUTPUTS, STEP_OUTPUTS, OutputName
from rollcast.scene import COLORS, SCENARIOS, Scene
from rollcast.schemas import (
    DEFAULT_HORIZON,
    BallPrompt,
    DetectedBall,
    DetectRequest,
    DetectResponse,
    ForecastObject,
    ModelDetail,
    ModelReference,
    PredictRequest,
    PredictResponse,
    PredictTiming,
    Problem,
    SeenBall,
    SimulatedObject,
    SimulateRequest,
    SimulateResponse,
    StreamBall,
    StreamDone,
    StreamObject,
    StreamStep,
    SurfaceGrid,
)
from rollcast.surfaces import surface_of
from rollcast.trajectory import FIRST_FORECAST_FRAME, FRAME_RATE_HZ, OBSERVED_FRAMES

NAME = "fake"
"""Name of the only model."""
TRAINED_HORIZON = 20
START = np.array([0.3, 0.3])
BELOW = np.array([0.0, 0.2])
VELOCITY = np.array([0.01, 0.004])
"""Start of the first ball, offset between balls, and velocity per step, in shares of the frame."""
RADIUS = 0.05
SCORE = 0.99
"""Confidence of every ball."""
SURFACE_POINTS = 9
TURNING_RAD_S = (0.0, 1.0, 0.0)


class RefusalError(Exception):
    """The request is answered with a problem document."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.problem = problem


def parts(body: bytes, boundary: str) -> tuple[dict[str, str], list[bytes], bytes | None]:
    """Take a form apart: its fields, its frames in order, and its final frame."""
    fields: dict[str, str] = {}
    frames: list[bytes] = []
    final_frame: bytes | None = None
    for part in body.split(f"--{boundary}".encode())[1:-1]:
        head, _, content = part.removeprefix(b"\r\n").partition(b"\r\n\r\n")
        content = content.removesuffix(b"\r\n")
        name = head.partition(b'name="')[2].partition(b'"')[0].decode()
        if name == "frames":
            frames.append(content)
        elif name == "final_frame":
            final_frame = content
        else:
            fields[name] = content.decode()
    return fields, frames, final_frame


def typed(
    fields: Mapping[str, Any], frames: Sequence[bytes], final_frame: bytes | None
) -> dict[str, Any]:
    """Return a request's body with the types of the schema; forms send numbers as text."""
    if not frames:
        return dict(fields)
    numbers = {"horizon": int, "num_objects": int, "frame_rate": float, "step_rate": float}
    numbers |= {"min_score": float, "refine_still": "true".__eq__}
    values: dict[str, Any] = {name: numbers.get(name, str)(value) for name, value in fields.items()}
    return {**values, "frames": list(frames), "final_frame": final_frame}


def forecast(
    request: PredictRequest, positions: np.ndarray | None, variance_px2: float
) -> PredictResponse:
    """Answer with chosen positions [objects, steps, 2], or with balls on lines.

    Prompts are answered with balls that roll from there, in frames of any rectangle, each with its
    score and where it was seen.

    Raises
    ------
    RefusalError
        When the frames cannot be read or the positions do not suffice.
    """
    size = _size(request.frames, square=request.balls is None)
    side = max(size)
    objects = request.num_objects if request.balls is None else len(request.balls)
    if request.num_objects not in (None, objects):
        raise RefusalError(
            _wrong("num_objects", request.num_objects, f"{objects}, the number of balls")
        )
    rate = request.frame_rate or FRAME_RATE_HZ
    step_rate = request.step_rate or rate
    if positions is None:
        ahead = np.arange(request.horizon or DEFAULT_HORIZON) * (rate / step_rate)
        starts = _starts(request.balls, objects or 1, side)
        positions = starts[:, None] + ahead[:, None] * side * VELOCITY
    horizon = request.horizon or positions.shape[1]
    if horizon > positions.shape[1]:
        raise RefusalError(
            _wrong("horizon", horizon, f"at most {positions.shape[1]}, as many as given")
        )
    if objects not in (None, len(positions)):
        raise RefusalError(_wrong("num_objects", objects, f"{len(positions)}, as many as given"))
    return PredictResponse(
        model=ModelReference(name=NAME, version=1, variant=NAME, trained_horizon=TRAINED_HORIZON),
        frame_size=size,
        frame_rate=rate,
        step_rate=step_rate,
        objects=[
            ForecastObject(
                id=ball,
                color=COLORS[ball % len(COLORS)],
                **_made_outputs(path[:horizon], variance_px2),
                covariance_source="predicted",
                score=None if request.balls is None else SCORE,
                seen=None if request.balls is None else _seen(request.balls[ball], path[0], side),
            )
            for ball, path in enumerate(positions)
        ],
        times_s=[step / step_rate for step in range(horizon)],
        ellipse50_radii=[GAUSSIAN_ELLIPSE50_RADIUS] * horizon,
        **_made_ends(request, positions[:, horizon - 1]),
        warnings=[f"The horizon of {horizon} steps exceeds the {TRAINED_HORIZON} trained ones."]
        if horizon > TRAINED_HORIZON
        else [],
        timing_ms=PredictTiming(decode=0, encode=0, rollout=0, total=0),
    )


def detection(request: DetectRequest) -> DetectResponse:
    """Answer with the first ball of forecasts."""
    size = _size(request.frames, square=False)
    side = max(size)
    (start,) = _starts(None, 1, side)
    prompt = BallPrompt(x=float(start[0]), y=float(start[1]))
    ball = DetectedBall(
        score=SCORE,
        moving=1,
        refined=True,
        seen=_seen(prompt, start, side),
        visible=[1.0] * OBSERVED_FRAMES,
    )
    return DetectResponse(model=f"{NAME}@1", frame_size=size, balls=[ball])


def events(whole: PredictResponse) -> bytes:
    """Write a forecast as the events of its stream."""
    parts: list[tuple[str, BaseModel]] = [
        (
            "step",
            StreamStep(
                step=step,
                time_s=time_s,
                ellipse50_radius=whole.ellipse50_radii[step],
                objects=[
                    StreamObject(
                        id=ball.id,
                        **{spec.step_name: getattr(ball, spec.name)[step] for spec in STEP_OUTPUTS},
                    )
                    for ball in whole.objects
                ],
            ),
        )
        for step, time_s in enumerate(whole.times_s)
    ]
    balls = [
        StreamBall(**ball.model_dump(include=set(StreamBall.model_fields)))
        for ball in whole.objects
    ]
    rest: dict[str, Any] = dict(whole)
    rest["objects"] = balls
    parts.append(("done", StreamDone(**rest)))
    return "".join(
        f"event: {name}\ndata: {body.model_dump_json()}\n\n" for name, body in parts
    ).encode()


def simulation(request: SimulateRequest) -> SimulateResponse:
    """Answer with discs that roll along lines over a dark frame."""
    side = request.image_size
    indices = np.arange(request.steps)
    paths = [_line(ball, indices, side) for ball in range(request.balls)]
    scene = _scene(request)
    return SimulateResponse(
        scenario=request.scenario,
        seed=request.seed,
        frame_rate=FRAME_RATE_HZ,
        frame_size=(side, side),
        start_step=request.start_step or 0,
        times_s=(indices / FRAME_RATE_HZ).tolist(),
        frames=[_drawn([path[index] for path in paths], side) for index in indices]
        if request.include_frames
        else None,
        objects=[
            SimulatedObject(
                id=ball,
                color=COLORS[ball],
                radius_px=RADIUS * side,
                positions=path.tolist(),
                angular_velocities=[TURNING_RAD_S] * request.steps,
            )
            for ball, path in enumerate(paths)
        ],
        surface=_ground(scene) if request.include_surface else None,
        scene=scene,
    )


def model() -> ModelDetail:
    """Describe the only model."""
    return ModelDetail(
        name=NAME,
        version=1,
        default=True,
        status="ready",
        variant=NAME,
        scenarios=list(SCENARIOS),
        objects=1,
        frames=OBSERVED_FRAMES,
        trained_horizon=TRAINED_HORIZON,
        covariance_source="predicted",
        angular_velocity=True,
        versions=[1],
        licence=None,
        card=None,
    )


def invalid(error: ValidationError) -> Problem:
    """Return the document for a body that the schema refuses."""
    fault = error.errors()[0]
    return _wrong(".".join(map(str, fault["loc"])) or "body", None, fault["msg"])


def nothing_here(request: str) -> Problem:
    """Return the document for a call that there is not."""
    return Problem(
        type="/problems/not-found",
        title="Not Found",
        status=404,
        detail=f"{request}: the fake service only has the model {NAME!r} alone",
    )


def _wrong(field: str, value: int | str | None, expected: str) -> Problem:
    return Problem(
        type="/problems/invalid-value",
        title="A value is invalid",
        status=422,
        detail=f"{field}: expected {expected}",
        field=field,
        value=value,
        expected=expected,
    )


def _size(frames: Sequence[bytes], *, square: bool) -> tuple[int, int]:
    """Return width and height of frames, which are all of one size."""
    sizes: list[tuple[int, int]] = []
    for index, frame in enumerate(frames):
        try:
            with Image.open(io.BytesIO(frame)) as image:
                sizes.append(image.size)
        except OSError as error:
            raise RefusalError(
                _wrong(f"frames[{index}]", None, "a PNG, JPEG or WebP file")
            ) from error
        width, height = sizes[-1]
        if square and width != height:
            expected = "a square frame, or balls that are meant"
            raise RefusalError(_wrong(f"frames[{index}]", f"{width} x {height}", expected))
        if sizes[-1] != sizes[0]:
            raise RefusalError(_wrong(f"frames[{index}]", f"{width} x {height}", "one size of all"))
    return sizes[0]


def _starts(prompts: Sequence[BallPrompt] | None, objects: int, side: int) -> np.ndarray:
    """Return where balls are in the last observed frame, [objects, 2]."""
    if prompts is not None:
        return np.array([(prompt.x, prompt.y) for prompt in prompts], float)
    last = np.array([FIRST_FORECAST_FRAME])
    return np.concatenate([_line(ball, last, side) for ball in range(objects)])


def _seen(prompt: BallPrompt, start: np.ndarray, side: int) -> list[SeenBall]:
    """Return where a ball was in the observed frames, on the line that it rolls along."""
    radius = prompt.radius or RADIUS * side
    back = np.arange(1 - OBSERVED_FRAMES, 1)[:, None] * side * VELOCITY
    return [SeenBall(x=x, y=y, radius=radius) for x, y in (start + back).tolist()]


def _line(ball: int, indices: np.ndarray, side: int) -> np.ndarray:
    return side * (START + ball * BELOW + indices[:, None] * VELOCITY)


def _drawn(centres: Sequence[np.ndarray], side: int) -> str:
    image = Image.new("RGB", (side, side), (40, 40, 40))
    draw = ImageDraw.Draw(image)
    for (x, y), color in zip(centres, COLORS, strict=False):
        reach = RADIUS * side
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), color)
    return base64.b64encode(encode_png(np.asarray(image))).decode()


def _ground(scene: Scene) -> SurfaceGrid:
    reach_m = camera_for(scene.scenario, image_size=1).half_width_m
    points_m = np.linspace(-reach_m, reach_m, SURFACE_POINTS)
    heights_m, _ = surface_of(scene).height_and_normal(*np.meshgrid(points_m, -points_m))
    rows: list[list[float]] = heights_m.tolist()
    return SurfaceGrid(
        half_width_m=reach_m,
        heights_m=[[None if math.isnan(height) else height for height in row] for row in rows],
    )


def _made_outputs(path: np.ndarray, variance_px2: float) -> dict[OutputName, Any]:
    """Return the outputs of a ball on a path [T, 2], zeros for outputs that are not simulated."""
    known = {
        "positions": path,
        "covariances": variance_px2 * np.eye(2),
        "angular_velocities": np.array(TURNING_RAD_S),
    }
    return {
        spec.name: np.broadcast_to(known.get(spec.name, 0.0), (len(path), *spec.shape)).tolist()
        for spec in STEP_OUTPUTS
    }


def _made_ends(request: PredictRequest, last: np.ndarray) -> dict[OutputName, Any]:
    """Return the outputs that belong to no step: the balls' last positions with a final frame."""
    known = {"final_positions": last}
    return {
        spec.name: None
        if request.final_frame is None
        else np.broadcast_to(known.get(spec.name, 0.0), (len(last), *spec.shape)).tolist()
        for spec in FORECAST_OUTPUTS
    }


def _scene(request: SimulateRequest) -> Scene:
    shape: dict[str, Any] = {"axis_ratio": 0.75 if request.scenario == "ellipsoid" else 1.0}
    if request.scenario == "heightfield":
        shape = {
            "noise_scale": 0.5,
            "noise_offset_m": (0.0, 0.0),
            "light_position_m": (1.0, 1.0, 2.0),
        }
    elif request.scenario == "table":
        shape = {"slope": (0.0, 0.0), "walls_m": (-1.2, -1.2, 1.2, 1.2)}
    sampled: dict[str, Any] = {
        "scenario": request.scenario,
        "seed": request.seed,
        "textured": request.balls == 1,
        "radius_m": 0.1,
        "rotation_rad": 0.0,
        "positions_m": [(-0.4, 0.4 - 0.4 * ball, -0.5) for ball in range(request.balls)],
        "velocities_m_s": [(0.8, -0.3, 0.0)] * request.balls,
        "orientations_xyzw": [(0.0, 0.0, 0.0, 1.0)] * request.balls,
    }
    return Scene.model_validate(sampled | shape | request.parameters)
