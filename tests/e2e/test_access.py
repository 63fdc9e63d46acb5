"""API keys as people use them: made by the command, asked for by the real service."""

import subprocess
import time
from pathlib import Path

import pytest

from rollcast.client import Client
from rollcast.errors import AuthError
from tests.e2e.conftest import (
    ROOT,
    SERVICE_PYTHON,
    start_service,
    stop_service,
    wait_until_ready,
)


def keys(file: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [SERVICE_PYTHON, "-m", "service.auth", "--file", file, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def refused(address: str, token: str | None) -> bool:
    with Client(address, api_key=token) as client:
        try:
            client.models()
        except AuthError:
            return True
    return False


def until(change, within_s=10.0):
    deadline = time.monotonic() + within_s
    while not change():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_key_from_its_making_to_its_removal(tmp_path):
    file = tmp_path / "keys.json"
    token = keys(file, "add", "robot", "--expires", "2999-12-31").stdout.strip()
    assert keys(file, "list").stdout == "robot: forecast, until 2999-12-31\n"
    log = tmp_path / "log"
    with log.open("w") as lines:
        process, address = start_service(log=lines, ROLLCAST_KEYS_FILE=str(file))
        try:
            with Client(address, api_key=token) as client:
                wait_until_ready(client)
                scene = client.simulate("hemisphere", seed=1, steps=8)
                assert scene.frames is not None
                assert client.predict(scene.frames[:4], horizon=2).positions.shape == (1, 2, 2)
            assert refused(address, None)
            assert refused(address, token[:-1])
            second = keys(file, "add", "teacher").stdout.strip()
            until(lambda: not refused(address, second))
            assert keys(file, "remove", "robot").returncode == 0
            until(lambda: refused(address, token))
            assert not refused(address, second)
        finally:
            stop_service(process)
    text = log.read_text()
    assert token not in text
    assert second not in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("add", "robot"), "has a key 'robot' already"),
        (("remove", "nobody"), "has no key 'nobody'"),
        (("add", "two words"), "String should match pattern"),
    ],
)
def test_what_cannot_be_done_is_said(tmp_path, arguments, said):
    file = tmp_path / "keys.json"
    assert keys(file, "add", "robot").returncode == 0
    before = file.read_bytes()
    answer = keys(file, *arguments)
    assert answer.returncode == 1
    assert said in answer.stderr
    assert file.read_bytes() == before


def test_a_service_without_its_file_says_so(tmp_path):
    missing = tmp_path / "keys.json"
    answer = subprocess.run(
        ["env", f"ROLLCAST_KEYS_FILE={missing}", SERVICE_PYTHON, "-m", "service", "--port", "0"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert answer.returncode == 1
    assert answer.stderr.startswith("rollcast: keys_file: ")
    assert answer.stderr.count("\n") == 1


def said(*arguments: str, **settings: str) -> subprocess.Popen[str]:
    variables = [f"{name}={value}" for name, value in settings.items()]
    return subprocess.Popen(
        ["env", *variables, SERVICE_PYTHON, "-m", "service", "--port", "0", *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_a_network_is_not_served_without_keys_unless_told_so(tmp_path):
    file = tmp_path / "keys.json"
    keys(file, "add", "robot")
    refused = said("--host", "0.0.0.0")
    _, line = refused.communicate(timeout=60)
    assert refused.returncode == 1
    assert line.startswith("rollcast: refuses to listen on 0.0.0.0 without API keys")
    assert "ROLLCAST_KEYS_FILE=" in line
    assert "ROLLCAST_ALLOW_UNAUTHENTICATED=true" in line
    for settings in ({"ROLLCAST_KEYS_FILE": str(file)}, {"ROLLCAST_ALLOW_UNAUTHENTICATED": "true"}):
        told = said("--host", "0.0.0.0", **settings)
        assert told.stdout is not None
        assert told.stdout.readline().startswith("Rollcast listens on http://0.0.0.0:")
        stop_service(told)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.0.0.2"])
def test_this_machine_alone_needs_no_keys(host):
    told = said("--host", host)
    assert told.stdout is not None
    assert told.stdout.readline().startswith(f"Rollcast listens on http://{host}:")
    stop_service(told)
