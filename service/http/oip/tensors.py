"""Tensors of the Open Inference Protocol: read from a request's body, written into an answer's.

A body is JSON; the tensors' numbers stand in it or, with the binary tensor extension, behind it:
little-endian, row-major, in the order of the tensors. Lengths are those of 128-pixel frames.

Axes: B requests, N balls, T steps, K frames.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import prod
from typing import Any, cast

import numpy as np
from jaxtyping import Float32, UInt8

from rollcast.camera import NETWORK_FRAME_SIZE
from rollcast.manifest import FRAMES_INPUT, Manifest
from rollcast.outputs import OUTPUTS, OutputName, OutputSpec
from rollcast.schemas import MAX_HORIZON
from service.errors import DivergedError, InvalidValueError, MalformedBodyError
from service.http.oip.schemas import (
    BinarySize,
    InferInput,
    InferOutput,
    InferRequest,
    InferResponse,
    TensorMetadata,
)
from service.inference.rollout import ForecastArrays

HORIZON_INPUT = "horizon"
BALLS_INPUT = "balls"
LENGTH_HEADER = "Inference-Header-Content-Length"
"""Length of the JSON before the binary tensors; without this header there are none."""
FREE = -1
"""Length of an axis that the request decides."""
DTYPES: Mapping[str, np.dtype[Any]] = {
    "UINT8": np.dtype("u1"),
    "INT64": np.dtype("<i8"),
    "FP32": np.dtype("<f4"),
}


@dataclass(frozen=True)
class Query:
    """A request, checked against the model's manifest."""

    id: str | None
    frames: UInt8[np.ndarray, "B K 128 128 3"]
    horizon: int
    balls: Float32[np.ndarray, "B N 2"] | None
    """Points in the last observed frames that select the balls, pixels of 128."""
    outputs: Mapping[OutputName, bool]
    """The wanted ones in order, and whether each comes behind the JSON."""


@dataclass(frozen=True)
class Message:
    """A body that is ready to be sent."""

    content: bytes
    json_length: int | None
    """Length of the JSON when binary tensors follow it."""


def inputs_of(manifest: Manifest) -> list[TensorMetadata]:
    """Describe the inputs of a model."""
    inputs = [
        TensorMetadata(name=FRAMES_INPUT, datatype="UINT8", shape=[FREE, *manifest.frames_shape]),
        TensorMetadata(name=HORIZON_INPUT, datatype="INT64", shape=[1]),
    ]
    if manifest.max_objects is not None:
        inputs.append(TensorMetadata(name=BALLS_INPUT, datatype="FP32", shape=[FREE, FREE, 2]))
    return inputs


def outputs_of(manifest: Manifest) -> list[TensorMetadata]:
    """Describe the outputs of a model, including covariances of any source."""
    balls = manifest.objects if manifest.max_objects is None else FREE
    return [
        TensorMetadata(
            name=spec.name,
            datatype="FP32",
            shape=[FREE, balls, *([FREE] if spec.is_per_step else []), *spec.shape],
        )
        for spec in _answered_outputs(manifest)
    ]


def split(body: bytes | bytearray, announced: str | None) -> tuple[bytes | bytearray, memoryview]:
    """Divide a body into its JSON and the binary tensors behind it.

    Parameters
    ----------
    body
        The whole body.
    announced
        The header with the JSON's length.

    Raises
    ------
    MalformedBodyError
        When the body has no such length.
    """
    if announced is None:
        return body, memoryview(b"")
    digits = announced.isascii() and announced.isdecimal() and len(announced) <= 18
    if not digits or int(announced) > len(body):
        expected = f"the length of the JSON, at most the body's {len(body)} bytes"
        raise MalformedBodyError.at(LENGTH_HEADER, announced, expected)
    length = int(announced)
    return body[:length], memoryview(body)[length:]


def read_query(
    request: InferRequest, binary: memoryview, manifest: Manifest, max_batch: int
) -> Query:
    """Check a request against a model and read its tensors, binary ones without a copy.

    Parameters
    ----------
    request
        The JSON of the request.
    binary
        Bytes after the JSON.
    manifest
        The model's.
    max_batch
        Largest B.

    Raises
    ------
    InvalidValueError
        With the field at fault.
    """
    if request.model_name not in (None, manifest.name):
        expected = f"{manifest.name}, the name in the path, or none"
        raise InvalidValueError.at("model_name", request.model_name, expected)
    outputs = _requested_outputs(request, manifest)
    limits = (max_batch, manifest.max_objects or 1)
    tensors = _read_tensors(request.inputs, binary, inputs_of(manifest), limits)
    if FRAMES_INPUT not in tensors:
        given = ", ".join(tensors) or "empty"
        raise InvalidValueError.at("inputs", given, f"{FRAMES_INPUT} among them")
    horizon = _horizon(tensors.get(HORIZON_INPUT), manifest)
    frames, balls = tensors[FRAMES_INPUT], tensors.get(BALLS_INPUT)
    if balls is not None:
        _check_balls(balls, len(frames))
    return Query(request.id, frames, horizon, balls, outputs)


