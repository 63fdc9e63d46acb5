# pyright: standard
"""Data sets of simulated scenes: generated, stored as Parquet files, read as arrays.

    from rollcast import datasets

    scenes = datasets.scenes("hemisphere", count=20, steps=60)
    datasets.write("bowls.parquet", scenes, image_size=128)
    data = datasets.load("bowls.parquet")
    data[0].frames.shape                          # (60, 128, 128, 3)
    loader = torch.utils.data.DataLoader(data.windows(horizon=20), batch_size=32, shuffle=True)

Generating needs the extra ``simulation``, files the extra ``datasets``. The format is documented in
``docs/guide/datasets.md``.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import pyarrow as pa
from jaxtyping import Float, UInt8
from pyarrow import parquet

from rollcast.camera import NETWORK_FRAME_SIZE, camera_for
from rollcast.errors import DatasetError, FootageError
from rollcast.frames import as_frame, encode_png, require_regular_file
from rollcast.image_sequence import in_order, is_hidden
from rollcast.scene import Scenario, Scene
from rollcast.trajectory import FRAME_RATE_HZ, OBSERVED_FRAMES, Trajectory

if TYPE_CHECKING:
    import pandas as pd

    from rollcast.simulation import Sequence as SimulatedSequence

PER_BALL = pa.list_(pa.list_(pa.list_(pa.float32())))
"""Lists [frames, balls, numbers]."""
COLUMNS = pa.schema(
    [
        pa.field("scene", pa.string(), nullable=False),
        pa.field("start_step", pa.int32(), nullable=False),
        pa.field("frame_rate", pa.float32(), nullable=False),
        pa.field("image_size", pa.int32(), nullable=False),
        *(
            pa.field(name, PER_BALL, nullable=False)
            for name in (
                "positions_px", "positions_m", "orientations_xyzw", "angular_velocities_rad_s",
            )
        ),
        pa.field("frames", pa.list_(pa.struct([("bytes", pa.binary()), ("path", pa.string())]))),
    ]
)  # fmt: skip
"""Frames are PNG files, in the form that Hugging Face's ``datasets`` reads as images."""
SUFFIX = ".parquet"
ROWS_WRITTEN_TOGETHER = 32
COMPRESS_LEVEL = 6
"""Compression level of the PNG files, which are written once and read often."""


@dataclass(frozen=True)
class SceneRecord:
    """One scene of a data set with F frames and N balls.

    Attributes
    ----------
    scene
        Parameters of the scene.
    start_step
        Index of the first frame, counted from the start of the simulation.
    frame_rate
        Frames per second.
    image_size
        Side of the square frames, pixels.
    positions_px
        Ball centres in the frames, pixels, x right and y down.
    trajectory
        Ball centres in metres, orientations and angular velocities, world axes.
    frames
        Rendered frames, or None in a data set without frames.
    """

    scene: Scene
    start_step: int
    frame_rate: float
    image_size: int
    positions_px: Float[np.ndarray, "F N 2"]
    trajectory: Trajectory
    frames: UInt8[np.ndarray, "F size size 3"] | None


