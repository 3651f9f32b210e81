# SPDX-License-Identifier: Apache-2.0
"""What a denoiser tells of a frame: why a pixel has no history, how far motion misses, what was repaired and cut."""

from __future__ import annotations

import numpy as np
import pytest

from svgf.denoiser import Denoiser
from svgf.diagnostics import DIAGNOSTICS, ResetReason
from svgf.errors import InputError
from svgf.io import exr
from svgf.passes import DIAGNOSTIC_PASSES
from svgf.renderer import Renderer
from svgf.settings import METHODS, DenoiseSettings, Settings

from .scenes import WHITE, build, camera, quad, transform
from .test_denoiser import HEIGHT, WIDTH, add_noise, make_frame

TEMPORAL = ("svgf+", "svgf")


def diagnose(device, method, frames, **settings):
    denoiser = Denoiser(WIDTH, HEIGHT, device, method, DenoiseSettings(**settings), diagnostics=True)
    for frame in frames:
        denoiser.denoise(frame)
    return denoiser


@pytest.mark.parametrize("method", TEMPORAL)
def test_each_reason_is_told(device, method):
    before, frame = make_frame(), make_frame()
    before["object_id"][4:6], frame["object_id"][4:6] = 2, 3
    # Three rows: the outer ones find history in the pixels around.
    before["depth"][8:11] = 5.0
    before["normal"][12:15] = [0.0, 1.0, 0.0]
    frame["motion"][16:18] = [np.nan, 0.0, 0.0]
    frame["motion"][20:22] = [-100.0, 0.0, 0.0]
    for name in ("object_id", "normal", "diffuse"):
        frame[name][22:] = 0
    frame["depth"][22:] = 1e10
    denoiser = Denoiser(WIDTH, HEIGHT, device, method, diagnostics=True)
    denoiser.denoise(before)
    assert (denoiser.diagnostics["reset_reason"] == ResetReason.RESTARTED).all()
    denoiser.denoise(frame)
    expected = np.full((HEIGHT, WIDTH), float(ResetReason.KEPT))
    expected[4:6] = ResetReason.OTHER_OBJECT
    expected[9] = ResetReason.OTHER_DEPTH
    expected[13] = ResetReason.OTHER_NORMAL
    expected[16:18] = ResetReason.BAD_MOTION
    expected[20:22] = ResetReason.OUTSIDE
    expected[22:] = ResetReason.BACKGROUND
    np.testing.assert_array_equal(denoiser.diagnostics["reset_reason"], expected)
    denoiser.reset("camera cut")
    denoiser.denoise(frame)
    expected[:22] = ResetReason.RESTARTED
    np.testing.assert_array_equal(denoiser.diagnostics["reset_reason"], expected)


def test_light_that_changes_is_a_reason(device):
    rng = np.random.default_rng(1)
    frames = [add_noise(make_frame(), rng, 0.3) for _ in range(12)]
    frames += [add_noise(make_frame(radiance=10.0), rng, 0.3) for _ in range(3)]
    reasons = diagnose(device, "svgf+", frames).diagnostics["reset_reason"]
    assert (reasons == ResetReason.LIGHT_CHANGED).mean() > 0.9
    assert (diagnose(device, "svgf+", frames[:12]).diagnostics["reset_reason"] == ResetReason.KEPT).mean() > 0.9


