"""The training's image: it simulates as nobody and keeps what it made in its volume."""

from tests.image.conftest import HARDENED, RUN


def test_it_shows_its_commands_and_holds_torch(training_images):
    shown = training_images.podman(
        *RUN, *HARDENED, "--rm", "rollcast-training:test", "train", "--help"
    )
    assert shown.returncode == 0, shown.stdout
    assert "field-one-ball" in shown.stdout


def test_it_keeps_scenes_in_its_volume(training_images, tmp_path):
    tmp_path.chmod(0o777)
    done = training_images.podman(
        *RUN, *HARDENED, "--rm", "--volume", f"{tmp_path}:/runs", "rollcast-training:test",
        "simulate", "hemisphere", "--scenes", "2", "--split", "validation",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert [path for path in tmp_path.rglob("*") if path.is_file()]
