# pyright: standard
"""Tracks as a table: one row a frame and ball, in a Parquet or CSV file."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int
from pyarrow import csv, parquet
from pydantic import AliasChoices, BaseModel, Field, ValidationError

from rollcast.errors import FootageError
from rollcast.frames import require_regular_file

ABOUT = b"rollcast"
"""Key of the file metadata with the properties of the clip, as JSON."""
COLUMNS = pa.schema(
    [
        pa.field("clip", pa.string()),
        pa.field("frame", pa.int64()),
        pa.field("time", pa.float64()),
        pa.field("ball", pa.int64()),
        pa.field("x", pa.float64()),
        pa.field("y", pa.float64()),
        pa.field("radius", pa.float64()),
        pa.field("confidence", pa.float64()),
    ]
)

PARQUET, CSV = ".parquet", ".csv"


class _ClipProperties(BaseModel):
    """Properties that all rows of a table share."""

    width: int
    height: int
    colors: tuple[str, ...] = Field(validation_alias=AliasChoices("colors", "colours"))
    """Files of earlier versions have the second name."""
    source_sha256: str = ""


@dataclass(frozen=True)
class Tracks:
    """Positions of the balls of a clip in every frame.

    Attributes
    ----------
    clip
        Name of the clip.
    width, height
        Of its pictures, pixels.
    colors
        Mean colour of each ball, as ``#rrggbb``; their order is that of the balls.
    frames
        Numbers of the clip's frames, from 0, without repeated frames.
    times_s
        Seconds after the clip's first frame.
    positions_px
        Centres in pixels of the clip's pictures, (0, 0) their top-left corner (``camera.py``); NaN
        in gaps.
    radii_px
        NaN in gaps.
    confidences
        0 to 1; 0 in gaps.
    source_sha256
        Hash of the clip's file; empty where it is not known.
    """

    clip: str
    width: int
    height: int
    colors: tuple[str, ...]
    frames: Int[np.ndarray, " frames"]
    times_s: Float[np.ndarray, " frames"]
    positions_px: Float[np.ndarray, "frames balls 2"]
    radii_px: Float[np.ndarray, "frames balls"]
    confidences: Float[np.ndarray, "frames balls"]
    source_sha256: str = ""

    @property
    def balls(self) -> int:
        """Number of balls."""
        return len(self.colors)

    @property
    def found(self) -> np.ndarray:
        """Mask of the balls that were found in each frame, [frames, balls]."""
        return ~np.isnan(self.positions_px[..., 0])

    def write(self, path: Path) -> None:
        """Write a row for every frame and ball, null and confidence 0 in gaps.

        Parameters
        ----------
        path
            A Parquet file, or with the suffix ``.csv`` a table of the same columns, whose first
            lines, which begin with ``#``, hold the properties of the clip.
        """
        frames, balls = self.confidences.shape
        columns = [
            [self.clip] * (frames * balls),
            np.repeat(self.frames, balls),
            np.repeat(self.times_s, balls),
            np.tile(np.arange(balls), frames),
            *(self.positions_px[..., axis].ravel() for axis in (0, 1)),
            self.radii_px.ravel(),
            self.confidences.ravel(),
        ]
        about = {
            "width": self.width,
            "height": self.height,
            "colors": self.colors,
            "source_sha256": self.source_sha256,
        }
        table = pa.Table.from_arrays(
            [pa.array(c, f.type, from_pandas=True) for c, f in zip(columns, COLUMNS, strict=True)],
            schema=COLUMNS.with_metadata({ABOUT: json.dumps(about).encode()}),
        )
        with path.open("wb") as file:  # names go through Python: pyarrow wants UTF-8
            if path.suffix.lower() == CSV:
                file.write(b"# " + json.dumps(about).encode() + b"\n")
                csv.write_csv(table, file)
            else:
                parquet.write_table(table, file)

    @classmethod
    def read(cls, path: Path) -> "Tracks":
        """Read a file of :meth:`write`.

        Raises
        ------
        FootageError
            When the file cannot be read or holds no such table.
        """
        try:
            require_regular_file(path)
            with path.open("rb") as file:
                table = _read_csv(file) if path.suffix.lower() == CSV else parquet.read_table(file)
        except (OSError, ValueError, pa.ArrowException) as error:
            raise FootageError(f"{path} cannot be read as tracks: {error}") from error
        about = (table.schema.metadata or {}).get(ABOUT)
        if about is None or not table.schema.equals(COLUMNS) or not table.num_rows:
            raise FootageError(
                f"{path} holds no tracks: its columns are {', '.join(table.column_names)}, "
                f"expected {', '.join(COLUMNS.names)}, as `rollcast track` writes them"
            )
        try:
            clip = _ClipProperties.model_validate_json(about)
        except ValidationError as error:
            fault = error.errors()[0]
            place = ".".join(map(str, fault["loc"]))
            raise FootageError(
                f"{path} holds no tracks: the properties of its clip are wrong: {place} "
                f"{fault['msg'].lower()}"
            ) from error
        balls = len(clip.colors)
        if not balls or table.num_rows % balls:
            raise FootageError(
                f"{path} holds no tracks: it has {table.num_rows} rows, expected one of each "
                f"of {balls} balls in every frame"
            )
        values = {name: table[name].to_numpy() for name in COLUMNS.names[1:]}
        shaped = {name: column.reshape(-1, balls) for name, column in values.items()}
        return cls(
            clip=table["clip"][0].as_py(),
            width=clip.width,
            height=clip.height,
            colors=clip.colors,
            frames=shaped["frame"][:, 0].copy(),
            times_s=shaped["time"][:, 0].copy(),
            positions_px=np.stack([shaped["x"], shaped["y"]], axis=-1),
            radii_px=shaped["radius"].copy(),
            confidences=shaped["confidence"].copy(),
            source_sha256=clip.source_sha256,
        )


def is_csv_of_tracks(path: Path) -> bool:
    """Return whether a CSV file begins as :meth:`Tracks.write` begins it."""
    with path.open("rb") as file:
        return file.read(3) == b"# {"


def _read_csv(file: BinaryIO) -> pa.Table:
    """Read a table whose first line, after ``#``, holds the properties of the clip, as JSON."""
    first = file.readline()
    about = first.removeprefix(b"#").strip()
    if about == first.strip():
        raise ValueError("its first line is not '# {...}' with the properties of the clip")
    table = csv.read_csv(file, convert_options=csv.ConvertOptions(column_types=COLUMNS))
    return table.replace_schema_metadata({ABOUT: about})
