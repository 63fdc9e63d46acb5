"""The service as its users meet it."""

import socket
import subprocess
import sys

import httpx2
import numpy as np
import pytest

from rollcast.client import Client
from rollcast.errors import BadRequestError
from tests.e2e.conftest import (
    ROOT,
    SERVICE_PYTHON,
    start_service,
    stop_service,
    wait_until_ready,
)


def test_from_a_scene_to_a_forecast(client):
    scene = client.simulate("hemisphere", seed=7)
    assert scene.frames is not None
    assert scene.frames.shape == (44, 128, 128, 3)
    assert scene.positions.shape == (1, 44, 2)
    forecast = client.predict(scene.frames[:4], horizon=40)
    assert forecast.positions.shape == (1, 40, 2)
    assert forecast.covariances.shape == (1, 40, 2, 2)
    assert forecast.angular_velocities is not None
    assert forecast.angular_velocities.shape == (1, 40, 3)
    np.testing.assert_allclose(np.diff(forecast.times_s), 1 / 40)


def test_a_scene_can_be_asked_for_again(client):
    scene = client.simulate("ellipsoid", seed=3, steps=5)
    again = client.simulate(scene=scene.scene, steps=5)
    np.testing.assert_array_equal(scene.frames, again.frames)
    np.testing.assert_array_equal(scene.positions, again.positions)


def test_the_ground_can_be_asked_for(client):
    bowl = client.simulate("hemisphere", seed=3, steps=4, include_surface=True).surface
    middle = len(bowl.heights_m) // 2
    assert bowl.heights_m[middle, middle] == np.nanmin(bowl.heights_m)
    assert np.isnan(bowl.heights_m[0, 0])
    assert bowl.half_width_m == 1.05
    assert client.simulate("hemisphere", seed=3, steps=4).surface is None


def test_larger_frames_are_answered_in_their_own_pixels(client):
    small = client.simulate("hemisphere", seed=11, steps=4)
    large = client.simulate("hemisphere", seed=11, steps=4, image_size=512)
    by_small, by_large = (client.predict(scene.frames, horizon=10) for scene in (small, large))
    np.testing.assert_allclose(by_large.positions / 4, by_small.positions, atol=6)
    assert by_large.frame_size == (512, 512)


def test_frames_may_be_cropped(client):
    scene = client.simulate("hemisphere", seed=11, steps=4)
    wide = np.pad(scene.frames, ((0, 0), (0, 0), (32, 32), (0, 0)))
    with pytest.raises(BadRequestError) as caught:
        client.predict(wide, model="fieldnet")
    assert caught.value.problem.value == "192 x 128"
    cropped = client.predict(wide, crop="square")
    np.testing.assert_array_equal(cropped.positions, client.predict(scene.frames).positions)


def test_a_body_that_is_too_large_is_refused_and_the_next_is_answered(address, client):
    body = bytes(100_000_000)
    for content in (body, iter([body])):
        response = httpx2.post(
            f"{address}/predict", content=content, headers={"content-type": "application/json"}
        )
        assert response.status_code == 413
        assert response.json()["type"] == "/problems/body-too-large"
    assert client.health().status == "ready"


def test_a_client_that_goes_away_leaves_no_trace(tmp_path):
    with (tmp_path / "log").open("w+") as log:
        process, address = start_service(log=log)
        host, port = address.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as connection:
            connection.sendall(
                b"POST /simulate HTTP/1.1\r\nHost: rollcast\r\nContent-Type: application/json\r\n"
                b"Content-Length: 1000\r\n\r\n{"
            )
        with Client(address) as client:
            wait_until_ready(client)
        stop_service(process)
        log.seek(0)
        assert "Traceback" not in log.read()


def test_a_port_in_use_gives_one_clear_line(address):
    port = address.rpartition(":")[2]
    second = subprocess.run(
        [sys.executable, "-m", "service", "--port", port],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert second.returncode == 1
    assert second.stdout == ""
    assert second.stderr == (
        f"rollcast: cannot listen on 127.0.0.1:{port}: Address already in use; "
        "choose another port with --port\n"
    )


def test_a_missing_execution_provider_gives_one_clear_line():
    provider = {"ROLLCAST_EXECUTION_PROVIDER": "CUDAExecutionProvider"}
    ended = subprocess.run(
        [sys.executable, "-m", "service", "--port", "0"],
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", **provider},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 1
    assert "Traceback" not in ended.stderr
    assert ended.stderr.startswith(
        "rollcast: execution_provider: CUDAExecutionProvider is not in the installed ONNX Runtime"
    )


def test_products_stay_on_one_thread():
    """OpenBLAS makes a thread for every core when NumPy is imported, unless it is told before."""
    program = (
        "import os, sys, service.command_line\n"
        "from service.settings import keep_products_on_one_thread\n"
        "assert 'numpy' not in sys.modules\n"
        "keep_products_on_one_thread()\n"
        "import numpy\n"
        "print(len(os.listdir('/proc/self/task')))"
    )
    command = ["env", "-u", "OMP_NUM_THREADS", SERVICE_PYTHON, "-c", program]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "1\n"