def write_answer(query: Query, manifest: Manifest, forecast: ForecastArrays) -> Message:
    """Write the outputs that a request wants.

    Raises
    ------
    DivergedError
        When a number exceeds FP32.
    """
    outputs: list[InferOutput] = []
    binary: list[memoryview] = []
    for name, behind in query.outputs.items():
        tensor = _as_fp32(name, forecast.outputs[name])
        outputs.append(
            InferOutput(
                name=name,
                datatype="FP32",
                shape=list(tensor.shape),
                parameters=BinarySize(binary_data_size=tensor.nbytes) if behind else None,
                data=None if behind else tensor.ravel().tolist(),
            )
        )
        if behind:
            binary.append(tensor.data)
    response = InferResponse(
        model_name=manifest.name,
        model_version=str(manifest.version),
        id=query.id,
        outputs=outputs,
    )
    text = response.model_dump_json(exclude_none=True).encode("utf-8")
    return Message(b"".join([text, *binary]), len(text) if binary else None)


def _answered_outputs(manifest: Manifest) -> list[OutputSpec]:
    return [spec for spec in OUTPUTS if spec.is_required or spec.name in manifest.output_names]


def _requested_outputs(request: InferRequest, manifest: Manifest) -> dict[OutputName, bool]:
    by_default = request.parameters is not None and request.parameters.binary_data_output
    known = [spec.name for spec in _answered_outputs(manifest)]
    wanted: dict[OutputName, bool] = {}
    for index, output in enumerate(request.outputs or ()):
        field = f"outputs[{index}].name"
        if output.name not in known:
            raise InvalidValueError.at(field, output.name, _one_of(known))
        if output.name in wanted:
            raise InvalidValueError.at(field, output.name, "every output once")
        own = None if output.parameters is None else output.parameters.binary_data
        wanted[output.name] = by_default if own is None else own
    return wanted or dict.fromkeys(known, by_default)


def _read_tensors(
    inputs: Sequence[InferInput],
    binary: memoryview,
    declared: Sequence[TensorMetadata],
    limits: Sequence[int],
) -> dict[str, np.ndarray]:
    known = {tensor.name: tensor for tensor in declared}
    tensors: dict[str, np.ndarray] = {}
    rest = binary
    for index, given in enumerate(inputs):
        field = f"inputs[{index}]"
        if given.name not in known:
            raise InvalidValueError.at(f"{field}.name", given.name, _one_of(known))
        if given.name in tensors:
            raise InvalidValueError.at(f"{field}.name", given.name, "every input once")
        _check_kind(given, known[given.name], field, limits)
        if given.binary_size is None:
            tensors[given.name] = _from_json(given, field)
        else:
            tensors[given.name] = _from_binary(given, given.binary_size, rest, field)
            rest = rest[given.binary_size :]
    if rest:
        expected = f"{len(binary) - len(rest)} bytes after the JSON, the sum of binary_data_size"
        raise InvalidValueError.at("body", f"{len(binary)} bytes after the JSON", expected)
    return tensors


def _check_kind(
    given: InferInput, declared: TensorMetadata, field: str, limits: Sequence[int]
) -> None:
    if given.datatype != declared.datatype:
        raise InvalidValueError.at(f"{field}.datatype", given.datatype, declared.datatype)
    free = dict(enumerate(limits[: declared.shape.count(FREE)]))
    fits = len(given.shape) == len(declared.shape) and all(
        1 <= length <= free[axis] if axis in free else length == wanted
        for axis, (length, wanted) in enumerate(zip(given.shape, declared.shape, strict=True))
    )
    if not fits:
        axes = zip(("first", "second"), free.values(), strict=False)
        free = "".join(f", the {axis} axis 1 to {most}" for axis, most in axes)
        raise InvalidValueError.at(
            f"{field}.shape", str(given.shape), f"{declared.shape}{free}, for {declared.name}"
        )


def _from_binary(given: InferInput, size: int, rest: memoryview, field: str) -> np.ndarray:
    dtype = DTYPES[given.datatype]
    if given.data is not None:
        expected = "no data beside parameters.binary_data_size"
        raise InvalidValueError.at(f"{field}.data", given.data, expected)
    size_field = f"{field}.parameters.binary_data_size"
    expected_size = prod(given.shape) * dtype.itemsize
    if size != expected_size:
        expected = f"{expected_size}, for {given.datatype} {given.shape}"
        raise InvalidValueError.at(size_field, size, expected)
    if size > len(rest):
        expected = f"at most the {len(rest)} bytes that remain after the JSON ({LENGTH_HEADER})"
        raise InvalidValueError.at(size_field, size, expected)
    return np.frombuffer(rest[:size], dtype).reshape(given.shape)