class SceneDataset(Sequence[SceneRecord]):
    """Scenes of Parquet files; frames are decoded when a scene is read.

    Parameters
    ----------
    table
        Rows of :data:`COLUMNS`.
    """

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def __len__(self) -> int:
        """Count the scenes."""
        return self._table.num_rows

    @overload
    def __getitem__(self, index: int) -> SceneRecord: ...
    @overload
    def __getitem__(self, index: slice) -> "SceneDataset": ...
    def __getitem__(self, index: int | slice) -> "SceneRecord | SceneDataset":
        """Read a scene, or select several.

        Raises
        ------
        IndexError
            When there is no such scene.
        """
        if isinstance(index, slice):
            return SceneDataset(self._table.take(list(range(len(self)))[index]))
        row = self._row(index)
        has_frames = self._table["frames"][range(len(self))[index]].is_valid
        return SceneRecord(
            Scene.model_validate_json(row["scene"]),
            row["start_step"],
            row["frame_rate"],
            row["image_size"],
            np.array(row["positions_px"], np.float32),
            Trajectory(
                *(
                    np.array(row[name], np.float32)
                    for name in ("positions_m", "orientations_xyzw", "angular_velocities_rad_s")
                )
            ),
            self.frames(index, 0, len(row["positions_px"])) if has_frames else None,
        )

    @property
    def lengths(self) -> list[int]:
        """Number of frames of every scene."""
        return self._table["positions_px"].combine_chunks().value_lengths().to_pylist()

    @property
    def has_frames(self) -> bool:
        """True if all scenes were rendered."""
        return self._table["frames"].null_count == 0

    def frames(self, index: int, start: int, stop: int) -> UInt8[np.ndarray, "F size size 3"]:
        """Decode some frames of a scene that was rendered."""
        stored = self._table["frames"][range(len(self))[index]].values.slice(start, stop - start)
        return np.stack([as_frame(frame["bytes"].as_py()) for frame in stored])

    def _row(self, index: int) -> dict[str, Any]:
        """Return everything but the frames of a scene."""
        names = COLUMNS.names[:-1]
        (row,) = self._table.select(names).slice(range(len(self))[index], 1).to_pylist()
        return row

    def positions_and_spins(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Return centres in pixels [F, N, 2] and angular velocities in rad/s [F, N, 3]."""
        row = self._row(index)
        return (
            np.array(row["positions_px"], np.float32),
            np.array(row["angular_velocities_rad_s"], np.float32),
        )

    def to_dataframe(self) -> "pd.DataFrame":
        """Return a row for every scene, frame and ball; needs the extra ``dataframe``."""
        import pandas as pd

        parts: list[dict[str, np.ndarray]] = []
        for index, row in enumerate(self._table.drop_columns(["frames"]).to_pylist()):
            values = {name: np.array(row[name], np.float32) for name in COLUMNS.names[4:8]}
            count, balls = values["positions_m"].shape[:2]
            columns: dict[str, np.ndarray] = {
                "scene": np.full(count * balls, index),
                "frame": np.repeat(np.arange(count), balls),
                "time_s": np.repeat(np.arange(count) / row["frame_rate"], balls),
                "ball": np.tile(np.arange(balls), count),
            }
            for name, axes in (
                ("positions_px", ("x_px", "y_px")),
                ("positions_m", ("x_m", "y_m", "z_m")),
                ("angular_velocities_rad_s", ("wx_rad_s", "wy_rad_s", "wz_rad_s")),
            ):
                flat = values[name].reshape(count * balls, -1)
                columns |= {axis: flat[:, number] for number, axis in enumerate(axes)}
            parts.append(columns)
        return pd.DataFrame(
            {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        )

    def windows(self, horizon: int, observed: int = OBSERVED_FRAMES) -> "Windows":
        """Return all windows of observed frames and the positions that follow.

        Parameters
        ----------
        horizon
            Number of steps; step 0 is the last observed frame.
        observed
            Number of frames.

        Raises
        ------
        DatasetError
            When the data set has no frames.
        """
        return Windows(self, horizon, observed)


class Windows(Sequence[Mapping[str, np.ndarray]]):
    """Windows as mappings of arrays: a map-style data set for ``torch.utils.data.DataLoader``.

    Every window has ``frames`` [observed, size, size, 3] uint8, ``positions`` [N, horizon, 2] in
    pixels and ``angular_velocities`` [N, horizon, 3] in rad/s. Scenes with different numbers of
    balls do not fit into one batch of the default collation.
    """

    def __init__(self, data: SceneDataset, horizon: int, observed: int) -> None:
        self._data = data
        self._horizon = horizon
        self._observed = observed
        if not data.has_frames:
            raise DatasetError(
                "the data set has no frames: write it with image_size, or python -m training "
                "simulate --output FILE.parquet --image-size 128"
            )
        counts = [max(length - observed - horizon + 2, 0) for length in data.lengths]
        self._ends = np.cumsum(counts)

    def __len__(self) -> int:
        """Count the windows."""
        return int(self._ends[-1]) if len(self._ends) else 0

    @overload
    def __getitem__(self, index: int) -> Mapping[str, np.ndarray]: ...
    @overload
    def __getitem__(self, index: slice) -> list[Mapping[str, np.ndarray]]: ...
    def __getitem__(
        self, index: int | slice
    ) -> Mapping[str, np.ndarray] | list[Mapping[str, np.ndarray]]:
        """Return a window.

        Raises
        ------
        IndexError
            When there is no such window.
        """
        if isinstance(index, slice):
            return [self[number] for number in range(len(self))[index]]
        number = range(len(self))[index]
        scene = int(np.searchsorted(self._ends, number, side="right"))
        start = number - (int(self._ends[scene - 1]) if scene else 0)
        last = start + self._observed - 1
        steps = slice(last, last + self._horizon)
        positions, spins = self._data.positions_and_spins(scene)
        return {
            "frames": self._data.frames(scene, start, last + 1),
            "positions": positions[steps].swapaxes(0, 1).copy(),
            "angular_velocities": spins[steps].swapaxes(0, 1).copy(),
        }


def scenes(
    scenario: Scenario,
    *,
    count: int,
    steps: int,
    objects: int = 1,
    first_seed: int = 0,
    parameters: Mapping[str, object] | None = None,
) -> "Iterator[SimulatedSequence]":
    """Simulate scenes one after the other; needs the extra ``simulation``.

    Parameters
    ----------
    count
        Number of scenes.
    steps
        Frames of every scene.
    objects
        Balls.
    first_seed
        Seed of the first scene; the others follow.
    parameters
        Fields of :class:`rollcast.scene.Scene` that are fixed.

    Raises
    ------
    SceneParametersError, SceneRejectedError
        When there is no scene with these parameters.
    """
    from rollcast.simulation import Simulator

    with closing(Simulator()) as simulator:
        for seed in range(first_seed, first_seed + count):
            yield simulator.sequence(scenario, objects, seed, steps, parameters=parameters)


def write(
    path: str | Path, sequences: "Iterable[SimulatedSequence]", image_size: int | None = None
) -> int:
    """Write scenes into a Parquet file; return their number.

    Parameters
    ----------
    path
        File, which is replaced.
    sequences
        Scenes; a generator is written as it goes.
    image_size
        Side of the frames in pixels; None leaves them out, and positions are in pixels of 128.
    """
    count = 0
    rows: list[dict[str, object]] = []
    with parquet.ParquetWriter(path, COLUMNS, compression="zstd") as writer:
        for sequence in sequences:
            rows.append(_row(sequence, image_size))
            count += 1
            if len(rows) == ROWS_WRITTEN_TOGETHER:
                writer.write_table(pa.Table.from_pylist(rows, COLUMNS))
                rows = []
        if rows:
            writer.write_table(pa.Table.from_pylist(rows, COLUMNS))
    return count


def load(path: str | Path) -> SceneDataset:
    """Read a Parquet file of :func:`write`, or all such files of a folder, by number.

    Raises
    ------
    DatasetError
        When a file cannot be read, or has other columns.
    """
    path = Path(path)
    files = _parquet_files(path) if path.is_dir() else [path]
    if not files:
        raise DatasetError(f"{path} contains no .parquet file")
    return SceneDataset(pa.concat_tables([_read(file) for file in files]))


def _parquet_files(folder: Path) -> list[Path]:
    """Return the data sets of a folder by the numbers in their names; hidden files are no data."""
    found = [path for path in folder.iterdir() if path.suffix.lower() == SUFFIX]
    return in_order([path for path in found if not is_hidden(path)])


def _read(file: Path) -> pa.Table:
    try:
        require_regular_file(file)
        table = parquet.read_table(file)
    except (OSError, FootageError, pa.ArrowInvalid) as error:
        raise DatasetError(f"{file} cannot be read as a data set: {error}") from error
    if table.column_names != COLUMNS.names:
        raise DatasetError(
            f"{file} is not a data set of scenes: its columns are {', '.join(table.column_names)}, "
            f"expected {', '.join(COLUMNS.names)}"
        )
    return table.cast(COLUMNS)


def _row(sequence: "SimulatedSequence", image_size: int | None) -> dict[str, object]:
    scene, trajectory = sequence.scene, sequence.trajectory
    size = NETWORK_FRAME_SIZE if image_size is None else image_size
    frames = None
    if image_size is not None:
        frames = [
            {"bytes": encode_png(frame, COMPRESS_LEVEL), "path": None}
            for frame in sequence.render(image_size)
        ]
    return {
        "scene": scene.model_dump_json(exclude_none=True),
        "start_step": sequence.start_step,
        "frame_rate": FRAME_RATE_HZ,
        "image_size": size,
        "positions_px": camera_for(scene.scenario, size).project(trajectory.positions_m).tolist(),
        "positions_m": trajectory.positions_m.tolist(),
        "orientations_xyzw": trajectory.orientations_xyzw.tolist(),
        "angular_velocities_rad_s": trajectory.angular_velocities_rad_s.tolist(),
        "frames": frames,
    }
