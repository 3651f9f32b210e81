# SPDX-License-Identifier: Apache-2.0
"""OpenEXR out and in, with Blender's names and Cycles' conventions; PNG out."""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from svgf.errors import InputError
from svgf.frame import Frame
from svgf.io import exr, files, label, png

HEIGHT, WIDTH = 5, 7


def make_frame(height: int = HEIGHT, width: int = WIDTH) -> Frame:
    random = np.random.default_rng(3)

    def image(*channels: int) -> np.ndarray:
        return random.normal(size=(height, width, *channels)).astype(np.float32)

    return Frame(
        frame=12,
        color=image(3) * 1e5,
        noisy=image(3),
        albedo=image(3),
        normal=image(3),
        depth=np.full((height, width), 1e10, np.float32),
        motion=image(3),
        roughness=image(),
        object_id=random.integers(0, 100_000, (height, width), dtype=np.int32),
        variance=image(),
        history_length=image(),
    )


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "frame.exr"
    exr.write(make_frame(), path, metadata={"svgf.device": "cpu", "svgf.samples": 4})
    return path


# What Blender 5.0 and 5.2 call these passes when Cycles writes them, and ours that Cycles does not have.
BLENDER_PASSES = {
    "Combined": "RGBA",
    "Noisy Image": "RGBA",
    "Denoising Albedo": "RGB",
    "Denoising Roughness": "X",
    "Normal": "XYZ",
    "Depth": "Z",
    "Vector": "XYZW",
    "Object Index": "X",
}
OWN_PASSES = {"Depth Change": "V", "Variance": "V", "History Length": "V"}


def test_channels_have_the_names_that_blender_5_writes(written: Path) -> None:
    channels = OpenEXR.File(str(written), separate_channels=True).channels()
    passes = {**BLENDER_PASSES, **OWN_PASSES}
    assert channels.keys() == {f"ViewLayer.{name}.{suffix}" for name, suffixes in passes.items() for suffix in suffixes}
    assert all(channel.pixels.dtype == np.float32 for channel in channels.values())


def test_header_says_units_and_how_it_was_made(written: Path) -> None:
    header = OpenEXR.File(str(written), separate_channels=True, header_only=True).header()
    passes = {name.split(".")[1] for name in exr.read(written)}
    assert {name for name in header if name.startswith("svgf.unit.")} == {f"svgf.unit.{name}" for name in passes}
    assert header["svgf.unit.Depth"].startswith("m,") and "unknown" in header["svgf.unit.Vector"]
    assert header["svgf.device"] == "cpu" and header["svgf.samples"] == 4 and header["Frame"] == "012"
    assert header["colorInteropID"] == "lin_rec709_scene"


def test_values_survive_to_the_bit(written: Path) -> None:
    frame, passes = make_frame(), exr.read(written)
    np.testing.assert_array_equal(passes["ViewLayer.Combined"][..., :3], frame.color)
    np.testing.assert_array_equal(passes["ViewLayer.Combined"][..., 3], 1.0)
    np.testing.assert_array_equal(passes["ViewLayer.Noisy Image"][..., :3], frame.noisy)
    np.testing.assert_array_equal(passes["ViewLayer.Denoising Albedo"], frame.albedo)
    np.testing.assert_array_equal(passes["ViewLayer.Normal"], frame.normal)
    np.testing.assert_array_equal(passes["ViewLayer.Depth"], frame.depth)
    np.testing.assert_array_equal(passes["ViewLayer.Depth Change"], frame.motion[..., 2])
    np.testing.assert_array_equal(passes["ViewLayer.Object Index"], frame.object_id.astype(np.float32))
    np.testing.assert_array_equal(passes["ViewLayer.Denoising Roughness"], frame.roughness)
    np.testing.assert_array_equal(passes["ViewLayer.Variance"], frame.variance)
    np.testing.assert_array_equal(passes["ViewLayer.History Length"], frame.history_length)


def test_vector_is_in_the_convention_of_cycles(written: Path) -> None:
    """Previous column = column + X, previous row = row - Y."""
    frame, vector = make_frame(), exr.read(written)["ViewLayer.Vector"]
    np.testing.assert_array_equal(vector[..., 0], frame.motion[..., 0])
    np.testing.assert_array_equal(vector[..., 1], -frame.motion[..., 1])
    np.testing.assert_array_equal(vector[..., 2:], 0.0)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 33), (17, 1), (33, 31)])
def test_odd_sizes(tmp_path: Path, height: int, width: int) -> None:
    exr.write(make_frame(height, width), tmp_path / "odd.exr", layer="Layer")
    assert exr.read(tmp_path / "odd.exr")["Layer.Combined"].shape == (height, width, 4)


def test_same_frame_gives_same_bytes(tmp_path: Path) -> None:
    for name in ("a.exr", "b.exr"):
        exr.write(make_frame(), tmp_path / name)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


