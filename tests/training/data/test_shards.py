"""Shards of scenes: made once, whole or not at all, the same bytes wherever they are made."""

import sys

import fsspec
import numpy as np
import pytest
import typer

from training.cli.options import with_ray
from training.data.shards import (
    SHARD_SCENES,
    Source,
    in_processes,
    load_recordings,
    make_missing,
    split_shards,
)

SOURCE = Source("hemisphere")


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    shards = split_shards(SOURCE, "validation", 2 * SHARD_SCENES, str(folder))
    make_missing(shards, in_processes(1), "one process")
    return folder


def test_they_hold_the_scenes_of_the_split_in_order(made):
    recordings = load_recordings(sorted(made.iterdir()))
    seeds = [recording.scene.seed for recording in recordings]
    assert seeds == list(range(2_000_000, 2_000_000 + 2 * SHARD_SCENES))


def test_they_are_the_same_bytes_for_any_number_of_processes(made, tmp_path):
    shards = split_shards(SOURCE, "validation", 2 * SHARD_SCENES, str(tmp_path))
    make_missing(shards, in_processes(2), "two processes")
    assert contents(tmp_path) == contents(made)


def test_those_that_are_there_are_kept(made):
    shards = split_shards(SOURCE, "validation", 2 * SHARD_SCENES, str(made))

    def none(missing):
        raise AssertionError(missing)

    make_missing(shards, none, "none")


def test_one_that_was_not_finished_is_made_again(made, tmp_path):
    (shard,) = split_shards(SOURCE, "validation", SHARD_SCENES, str(tmp_path))
    whole = (made / "2000000.npz").read_bytes()
    (tmp_path / "2000000.npz.0123").write_bytes(whole[:1000])
    assert not shard.exists()
    shard.make()
    assert (tmp_path / "2000000.npz").read_bytes() == whole


def test_any_address_of_fsspecs_will_do(made):
    (shard,) = split_shards(SOURCE, "validation", SHARD_SCENES, "memory://shards/hemisphere")
    shard.make()
    assert shard.exists()
    with fsspec.open(shard.address) as file:
        data = file.read()
    assert data == (made / "2000000.npz").read_bytes()
    assert np.load(made / "2000000.npz")["positions"].dtype == np.float32


def test_ray_is_an_extra_that_is_asked_for(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "training.orchestration.ray_backend", raising=False)
    with pytest.raises(typer.Exit):
        with_ray()
    assert "--ray needs the extra ray-training" in capsys.readouterr().err