@pytest.mark.parametrize("method", TEMPORAL)
@pytest.mark.parametrize("miss", [0.0, 0.5, 3.0])
def test_motion_error_is_in_pixels(device, method, miss):
    """A slanted wall slides to the right by two pixels a frame, and its motion says so, but for a miss."""
    frames = []
    for step in range(2):
        frame = make_frame()
        frame["depth"] += 0.1 * (np.arange(WIDTH, dtype=np.float32) - 2.0 * step)
        frame["depth_gradient"][..., 0] = 0.1
        frame["motion"][..., 0] = miss - 2.0
        frame["window"] = np.array([-0.5, 0.5, -0.3, 0.3])
        frames.append(frame)
    error = diagnose(device, method, frames).diagnostics["motion_error"]
    footprint = frames[1]["depth"] / WIDTH
    # Of half precision: svgf+ keeps slopes to 2^-9, and the nearest pixel's depth to 4e-6.
    expected = np.float32(miss) * 0.1 / (0.1 + footprint)
    inner = np.s_[:, 6:-6]
    np.testing.assert_allclose(error[inner], expected[inner], rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_repairs_are_placed_and_add_up(device, method):
    rng = np.random.default_rng(2)
    frames = [make_frame(), make_frame()]
    frames[1]["diffuse"][3, 4] = [np.nan, -1.0, 1.0]
    frames[1]["diffuse_albedo"][6, 7, 1] = np.inf
    frames[1]["emission"][8, 9] = -np.inf
    frames[1]["depth"][10, 11] = np.nan
    frames[1]["motion"][12, 13] = np.nan
    frames[1]["depth_gradient"][14, 15] = np.inf
    denoiser = diagnose(device, method, frames)
    image = denoiser.diagnostics["repaired_values"]
    assert image.sum() == denoiser.repaired
    placed = {(3, 4): 2, (6, 7): 1, (8, 9): 3, (10, 11): 1, (14, 15): 2}
    if method in TEMPORAL:
        placed[12, 13] = 1
    assert {tuple(map(int, at)): int(image[tuple(at)]) for at in np.argwhere(image)} == placed
    values = np.float32([1.0, np.nan, -1.0])
    everything = {name: rng.choice(values, image.shape) for name, image in make_frame().items()}
    everything["object_id"] = rng.integers(0, 3, (HEIGHT, WIDTH)).astype(np.int32)
    denoiser.denoise(everything)
    assert denoiser.diagnostics["repaired_values"].sum() == denoiser.repaired > 1000


def test_suppressed_light_is_placed_and_adds_up(device):
    rng = np.random.default_rng(3)
    frames = [add_noise(make_frame(), rng, 0.3) for _ in range(4)]
    frames[3]["diffuse"][5, 6] = 1e4
    denoiser = diagnose(device, "svgf+", frames)
    image = denoiser.diagnostics["suppressed_light"]
    assert image[5, 6] == pytest.approx(2e4, rel=0.01)
    assert image.sum() == pytest.approx(denoiser.fireflies[1], rel=1e-3)
    denoiser.denoise(make_frame())
    assert not denoiser.diagnostics["suppressed_light"].any()


@pytest.mark.parametrize("method", METHODS)
def test_diagnostics_change_no_bit(device, method):
    rng = np.random.default_rng(4)
    with_them = Denoiser(WIDTH, HEIGHT, device, method, diagnostics=True)
    without = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(4):
        frame = add_noise(make_frame(), rng)
        frame["motion"][..., 0] = 0.3
        first, second = with_them.denoise(frame), without.denoise(frame)
        assert first.keys() == second.keys()
        for name in ("color", "variance", "history_length"):
            np.testing.assert_array_equal(first[name], second[name])
        assert with_them.diagnostics.keys() == DIAGNOSTICS.keys()
    with pytest.raises(InputError, match="makes no diagnostics.*diagnostics=True"):
        _ = without.diagnostics


@pytest.mark.parametrize("method", TEMPORAL)
def test_history_is_what_was_given(device, method):
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    assert denoiser.history == {}
    frame = make_frame(radiance=3.0)
    frame["specular"], frame["specular_albedo"] = frame["diffuse"] * 0.5, np.ones_like(frame["diffuse"])
    for _ in range(3):
        denoiser.denoise(frame)
    history = denoiser.history
    np.testing.assert_allclose(history["color0"], 3.0, rtol=2.0**-13)
    np.testing.assert_allclose(history["color1"], 0.75, rtol=2.0**-13)
    if method == "svgf+":
        np.testing.assert_array_equal(history["frames0"], 3.0)


def test_what_stands_still_keeps_the_bits_of_its_history(device):
    """Without motion history is read from one pixel and not resampled: what does not change stays to the bit."""
    rng = np.random.default_rng(5)
    frame = make_frame()
    frame["diffuse"] *= rng.gamma(1.0, 1.0, frame["diffuse"].shape).astype(np.float32)
    # No two pixels show the same surface: none begins with the mean of its neighbours.
    frame["object_id"] = np.arange(1, WIDTH * HEIGHT + 1, dtype=np.int32).reshape(HEIGHT, WIDTH)
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf+", DenoiseSettings(firefly_limit=1e9, history_clamp=1e6))
    denoiser.denoise(frame)
    first = denoiser.history["color0"]
    for _ in range(40):
        denoiser.denoise(frame)
    np.testing.assert_array_equal(denoiser.history["color0"], first)


@pytest.mark.parametrize("build", ["cpu", "cpu_avx2", "cuda"])
def test_reasons_are_the_native_ones(build):
    native = pytest.importorskip(f"svgf._native.{build}", exc_type=ImportError)
    assert native.reset_reasons() == {each.name.lower(): each.value for each in ResetReason}


def test_a_renderer_writes_them_as_passes(device, tmp_path):
    scene = build([(quad(4.0), transform((0, 0, -3)), [WHITE])], camera((0, 0, 3), (0, 0, -3)))
    renderer = Renderer(Settings(24, 14, diagnostics=True), device)
    for _ in range(2):
        frame = renderer.render(scene)
    assert (frame.reset_reason[frame.object_id > 0] == ResetReason.KEPT).all()
    assert not frame.motion_error.any()
    exr.write(frame, tmp_path / "frame.exr")
    passes = exr.read(tmp_path / "frame.exr")
    for name in DIAGNOSTIC_PASSES:
        assert passes[f"ViewLayer.{name}"].shape == (14, 24)
    exr.write(Renderer(Settings(24, 14), device).render(scene), tmp_path / "plain.exr")
    assert not set(map("ViewLayer.{}".format, DIAGNOSTIC_PASSES)) & exr.read(tmp_path / "plain.exr").keys()
