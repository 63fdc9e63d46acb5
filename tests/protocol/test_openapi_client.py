"""The client that is generated from the protocol's own OpenAPI document."""

import asyncio

import httpx
import numpy as np
import pytest
from open_inference.openapi.client import (
    AsyncOpenInferenceClient,
    InferenceRequest,
    OpenInferenceClient,
)
from open_inference.openapi.core.api_error import ApiError
from open_inference.openapi.errors import BadRequestError

from tests.protocol.conftest import HORIZON


def asked(frames: np.ndarray) -> InferenceRequest:
    """A request; the client turns every number into a float."""
    flat = frames.ravel().tolist()
    inputs = [
        {"name": "frames", "datatype": "UINT8", "shape": list(frames.shape), "data": flat},
        {"name": "horizon", "datatype": "INT64", "shape": [1], "data": [HORIZON]},
    ]
    return InferenceRequest(id="nine", inputs=inputs)


@pytest.fixture
def client(address):
    with httpx.Client(timeout=60) as connection:
        yield OpenInferenceClient(base_url=f"http://{address}", httpx_client=connection)


def test_forecasts_are_those_of_predict(client, frames, expected):
    answer = client.model_infer("fieldnet", request=asked(frames))
    (positions,) = (output for output in answer.outputs if output.name == "positions")
    values = np.array(positions.data.__root__).reshape(positions.shape)
    np.testing.assert_allclose(values[0, 0], expected, atol=1e-4)
    assert answer.id == "nine"
    again = client.model_version_infer("fieldnet", "1", request=asked(frames))
    assert again.outputs == answer.outputs


def test_server_and_models_are_told(client):
    client.check_server_liveness()
    client.check_server_readiness()
    client.check_model_readiness("fieldnet")
    client.check_model_version_readiness("fieldnet", "1")
    assert client.read_server_metadata().name == "rollcast"
    assert client.read_model_metadata("fieldnet").inputs[0].name == "frames"
    with pytest.raises(ApiError):
        client.check_model_readiness("nobody")


def test_a_refusal_is_the_clients_own_exception(client, frames):
    with pytest.raises(BadRequestError, match="shape"):
        client.model_infer("fieldnet", request=asked(frames[:, :3]))


def test_without_waiting(address, frames, expected):
    async def one() -> np.ndarray:
        async with httpx.AsyncClient(timeout=60) as connection:
            client = AsyncOpenInferenceClient(base_url=f"http://{address}", httpx_client=connection)
            answer = await client.model_infer("fieldnet", request=asked(frames))
        (positions,) = (output for output in answer.outputs if output.name == "positions")
        return np.array(positions.data.__root__).reshape(positions.shape)

    np.testing.assert_allclose(asyncio.run(one())[0, 0], expected, atol=1e-4)
