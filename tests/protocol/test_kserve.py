"""KServe's client."""

import asyncio

import httpx
import numpy as np
import pytest
from kserve import InferenceRESTClient, InferInput, InferRequest, InferResponse, RESTConfig

from tests.protocol.conftest import HORIZON


def asked(frames: np.ndarray, *, binary: bool) -> InferRequest:
    """Build a request."""
    inputs = [
        InferInput("frames", list(frames.shape), "UINT8"),
        InferInput("horizon", [1], "INT64"),
    ]
    inputs[0].set_data_from_numpy(frames, binary_data=binary)
    inputs[1].set_data_from_numpy(np.array([HORIZON]), binary_data=binary)
    return InferRequest("fieldnet", inputs, request_id="eight")


async def infer(address: str, request: InferRequest, model: str = "fieldnet") -> InferResponse:
    async with InferenceRESTClient(RESTConfig(protocol="v2")) as client:
        answer = await client.infer(f"http://{address}", request, model_name=model)
    assert isinstance(answer, InferResponse)
    return answer


@pytest.mark.parametrize("binary", [True, False])
def test_forecasts_are_those_of_predict(address, frames, expected, binary):
    answer = asyncio.run(infer(address, asked(frames, binary=binary)))
    (positions,) = (output for output in answer.outputs if output.name == "positions")
    np.testing.assert_allclose(positions.as_numpy()[0, 0], expected, atol=1e-4)
    assert answer.id == "eight"


def test_server_and_models_are_told(address):
    async def told() -> list[bool]:
        async with InferenceRESTClient(RESTConfig(protocol="v2")) as client:
            url = f"http://{address}"
            return [
                await client.is_server_live(url),
                await client.is_server_ready(url),
                await client.is_model_ready(url, "fieldnet"),
            ]

    assert asyncio.run(told()) == [True, True, True]


def test_a_refusal_is_the_clients_own_exception(address, frames):
    with pytest.raises(httpx.HTTPStatusError, match="nobody"):
        asyncio.run(infer(address, asked(frames, binary=True), model="nobody"))
