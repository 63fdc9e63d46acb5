"""The file of keys: changed by several at once, replaced by what is no file, filled in wrongly."""

import json
import logging
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from service.auth.api_keys import ApiKeyStore, KeyFile, new_token, without_tokens
from service.observability.log_config import JsonLines, TextLines
from service.settings import Settings


def run(path, *arguments):
    command = [sys.executable, "-m", "service.auth", "--file", str(path), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_keys_that_are_added_at_the_same_time_are_all_kept(tmp_path):
    path = tmp_path / "keys.json"
    with ThreadPoolExecutor(6) as pool:
        added = list(pool.map(lambda index: run(path, "add", f"robot{index}"), range(6)))
    assert [one.returncode for one in added] == [0] * 6, added
    store = ApiKeyStore(path)
    found = {store.find(one.stdout.strip()).name for one in added}
    assert found == {f"robot{index}" for index in range(6)}
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o600


TOKEN = new_token()
WRONG_PLACES = {
    "for its hash": {"keys": [{"name": "robot", "sha256": TOKEN}]},
    "for its name": {"keys": [{"name": TOKEN, "sha256": "0" * 64}]},
    "as a field": {"keys": [{"name": "robot", "sha256": "0" * 64, TOKEN: 1}]},
    "as a scope": {"keys": [{"name": "robot", "sha256": "0" * 64, "scopes": [TOKEN]}]},
    "in the list": {"keys": [TOKEN]},
    "beside the list": {"keys": [], TOKEN: ""},
    "as the file": TOKEN,
}


@pytest.mark.parametrize("place", WRONG_PLACES)
def test_a_key_in_a_wrong_place_is_not_repeated(tmp_path, place, caplog):
    path = tmp_path / "keys.json"
    KeyFile().write(path)
    store = ApiKeyStore(path)
    path.write_text(json.dumps(WRONG_PLACES[place]))
    for read in (lambda: KeyFile.read(path), lambda: Settings(models_dir=tmp_path, keys_file=path)):
        with pytest.raises(ValueError) as caught:  # noqa: PT011 - what it says is the question
            read()
        assert TOKEN not in str(caught.value)
    listed = run(path, "list")
    assert listed.returncode == 1
    assert TOKEN not in listed.stdout + listed.stderr
    store._checked_at = 0  # a second later
    assert store.find(TOKEN) is None
    assert "cannot be read" in caplog.text
    assert TOKEN not in caplog.text


@pytest.mark.parametrize("lines", [JsonLines(), TextLines("%(message)s")])
def test_no_line_of_the_log_has_a_key(lines):
    record = logging.LogRecord(
        "service", logging.INFO, "", 1, "GET /models/%s: 404", (TOKEN,), None
    )
    record.path = f"/models/{TOKEN}"
    line = lines.format(record)
    assert TOKEN not in line
    assert "rollcast_***" in line


def test_names_of_figures_stay_in_the_log():
    text = "rollcast_requests_in_flight and rollcast-2 are no keys"
    assert without_tokens(text) == text


def test_a_pipe_in_place_of_the_file_is_refused_and_the_keys_stay(tmp_path, caplog):
    path = tmp_path / "keys.json"
    token = run(path, "add", "robot").stdout.strip()
    store = ApiKeyStore(path)
    path.unlink()
    os.mkfifo(path)
    store._checked_at = 0
    began = time.monotonic()
    assert store.find(token).name == "robot"
    assert time.monotonic() - began < 5
    assert re.search("not a regular file", caplog.text)
    assert run(path, "add", "another").returncode == 1
