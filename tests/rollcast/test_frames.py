"""One conversion of pictures: whatever holds the same picture becomes the same frame."""

import io
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rollcast.client.images import decoded, encoded
from rollcast.errors import FootageError, FrameError
from rollcast.frames import as_frame

try:
    import torch
except ModuleNotFoundError:  # where the lowest allowed versions run
    torch = None

SIDE = 32
GREY = np.linspace(0, 255, SIDE * SIDE).astype(np.uint8).reshape(SIDE, SIDE)
RGB = np.stack([GREY, GREY[::-1], GREY.T], axis=-1)
ALPHA = np.where(np.arange(SIDE) < SIDE // 2, 0, 255).astype(np.uint8) * np.ones(
    (SIDE, 1), np.uint8
)
RGBA = np.concatenate([RGB, ALPHA[..., None]], axis=-1)
ON_WHITE = np.where(ALPHA[..., None] == 0, 255, RGB).astype(np.uint8)
GREY_RGB = np.repeat(GREY[..., None], 3, axis=-1)


def file_of(image, kind="PNG", **options):
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


PNG = file_of(Image.fromarray(RGB))
SAME_AS_RGB = {
    "array": RGB,
    "uint16": RGB.astype(np.uint16) * 257,
    "float32": RGB.astype(np.float32) / 255,
    "float64": RGB / 255,
    "channels first": RGB.transpose(2, 0, 1),
    "not contiguous": np.repeat(RGB, 2, axis=0)[::2],
    "big-endian": (RGB.astype(np.uint16) * 257).astype(">u2"),
    "image": Image.fromarray(RGB),
    "palette": Image.fromarray(GREY).convert("P"),
    "bytes": PNG,
    "bytearray": bytearray(PNG),
    "memoryview": memoryview(PNG),
    "open file": io.BytesIO(PNG),
}
if torch is not None:
    TENSOR = torch.from_numpy(RGB)
    SAME_AS_RGB |= {
        "tensor": TENSOR,
        "tensor, channels first": TENSOR.permute(2, 0, 1),
        "tensor of floats": TENSOR / 255,
        "tensor with gradients": (TENSOR / 255).requires_grad_(),
    }


@pytest.mark.parametrize("kind", SAME_AS_RGB)
def test_the_same_picture_is_the_same_frame(kind):
    expected = GREY_RGB if kind == "palette" else RGB
    frame = as_frame(SAME_AS_RGB[kind])
    assert frame.dtype == np.uint8
    np.testing.assert_array_equal(frame, expected)


def test_a_path_and_an_open_file(tmp_path):
    path = tmp_path / "frame.png"
    path.write_bytes(PNG)
    np.testing.assert_array_equal(as_frame(path), RGB)
    np.testing.assert_array_equal(as_frame(str(path)), RGB)
    (entry,) = os.scandir(tmp_path)
    np.testing.assert_array_equal(as_frame(entry), RGB)
    with path.open("rb") as file:
        np.testing.assert_array_equal(as_frame(file), RGB)
    with path.open("r") as file, pytest.raises(TypeError, match="mode 'rb'"):
        as_frame(file)


@pytest.mark.parametrize(
    "picture",
    [GREY, GREY[..., None], GREY[None], GREY / 255, GREY.astype(np.uint16) * 257,
     Image.fromarray(GREY), Image.fromarray(GREY.astype(np.uint16) * 257),
     Image.fromarray(GREY.astype(np.int32) * 257), Image.fromarray((GREY / 255).astype(np.float32)),
     file_of(Image.fromarray(GREY.astype(np.uint16) * 257)),
     file_of(Image.fromarray((GREY / 255).astype(np.float32)), "TIFF")],
)  # fmt: skip
def test_grey_of_every_depth(picture):
    np.testing.assert_array_equal(as_frame(picture), GREY_RGB)


@pytest.mark.parametrize("picture", [RGBA, Image.fromarray(RGBA), file_of(Image.fromarray(RGBA))])
def test_transparency_lies_on_white(picture):
    np.testing.assert_array_equal(as_frame(picture), ON_WHITE)