# --- Files of others ---


def planes(*names: str, dtype: type = np.float32, size: tuple[int, int] = (HEIGHT, WIDTH)) -> dict[str, np.ndarray]:
    return {name: np.full(size, index + 1, dtype) for index, name in enumerate(names)}


def save(path: Path, *parts: OpenEXR.Part) -> Path:
    OpenEXR.File(list(parts)).write(str(path))
    return path


def part(channels: dict[str, np.ndarray], name: str = "", **header: object) -> OpenEXR.Part:
    return OpenEXR.Part({"type": OpenEXR.scanlineimage, **header}, channels, name)


def test_multi_part_file_of_blender_5(tmp_path: Path) -> None:
    path = save(
        tmp_path / "multi.exr",
        part(planes(*(f"ViewLayer.Combined.{c}" for c in "RGBA")), "ViewLayer.Combined"),
        part(planes("ViewLayer.Depth.Z"), "ViewLayer.Depth"),
        part(planes(*(f"Other.Vector.{c}" for c in "XYZW"), dtype=np.float16), "Other.Vector"),
    )
    passes = exr.read(path)
    assert list(passes) == ["ViewLayer.Combined", "ViewLayer.Depth", "Other.Vector"]
    np.testing.assert_array_equal(passes["ViewLayer.Combined"][0, 0], [1, 2, 3, 4])
    np.testing.assert_array_equal(passes["Other.Vector"][0, 0], [1, 2, 3, 4])
    assert passes["ViewLayer.Depth"].shape == (HEIGHT, WIDTH) and passes["Other.Vector"].dtype == np.float32


def test_parts_that_name_the_layer(tmp_path: Path) -> None:
    path = save(tmp_path / "multi.exr", part(planes(*"RGB"), "beauty"), part(planes(*"XYZ"), "N"))
    assert {name: list(pixels[0, 0]) for name, pixels in exr.read(path).items()} == {
        "beauty": [1, 2, 3],
        "N": [1, 2, 3],
    }


def test_plain_image_and_names_of_blender_4(tmp_path: Path) -> None:
    path = save(
        tmp_path / "a.exr", part(planes(*"RGBA", "ViewLayer.DiffDir.R", "ViewLayer.DiffDir.G", "ViewLayer.DiffDir.B"))
    )
    passes = exr.read(path)
    assert list(passes["Combined"][0, 0]) == [1, 2, 3, 4]
    assert list(passes["ViewLayer.DiffDir"][0, 0]) == [5, 6, 7]


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "DWAA"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_pixel_types_and_compressions(tmp_path: Path, compression: str, dtype: type) -> None:
    method = getattr(OpenEXR, f"{compression}_COMPRESSION")
    path = save(tmp_path / "a.exr", part(planes("V.Object Index.X", dtype=dtype), compression=method))
    pixels = exr.read(path)["V.Object Index"]
    assert pixels.dtype == (np.uint32 if dtype is np.uint32 else np.float32)
    np.testing.assert_allclose(pixels, 1, rtol=1e-3)


def test_pass_is_found_in_the_first_layer_that_has_it(tmp_path: Path) -> None:
    passes = {"A.Depth": np.zeros(1), "B.Combined": np.ones(1), "C.Combined": np.zeros(1)}
    assert exr.find_pass(passes, "Combined", "x.exr")[0] == 1
    assert exr.find_pass(passes, "C.Combined", "x.exr")[0] == 0
    with pytest.raises(InputError, match=r'x.exr has no pass "Depth Change". It has: A.Depth, B.Combined, C.Combined.'):
        exr.find_pass(passes, "Depth Change", "x.exr")


# --- Bad files ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"", "is not an OpenEXR file"),
        (lambda data: b"\x89PNG" + data, "is not an OpenEXR file"),
        (lambda data: data[:8], "is truncated or damaged"),
        (lambda data: data[:200], "is truncated or damaged"),
        (lambda data: data[:-1], "is truncated or damaged"),
        (lambda data: data[:-100], "is truncated or damaged"),
        (
            lambda data: data.replace(struct.pack("<ii", WIDTH - 1, HEIGHT - 1), struct.pack("<ii", 2**30, 2**30)),
            "damaged",
        ),
    ],
)
def test_damaged_files(written: Path, change: Callable[[bytes], bytes], message: str) -> None:
    assert exr.is_complete(written)
    written.write_bytes(change(written.read_bytes()))
    with pytest.raises(InputError, match=rf"frame\.exr .*{message}"):
        exr.read(written)
    assert not exr.is_complete(written)


