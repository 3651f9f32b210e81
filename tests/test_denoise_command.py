# SPDX-License-Identifier: Apache-2.0
"""``svgf denoise`` on sequences as Blender 4.5, 5.0 and 5.2 write them, on the reference device."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from typer.testing import CliRunner

from svgf.cli import app
from svgf.cycles.image import MultilayerImage
from svgf.cycles.inputs import Reading, layer_inputs
from svgf.cycles.passes import LIGHT_PASSES
from svgf.denoiser import Denoiser
from svgf.diagnostics import ResetReason
from svgf.io import exr
from svgf.passes import DIAGNOSTIC_PASSES
from svgf.sequence import find_sequence

from .cycles_files import HEIGHT, WIDTH, Format, Passes, Shot, combined, done, refused, run, write_shot

STILL = Shot(speed=(0.0, 0.0))


def truth(frame: int, shot: Shot) -> np.ndarray:
    return Shot(shot.speed, shot.pan, 0.0, shot.seed, shot.view).passes(frame)["Combined"][..., :3]


# --- What goes in and what comes out ---


@pytest.mark.parametrize("version", ["4.5", "5.0", "5.2"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_all_but_combined_passes_through_untouched(tmp_path: Path, version: str, dtype: type) -> None:
    form = Format(version, dtype, layers=("ViewLayer", "Other.Layer"))
    source = write_shot(tmp_path / "in", range(1, 3), form)
    assert done(source, tmp_path / "out") == ""
    for path in source.iterdir():
        given, written = (
            OpenEXR.File(str(file), separate_channels=True) for file in (path, tmp_path / "out" / path.name)
        )
        assert [part.name() for part in written.parts] == [part.name() for part in given.parts]
        for index, (part, other) in enumerate(zip(given.parts, written.parts, strict=True)):
            added = other.header.keys() - part.header.keys()
            assert all(name.startswith("svgf.") for name in added) and bool(added) == (index == 0)
            assert other.header["compression"] == part.header["compression"]
            assert other.header.get("Software") == part.header.get("Software")
            assert list(other.channels) == list(part.channels)
            for name, channel in part.channels.items():
                pixels = other.channels[name].pixels
                assert pixels.dtype == channel.pixels.dtype
                same = pixels.tobytes() == channel.pixels.tobytes()
                assert same != (".Combined." in name and not name.endswith(".A")), name
        assert written.parts[0].header["svgf.method"] == "svgf+"
        assert written.parts[0].header["svgf.Other.Layer.signals"] == "diffuse, specular"


@pytest.mark.parametrize("version", ["4.5", "5.0", "5.2"])
@pytest.mark.parametrize("without", [(), LIGHT_PASSES, (*LIGHT_PASSES, "Normal", "Object Index", "Emission")])
@pytest.mark.parametrize("method", ["svgf", "svgf+"])
def test_noise_falls_and_history_grows(tmp_path: Path, version: str, without: tuple[str, ...], method: str) -> None:
    shot = Shot()
    source = write_shot(tmp_path / "in", range(1, 7), Format(version, without=without), shot)
    assert done(source, tmp_path / "out", "--method", method) == ""

    def error(folder: Path, frame: int) -> float:
        return float(np.mean((combined(folder / f"frame_{frame:04d}.exr")[..., :3] - truth(frame, shot)) ** 2))

    first, last = (error(tmp_path / "out", frame) / error(source, frame) for frame in (1, 6))
    assert last < 0.25
    # svgf+ starts below svgf's last frame, and resolves the card's edges over time, which here have none to resolve.
    assert last < first or (method == "svgf+" and first < 0.02 and last < 0.03)


def test_a_frame_is_what_the_denoiser_gives(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 4))
    done(source, tmp_path / "out")
    denoiser = Denoiser(WIDTH, HEIGHT, "reference")
    for path in sorted(source.iterdir()):
        inputs = layer_inputs(MultilayerImage(path), Reading("ViewLayer", light_passes=True, motion=True))
        result = denoiser.denoise(inputs.images)
        np.testing.assert_array_equal(combined(tmp_path / "out" / path.name)[..., :3], result["color"] + inputs.deficit)


def test_inputs_are_in_the_denoisers_convention(tmp_path: Path) -> None:
    path = Format("4.5").write(tmp_path / "a.exr", 3)
    passes = Shot().passes(3)
    images = layer_inputs(MultilayerImage(path), Reading("ViewLayer", light_passes=True, motion=True)).images
    card, sky = passes["Object Index"][..., 0] == 7, passes["Depth"][..., 0] == 1e10
    np.testing.assert_array_equal(images["motion"][card], np.tile([-3.0, -2.0], (card.sum(), 1)))
    assert not images["motion"][~card].any()
    assert set(images["object_id"][card]) == {8} and set(images["object_id"][sky]) == {0}
    assert set(images["object_id"][~card & ~sky]) == {1}  # Blender's index 0 is an object like others
    np.testing.assert_array_equal(images["diffuse_albedo"], passes["Diffuse Color"])
    np.testing.assert_allclose(
        images["diffuse"] + images["specular"] + images["emission"], passes["Combined"][..., :3], rtol=1e-5
    )


@pytest.mark.parametrize("lit,roughness", [(0.9, 0.1), (0.5, 0.25), (0.2, 0.4)])
def test_reflections_that_light_rarely_finds_are_filtered_as_rough(
    tmp_path: Path, lit: float, roughness: float
) -> None:
    """An object at a time, by the share of its specular samples that are black; one that reflects nothing is sharp."""

    def darken(frame: int, passes: Passes) -> None:
        card = passes["Object Index"][..., 0] == 7
        found = np.zeros(card.sum(), bool)
        found[: round(lit * found.size)] = True
        for lobe in ("Glossy", "Transmission"):
            passes[f"{lobe} Color"][:] = 0.0
        passes["Glossy Color"][card] = 0.5
        for part in ("Direct", "Indirect"):
            passes[f"Glossy {part}"][card] = found[:, None]

    path = Format(change=darken).write(tmp_path / "a.exr", 1)
    images = layer_inputs(MultilayerImage(path), Reading("ViewLayer", light_passes=True, motion=True)).images
    card = images["object_id"] == 8
    np.testing.assert_allclose(images["roughness"][card], roughness, atol=0.02)
    np.testing.assert_allclose(images["roughness"][~card], 0.1)


def test_motion_that_is_rounding_is_none(tmp_path: Path) -> None:
    def tremble(frame: int, passes: Passes) -> None:
        passes["Vector"] += np.float32(1e-4)

    path = Format(change=tremble).write(tmp_path / "a.exr", 1, STILL)
    reading = Reading("ViewLayer", light_passes=True, motion=True)
    assert not layer_inputs(MultilayerImage(path), reading).images["motion"].any()


def test_albedo_is_clipped_and_light_kept(tmp_path: Path) -> None:
    """A mirror that sees a lamp has the lamp's radiance as Denoising Albedo."""

    def shine(frame: int, passes: Passes) -> None:
        passes["Denoising Albedo"][10:20] = 300.0

    path = Format(without=LIGHT_PASSES, change=shine).write(tmp_path / "a.exr", 1)
    inputs = layer_inputs(MultilayerImage(path), Reading("ViewLayer", light_passes=False, motion=True))
    assert inputs.images["albedo"].max() == 1.0 and inputs.images["albedo"].min() > 0.0
    np.testing.assert_allclose(
        inputs.images["color"] + inputs.images["emission"], Shot().passes(1)["Combined"][..., :3], rtol=1e-5
    )