def _from_json(given: InferInput, field: str) -> np.ndarray:
    dtype = DTYPES[given.datatype]
    field = f"{field}.data"
    if given.data is None:
        raise InvalidValueError.at(field, None, "numbers, or parameters.binary_data_size")
    numbers = _flattened(given.data, given.shape)
    if numbers is None:
        expected = f"{prod(given.shape)} numbers, or lists nested as {given.shape}"
        raise InvalidValueError.at(field, given.data, expected)
    if dtype.kind == "f":
        _check_each(numbers, _is_number, field, "numbers")
        return _floats(numbers, dtype, field).reshape(given.shape)
    limits = np.iinfo(dtype)
    expected = f"whole numbers, {limits.min} to {limits.max}"
    if set(map(type, numbers)) != {int}:
        _check_each(numbers, _is_whole, field, expected)
        numbers = list(map(int, numbers))
    try:
        return np.array(numbers, dtype).reshape(given.shape)
    except OverflowError as error:
        wrong = next(number for number in numbers if not limits.min <= number <= limits.max)
        raise InvalidValueError.at(field, wrong, expected) from error


def _floats(numbers: Sequence[Any], dtype: np.dtype, field: str) -> np.ndarray:
    """Return numbers as floats; those beyond the datatype's range are infinite."""
    try:
        with np.errstate(over="ignore"):
            return np.array(numbers, dtype)
    except OverflowError as error:  # of an integer
        largest = float(np.finfo(dtype).max)
        wrong = next(number for number in numbers if abs(number) > largest)
        raise InvalidValueError.at(field, wrong, f"numbers up to {largest:g}") from error


def _check_each(
    values: Sequence[object], fits: Callable[[object], bool], field: str, expected: str
) -> None:
    for value in values:
        if not fits(value):
            raise InvalidValueError.at(field, value, expected)


def _is_number(value: object) -> bool:
    return type(value) in {int, float}


def _is_whole(number: object) -> bool:
    """Return whether it is a whole number; some clients send every number as a float."""
    return type(number) is int or (type(number) is float and number.is_integer())


def _flattened(data: list[Any], shape: Sequence[int]) -> list[Any] | None:
    """Return the numbers in a row, or None when the lists do not have the shape."""
    rows = data
    if rows and isinstance(rows[0], list):
        for axis, length in enumerate(shape[1:], start=1):
            if len(rows) != prod(shape[:axis]) or not all(_is_row(row, length) for row in rows):
                return None
            rows = list(chain.from_iterable(rows))
    return rows if len(rows) == prod(shape) else None


def _is_row(value: object, length: int) -> bool:
    return isinstance(value, list) and len(cast("list[object]", value)) == length


def _check_balls(balls: np.ndarray, batch: int) -> None:
    if len(balls) != batch:
        expected = f"{batch} on the first axis, as many as {FRAMES_INPUT}"
        raise InvalidValueError.at(BALLS_INPUT, str(list(balls.shape)), expected)
    outside = ~((balls >= 0) & (balls <= NETWORK_FRAME_SIZE)).all(axis=-1)
    if outside.any():
        expected = f"points x, y of the frames, 0 to {NETWORK_FRAME_SIZE}"
        raise InvalidValueError.at(BALLS_INPUT, str(balls[outside][0].tolist()), expected)


def _horizon(tensor: np.ndarray | None, manifest: Manifest) -> int:
    """Return the number of steps, which a final frame fixes."""
    fixed = None if manifest.final_step is None else manifest.final_step + 1
    if tensor is None:
        return fixed or manifest.trained_horizon
    horizon = int(tensor[0])
    if fixed is not None and horizon != fixed:
        expected = f"{fixed}: the final frame of {manifest.label} shows step {manifest.final_step}"
        raise InvalidValueError.at(HORIZON_INPUT, horizon, expected)
    if not 1 <= horizon <= MAX_HORIZON:
        raise InvalidValueError.at(HORIZON_INPUT, horizon, f"1 to {MAX_HORIZON}")
    return horizon


def _as_fp32(name: str, values: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        tensor = np.ascontiguousarray(values, DTYPES["FP32"])
    if not np.isfinite(tensor).all():
        expected = "finite FP32 numbers: these frames allow fewer steps"
        raise DivergedError.at(name, "not finite", expected)
    return tensor


def _one_of(names: Iterable[str]) -> str:
    return "one of " + ", ".join(names)
