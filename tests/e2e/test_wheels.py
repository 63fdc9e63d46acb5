"""The service from wheels in an environment of its own, without a checkout."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from rollcast.client import Client
from tests.e2e.conftest import ROOT, said_address, wait_until_ready

UV = ROOT / ".venv/uv/bin/uv"


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """Folder of the programs of an environment into which ``rollcast[serve]`` was installed."""
    folder = tmp_path_factory.mktemp("wheels")
    subprocess.run([ROOT / "tools/wheels.sh", folder / "index"], check=True)
    environment = folder / "environment"
    subprocess.run([UV, "venv", "--quiet", "--python", sys.executable, environment], check=True)
    subprocess.run(
        [
            *(UV, "pip", "install", "--quiet", "--python", environment / "bin/python"),
            *("--find-links", folder / "index", "rollcast[serve]"),
        ],
        cwd=folder,
        check=True,
    )
    return environment / "bin"


def test_the_wheels_have_one_version():
    ours, models = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        for folder in (".", "models")
    )
    assert ours["version"] == models["version"]
    assert f"rollcast-models=={models['version']}" in ours["optional-dependencies"]["serve"]


def test_rollcast_serve_forecasts_without_a_checkout(installed, tmp_path):
    process = subprocess.Popen(
        ["env", "-u", "PYTHONPATH", installed / "rollcast", "serve", "--port", "0"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        with Client(said_address(process.stdout)) as client:
            wait_until_ready(client)
            names = {model.name for model in client.models()}
            assert names == {path.name for path in (ROOT / "models").iterdir() if path.is_dir()}
            scene = client.simulate("ellipsoid", seed=7, steps=8)
            forecast = client.predict(scene.frames[:4], horizon=4)
            assert forecast.positions.shape == (1, 4, 2)
    finally:
        process.terminate()
        process.communicate(timeout=60)
    assert not list(tmp_path.iterdir())