@pytest.mark.parametrize("without", [(), LIGHT_PASSES])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_energy_of_a_settled_still_shot(tmp_path: Path, without: tuple[str, ...], dtype: type) -> None:
    count = 24
    source = write_shot(tmp_path / "in", range(1, count + 1), Format(dtype=dtype, without=without), STILL)
    done(source, tmp_path / "out")
    means = [np.mean([combined(path)[..., :3].mean() for path in sorted(folder.iterdir())[8:]])
             for folder in (source, tmp_path / "out")]  # fmt: skip
    assert means[1] == pytest.approx(means[0], rel=0.005)


def test_light_outside_the_light_passes_is_kept(tmp_path: Path) -> None:
    """A volume glows on the left and a matte cuts light on the right."""

    def change(frame: int, passes: Passes) -> None:
        passes["Combined"][:, :20, :3] += 0.7
        passes["Combined"][:, 50:, :3] *= 0.5

    source = write_shot(tmp_path / "in", range(1, 3), Format(change=change), Shot(noise=0.0))
    messages = done(source, tmp_path / "out", "--method", "svgf")  # which keeps an image without noise
    assert messages.count("of the light is in Combined but in no light pass") == 1
    for path in source.iterdir():
        np.testing.assert_allclose(combined(tmp_path / "out" / path.name), combined(path), atol=2e-5)


