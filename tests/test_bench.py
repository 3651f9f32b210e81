# SPDX-License-Identifier: Apache-2.0
"""``svgf bench``: every command at a few pixels, its table, JSON, CSV and plot."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from .command_line import SMALL, assert_done, assert_refused, run


def test_bench_rays(tmp_path: Path, monkeypatch) -> None:
    from svgf.bench import rays

    monkeypatch.setattr(rays, "ROOMS", {"tiny": 2})
    monkeypatch.setattr(rays, "UPDATED_ROOMS", {"tiny": 2})
    csv_file, plot_file = tmp_path / "rays.csv", tmp_path / "rays.png"
    assert_done(run("bench", "rays", *SMALL[:4], "--count", 1, "--csv", csv_file, "--plot", plot_file))
    rows = list(csv.DictReader(csv_file.open()))
    assert {row["what"] for row in rows if row["scene"] == "tiny"} >= {"primary", "bounce", "shadow", "build", "deform"}
    assert all(float(row["milliseconds"]) > 0 for row in rows)
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_bench_effects(scene_file: Path, tmp_path: Path) -> None:
    csv_file, plot_file = tmp_path / "effects.csv", tmp_path / "effects.png"
    assert_done(run("bench", "effects", scene_file, *SMALL, "--count", 1, "--csv", csv_file, "--plot", plot_file))
    rows = list(csv.DictReader(csv_file.open()))
    assert rows[-1]["what"] == "full kernel"
    assert all(float(row["on_ms"]) > 0 and float(row["off_ms"]) > 0 for row in rows)
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_bench_denoise(tmp_path: Path) -> None:
    size = ("--size", "40x24", "--size", "64x36", "--count", 2, "--warm-up", 5)
    files = ("--csv", tmp_path / "t.csv", "--plot", tmp_path / "t.png")
    report = json.loads(assert_done(run("bench", "denoise", "--device", "cpu", *size, *files, "--json")))
    rows = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    assert len(rows) == len(report["rows"])
    assert {(row["width"], row["signals"]) for row in rows} == {("40", "1"), ("40", "2"), ("64", "1"), ("64", "2")}
    for row in report["rows"]:
        assert row["milliseconds"] > 0.0 and row["bytes"] >= 4 * row["width"] * row["height"]
        assert row["bandwidth"] == pytest.approx(row["bytes"] / row["milliseconds"] / 1e6)
    total = {(row["width"], row["signals"]): row["milliseconds"] for row in report["rows"] if "all" in row["stage"]}
    assert len(report["growths"]) == 2
    for row in report["growths"]:
        assert (row["smaller"], row["larger"]) == ("40x24", "64x36") and row["pixels"] == 64 * 36 / (40 * 24)
        assert row["milliseconds"] == total[64, row["signals"]] / total[40, row["signals"]]
    assert all(row["bytes_per_pixel"] * row["width"] * row["height"] == row["bytes"] for row in report["buffers"])
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    assert_refused(run("bench", "denoise", "--device", "reference", *size), "Use cuda or cpu")


def test_bench_ablation(scene_file: Path, tmp_path: Path) -> None:
    frames = ("--size", "16x9", "--device", "cpu", "--frames", "1-4", "--first", 2, "--reference-spp", 4)
    options = (*frames, "--method", "svgf+", "--method", "none")
    files = ("--csv", tmp_path / "a.csv", "--plot", tmp_path / "a.png")
    rows = json.loads(assert_done(run("bench", "ablation", scene_file, *options, *files, "--json")))["rows"]
    from svgf.bench.ablation import STEPS, STILL_STEPS

    assert [(row["scene"], row["method"], row["off"]) for row in rows] == [
        *(("shard", "svgf+", off) for off in ("whole", *STEPS["svgf+"])),
        ("shard", "none", "whole"),
        *(("shard, still", "svgf+", off) for off in ("whole", *STILL_STEPS)),
    ]
    assert all(row[name] >= 0.0 for row in rows for name in ("relmse", "flip", "flicker", "milliseconds"))
    # What is off is off: without the filter only the temporal mean is left, which has more noise.
    by_step = {row["off"]: row for row in rows if row["scene"] == "shard" and row["method"] == "svgf+"}
    assert by_step["a-trous"]["relmse"] != by_step["whole"]["relmse"]
    still = {row["off"]: row for row in rows if row["scene"] == "shard, still"}
    assert still["all history"]["relmse"] > 2.0 * still["whole"]["relmse"]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + len(rows)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert_refused(run("bench", "ablation", scene_file, *options, "--method", "best"), "Choose one of none, eaw, svgf")


def test_bench_ablation_shows_each_scene_when_it_is_measured(scene_file: Path, tmp_path: Path) -> None:
    """A run that ends early has shown what it has: here the second scene is none."""
    broken = tmp_path / "broken.svgf"
    broken.write_text("no scene")
    options = ("--size", "16x9", "--device", "cpu", "--frames", "1-3", "--first", 2, "--reference-spp", 1)
    files = (scene_file, broken, "--csv", tmp_path / "a.csv")
    result = run("bench", "ablation", *files, *options, "--method", "none")
    assert result.exit_code == 2 and "broken.svgf" in result.stderr
    title, *table = result.stdout.splitlines()
    assert "(cpu), 16x9" in title and "shard" in table[1] and "none" in table[3]
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 2


def test_every_step_of_the_ablation_is_a_setting() -> None:
    from svgf.bench.ablation import STEPS, STILL_STEPS, changed
    from svgf.settings import METHODS, DenoiseSettings, PlusStep, Settings

    assert set(STEPS) == set(METHODS)
    rows = [(method, changes) for method, steps in STEPS.items() for changes in steps.values()]
    rows += [("svgf+", changes) for changes in STILL_STEPS.values()]
    for method, changes in rows:
        assert changed(Settings(), method, changes) != Settings(method=method)
    switched = [changes.get("steps", int(DenoiseSettings().steps)) for _, changes in rows]
    assert all(any(not steps & step for steps in switched) for step in PlusStep)


def test_bench_stages(scene_file: Path, tmp_path: Path) -> None:
    arguments = ("bench", "stages", scene_file, scene_file, *SMALL, "--count", 3, "--warm-up", 1)
    figures = json.loads(assert_done(run(*arguments, "--csv", tmp_path / "a.csv", "--json")))
    assert "(reference), 16x9" in figures["title"]
    rows = figures["rows"]
    stages = [row["stage"] for row in rows if row["scene"] == "shard"]
    assert stages[:3] == ["update", "gbuffer", "path"] and stages[-2:] == ["denoise, all", "whole frame"]
    assert all(0 <= row["minimum"] <= row["median"] <= row["maximum"] and row["frames"] == 3 for row in rows)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "scene,stage,median,minimum,maximum,frames" and len(lines) == 1 + len(rows)
    table = assert_done(run(*arguments))
    assert "whole frame" in table and "reference" in table.splitlines()[0] and "16x9" in table.splitlines()[0]


def test_bench_resolution(scene_file: Path, tmp_path: Path) -> None:
    sizes = ("--size", "16x9", "--size", "32x18", "--device", "reference", "--count", 1, "--warm-up", 1)
    files = ("--csv", tmp_path / "r.csv", "--plot", tmp_path / "r.png")
    rows = json.loads(assert_done(run("bench", "resolution", scene_file, *sizes, *files, "--json")))["rows"]
    assert [(row["width"], row["height"]) for row in rows] == [(16, 9), (32, 18)]
    assert all(0.0 < row["trace"] and 0.0 < row["denoise"] < row["whole"] for row in rows)
    assert len(list(csv.DictReader((tmp_path / "r.csv").open()))) == 2
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")
    assert "32x18" in assert_done(run("bench", "resolution", scene_file, *sizes))


def test_bench_cycles(tmp_path: Path) -> None:
    bpy = pytest.importorskip("bpy", reason="bpy is not installed: pip install svgf[blender]")
    bpy.ops.wm.read_factory_settings()  # a cube, a lamp and a camera
    bpy.context.scene.frame_end = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "cube.blend"))
    options = ("--size", "64x36", "--bounces", 1, "--count", 2)
    report = json.loads(
        assert_done(run("bench", "cycles", tmp_path / "cube.blend", *options, "--csv", tmp_path / "c.csv", "--json"))
    )
    (row,) = report["rows"]
    assert row["scene"] == "cube" and all(milliseconds > 0 for name, milliseconds in row.items() if name != "scene")
    (line,) = csv.DictReader((tmp_path / "c.csv").read_text().splitlines())
    assert {name: line[name] for name in row} == {name: str(value) for name, value in row.items()}
    # What was measured: the file's scene with these settings in both renderers.
    scene = bpy.context.scene
    assert scene.render.engine == "CYCLES" and (scene.render.resolution_x, scene.render.resolution_y) == (64, 36)
    assert (scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising) == (1, 1, False)
    assert_refused(run("bench", "cycles", tmp_path / "nowhere.blend", *options), "There is no file")


def test_table_of_bench_cycles(monkeypatch) -> None:
    from svgf.bench import cycles

    pytest.importorskip("bpy", reason="bpy is not installed: pip install svgf[blender]")
    measured = cycles.CyclesComparison("room", wall=200.0, cycles_wall=300.0, processor=400.0, cycles_processor=1000.0)
    monkeypatch.setattr(cycles, "measure", lambda *arguments: measured)
    text = assert_done(run("bench", "cycles", "room.blend", "--size", "64x36", "--count", 2))
    assert "64x36, 1 sample per pixel: median ms of 2 frames" in text
    (line,) = (line for line in text.splitlines() if "room" in line)
    assert [cell.strip() for cell in line.split("│")[1:-1]] == ["room", "200", "300", "1.50x", "400", "1000", "2.50x"]
