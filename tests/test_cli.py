# SPDX-License-Identifier: Apache-2.0
"""The command line, on the reference device at a few pixels: results, exit codes, and one sentence for bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import svgf
from svgf.cli import sources
from svgf.errors import InputError
from svgf.frame_range import format_frames, parse_frames
from svgf.framing import reframe
from svgf.io import exr
from svgf.scene import Camera, RenderDefaults, Scene

from .command_line import SMALL, assert_done, assert_refused, make_scene, run

# --- Frames and sizes ---


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("7", (7,)),
        ("1-4", (1, 2, 3, 4)),
        ("3,1", (1, 3)),
        ("1-3,2-5", (1, 2, 3, 4, 5)),
        ("1-10:4", (1, 5, 9)),
        (" 1 - 2".replace(" - ", "-"), (1, 2)),
        ("-2-1", (-2, -1, 0, 1)),
        ("0", (0,)),
    ],
)
def test_frames_are_read(text: str, frames: tuple[int, ...]) -> None:
    assert parse_frames(text) == frames


@pytest.mark.parametrize(
    "text", ["", "a", "1-", "4-1", "1-5:0", "1..5", "1-5:", "1-99999999", "1,,2", "1.5", "9" * 5000]
)
def test_frames_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="name"):
        parse_frames(text)


def test_frames_are_written_short() -> None:
    assert format_frames([]) == ""
    assert format_frames([3, 1, 2, 7, 9, 10]) == "1-3, 7, 9-10"


def test_other_proportions_keep_the_view_along_the_longer_side() -> None:
    """As Blender frames with sensor fit Auto; shift is measured along the longer side, so the centre stays."""
    camera = Camera(np.eye(3, 4), (-0.4, 0.8, -0.2, 0.4))
    scene = replace(make_scene(), camera=camera, previous_camera=camera, defaults=RenderDefaults(200, 100))
    assert reframe(scene, 400, 200).camera is camera
    square = reframe(scene, 50, 50)
    assert square.camera.window == pytest.approx((-0.4, 0.8, -0.5, 0.7))
    assert (square.defaults.width, square.defaults.height) == (50, 50)
    upright = reframe(scene, 100, 200)
    assert upright.camera.window == pytest.approx((-0.1, 0.5, -0.5, 0.7))
    assert reframe(upright, 200, 100).previous_camera.window == pytest.approx(camera.window)


# --- render ---


def test_render(scene_file: Path, tmp_path: Path) -> None:
    output = assert_done(run("render", scene_file, "-o", tmp_path / "a" / "b", "--frames", "2-3", "--png", *SMALL))
    names = {path.name for path in (tmp_path / "a" / "b").iterdir()}
    assert names == {"shard_0002.exr", "shard_0002.png", "shard_0003.exr", "shard_0003.png"}
    assert output.startswith("2 frames of 16x9 in ") and "shard_0003.exr" in output and output.count("\n") == 1
    passes = exr.read(tmp_path / "a" / "b" / "shard_0003.exr")
    assert passes["ViewLayer.Combined"].shape == (9, 16, 4)
    assert np.isfinite(passes["ViewLayer.Combined"]).all() and passes["ViewLayer.Combined"].mean() > 0
    assert passes["ViewLayer.History Length"].max() == 2


def test_render_is_what_the_renderer_renders(scene_file: Path, tmp_path: Path) -> None:
    assert_done(
        run("render", scene_file, "-o", tmp_path, "--seed", 3, "--spp", 2, "--device", "reference", "--method", "eaw")
    )
    with svgf.SceneFile(scene_file) as file:
        renderer = svgf.Renderer(svgf.Settings(seed=3, samples=2, method="eaw"), "reference")
        for scene in file:
            frame = renderer.render(scene)
            passes = exr.read(tmp_path / f"shard_{scene.frame:04d}.exr")
            np.testing.assert_array_equal(passes["ViewLayer.Combined"][..., :3], frame.color)
            np.testing.assert_array_equal(passes["ViewLayer.Noisy Image"][..., :3], frame.noisy)
            assert frame.color.shape == (18, 32, 3)


def test_render_json_and_warnings(scene_file: Path, tmp_path: Path) -> None:
    result = run("render", scene_file, "-o", tmp_path, "--json", *SMALL)
    summary = json.loads(assert_done(result))
    assert summary["device"] == "reference"
    assert [entry["frame"] for entry in summary["frames"]] == [1, 2, 3, 4]
    assert [entry["reset"] for entry in summary["frames"]] == ["first frame", "", "", ""]
    assert summary["frames"][0]["milliseconds"]["path"] > 0
    assert result.stderr == "Warning: Volumes are not simulated.\n"


@pytest.mark.parametrize("size", ["1x1", "1x7", "13x5"])
def test_odd_sizes(scene_file: Path, tmp_path: Path, size: str) -> None:
    assert_done(run("render", scene_file, "-o", tmp_path, "--size", size, "--device", "reference", "--frames", "1-2"))
    width, height = map(int, size.split("x"))
    assert exr.read(tmp_path / "shard_0002.exr")["ViewLayer.Combined"].shape == (height, width, 4)


def test_resume_gives_the_same_frames(scene_file: Path, tmp_path: Path) -> None:
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    assert_done(run("render", scene_file, "-o", whole, *SMALL))
    assert_done(run("render", scene_file, "-o", resumed, "--frames", "1-2", *SMALL))
    (resumed / "shard_0002.exr").write_bytes((whole / "shard_0002.exr").read_bytes()[:-20])
    before = (resumed / "shard_0001.exr").stat().st_mtime_ns
    summary = json.loads(assert_done(run("render", scene_file, "-o", resumed, "--resume", "--json", *SMALL)))
    assert [entry["frame"] for entry in summary["frames"]] == [2, 3, 4]
    assert (resumed / "shard_0001.exr").stat().st_mtime_ns == before
    for path in whole.iterdir():
        assert path.read_bytes() == (resumed / path.name).read_bytes()
    assert assert_done(run("render", scene_file, "-o", resumed, "--resume", *SMALL)) == "All frames were there.\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{scenes}/none.svgf"], "Cannot read .*none.svgf: there is no such file or folder. Check the path."),
        (["{scenes}/none.blend"], "Cannot read .*none.blend: there is no such file"),
        (["{scenes}/none.obj"], "is neither a .svgf nor a .blend file"),
        (["{scenes}"], "is neither a .svgf nor a .blend file"),
        (["{file}", "--size", "0x9"], "The image size is 0x9. Both sides must be"),
        (["{file}", "--size", "16x-9"], "The image size is 16x-9"),
        (["{file}", "--size", "99999x1"], "The image size is 99999x1"),
        (["{file}", "--size", "wide"], '"wide" is not an image size. Write it as 960x540.'),
        (["{file}", "--frames", "4-1"], '"4-1" names no frame'),
        (["{file}", "--frames", "3-6"], r"shard.svgf has no frame 5-6. It holds 1-4."),
        (["{file}", "--device", "tpu"], 'There is no device "tpu". Choose one of auto, cuda, cpu, reference.'),
        (["{file}", "--method", "svfg"], "Settings.method is 'svfg'. Did you mean \"svgf\"?"),
        (["{file}", "--spp", "0"], "Settings.samples is 0"),
        (["{file}", "--bounces", "-1"], "Settings.bounces is -1"),
        (["{file}", "--seed", "-1"], "Settings.seed is -1"),
        (["{scenes}/x.blend", "--resume"], r"To resume x.blend, svgf must know the frames. Add --frames A-B."),
    ],
)
def test_bad_arguments_of_render(scene_file: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    filled = [argument.format(file=scene_file, scenes=scene_file.parent) for argument in arguments]
    assert_refused(
        run("render", *filled, "-o", tmp_path / "out", *(() if "--device" in filled else ("--device", "reference"))),
        message,
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (lambda data: b"", "is not an svgf scene file"),
        (lambda data: data[: len(data) // 2], "is truncated or damaged"),
        (lambda data: data[:-1], "is truncated or damaged"),
        (lambda data: data[:60] + bytes(20) + data[80:], "bad.svgf"),
    ],
)
def test_damaged_scene_file(scene_file: Path, tmp_path: Path, content: Callable[[bytes], bytes], message: str) -> None:
    path = tmp_path / "bad.svgf"
    path.write_bytes(content(scene_file.read_bytes()))
    assert_refused(run("render", path, "-o", tmp_path / "out", *SMALL), message)
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_output(scene_file: Path, tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_bytes(b"")
    assert_refused(
        run("render", scene_file, "-o", in_the_way, *SMALL), "Cannot create the folder .*file: a file of that name"
    )
    assert_refused(run("render", scene_file, "-o", in_the_way / "out", *SMALL), "a part of the path is a file")


def test_missing_driver_is_one_sentence(scene_file: Path, tmp_path: Path) -> None:
    if any(info.name == "cuda" and info.available for info in svgf.available_devices()):
        pytest.skip("this machine has a GPU")
    assert_refused(run("render", scene_file, "-o", tmp_path, "--device", "cuda"), 'Device "cuda" is not available: ')


# --- In a process of its own: signals and limits ---


def start(*arguments: object, preparation: str = "") -> subprocess.Popen[str]:
    program = f"import signal, resource; {preparation}\nfrom svgf.cli import main\nmain()"
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
@pytest.mark.parametrize("name", ["reference", "cpu"])
def test_ctrl_c_stops_at_once_and_leaves_no_half_file(scene_file: Path, tmp_path: Path, name: str) -> None:
    if not any(info.name == name and info.available for info in svgf.available_devices()):
        pytest.skip(f'device "{name}" is not available')
    preparation = "signal.signal(signal.SIGINT, signal.default_int_handler)"
    process = start(
        "render", scene_file, "-o", tmp_path, "--device", name, "--size", "64x36", "--spp", "1000000",
        preparation=preparation,
    )  # fmt: skip
    assert process.stderr.readline().startswith("Warning: ")  # the first frame is about to start
    time.sleep(0.5)
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert time.monotonic() - sent < 15
    assert process.returncode == 130 and stdout == "" and stderr == "Stopped.\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_full_disk(scene_file: Path, tmp_path: Path) -> None:
    """The system refuses to let a file grow: nothing half-written stays."""
    process = start(
        "render",
        scene_file,
        "-o",
        tmp_path,
        *SMALL,
        preparation="resource.setrlimit(resource.RLIMIT_FSIZE, (500, 500))",
    )
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 2 and stdout == ""
    assert "Error: Cannot write " in stderr and "Traceback" not in stderr
    assert not list(tmp_path.iterdir())


def test_help_is_quick() -> None:
    process = start("--help")
    stdout, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    for command in ("demo", "render", "denoise", "export", "compare", "bench", "doctor"):
        assert command in stdout
    program = "import sys, svgf.cli; print('numpy' in sys.modules, 'OpenEXR' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert loaded == "False False\n"


@pytest.mark.parametrize("arguments", [["render"], ["--nothing"], ["nothing"], ["bench", "stages", "--count", "0"]])
def test_wrong_usage(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2 and result.stdout == "" and "Usage: svgf" in result.stderr


def test_version() -> None:
    assert assert_done(run("--version")) == f"svgf {svgf.__version__}\n"


# --- compare ---


@pytest.fixture(scope="session")
def rendered(scene_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rendered")
    assert_done(run("render", scene_file, "-o", folder, *SMALL))
    return folder


def test_compare_files(rendered: Path) -> None:
    path = rendered / "shard_0001.exr"
    result = json.loads(assert_done(run("compare", path, path, "--json")))
    assert result["mean"] == {"relMSE": 0.0, "PSNR": None, "SSIM": pytest.approx(1.0), "FLIP": 0.0}
    table = assert_done(run("compare", path, path))
    assert all(name in table for name in ("relMSE", "PSNR", "SSIM", "FLIP")) and "flicker" not in table


@pytest.mark.parametrize("pattern", ["", "shard_*.exr", "shard_####.exr"])
def test_compare_sequences(rendered: Path, pattern: str) -> None:
    from svgf import metrics

    result = json.loads(assert_done(run("compare", rendered / pattern, rendered, "--pass", "Noisy Image", "--json")))
    assert [row["frame"] for row in result["frames"]] == [1, 2, 3, 4]
    images = [exr.read(rendered / f"shard_{frame:04d}.exr") for frame in range(1, 5)]
    noisy = [image["ViewLayer.Noisy Image"][..., :3] for image in images]
    color = [image["ViewLayer.Combined"][..., :3] for image in images]
    assert result["mean"]["flicker"] == pytest.approx(metrics.flicker(noisy, color))
    assert result["mean"]["relMSE"] == pytest.approx(
        np.mean([metrics.relative_mse(*pair) for pair in zip(noisy, color, strict=True)])
    )
    assert result["frames"][2]["SSIM"] == pytest.approx(metrics.ssim(noisy[2], color[2]))


def test_compare_what_sequences_have_in_common(rendered: Path, tmp_path: Path) -> None:
    for frame in (2, 4):
        (tmp_path / f"truth_{frame}.exr").write_bytes((rendered / f"shard_{frame:04d}.exr").read_bytes())
    result = run("compare", rendered, tmp_path, "--json")
    assert result.stderr == "Warning: 2 frames are in one of the sequences only.\n"
    comparison = json.loads(assert_done(result))
    assert [row["frame"] for row in comparison["frames"]] == [2, 4]
    assert "flicker" not in comparison["mean"]
    assert "worst" in assert_done(run("compare", rendered, rendered, "--frames", "2-3"))


def test_compare_refuses(rendered: Path, scene_file: Path, tmp_path: Path) -> None:
    first = rendered / "shard_0001.exr"
    assert_done(run("render", scene_file, "-o", tmp_path, "--size", "8x8", "--device", "reference", "--frames", "1"))
    other = tmp_path / "shard_0001.exr"
    assert_refused(
        run("compare", first, other), "shard_0001.exr is 16x9, but .*shard_0001.exr is 8x8. Render both at one size."
    )
    assert_refused(run("compare", first, tmp_path / "none.exr"), "Cannot read .*none.exr: there is no such file")
    assert_refused(run("compare", first, scene_file), "is not an OpenEXR file")
    assert_refused(run("compare", first, scene_file.parent), "names no .exr file")
    assert_refused(run("compare", first, first, "--pass", "Mist"), 'has no pass "Mist". It has: ViewLayer.Combined')
    assert_refused(run("compare", first, first, "--pass", "Depth"), 'pass "Depth" has no three channels')
    assert_refused(run("compare", rendered, rendered, "--frames", "9"), "have no frame in common")
    (tmp_path / "again_0001.exr").write_bytes(first.read_bytes())
    assert_refused(run("compare", tmp_path, rendered), "are both frame 1. Name one sequence")
    other.write_bytes(first.read_bytes()[:-9])
    assert_refused(run("compare", other, first), "shard_0001.exr is truncated or damaged. Render it again.")


# --- doctor, bench, demo ---


def test_doctor(scene_file: Path) -> None:
    output = assert_done(run("doctor"))
    assert svgf.__version__ in output and "reference" in output and "OpenEXR" in output and "cuda" in output
    output = assert_done(run("doctor", scene_file))
    for text in (
        "1-4",
        "32x18",
        "3 triangles",
        "1 point",
        "SPECULAR",
        "Glossy",
        "OBJECT_MOTION",
        "1 of 2 instances",
        "Lamp",
    ):
        assert text in output, text
    assert "Warning: Volumes are not simulated." in output
    result = run("doctor", scene_file.with_name("none.svgf"))
    assert result.exit_code == 2 and result.stderr.startswith("Error: Cannot read") and result.stderr.count("\n") == 1


@pytest.fixture
def shipped(scene_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "shipped_scenes", lambda: {"cornell": scene_file})


def test_demo(shipped: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from svgf.cli import demo

    monkeypatch.setattr(demo, "_SIZE", (32, 18))
    monkeypatch.setattr(demo, "_REFERENCE_SAMPLES", 8)
    output = assert_done(run("demo", "-o", tmp_path / "out", "--device", "reference"))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "comparison.png",
        "cornell_0004.exr",
        "cornell_0004.png",
    }
    assert "relMSE, denoised" in output and "reference" in output and "comparison.png" in output
    width, height = np.frombuffer((tmp_path / "out" / "comparison.png").read_bytes()[16:24], ">u4")
    assert (width, height) == (3 * 32, 18 + 26)


def test_demo_of_a_scene_that_is_not_there(shipped: None, tmp_path: Path) -> None:
    assert_refused(
        run("demo", "--scene", "teapot", "-o", tmp_path / "out"), 'no scene "teapot". Choose one of cornell.'
    )
    assert not list(tmp_path.iterdir())


# --- .blend files, with an exporter that stands in for the add-on's ---


@pytest.fixture
def exporter(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """What the exporter was asked for."""
    calls: list[dict[str, object]] = []

    def export_file(path, frames=None, size=None, report=None) -> Iterator[Scene]:
        calls.append({"path": path, "frames": frames, "size": size})
        wanted = frames or (1, 2)
        for done, frame in enumerate(wanted, start=1):
            if frame == 99:
                raise InputError(f"{path} has no camera.", "Add one.")
            yield make_scene(frame)
            if report:
                report(done, len(wanted))

    module = types.ModuleType("svgf_blender.export")
    module.export_file = export_file
    monkeypatch.setitem(sys.modules, "svgf_blender.export", module)
    return calls


@pytest.fixture
def blend_file(tmp_path: Path) -> Path:
    path = tmp_path / "shot.blend"
    path.write_bytes(b"BLENDER")
    return path


def test_export(exporter: list, blend_file: Path, tmp_path: Path) -> None:
    target = tmp_path / "shot.svgf"
    result = run("export", blend_file, "-o", target, "--frames", "1-3", "--size", "64x36")
    assert assert_done(result).startswith(f"{target}: frames 1-3, ")
    assert result.stderr == "Warning: Volumes are not simulated.\n"
    assert exporter == [{"path": blend_file, "frames": (1, 2, 3), "size": (64, 36)}]
    with svgf.SceneFile(target) as file:
        assert file.frames == (1, 2, 3)


def test_export_that_fails_leaves_nothing(exporter: list, blend_file: Path, tmp_path: Path) -> None:
    target = tmp_path / "shot.svgf"
    assert_refused(run("export", blend_file, "-o", target, "--frames", "1,99"), "shot.blend has no camera. Add one.")
    assert_refused(
        run("export", blend_file, "-o", tmp_path / "shot.usd"), r"does not end in .svgf. Write -o .*shot.svgf"
    )
    assert_refused(run("export", blend_file, "-o", tmp_path / "none" / "a.svgf"), "there is no such file or folder")
    assert_refused(run("export", tmp_path / "none.blend", "-o", target), "Cannot read .*none.blend")
    assert list(tmp_path.iterdir()) == [blend_file]


def test_render_and_bench_of_a_blend_file(exporter: list, blend_file: Path, tmp_path: Path) -> None:
    assert_done(run("render", blend_file, "-o", tmp_path / "out", *SMALL))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"shot_0001.exr", "shot_0002.exr"}
    figures = json.loads(
        assert_done(run("bench", "stages", blend_file, *SMALL, "--count", 2, "--warm-up", 0, "--json"))
    )
    assert figures["rows"][0]["stage"] == "export" and figures["rows"][0]["frames"] == 1


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("bpy", r"Reading .blend files needs the bpy package. Install it with: pip install 'svgf\[blender\]'"),
        ("svgf_blender.export", "Reading .blend files needs svgf's add-on"),
    ],
)
def test_blend_file_without_blender(
    blend_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str, message: str
) -> None:
    def fail(name: str) -> None:
        raise ModuleNotFoundError(f"No module named '{missing}'", name=missing)

    monkeypatch.setattr(sources.importlib, "import_module", fail)
    assert_refused(run("render", blend_file, "-o", tmp_path / "out", "--device", "reference"), message)
    assert_refused(run("export", blend_file, "-o", tmp_path / "a.svgf"), message)
    assert list(tmp_path.iterdir()) == [blend_file]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_export_to_a_full_disk(exporter: list, blend_file: Path, tmp_path: Path) -> None:
    (tmp_path / f".shot.svgf.{os.getpid()}.part").symlink_to("/dev/full")
    assert_refused(
        run("export", blend_file, "-o", tmp_path / "shot.svgf"), "shot.svgf: the disk is full. Free some space"
    )
    assert list(tmp_path.iterdir()) == [blend_file]