def test_half_keeps_bright_lights_finite(tmp_path: Path) -> None:
    def blind(frame: int, passes: Passes) -> None:
        for name in ("Combined", "Emission"):
            passes[name][20, 30, :3] = 6.5e4
        passes["Emission"][20, 30] = 6.55e4

    source = write_shot(tmp_path / "in", range(1, 2), Format(dtype=np.float16, change=blind))
    done(source, tmp_path / "out")
    assert np.isfinite(combined(tmp_path / "out" / "frame_0001.exr")).all()


def test_bad_values_are_repaired_and_told(tmp_path: Path) -> None:
    def spoil(frame: int, passes: Passes) -> None:
        for name, value in (
            ("Combined", np.nan),
            ("Diffuse Direct", np.inf),
            ("Vector", np.nan),
            ("Glossy Direct", -1e38),
        ):
            passes[name][20, 30, :3] = value

    source = write_shot(tmp_path / "in", range(1, 3), Format(change=spoil))
    assert "values were no numbers or out of range; they were repaired." in done(source, tmp_path / "out")
    assert all(np.isfinite(combined(path)).all() for path in (tmp_path / "out").iterdir())


def test_a_lobe_that_overflowed_harms_no_other(tmp_path: Path) -> None:
    """A firefly beyond half's range, as it happens in real sequences."""

    def overflow(frame: int, passes: Passes) -> None:
        passes["Glossy Direct"][20, 30] = np.inf

    path = Format(change=overflow).write(tmp_path / "a.exr", 1)
    reading = Reading("ViewLayer", light_passes=True, motion=True)
    spoiled = layer_inputs(MultilayerImage(path), reading)
    good = layer_inputs(MultilayerImage(Format().write(tmp_path / "b.exr", 1)), reading)
    np.testing.assert_allclose(spoiled.images["diffuse"], good.images["diffuse"], rtol=1e-5)
    assert np.isfinite(spoiled.images["emission"]).all() and not spoiled.deficit.any()


def test_compression_with_loss_is_not_repeated(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 2), Format("4.5", compression="DWAA"))
    done(source, tmp_path / "out")
    given, written = exr.read(source / "frame_0001.exr"), exr.read(tmp_path / "out" / "frame_0001.exr")
    for name in given:
        assert np.array_equal(given[name], written[name]) != name.endswith(".Combined")


def test_layers(tmp_path: Path) -> None:
    """All render layers, or the one that is named; the compositor's picture stays."""
    path = write_shot(tmp_path / "in", range(1, 2), Format("4.5", layers=("Near", "Far"))) / "frame_0001.exr"
    file = OpenEXR.File(str(path), separate_channels=True)
    channels = {name: channel.pixels for name, channel in file.channels().items()}
    channels |= {f"Composite.Combined.{c}": channels[f"Near.Combined.{c}"] for c in "RGBA"}
    OpenEXR.File(file.header(), channels).write(str(path))
    assert 'Layer "Composite" holds nothing but Combined and stays as it is.' in done(path, tmp_path / "all", "--png")
    assert {file.name for file in (tmp_path / "all").iterdir()} == {
        "frame_0001.exr", "frame_0001_Near.png", "frame_0001_Far.png"
    }  # fmt: skip
    done(path, tmp_path / "far", "--layer", "Far", "--png")
    assert {file.name for file in (tmp_path / "far").iterdir()} == {"frame_0001.exr", "frame_0001.png"}
    for name, changed in (("Near", (True, False)), ("Far", (True, True)), ("Composite", (False, False))):
        for folder, expected in zip(("all", "far"), changed, strict=True):
            same = np.array_equal(combined(path, name), combined(tmp_path / folder / path.name, name))
            assert same != expected, (name, folder)
    assert 'has no layer "Fra". It has: Composite, Far, Near.' in refused(path, tmp_path / "none", "--layer", "Fra")


