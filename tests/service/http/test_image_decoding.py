import contextlib
import random
import struct
import time
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from rollcast.errors import FrameError
from rollcast.frames import as_frame
from service.errors import BrokenImageError, InvalidValueError, NotAnImageError, ServiceError
from tests.service.samples import decode_frames, dot, encode, png, png_chunk, png_header


def decoded(data: bytes) -> np.ndarray:
    return decode_frames([data], ["frames[0]"])[0][0]


def noise(side: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (side, side, 3), np.uint8)


def test_a_png_of_128_pixels_is_left_as_it_is():
    frame = noise(128)
    np.testing.assert_array_equal(decoded(png(frame)), frame)


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_lossless_formats_agree(kind):
    frame = noise(128)
    image = Image.fromarray(frame)
    options = {"lossless": True} if kind == "WEBP" else {}
    np.testing.assert_array_equal(decoded(encode(image, kind, **options)), frame)


def test_jpeg_is_close():
    frame = dot(60, 60)
    data = encode(Image.fromarray(frame), "JPEG", quality=95)
    assert np.abs(decoded(data).astype(int) - frame).mean() < 2


@pytest.mark.parametrize("side", [256, 200, 1000, 129, 2048])
def test_shrinking_averages_areas(side):
    frame = noise(side)
    edges = np.arange(129) * side / 128
    table = np.pad(frame.astype(float).cumsum(0).cumsum(1), ((1, 0), (1, 0), (0, 0)))
    at = np.arange(side + 1)
    for axis in (0, 1):
        table = np.apply_along_axis(lambda line: np.interp(edges, at, line), axis, table)
    expected = np.diff(np.diff(table, axis=0), axis=1) * (128 / side) ** 2
    np.testing.assert_allclose(decoded(png(frame)), expected, atol=0.51)


def test_enlarging_keeps_places():
    frame = decoded(png(dot(40, 88, 32)))
    light = frame.mean(axis=-1)
    centres = np.arange(128) + 0.5
    assert (light.sum(axis=0) @ centres) / light.sum() == pytest.approx(40, abs=0.05)
    assert (light.sum(axis=1) @ centres) / light.sum() == pytest.approx(88, abs=0.05)


GREY = np.tile(np.arange(128, dtype=np.uint8), (128, 1))


@pytest.mark.parametrize(
    "image",
    [
        Image.fromarray(GREY),
        Image.fromarray(GREY.astype(np.uint16) * 257),
        Image.fromarray(GREY).convert("P"),
        Image.fromarray(GREY).convert("LA"),
        Image.fromarray(GREY).convert("RGBA"),
    ],
    ids=lambda image: image.mode,
)
def test_grey_of_any_kind_becomes_the_same_rgb(image):
    np.testing.assert_array_equal(decoded(encode(image, "PNG")), GREY[..., None].repeat(3, axis=2))


def test_transparency_lies_on_white():
    image = Image.new("RGBA", (128, 128), (255, 0, 0, 0))
    image.paste((0, 0, 255, 255), (0, 0, 64, 128))
    frame = decoded(encode(image, "PNG"))
    np.testing.assert_array_equal(frame[:, :64], np.broadcast_to([0, 0, 255], (128, 64, 3)))
    np.testing.assert_array_equal(frame[:, 64:], 255)


@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_of_an_animation_the_first_picture_is_read(kind):
    first, second = (Image.fromarray(dot(x, 60)) for x in (30, 90))
    options = {"lossless": True} if kind == "WEBP" else {}
    data = encode(first, kind, save_all=True, append_images=[second], duration=40, **options)
    np.testing.assert_array_equal(decoded(data), dot(30, 60))


def test_an_animation_of_a_thousand_pictures_costs_no_more_than_one():
    blank = Image.new("L", (128, 128))
    data = encode(blank, "PNG", save_all=True, append_images=[Image.new("L", (128, 128), 9)] * 999)
    started = time.perf_counter()
    decoded(data)
    assert time.perf_counter() - started < 1


def test_sixteen_bits_of_color_become_eight():
    pixels = noise(64).astype(np.uint16) * 257
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in pixels)
    header = struct.pack(">IIBBBBB", 64, 64, 16, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)
    np.testing.assert_array_equal(decoded(data), decoded(png(noise(64))))


@pytest.mark.parametrize("sides", [(0, 0), (0, 128), (128, 0), (2**31 - 1, 2**31 - 1)])
def test_a_picture_without_pixels_or_with_too_many_is_refused_by_its_header(sides):
    data = png_header(*sides)
    with pytest.raises((InvalidValueError, BrokenImageError)):
        decoded(data)


