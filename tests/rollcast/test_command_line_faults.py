"""Whatever goes wrong, a user of the command line gets a line, and the answer that there is."""

import io
import os
import sys

import numpy as np
import pytest
from PIL import Image

from rollcast.__main__ import main
from rollcast.client import Client
from rollcast.client.testing import FakeService

SIDE = 48


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for number in range(8):
        picture = Image.fromarray(np.full((SIDE, SIDE, 3), 20 * number, np.uint8))
        picture.save(folder / f"{number}.png")
    return folder


def connect(_):
    return Client(transport=FakeService())


def test_a_fault_of_ours_is_a_line_and_a_file(images, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)

    def broken(_):
        raise ZeroDivisionError("by nothing")

    assert main(["predict", str(images)], broken) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("rollcast: unexpected ZeroDivisionError: by nothing; this is a")
    assert printed.err.count("\n") == 1
    [log] = tmp_path.glob("rollcast-*.log")
    assert str(log) in printed.err
    assert "Traceback" in log.read_text()


def test_the_answer_is_printed_before_it_is_drawn(images, capsys, tmp_path):
    out = tmp_path / "gone" / "forecast.png"
    out.parent.mkdir()

    def connect_and_remove(_):
        out.parent.rmdir()
        return Client(transport=FakeService())

    assert main(["predict", str(images), "--out", str(out)], connect_and_remove) == 1
    printed = capsys.readouterr()
    assert printed.out.startswith("fake@1: four frames from 0.000 s to 0.075 s")
    assert printed.err.startswith("rollcast: ")
    assert printed.err.count("\n") == 1


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("SSL_CERT_FILE", "/no/such/file.pem"),
        ("ALL_PROXY", "socks5://127.0.0.1:1"),
        ("HTTP_PROXY", "gopher://127.0.0.1:1"),
    ],
)
def test_an_environment_that_cannot_be_used_is_named(images, capsys, monkeypatch, variable, value):
    monkeypatch.setenv(variable, value)
    monkeypatch.delenv("NO_PROXY", raising=False)
    monkeypatch.delenv("no_proxy", raising=False)
    code = main(["predict", str(images), "--url", "http://127.0.0.1:9"])
    printed = capsys.readouterr()
    assert (code, printed.out, printed.err.count("\n")) == (1, "", 1)
    assert variable.lower() in printed.err.lower() or "does not answer" in printed.err


@pytest.mark.parametrize(
    ("arguments", "environment", "named"),
    [
        ([], {"ROLLCAST_URL": "ftp://there"}, "ROLLCAST_URL"),
        ([], {"ROLLCAST_API_KEY": "a b"}, "ROLLCAST_API_KEY"),
        (["--api-key", "ключ"], {}, "api_key"),
    ],
)
def test_a_wrong_address_or_key_is_named_and_no_proxy(
    images, capsys, monkeypatch, arguments, environment, named
):
    for variable, value in environment.items():
        monkeypatch.setenv(variable, value)
    code = main([*arguments, "predict", str(images)])
    printed = capsys.readouterr()
    assert (code, printed.out, printed.err.count("\n")) == (1, "", 1)
    assert named in printed.err
    assert "proxies" not in printed.err


def test_names_that_are_not_utf8_are_printed(images, capsys, tmp_path):
    folder = tmp_path / os.fsdecode(b"images\xff")
    images.rename(folder)
    assert main(["predict", str(folder)], connect) == 0
    (folder / "3.png").write_bytes(b"no image")
    assert main(["predict", str(folder)], connect) == 1
    assert r"images\xff/3.png is not an image" in capsys.readouterr().err


def test_a_terminal_of_few_characters_gets_escapes(images, monkeypatch):
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    assert main(["simulate", "hemisphere", "--steps", "10", "--out", str(images.parent / "é")],
                connect) == 0  # fmt: skip
    sys.stdout.flush()
    assert rb"\xe9: 10 frames" in written.getvalue()