@pytest.mark.parametrize("method", ["eaw", "none"])
def test_methods_without_history_need_no_vector(tmp_path: Path, method: str) -> None:
    source = write_shot(tmp_path / "in", (1, 3), Format(without=("Vector",)))
    assert done(source, tmp_path / "out", "--method", method) == ""
    if method == "none":
        for path in source.iterdir():
            np.testing.assert_allclose(combined(tmp_path / "out" / path.name), combined(path), atol=1e-5)


def test_json(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 3))
    result = run(source, tmp_path / "out", "--json", "--png")
    summary = json.loads(result.stdout)
    assert summary["device"] == "reference" and summary["warnings"] == []
    assert [frame["layers"]["ViewLayer"]["reset"] for frame in summary["frames"]] == ["first frame", ""]
    assert all(Path(path).is_file() for frame in summary["frames"] for path in (frame["exr"], *frame["png"]))


# --- Frames ---


@pytest.mark.parametrize("pattern", ["", "frame_####.exr", "frame_%04d.exr", "frame_*.exr", "*.exr", "frame_000?.exr"])
def test_ways_to_name_a_sequence(tmp_path: Path, pattern: str) -> None:
    write_shot(tmp_path, range(1, 4))
    (tmp_path / "notes.txt").touch()
    assert list(find_sequence(tmp_path / pattern)) == [1, 2, 3]


def test_a_pattern_takes_digits_for_frames_only(tmp_path: Path) -> None:
    for name in ("frame_0001.exr", "frame_left_0001.exr", "frame_0002.exr"):
        (tmp_path / name).touch()
    assert [path.name for path in find_sequence(tmp_path / "frame_####.exr").values()] == [
        "frame_0001.exr", "frame_0002.exr"
    ]  # fmt: skip


def test_one_file_and_some_frames(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 5))
    done(source / "frame_0002.exr", tmp_path / "one")
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["frame_0002.exr"]
    done(source, tmp_path / "some", "--frames", "2-3")
    assert sorted(path.name for path in (tmp_path / "some").iterdir()) == ["frame_0002.exr", "frame_0003.exr"]
    assert "has no frame 5-6." in done(source, tmp_path / "fewer", "--frames", "3-6")
    assert "has no frame 7-9. It has 1-4." in refused(source, tmp_path / "none", "--frames", "7-9")


def test_a_gap_starts_anew(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", (1, 2, 5, 6))
    messages = done(source, tmp_path / "out")
    assert messages == "Warning: Frame 5 starts without history: it follows frame 2, not 4.\n"
    done(source, tmp_path / "second", "--frames", "5-6")
    for name in ("frame_0005.exr", "frame_0006.exr"):
        np.testing.assert_array_equal(combined(tmp_path / "out" / name), combined(tmp_path / "second" / name))


def test_a_cut_starts_anew(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 4))
    write_shot(source, range(4, 6), shot=Shot(view=1))
    messages = done(source, tmp_path / "out")
    assert messages == 'Warning: Frame 4, layer "ViewLayer", starts without history: the view was cut.\n'
    done(source, tmp_path / "second", "--frames", "4-5")
    for name in ("frame_0004.exr", "frame_0005.exr"):
        np.testing.assert_array_equal(combined(tmp_path / "out" / name), combined(tmp_path / "second" / name))


def test_a_fast_pan_is_no_cut(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 5), shot=Shot(pan=25.0, speed=(0.0, 0.0)))
    assert done(source, tmp_path / "out") == ""


def test_resume_gives_the_same_frames(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 6))
    done(source, tmp_path / "whole", "--png")
    done(source, tmp_path / "out", "--frames", "1-3", "--png")
    damaged = tmp_path / "out" / "frame_0003.exr"
    damaged.write_bytes(damaged.read_bytes()[:-50])
    kept = (tmp_path / "out" / "frame_0002.exr").stat().st_mtime_ns
    summary = json.loads(run(source, tmp_path / "out", "--resume", "--png", "--json").stdout)
    assert [frame["frame"] for frame in summary["frames"]] == [3, 4, 5]
    assert (tmp_path / "out" / "frame_0002.exr").stat().st_mtime_ns == kept
    for path in (tmp_path / "whole").iterdir():
        assert path.read_bytes() == (tmp_path / "out" / path.name).read_bytes()
    assert run(source, tmp_path / "out", "--resume", "--png").stdout == "All frames were there.\n"


