"""NVIDIA's client, the one that waits and the one that does not."""

import asyncio
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import tritonclient.http as triton
import tritonclient.http.aio as triton_aio
from tritonclient.utils import InferenceServerException

from tests.protocol.conftest import HORIZON


def asked(module: ModuleType, frames: np.ndarray, *, binary: bool) -> tuple[list[Any], list[Any]]:
    """Inputs and outputs of a request."""
    inputs = [
        module.InferInput("frames", frames.shape, "UINT8"),
        module.InferInput("horizon", [1], "INT64"),
    ]
    inputs[0].set_data_from_numpy(frames, binary_data=binary)
    inputs[1].set_data_from_numpy(np.array([HORIZON]), binary_data=binary)
    names = ("positions", "covariances", "angular_velocities")
    return inputs, [module.InferRequestedOutput(name, binary_data=binary) for name in names]


@pytest.fixture
def client(address):
    with triton.InferenceServerClient(address) as client:
        yield client


@pytest.mark.parametrize("binary", [True, False])
def test_forecasts_are_those_of_predict(client, frames, expected, binary):
    inputs, outputs = asked(triton, frames, binary=binary)
    answer = client.infer("fieldnet", inputs, outputs=outputs, request_id="seven")
    np.testing.assert_allclose(answer.as_numpy("positions")[0, 0], expected, atol=1e-4)
    assert answer.as_numpy("covariances").shape == (1, 1, HORIZON, 2, 2)
    assert answer.as_numpy("angular_velocities").shape == (1, 1, HORIZON, 3)
    assert answer.get_response()["id"] == "seven"


def test_compressed_bodies(client, frames, expected):
    inputs, _ = asked(triton, frames, binary=True)
    answer = client.infer("fieldnet", inputs, response_compression_algorithm="gzip")
    np.testing.assert_allclose(answer.as_numpy("positions")[0, 0], expected, atol=1e-4)


def test_server_and_models_are_told(client):
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.is_model_ready("fieldnet")
    assert client.is_model_ready("fieldnet", "1")
    assert not client.is_model_ready("nobody")
    assert client.get_server_metadata()["name"] == "rollcast"
    metadata = client.get_model_metadata("fieldnet")
    assert metadata["inputs"][0]["name"] == "frames"
    assert {tensor["name"] for tensor in metadata["outputs"]} >= {"positions", "covariances"}


def test_models_come_and_go(client):
    index = {
        (model["name"], model["version"]): model for model in client.get_model_repository_index()
    }
    assert index["dispnet", "1"]["state"] == "READY"
    client.unload_model("dispnet")
    assert not client.is_model_ready("dispnet")
    client.load_model("dispnet")
    assert client.is_model_ready("dispnet")


def test_a_refusal_is_the_clients_own_exception(client, frames):
    inputs, _ = asked(triton, frames[:, :3], binary=True)
    with pytest.raises(InferenceServerException, match="shape"):
        client.infer("fieldnet", inputs)


def test_without_waiting(address, frames, expected):
    async def several() -> list[np.ndarray]:
        async with triton_aio.InferenceServerClient(address) as client:
            assert await client.is_server_ready()
            inputs, outputs = asked(triton_aio, frames, binary=True)
            requests = (client.infer("fieldnet", inputs, outputs=outputs) for _ in range(6))
            return [answer.as_numpy("positions") for answer in await asyncio.gather(*requests)]

    for positions in asyncio.run(several()):
        np.testing.assert_allclose(positions[0, 0], expected, atol=1e-2)
