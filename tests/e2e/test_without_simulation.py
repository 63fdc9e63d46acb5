"""The service without PyBullet: on Python 3.13, and with the package hidden."""

import subprocess
import sys

import httpx2
import numpy as np
import pytest

from rollcast.camera import camera_for
from rollcast.client import Client
from rollcast.errors import ServerError
from rollcast.simulation import Simulator
from rollcast.trajectory import FIRST_FORECAST_FRAME
from tests.e2e.conftest import ROOT, SERVICE_PYTHON, start_service, stop_service, wait_until_ready

HIDDEN = """
import runpy, sys
sys.modules["pybullet"] = None
runpy.run_module("service", run_name="__main__", alter_sys=True)
"""
OTHER_PYTHON = ROOT / ".venv/service-3.13/bin/python"
COMMANDS = {
    "hidden": (SERVICE_PYTHON, "-c", HIDDEN),
    "3.13": (OTHER_PYTHON, "-m", "service"),
}


needs_other_python = pytest.mark.skipif(
    not OTHER_PYTHON.exists(), reason="requires Python 3.13 (.venv/service-3.13)"
)


@pytest.fixture(scope="module", params=["hidden", pytest.param("3.13", marks=needs_other_python)])
def address(request):
    process, address = start_service(command=COMMANDS[request.param])
    with Client(address) as client:
        wait_until_ready(client)
    yield address
    stop_service(process)


@pytest.fixture(scope="module")
def scene():
    """Simulation in the process of the tests."""
    return Simulator().sequence("hemisphere", objects=1, seed=7, steps=24)


@needs_other_python
def test_that_python_has_no_pybullet():
    done = subprocess.run(
        [OTHER_PYTHON, "-c", "import sys; print(sys.version_info[:2]); import pybullet"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "(3, 13)\n"
    assert "ModuleNotFoundError: No module named 'pybullet'" in done.stderr


def test_it_forecasts(address, scene):
    with Client(address) as client:
        forecast = client.predict(scene.render(128)[:4], horizon=20)
    path = camera_for("hemisphere", 128).project(scene.trajectory.positions_m)[:, 0]
    truth = path[FIRST_FORECAST_FRAME:][:20]
    assert np.linalg.norm(forecast.positions[0] - truth, axis=1).mean() < 10


def test_it_says_what_simulations_need_and_goes_on(address, scene):
    with Client(address, retries=0) as client:
        with pytest.raises(ServerError) as caught:
            client.simulate("hemisphere", seed=7)
        assert client.health().status == "ready"
        assert client.predict(scene.render(128)[:4], horizon=1).positions.shape == (1, 1, 2)
    problem = caught.value.problem
    assert (problem.status, problem.type) == (501, "/problems/simulation-not-installed")
    assert "make serve PYTHON=/path/to/python3.11" in problem.detail


def test_no_body_makes_it_answer_otherwise(address):
    for body in (b"", b"{", b'{"scenario": "hemisphere", "seed": 1}', b"[" * 1000):
        answer = httpx2.post(
            f"{address}/simulate", content=body, headers={"Content-Type": "application/json"}
        )
        assert (answer.status_code, answer.headers.get("retry-after")) == (501, None)


def test_the_doctor_notes_it(address):
    run = subprocess.run(
        [sys.executable, "-m", "rollcast", "doctor", "--url", address],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, run.stderr) == (0, ""), run.stdout
    assert "\nnote simulation: Simulations require PyBullet, " in run.stdout
    assert "\nok   forecast: plain grey frames, 20 steps with " in run.stdout