# --- Nothing is lost ---


def test_the_input_is_never_overwritten(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 3))
    (tmp_path / "link").symlink_to(source)
    before = {path: path.read_bytes() for path in source.iterdir()}
    for output in (source, tmp_path / "link", source / ".." / "in"):
        for option in ((), ("--overwrite",), ("--resume",)):
            assert "is a frame of the input. Choose another folder" in refused(source, output, *option)
    assert {path: path.read_bytes() for path in source.iterdir()} == before


def test_what_is_there_is_kept_unless_told(tmp_path: Path) -> None:
    source = write_shot(tmp_path / "in", range(1, 3))
    done(source, tmp_path / "out")
    (tmp_path / "out" / "frame_0002.exr").write_bytes(b"precious")
    assert "(and 1 more) is there already. Add --resume" in refused(source, tmp_path / "out")
    assert (tmp_path / "out" / "frame_0002.exr").read_bytes() == b"precious"
    done(source, tmp_path / "out", "--overwrite")
    assert exr.is_complete(tmp_path / "out" / "frame_0002.exr")
    assert "contradict" in refused(source, tmp_path / "out", "--overwrite", "--resume")


def test_ctrl_c_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = write_shot(tmp_path / "in", range(1, 4))
    replaced = os.replace

    def stop(old: Path, new: Path) -> None:
        if Path(new).name == "frame_0002.exr":
            raise KeyboardInterrupt
        replaced(old, new)

    monkeypatch.setattr(os, "replace", stop)
    result = run(source, tmp_path / "out")
    assert result.exit_code == 130 and result.stderr == "Stopped.\n"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["frame_0001.exr"]


# --- Arguments ---


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--method", "svfg"), 'Did you mean "svgf"?'),
        (("--device", "tpu"), 'There is no device "tpu".'),
        (("--frames", "x"), '"x" does not name frames.'),
    ],
)
def test_bad_arguments(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    source = write_shot(tmp_path / "in", range(1, 2))
    if "--device" in arguments:
        result = CliRunner().invoke(app, ["denoise", str(source), "-o", str(tmp_path / "out"), *arguments])
        assert result.exit_code == 2 and message in result.stderr and not (tmp_path / "out").exists()
    else:
        assert message in refused(source, tmp_path / "out", *arguments)


def test_no_such_input(tmp_path: Path) -> None:
    assert "there is no such file or folder" in refused(tmp_path / "none", tmp_path / "out")
    assert "names no .exr file" in refused(tmp_path, tmp_path / "out")
    assert "names no .exr file" in refused(tmp_path / "a_####.exr", tmp_path / "out")


@pytest.mark.parametrize("version", ["4.5", "5.0"])
def test_diagnostics_are_passes_beside_combined(tmp_path: Path, version: str) -> None:
    source = write_shot(tmp_path / "in", range(1, 4), Format(version, np.float16))
    done(source, tmp_path / "plain")
    done(source, tmp_path / "out", "--diagnostics")
    passes = exr.read(tmp_path / "out" / "frame_0003.exr")
    reasons = passes["ViewLayer.Reset Reason"]
    card = passes[f"ViewLayer.{'IndexOB' if version == '4.5' else 'Object Index'}"] == 1
    assert (reasons[: 6][~card[:6]] == ResetReason.BACKGROUND).all()
    assert (reasons == ResetReason.KEPT).mean() > 0.5
    assert passes["ViewLayer.History Length"].max() == 3.0
    # The file's vectors are exact, and depth is the same all over a card that faces the camera.
    assert passes["ViewLayer.Motion Error"].max() < 0.1
    assert not passes["ViewLayer.Repaired Values"].any()
    plain = exr.read(tmp_path / "plain" / "frame_0003.exr")
    assert passes.keys() - plain.keys() == {
        f"ViewLayer.{name}" for name in (*DIAGNOSTIC_PASSES, "History Length", "Variance")
    }
    for name, image in plain.items():
        np.testing.assert_array_equal(passes[name], image)