def test_bool_is_black_and_white():
    frame = as_frame(GREY > 128)
    assert set(np.unique(frame)) == {0, 255}
    np.testing.assert_array_equal(frame[..., 0] == 255, GREY > 128)


@pytest.mark.parametrize("array", [RGB, RGB / 255, SAME_AS_RGB.get("tensor", RGB)])
def test_opencvs_order_of_channels(array):
    np.testing.assert_array_equal(as_frame(array, channels="bgr"), RGB[..., ::-1])
    np.testing.assert_array_equal(as_frame(RGBA, channels="bgr"), as_frame(RGBA[..., [2, 1, 0, 3]]))
    np.testing.assert_array_equal(as_frame(PNG, channels="bgr"), RGB)


def test_cmyk_and_an_orientation():
    cmyk = as_frame(file_of(Image.fromarray(GREY_RGB).convert("CMYK"), "JPEG", quality=98))
    assert np.abs(cmyk.astype(int) - GREY_RGB).mean() < 4
    exif = Image.Exif()
    exif[0x0112] = 6  # turned clockwise by a quarter
    np.testing.assert_array_equal(
        as_frame(file_of(Image.fromarray(RGB), "PNG", exif=exif)), np.rot90(RGB, -1)
    )


@pytest.mark.parametrize("progressive", [False, True])
def test_a_jpeg_without_its_end_is_read_where_all_pixels_are_there(progressive):
    whole = file_of(Image.fromarray(RGB), "JPEG", quality=90, progressive=progressive)
    for missing in (1, 2):
        np.testing.assert_array_equal(as_frame(whole[:-missing]), as_frame(whole))
    for missing in (40, len(whole) // 3):
        with pytest.raises(FrameError, match=r"damaged|cut off|truncated"):
            as_frame(whole[:-missing])


@pytest.mark.parametrize(
    ("picture", "error", "fix"),
    [
        (RGB.astype(int), TypeError, r"\.astype\(numpy\.uint8\)"),
        (RGB.astype(np.float32), FrameError, "from 0 to 255, expected 0 to 1: divide"),
        (np.full((SIDE, SIDE), np.nan), FrameError, "expected 0 to 1"),
        (RGB[None], FrameError, "pass several frames as a list"),
        (RGB[..., :2], FrameError, "1, 3 or 4"),
        (np.empty((0, SIDE, 3), np.uint8), FrameError, "no pixels"),
        ([[1, 2], [3, 4]], TypeError, r"numpy\.asarray makes an array"),
        (None, TypeError, "NoneType, expected a path"),
        (b"no image", FrameError, "is not an image, expected one of .*PNG"),
        (PNG[:200], FrameError, "truncated|damaged"),
        (b"\0\0\0\x18ftypheic" + bytes(40), FrameError, "HEIC picture.* convert it to JPEG"),
        ("no/such/file.png", FileNotFoundError, "no/such"),
    ],
)
def test_what_is_no_frame_names_the_fix(picture, error, fix):
    with pytest.raises(error, match=fix):
        as_frame(picture)
    if picture is not None and not isinstance(picture, bytes):
        with pytest.raises(error):
            encoded(picture, None)


def test_a_pipe_is_refused_at_once(tmp_path):
    pipe = tmp_path / "frame.png"
    os.mkfifo(pipe)
    for read in (as_frame, lambda path: encoded(path, None)):
        with pytest.raises(FootageError, match="is a pipe"):
            read(pipe)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TIFF", "BMP"])
def test_the_client_sends_files_that_the_service_reads(kind, tmp_path):
    data = file_of(Image.fromarray(RGB), kind)
    path = Path(tmp_path / "frame")
    path.write_bytes(data)
    sent = encoded(path, None)
    assert (sent == data) == (kind in {"PNG", "JPEG", "WEBP"})
    np.testing.assert_array_equal(decoded(sent), as_frame(data))
    assert encoded(data, None) == sent


def test_enormous_pictures_are_refused_by_their_header():
    image = Image.new("1", (8200, 8200))
    file = io.BytesIO()
    image.save(file, "PNG")
    tracemalloc.start()
    try:
        with pytest.raises(FrameError, match="8200 x 8200 pixels, expected at most 64 million"):
            as_frame(file.getvalue())
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()
