# SPDX-License-Identifier: Apache-2.0
"""What ``svgf denoise`` finds before it writes anything: missing passes, vectors that mislead, noise that repeats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from svgf.cycles.passes import LIGHT_PASSES

from .cycles_files import Format, Passes, Shot, combined, done, refused, write_shot


def spoiled(tmp_path: Path, frame: int, form: Format, frames: range = range(1, 5)) -> Path:
    """A good sequence in which one frame is written otherwise."""
    source = write_shot(tmp_path / "in", frames)
    form.write(source / f"frame_{frame:04d}.exr", frame)
    return source


@pytest.mark.parametrize(
    ("without", "message", "place"),
    [
        (("Vector",), 'has no pass "Vector".', "Data > Vector (and switch Motion Blur off) and render again."),
        (("Depth",), 'has no pass "Depth".', "Passes > Data > Z and render again."),
        (("Normal", "Denoising Normal"), 'has no pass "Normal".', "Data > Normal"),
        (("Glossy Indirect",), 'has no pass "Glossy Indirect".', "Light > Glossy > Indirect"),
        (("Depth", "Vector"), 'has no pass "Depth" and "Vector".', "Data > Z; Data > Vector"),
        (("Combined",), 'has no pass "Combined".', "Data > Combined"),
    ],
)
def test_missing_pass(tmp_path: Path, without: tuple[str, ...], message: str, place: str) -> None:
    error = refused(spoiled(tmp_path, 3, Format(without=without)), tmp_path / "out")
    assert error.startswith("Error: Frame 3 (") and f'layer "ViewLayer" {message}' in error
    assert "In Blender, enable View Layer properties > Passes > " in error and place in error


def test_neither_light_passes_nor_denoising_data(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 3), Format(without=("Denoising Albedo", *LIGHT_PASSES)))
    error = refused(source, tmp_path / "out")
    assert 'has no pass "Denoising Albedo"' in error and "Data > Denoising Data" in error


def test_incomplete_light_passes_are_told(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 2), Format(without=("Glossy Color",)))
    warning = done(source, tmp_path / "out")
    assert 'Layer "ViewLayer" is denoised from Combined alone, as it lacks "Glossy Color".' in warning


def test_no_render_layer(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 2), Format(without=("Combined",)))
    assert 'has no layer with the pass "Combined". It has: ViewLayer.' in refused(source, tmp_path / "out")


def test_size_that_changes(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 4))
    planes = {f"ViewLayer.Combined.{c}": np.zeros((9, 16), np.float32) for c in "RGBA"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, planes).write(str(source / "frame_0003.exr"))
    error = refused(source, tmp_path / "out")
    assert "Frame 3 (" in error and "is 16x9, but frame 1 is 64x36. Render all frames in one size." in error


@pytest.mark.parametrize("version", ["4.5", "5.0"])
@pytest.mark.parametrize("cut", [1, 50, 20_000])
def test_truncated_file_is_found_before_work_starts(tmp_path: Path, version: str, cut: int) -> None:
    source = write_shot(tmp_path / "in", range(1, 11), Format(version))
    path = source / "frame_0008.exr"
    path.write_bytes(path.read_bytes()[:-cut])
    assert "frame_0008.exr is truncated or damaged. Render it again." in refused(source, tmp_path / "out")


def test_stereo_views_in_one_file(tmp_path: Path) -> None:
    planes = {"ViewLayer.Combined.R": np.zeros((9, 16), np.float32)}
    parts = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, "view": v}, planes, f"Combined.{v}") for v in ("left", "right")
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert 'holds the channel "ViewLayer.Combined.R" twice.' in refused(tmp_path / "a.exr", tmp_path / "out")


@pytest.mark.parametrize(
    ("factors", "name"), [((-1, -1), "this position - the previous one;"), ((1, -1), "y pointing down")]
)
def test_other_vector_conventions_are_found_and_read(tmp_path: Path, factors: tuple[int, int], name: str) -> None:
    def convert(frame: int, passes: Passes) -> None:
        passes["Vector"] *= np.float32([*factors, *factors])

    shot = Shot(speed=(4.0, 3.0))
    source = write_shot(tmp_path / "in", range(0, 3), Format(change=convert), shot)
    assert name in done(source, tmp_path / "out")
    as_cycles = write_shot(tmp_path / "cycles", range(0, 3), shot=shot)
    assert done(as_cycles, tmp_path / "out_cycles") == ""
    for path in (tmp_path / "out").iterdir():
        np.testing.assert_array_equal(combined(path), combined(tmp_path / "out_cycles" / path.name))


def test_vectors_that_lost_their_negative_half(tmp_path: Path) -> None:
    def clamp(frame: int, passes: Passes) -> None:
        passes["Vector"] = np.maximum(passes["Vector"], 0)

    source = write_shot(tmp_path / "in", range(1, 4), Format(change=clamp), Shot(pan=2.0))
    error = refused(source, tmp_path / "out")
    assert "Vector holds no negative number" in error and "Color Depth Float (Full)" in error


def test_what_moves_to_the_left_only_is_no_fault(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(4, 8), shot=Shot(speed=(-2.0, 0.0)))
    assert done(source, tmp_path / "out") == ""


def test_vectors_of_another_shot(tmp_path: Path) -> None:
    def scramble(frame: int, passes: Passes) -> None:
        passes["Vector"] += 1000.0

    source = write_shot(tmp_path / "in", range(1, 4), Format(change=scramble))
    assert "Vector leads to another surface in the frame before for 100 % of the pixels." in refused(
        source, tmp_path / "out"
    )


@pytest.mark.parametrize("shot", [Shot(seed=5), Shot(seed=5, pan=1.0), Shot(seed=5, speed=(0.0, 0.0))])
def test_fixed_seed_is_noticed(tmp_path: Path, shot: Shot) -> None:
    source = write_shot(tmp_path / "in", range(1, 4), shot=shot)
    warning = done(source, tmp_path / "out")
    assert "frames 1 and 2 carry the same noise" in warning and "Use Animated Seed" in warning


def test_a_still_shot_without_noise_has_no_fixed_seed(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 4), shot=Shot(speed=(0.0, 0.0), noise=0.0))
    assert done(source, tmp_path / "out") == ""
