"""Bodies of the Open Inference Protocol (V2, REST), as they stand in JSON."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from rollcast.schemas import Flag, Integer, RequestBody, ResponseBody

PROTOCOL_PATH = "/v2"
"""Root of the protocol's routes."""
MAX_ITEMS = 8
"""Maximum number of inputs, outputs or axes; no model has as many."""

Datatype = Literal["UINT8", "INT64", "FP32"]
Item = TypeVar("Item")
Items = Annotated[list[Item], Field(max_length=MAX_ITEMS, fail_fast=True)]


class ServerMetadata(ResponseBody):
    """Answer of ``GET /v2``."""

    name: str
    version: str
    extensions: list[str]


class ServerLive(ResponseBody):
    """Answer of ``GET /v2/health/live``."""

    live: bool


class ServerReady(ServerLive):
    """Answer of ``GET /v2/health/ready``."""

    ready: bool


class TensorMetadata(ResponseBody):
    """Name, type and shape of a tensor."""

    name: str
    datatype: Datatype
    shape: list[int]
    """Shape, with -1 for axes whose length depends on the request."""


class ModelReady(ResponseBody):
    """Answer of ``GET /v2/models/{name}/ready``."""

    name: str
    ready: bool


class ModelMetadata(ResponseBody):
    """Answer of ``GET /v2/models/{name}``."""

    name: str
    versions: list[str]
    platform: str
    inputs: list[TensorMetadata]
    outputs: list[TensorMetadata]


class InputParameters(RequestBody):
    """Parameters of an input tensor."""

    binary_data_size: Annotated[Integer, Field(ge=0)] | None = None
    """Bytes of this tensor behind the JSON."""


class InferInput(RequestBody):
    """One input tensor: its numbers stand in ``data`` or behind the JSON."""

    name: str
    shape: Items[Integer]
    datatype: str
    parameters: InputParameters | None = None
    data: list[Any] | None = None
    """Row-major, flat or nested."""

    @property
    def binary_size(self) -> int | None:
        """Bytes behind the JSON, if the numbers stand there."""
        return None if self.parameters is None else self.parameters.binary_data_size


class OutputParameters(RequestBody):
    """Parameters of a requested output."""

    binary_data: Flag | None = None
    """Binary form of the output, behind the JSON; default: ``binary_data_output``."""


class RequestedOutput(RequestBody):
    """One output that is wanted."""

    name: str
    parameters: OutputParameters | None = None


class InferParameters(RequestBody):
    """Parameters of a request."""

    binary_data_output: Flag = False
    """Binary form of the outputs, behind the JSON."""


class InferRequest(RequestBody):
    """Body of ``POST /v2/models/{name}/infer``, alone or followed by binary tensors."""

    id: str | None = None
    """Identifier that the response repeats."""
    model_name: str | None = None
    """Model name, sent by KServe's client in addition to the path."""
    parameters: InferParameters | None = None
    inputs: Items[InferInput]
    """Tensor ``frames``, and ``horizon`` unless it is the model's default."""
    outputs: Items[RequestedOutput] | None = None
    """Requested outputs, in order; all outputs if omitted or empty."""


class BinarySize(ResponseBody):
    """Parameters of an output tensor that comes behind the JSON."""

    binary_data_size: int


class InferOutput(TensorMetadata):
    """One output tensor: its numbers stand in ``data`` or behind the JSON."""

    parameters: BinarySize | None = None
    data: list[float] | None = None
    """Row-major and flat."""


class InferResponse(ResponseBody):
    """Answer of ``POST /v2/models/{name}/infer``, alone or followed by binary tensors."""

    model_name: str
    model_version: str
    id: str | None = None
    outputs: list[InferOutput]


class IndexEntry(ResponseBody):
    """One version of a model in the repository."""

    name: str
    version: str
    state: Literal["READY", "UNAVAILABLE"]
    reason: str
    """Reason for not being ready; empty otherwise."""


class InferError(ResponseBody):
    """A refusal."""

    error: str
    """Error message: the field, its value and the expected value."""