def test_second_part_cut_off(tmp_path: Path) -> None:
    path = save(tmp_path / "multi.exr", part(planes(*"RGB"), "first"), part(planes(*"RGB"), "second"))
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(InputError, match="is truncated or damaged"):
        exr.read(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Cannot read .*none.exr: there is no such file or folder. Check the path."):
        exr.read(tmp_path / "none.exr")
    assert not exr.is_complete(tmp_path / "none.exr")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damage_never_does_worse_than_an_input_error(written: Path, data: st.DataObject) -> None:
    content = bytearray(written.read_bytes())
    for _ in range(data.draw(st.integers(0, 4), "flips")):
        content[data.draw(st.integers(0, len(content) - 1), "position")] ^= data.draw(st.integers(1, 255), "bits")
    if data.draw(st.booleans(), "truncate"):
        del content[data.draw(st.integers(0, len(content)), "length") :]
    path = written.with_name("damaged.exr")
    path.write_bytes(content)
    try:
        assert exr.read(path)
    except InputError as error:
        assert "damaged.exr" in str(error)


# --- Writing whole or not at all ---


def fail(code: int) -> Callable[..., None]:
    def raise_error(*_: object) -> None:
        raise OSError(code, os.strerror(code))

    return raise_error


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (errno.ENOSPC, "the disk is full. Free some space or choose another place."),
        (errno.EACCES, "permission denied"),
        (errno.EROFS, "the file system is read-only"),
        (errno.EIO, "Input/output error. Check the path and the disk."),
    ],
)
def test_failing_disk_leaves_the_old_file(
    written: Path, monkeypatch: pytest.MonkeyPatch, code: int, message: str
) -> None:
    before = written.read_bytes()
    monkeypatch.setattr(files.os, "replace", fail(code))
    with pytest.raises(InputError, match=rf"Cannot write .*frame\.exr: {message}"):
        exr.write(make_frame(), written)
    assert written.read_bytes() == before and list(written.parent.iterdir()) == [written]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_full_disk_while_writing(tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    (tmp_path / f".frame.exr.{os.getpid()}.part").symlink_to("/dev/full")
    with pytest.raises(InputError, match=r"Cannot write .*frame\.exr: the disk is full"):
        exr.write(make_frame(), path)
    assert not list(tmp_path.iterdir())


def test_unwritable_places(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for path, message in (
        (tmp_path / "none" / "a.exr", "there is no such file or folder"),
        (tmp_path / "file" / "a.exr", "a part of the path is a file"),
        (tmp_path / "folder", "it is a folder"),
        (tmp_path / ("x" * 300), "the name is too long"),
    ):
        with pytest.raises(InputError, match=message):
            exr.write(make_frame(), path)
    assert {path.name for path in tmp_path.iterdir()} == {"file", "folder"}


# --- PNG ---


def decode_png(data: bytes) -> np.ndarray:
    """A decoder of its own: 8-bit RGB, filters none and up."""
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, position = {}, 8
    while position < len(data):
        (length,) = struct.unpack(">I", data[position : position + 4])
        kind, body = data[position + 4 : position + 8], data[position + 8 : position + 8 + length]
        assert struct.unpack(">I", data[position + 8 + length : position + 12 + length])[0] == zlib.crc32(kind + body)
        chunks[kind] = body
        position += 12 + length
    width, height, *rest = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert rest == [8, 2, 0, 0, 0] and kind == b"IEND"
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 1 + 3 * width)
    assert set(rows[:, 0]) == {2}
    return np.cumsum(rows[:, 1:], axis=0, dtype=np.uint8).reshape(height, width, 3)


@pytest.mark.parametrize("size", [(1, 1), (9, 5), (64, 33)])
def test_png_round_trip(tmp_path: Path, size: tuple[int, int]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (*size, 3), np.uint8)
    png.write(pixels, tmp_path / "a.png")
    np.testing.assert_array_equal(decode_png((tmp_path / "a.png").read_bytes()), pixels)


def test_display_is_the_standard_view() -> None:
    linear = np.array([-1.0, 0.0, 0.0031308, 0.18, 0.5, 1.0, 7.0, np.nan, np.inf, -np.inf])
    np.testing.assert_array_equal(png.display(linear), [0, 0, 10, 118, 188, 255, 255, 0, 255, 0])


def test_png_of_something_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not float32 \[2, 2, 3\]"):
        png.write(np.zeros((2, 2, 3), np.float32), tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_captions() -> None:
    images = [("Noisy", np.full((4, 50, 3), 9, np.uint8)), ("ω", np.zeros((4, 50, 3), np.uint8))]
    picture = label.beside(images, scale=2)
    assert picture.shape == (4 + 2 * label.HEIGHT, 100, 3) and picture.dtype == np.uint8
    np.testing.assert_array_equal(picture[-4:, :50], 9)
    assert picture[: 2 * label.HEIGHT, :50].any() and picture[: 2 * label.HEIGHT, 50:].any()
    letters = {glyph: label.caption(glyph, 10).tobytes() for glyph in label._GLYPHS}
    assert len(set(letters.values())) == len(letters)
