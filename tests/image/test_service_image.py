"""The service's image: what is in it, what it answers, how it stops."""

from collections.abc import Iterator

import pytest

from rollcast.client import Client
from rollcast.errors import AuthError
from tests.e2e.conftest import ASKED, LONGEST_HORIZON, assert_same_forecasts, long_forecasts
from tests.image.conftest import BASE, HARDENED, RUN, SERVICE_IMAGE

MOST_MB = 600
LOAD = 8
STOP_S = 300


def test_it_is_small_and_says_what_it_is(service_images):
    image, base = service_images.inspect(SERVICE_IMAGE), service_images.inspect(BASE)
    beyond = (image["Size"] - base["Size"]) / 1e6
    print(f"{beyond:.0f} MB beyond the base")
    assert beyond < MOST_MB
    assert image["User"] == "10001:10001"
    assert image["Labels"]["org.opencontainers.image.title"] == "Rollcast"
    assert image["Config"]["StopSignal"] in {"SIGTERM", "15"}
    # Every address is bound by a flag that is there to be seen.
    assert image["Config"]["Cmd"][:2] == ["--host", "0.0.0.0"]


def test_it_holds_neither_torch_nor_robots(service_images, container):
    name, _ = container
    for package in ("torch", "pybullet_data", "pip"):
        done = service_images.podman("exec", name, "python", "-c", f"import {package}")
        assert "ModuleNotFoundError" in done.stdout


def test_it_runs_as_nobody_on_a_root_that_cannot_be_written(service_images, container):
    name, _ = container
    assert service_images.podman("exec", name, "id", "-u").stdout.strip() == "10001"
    written = service_images.podman("exec", name, "sh", "-c", "touch /app/here")
    assert "Read-only file system" in written.stdout


def test_its_health_check_tells_a_service_from_none(service_images, container):
    name, address = container
    _, *check = service_images.inspect(SERVICE_IMAGE)["Healthcheck"]["Test"]
    port = address.rpartition(":")[2]
    there = [part.replace("8000", port) for part in check]
    nowhere = [part.replace("8000", "9") for part in check]
    assert service_images.podman("exec", name, *there).returncode == 0
    assert service_images.podman("exec", name, *nowhere).returncode != 0


@pytest.mark.parametrize("asked", ASKED, ids=str)
def test_it_answers_as_the_checkout_does(container, checkout, asked):
    assert_same_forecasts(container[1], checkout, asked)


@pytest.fixture
def other_container(service_images) -> Iterator[tuple[str, str]]:
    """One that may be stopped, and has the time that a busy machine needs to answer."""
    with service_images.serving(
        "--env", f"ROLLCAST_GRACEFUL_SHUTDOWN_TIMEOUT_S={STOP_S}"
    ) as serving:
        yield serving


def test_it_answers_what_it_has_accepted_when_it_is_told_to_stop(service_images, other_container):
    name, address = other_container
    with long_forecasts(address, LOAD) as answers:
        stopped = service_images.podman("stop", "--time", str(STOP_S), name)
        assert stopped.returncode == 0
        assert [answer.result() for answer in answers] == LOAD * [LONGEST_HORIZON]
    # 0 or SIGTERM's own, but not what a kill leaves behind (137).
    ended = service_images.podman("inspect", "--format", "{{.State.ExitCode}}", name)
    assert ended.stdout.strip() in {"0", "143"}


def test_any_user_runs_it_and_makes_its_keys(service_images, tmp_path):
    """OpenShift gives a user without a name, in the group 0."""
    nobody = ("--user", "123456:0")
    tmp_path.chmod(0o777)
    made = service_images.podman(
        *RUN, *HARDENED, *nobody, "--rm", "--volume", f"{tmp_path}:/keys", "--entrypoint", "python",
        SERVICE_IMAGE, "-m", "service.auth", "--file", "/keys/keys.json", "add", "robot",
    )  # fmt: skip
    assert made.returncode == 0, made.stdout
    key = made.stdout.split()[-1]
    mounted = ("--volume", f"{tmp_path}:/keys:ro", "--env", "ROLLCAST_KEYS_FILE=/keys/keys.json")
    with service_images.serving(*nobody, *mounted) as (name, address):
        assert service_images.podman("exec", name, "id", "-u").stdout.strip() == "123456"
        with pytest.raises(AuthError), Client(address) as client:
            client.models()
        with Client(address, api_key=key) as client:
            frames = client.simulate("hemisphere", seed=1, steps=4).frames
            assert client.predict(frames, horizon=3).positions.shape == (1, 3, 2)
