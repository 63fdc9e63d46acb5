"""Data sets of scenes, against the simulations that they were made of."""

import os

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from rollcast import datasets
from rollcast.camera import camera_for
from rollcast.errors import DatasetError
from rollcast.simulation import Simulator

STEPS = 7


@pytest.fixture(scope="module")
def simulated():
    return list(datasets.scenes("ellipsoid", count=3, steps=STEPS, objects=2, first_seed=5))


@pytest.fixture(scope="module")
def path(simulated, tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "scenes.parquet"
    assert datasets.write(path, iter(simulated), image_size=64) == len(simulated)
    return path


@pytest.fixture(scope="module")
def data(path):
    return datasets.load(path)


def test_scenes_are_those_of_their_seeds(simulated):
    simulator = Simulator()
    again = simulator.sequence("ellipsoid", 2, 6, STEPS)
    simulator.close()
    assert simulated[1].scene == again.scene
    assert np.array_equal(simulated[1].trajectory.positions_m, again.trajectory.positions_m)


def test_what_is_written_is_read(simulated, data):
    assert len(data) == len(simulated)
    for record, made in zip(data, simulated, strict=True):
        assert record.scene == made.scene
        assert record.start_step == made.start_step
        assert record.frame_rate == 40
        assert np.array_equal(record.frames, made.render(64))
        expected = camera_for("ellipsoid", 64).project(made.trajectory.positions_m)
        assert np.allclose(record.positions_px, expected, atol=1e-4)
        spins = record.trajectory.angular_velocities_rad_s
        assert np.allclose(spins, made.trajectory.angular_velocities_rad_s, atol=1e-4)


def test_the_ball_is_where_the_position_says(data):
    """The brightest saturation about the position is the ball's, as Rollcast's pixels count."""
    record = data[0]
    assert record.frames is not None
    for frame, places in zip(record.frames, record.positions_px, strict=True):
        for x, y in places:
            patch = frame[int(y), int(x)].astype(int)
            assert patch.max() - patch.min() > 30


def test_a_slice_is_a_data_set(data):
    part = data[1:]
    assert isinstance(part, datasets.SceneDataset)
    assert [record.scene for record in part] == [data[1].scene, data[2].scene]
    assert data[-1].scene == data[2].scene
    with pytest.raises(IndexError):
        data[3]


def test_windows_are_batches_of_torch(data):
    loading = pytest.importorskip("torch.utils.data")
    windows = data.windows(horizon=3)
    assert len(windows) == 3 * (STEPS - 4 - 3 + 2)
    batch = next(iter(loading.DataLoader(windows, batch_size=5)))
    assert batch["frames"].shape == (5, 4, 64, 64, 3)
    assert batch["positions"].shape == (5, 2, 3, 2)
    second_scene = windows[len(windows) // 3]
    assert np.array_equal(second_scene["frames"], data[1].frames[:4])
    # Step 0 is the last observed frame.
    assert np.array_equal(second_scene["positions"][:, 0], data[1].positions_px[3])
    last = windows[-1]
    assert np.array_equal(last["positions"][:, -1], data[2].positions_px[-1])
    assert len(data.windows(horizon=STEPS)) == 0


def test_a_table_has_a_row_for_every_ball_and_frame(data):
    table = data.to_dataframe()
    assert len(table) == 3 * STEPS * 2
    row = table[(table.scene == 1) & (table.frame == 4) & (table.ball == 1)].iloc[0]
    assert row.time_s == pytest.approx(4 / 40)
    assert (row.x_px, row.y_px) == pytest.approx(tuple(data[1].positions_px[4, 1]))
    assert row.z_m == pytest.approx(data[1].trajectory.positions_m[4, 1, 2])


def test_frames_may_be_left_out(simulated, tmp_path):
    datasets.write(tmp_path / "b.parquet", simulated[:1])
    datasets.write(tmp_path / "a.parquet", simulated[1:])
    data = datasets.load(tmp_path)
    assert [record.scene.seed for record in data] == [6, 7, 5]
    assert data[0].frames is None
    assert data[0].image_size == 128
    with pytest.raises(DatasetError, match="has no frames: write it with image_size"):
        data.windows(horizon=2)


def test_files_come_by_number_and_hidden_ones_are_passed_over(simulated, tmp_path):
    for number, sequence in ((10, simulated[0]), (9, simulated[1])):
        datasets.write(tmp_path / f"part{number}.PARQUET", [sequence])
    (tmp_path / "._part9.parquet").write_bytes(b"\0\5\x16\7")
    assert [one.scene.seed for one in datasets.load(tmp_path)] == [
        sequence.scene.seed for sequence in (simulated[1], simulated[0])
    ]
    os.mkfifo(tmp_path / "x.parquet")
    with pytest.raises(DatasetError, match="is a pipe"):
        datasets.load(tmp_path)


def test_other_files_are_refused(tmp_path, path):
    with pytest.raises(DatasetError, match=r"contains no \.parquet file"):
        datasets.load(tmp_path)
    text = tmp_path / "text.parquet"
    text.write_text("no table")
    with pytest.raises(DatasetError, match=r"text\.parquet cannot be read"):
        datasets.load(text)
    other = tmp_path / "other.parquet"
    parquet.write_table(pa.table({"x": [1]}), other)
    with pytest.raises(DatasetError, match="its columns are x, expected scene, "):
        datasets.load(other)
    with pytest.raises(DatasetError, match="cannot be read"):
        datasets.load(tmp_path / "missing.parquet")