@pytest.mark.parametrize("kind", [b"iCCP", b"zTXt", b"iTXt", b"tEXt", b"abCd"])
@pytest.mark.parametrize("before", [True, False])
def test_what_is_no_picture_in_a_png_is_passed_over(kind, before):
    """A thousand profiles or texts that unfold to a gigabyte cost less than unfolding them."""
    frame, packed = noise(128), zlib.compress(bytes(1_000_000), 9)
    image = png(frame)
    place = 33 if before else len(image) - 12
    heads = {b"iTXt": b"a\0\1\0\0\0", b"tEXt": b"a\0"}
    chunk = png_chunk(kind, heads.get(kind, b"a\0\0") + packed)
    data = image[:place] + 1000 * chunk + image[place:]
    began = time.thread_time()
    np.testing.assert_array_equal(decoded(data), frame)
    taken = time.thread_time() - began
    began = time.thread_time()
    for _ in range(250):
        zlib.decompress(packed)
    assert taken < 0.02 + time.thread_time() - began


def test_cmyk_becomes_rgb():
    image = Image.new("CMYK", (128, 128), (255, 0, 0, 0))
    assert decoded(encode(image, "JPEG")).shape == (128, 128, 3)


def test_a_camera_held_upright_is_turned_back():
    image = Image.fromarray(dot(20, 100))
    exif = Image.Exif()
    exif[0x0112] = 6  # the top of the scene is at the right of the file
    turned = image.rotate(90)
    frame = decoded(encode(turned, "PNG", exif=exif))
    np.testing.assert_array_equal(frame, dot(20, 100))


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("missing", [1, 2])
def test_a_jpeg_may_lack_its_last_marker(progressive, missing):
    whole = encode(Image.fromarray(noise(96)), "JPEG", progressive=progressive)
    np.testing.assert_array_equal(decoded(whole[:-missing]), decoded(whole))
    np.testing.assert_array_equal(as_frame(whole[:-missing]), as_frame(whole))


@pytest.mark.parametrize("missing", [3, 12, 500])
def test_a_jpeg_may_lack_no_pixel(missing):
    whole = encode(Image.fromarray(noise(96)), "JPEG")
    with pytest.raises(BrokenImageError):
        decoded(whole[:-missing])
    with pytest.raises(FrameError):
        as_frame(whole[:-missing])


def test_the_side_of_the_frames_is_returned():
    assert decode_frames([png(noise(64))] * 4, list("abcd"))[1] == 64


@pytest.mark.parametrize("side", [32, 4096])
def test_the_smallest_and_the_largest_frame_are_read(side):
    data = encode(Image.new("RGB", (side, side), (9, 8, 7)), "PNG")
    np.testing.assert_array_equal(decoded(data), np.broadcast_to([9, 8, 7], (128, 128, 3)))


@pytest.mark.parametrize(
    ("data", "kind", "value"),
    [
        (b"", NotAnImageError, b""),
        (b"GIF89a" + bytes(20), NotAnImageError, b"GIF89a" + bytes(20)),
        (b"\xff\xd8\xff", BrokenImageError, b"\xff\xd8\xff"),
        (b"RIFF\x04\x00\x00\x00WEBP", BrokenImageError, b"RIFF\x04\x00\x00\x00WEBP"),
        (png_header(30_000, 30_000), InvalidValueError, "30000 x 30000"),
        (png_header(4097, 4097), InvalidValueError, "4097 x 4097"),
        (png_header(64, 63), InvalidValueError, "64 x 63"),
        (png(noise(128))[:-500], BrokenImageError, "PNG of 128 x 128"),
    ],
)
def test_refusals_tell_field_and_value(data, kind, value):
    with pytest.raises(kind) as caught:
        decoded(data)
    assert [
        (field_error.field, field_error.value) for field_error in caught.value.field_errors
    ] == [("frames[0]", value)]


def test_the_size_of_a_large_webp_is_refused_before_its_canvas_is_made():
    header = b"RIFF\x1a\x00\x00\x00WEBPVP8L\x0d\x00\x00\x00\x2f"
    sides = (16383 - 1) | (16383 - 1) << 14
    with pytest.raises(InvalidValueError):
        decoded(header + sides.to_bytes(4, "little") + bytes(20))


SEEDS = {
    kind: encode(Image.fromarray(noise(48)), kind, exif=b"Exif\0\0MM\0*\0\0\0\x08\0\0\0\0\0\0")
    for kind in ("PNG", "JPEG", "WEBP")
}


@pytest.mark.parametrize("kind", SEEDS)
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_damaged_files_are_decoded_or_refused(kind, seed):
    chance = random.Random(seed)
    data = bytearray(SEEDS[kind])
    for _ in range(chance.randint(1, 8)):
        data[chance.randrange(12, len(data))] = chance.randrange(256)
    if chance.random() < 0.3:
        del data[chance.randrange(16, len(data)) :]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged metadata and goes on
        with contextlib.suppress(ServiceError):
            assert decoded(bytes(data)).shape == (128, 128, 3)
