# SPDX-License-Identifier: Apache-2.0
"""Hostile frames for the denoiser, every method on every device: what comes out stays numbers, the harm stays where it
was done, and where the input means something the result is that of the float64 reference."""

from __future__ import annotations

import resource

import numpy as np
import pytest

from svgf.denoiser import Denoiser
from svgf.errors import InputError
from svgf.metrics import relative_mse
from svgf.renderer import Renderer
from svgf.settings import METHODS, DenoiseSettings, Settings

from ..scenes import MIRROR, WHITE, build, camera, quad, transform
from ..test_denoise_plus import make_plus_images
from ..test_denoise_stages import run
from ..test_denoiser import HEIGHT, WIDTH, add_noise, make_frame, put_square

TEMPORAL = ("svgf+", "svgf")
# Of colour: svgf+ stores 14 bits of it (core/packing.h), the others float32.
ROUNDING = {"svgf+": 2.0**-12, "svgf": 1e-5, "eaw": 1e-5, "none": 1e-6}


def assert_sound(result):
    for name in ("color", "variance", "history_length"):
        assert np.isfinite(result[name]).all() and (result[name] >= 0.0).all(), name


def denoise_both(device, method, frames, **settings):
    """The last result of the device, and of the float64 reference on the same frames."""
    height, width = frames[0]["depth"].shape
    both = [Denoiser(width, height, each, method, DenoiseSettings(**settings)) for each in (device, "reference")]
    for frame in frames:
        results = [denoiser.denoise(frame) for denoiser in both]
        assert_sound(results[0])
    return results


def assert_agrees(device, method, frames, tolerance, share=1.0, **settings):
    """share: of the pixels that must agree. svgf+ compares samples with limits, and packing may turn what it decides."""
    actual, expected = denoise_both(device, method, frames, **settings)
    scale = np.maximum(expected["color"].max(axis=-1), 1e-20)
    error = np.abs(actual["color"].astype(float) - expected["color"]).max(axis=-1) / scale
    assert (error <= tolerance).mean() >= share, np.quantile(error, [0.5, 0.9, 1.0])
    return actual


# --- Values that are none --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -7.0, 1e38])
@pytest.mark.parametrize("name", ["diffuse", "emission"])
@pytest.mark.parametrize("method", METHODS)
def test_bad_radiance_harms_no_neighbour(device, bad, name, method):
    height, width = 12, 20
    denoiser = Denoiser(width, height, device, method)
    good = make_frame(height, width)
    denoiser.denoise(good)
    frame = make_frame(height, width)
    frame[name][6, 10, 1] = bad
    result = denoiser.denoise(frame)
    assert result["repaired"] == 1
    assert_sound(result)
    assert (result["color"] <= 0.5 * (1.0 + ROUNDING[method])).all()
    assert (np.delete(result["color"].reshape(-1, 3), 6 * width + 10, axis=0) > 0.2).all()
    for _ in range(20 if method in TEMPORAL else 1):  # 0.8^20 = 1 %
        result = denoiser.denoise(good)
    assert result["repaired"] == 0
    # The mean of a still view keeps the 0 that took the value's place, a share of 1 in 22.
    np.testing.assert_allclose(np.delete(result["color"].reshape(-1, 3), 6 * width + 10, axis=0), 0.5, rtol=1e-2)
    np.testing.assert_allclose(result["color"], 0.5, rtol=1.1 / 22 if method == "svgf+" else 1e-2)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 1e38])
@pytest.mark.parametrize("name", ["diffuse_albedo", "normal", "depth", "depth_gradient", "motion"])
@pytest.mark.parametrize("method", METHODS)
def test_bad_guides_harm_no_neighbour(device, bad, name, method):
    if name in ("normal", "depth_gradient", "motion") and np.isfinite(bad):
        pytest.skip("a finite vector is no error")
    # Each component counts, but a surface without depth or normal, and motion, which only some read, count once.
    counts = {"diffuse_albedo": 3, "depth_gradient": 2, "normal": 1, "depth": 1, "motion": int(method in TEMPORAL)}
    # Radiance over the floor of the albedo is a firefly, and it spreads; it must only stay finite.
    tolerance = 1.0 if name == "diffuse_albedo" else max(1e-4, ROUNDING[method])
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    denoiser.denoise(make_frame())
    frame = make_frame()
    frame[name][12, 20] = bad
    result = denoiser.denoise(frame)
    assert result["repaired"] == counts[name]
    assert_sound(result)
    others = np.delete(result["color"].reshape(-1, 3), 12 * WIDTH + 20, axis=0)
    np.testing.assert_allclose(others, 0.5, rtol=tolerance)
    np.testing.assert_allclose(denoiser.denoise(make_frame())["color"], 0.5, rtol=tolerance)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 1e38])
@pytest.mark.parametrize("image", ["color", "moments"])
def test_bad_history_of_svgf_plus_is_gone_a_frame_later(device, image, bad):
    """Packed, history is numbers whatever is put into it, and what does not read that pixel stays the same. Of svgf's
    tests/test_denoise_stages.py asks the same."""
    if device.name == "reference":
        pytest.skip("its history is not packed")
    images = make_plus_images(np.random.default_rng(42))
    images["motion"] = np.zeros_like(images["motion"])
    spoilt = {name: values.copy() for name, values in images.items()}
    y, x = (size // 2 for size in images["depth"].shape)
    spoilt[f"hist_{image}0"][y, x] = bad
    good, _ = run(device, "svgf+", "temporal", images, history_fix_radius=1)
    result, _ = run(device, "svgf+", "temporal", spoilt, history_fix_radius=1)
    rows, columns = np.ogrid[: images["depth"].shape[0], : images["depth"].shape[1]]
    untouched = (abs(rows - y) > 3) | (abs(columns - x) > 3)
    for name, values in result.items():
        assert np.isfinite(values).all(), name
        np.testing.assert_array_equal(values[untouched], good[name][untouched], err_msg=name)
    assert (result["variance0"] >= 0.0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -0.5, 1.5])
def test_bad_roughness_counts_as_a_mirrors(device, bad):
    frames = [make_frame() for _ in range(2)]
    for frame in frames:
        frame["specular"], frame["specular_albedo"] = frame["diffuse"], frame["diffuse_albedo"]
        frame["roughness"] = np.full((HEIGHT, WIDTH), 0.3, np.float32)
    frames[1]["roughness"][12, 20] = bad
    result = assert_agrees(device, "svgf+", frames, 1e-2)
    assert result["repaired"] == 1
    np.testing.assert_allclose(result["color"], 1.0, rtol=ROUNDING["svgf+"])


@pytest.mark.parametrize("method", METHODS)
def test_everything_bad_at_once_stays_finite(device, method):
    rng = np.random.default_rng(8)
    values = np.float32([0.0, -0.0, 1e-45, 1e-30, 1.0, -1.0, 65504.0, 1e18, 3.4e38, -3.4e38, np.nan, np.inf, -np.inf])
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(4):
        frame = {name: rng.choice(values, image.shape) for name, image in make_frame().items()}
        frame["object_id"] = rng.integers(-1, 3, (HEIGHT, WIDTH)).astype(np.int32)
        result = denoiser.denoise(frame)
        assert_sound(result)
        assert result["repaired"] > 0
    for _ in range(3):
        assert_sound(denoiser.denoise(make_frame()))


# --- Numbers at the ends of their ranges -----------------------------------------------------------------------------


@pytest.mark.parametrize("radiance", [1e-12, 1e6, 1e12])
@pytest.mark.parametrize("method", METHODS)
def test_any_brightness(device, method, radiance):
    """A second moment of 1e12 and more, where half precision ends at 65504; and light far below what it resolves."""
    rng = np.random.default_rng(9)
    frames = [add_noise(make_frame(radiance=radiance), rng, 0.5) for _ in range(6)]
    result = assert_agrees(device, method, frames, 0.02, share=0.97)
    assert result["color"].mean(dtype=float) == pytest.approx(0.5 * radiance, rel=0.05)
    assert result["repaired"] == 0


@pytest.mark.parametrize("method", TEMPORAL)
def test_the_variance_of_a_bright_constant_does_not_cancel(device, method):
    """1e4 with noise of 1e-3 for 10,000 frames: E[x^2] - E[x]^2 would be off by 1e8 roundings of float32, about 10."""
    frames = 200 if device.name == "reference" else 10_000
    rng = np.random.default_rng(10)
    height, width = 8, 12
    denoiser = Denoiser(width, height, device, method, DenoiseSettings(levels=0))
    frame = make_frame(height, width)
    noisy = [
        np.repeat((0.5 * (1e4 + 1e-3 * rng.normal(size=(height, width, 1)))), 3, axis=-1).astype(np.float32)
        for _ in range(16)
    ]
    for index in range(frames):
        frame["diffuse"] = noisy[index % 16]
        result = denoiser.denoise(frame)
    assert_sound(result)
    np.testing.assert_allclose(result["color"], 0.5e4, rtol=ROUNDING[method])
    # No weighted mean of squared deviations exceeds the largest. float32 holds 0.5e4 to 2^-12, the packed colours of
    # svgf+ to 2^-15.
    largest = np.abs(np.array(noisy) - 0.5e4).max() + 2.0**-12
    if method == "svgf+" and device.name != "reference":
        largest = 0.5e4 * 2.0**-15
    assert (result["variance"] <= largest**2).all()


@pytest.mark.parametrize("albedo", [0.0, 1e-8, 5.0, 1e4])
@pytest.mark.parametrize("method", METHODS)
def test_any_albedo_loses_no_light(device, method, albedo):
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    frame = make_frame()
    frame["diffuse_albedo"][:] = albedo
    for _ in range(4):
        result = denoiser.denoise(frame)
        assert_sound(result)
    np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])
    frame["diffuse"][:] = 0.0
    denoiser.reset("nothing is lit")
    np.testing.assert_array_equal(denoiser.denoise(frame)["color"], 0.0)


@pytest.mark.parametrize("depth", [1e-3, 1.0, 1e7, 1e9])
@pytest.mark.parametrize("method", METHODS)
def test_any_depth(device, method, depth):
    """The same picture at any distance: a plane that is seen at a slant, and a nearer square in front of it."""

    def make(rng):
        frame = add_noise(put_square(make_frame(), 14), rng, 0.5)
        slope = np.float32(0.02)
        frame["depth"] *= (1.0 + slope * np.arange(WIDTH, dtype=np.float32)) * np.float32(depth / 10.0)
        frame["depth_gradient"][..., 0] = frame["depth"] * slope / (1.0 + slope * np.arange(WIDTH, dtype=np.float32))
        return frame

    rng = np.random.default_rng(11)
    frames = [make(rng) for _ in range(5)]
    result = assert_agrees(device, method, frames, 0.02, share=0.95)
    if method in TEMPORAL:  # svgf+ gives up what chance has moved too far
        assert (result["history_length"] > 4.5).mean() >= (1.0 if method == "svgf" else 0.95)


@pytest.mark.parametrize("gradient", [0.0, 1e-30, 1e10, np.inf])
@pytest.mark.parametrize("method", METHODS)
def test_any_depth_gradient(device, method, gradient):
    frame = make_frame()
    frame["depth_gradient"][:] = gradient
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(3):
        result = denoiser.denoise(frame)
        assert_sound(result)
        np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])
    assert result["repaired"] == (2 * HEIGHT * WIDTH if np.isinf(gradient) else 0)


@pytest.mark.parametrize("method", METHODS)
def test_nothing_but_sky(device, method):
    frame = make_frame()
    for name in ("diffuse", "diffuse_albedo", "normal", "object_id"):
        frame[name][:] = 0
    frame["depth"][:] = 1e10
    frame["emission"][:] = [0.1, 0.2, 4.0]
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(3):
        result = denoiser.denoise(frame)
        assert_sound(result)
        np.testing.assert_allclose(result["color"], frame["emission"], rtol=4.0 * ROUNDING[method])
        assert not result["history_length"].any() and not result["variance"].any()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (2, 2), (33, 17), (2, 65)])
@pytest.mark.parametrize("method", METHODS)
def test_any_size(device, size, method):
    width, height = size
    denoiser = Denoiser(width, height, device, method)
    for count in range(1, 4):
        result = denoiser.denoise(make_frame(height, width))
        assert result["color"].shape == (height, width, 3)
        assert result["variance"].shape == result["history_length"].shape == (height, width)
        np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])
        assert (result["history_length"] == (count if method in TEMPORAL else 1)).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_resolution_that_changes_is_refused_and_harms_nothing(device, method):
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    denoiser.denoise(make_frame())
    with pytest.raises(InputError, match="has the shape"):
        denoiser.denoise(make_frame(HEIGHT + 1, WIDTH))
    result = denoiser.denoise(make_frame())
    np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])
    assert (result["history_length"] == (2 if method in TEMPORAL else 1)).all()


def test_a_renderer_goes_on_where_the_resolution_changes(device):
    scene = build([(quad(4.0), transform((0, 0, -3)), [WHITE])], camera((0, 0, 3), (0, 0, -3)))
    renderer = Renderer(Settings(24, 14), device)
    renderer.render(scene)
    assert renderer.render(scene).reset == ""
    renderer.settings = Settings(31, 9)
    frame = renderer.render(scene)
    assert frame.reset == "" and frame.color.shape == (9, 31, 3)
    assert np.isfinite(frame.color).all() and (frame.history_length[frame.object_id > 0] > 1).mean() > 0.9


# --- Motion ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion", [41.0, -41.0, 1e6, -1e6, 3e9, -1e30, np.nan])
@pytest.mark.parametrize("method", TEMPORAL)
def test_motion_that_leads_nowhere_means_no_history(device, method, motion):
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(3):
        denoiser.denoise(make_frame(radiance=8.0))
    frame = make_frame(radiance=1.0)
    frame["motion"][..., 0] = motion
    result = denoiser.denoise(frame)
    assert_sound(result)
    assert (result["history_length"] == 1.0).all()
    np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])
    assert result["repaired"] == (HEIGHT * WIDTH if np.isnan(motion) else 0)


@pytest.mark.parametrize("method", TEMPORAL)
def test_what_stands_still_keeps_its_bits(device, method):
    """A picture that differs from pixel to pixel and not over time is not resampled: the same bits in every frame."""
    rng = np.random.default_rng(12)
    frame = make_frame()
    frame["diffuse"] *= rng.gamma(1.0, 1.0, frame["diffuse"].shape).astype(np.float32)
    # No two pixels show the same surface: none begins with the mean of its neighbours.
    frame["object_id"] = np.arange(1, WIDTH * HEIGHT + 1, dtype=np.int32).reshape(HEIGHT, WIDTH)
    settings = DenoiseSettings(levels=0, firefly_limit=1e9, history_clamp=1e6, antialias_frames=1.0, alpha=0.0)
    denoiser = Denoiser(WIDTH, HEIGHT, device, method, settings)
    first = denoiser.denoise(frame)["color"]
    for count in range(2, 40):
        result = denoiser.denoise(frame)
        assert (result["history_length"] == count).all()
        if method == "svgf+":
            np.testing.assert_array_equal(result["color"], first)
        else:  # (1 - alpha) x + alpha x rounds
            np.testing.assert_allclose(result["color"], first, rtol=1e-5)


@pytest.mark.parametrize("method", TEMPORAL)
def test_a_camera_that_turns_around_leaves_no_ghost(device, method):
    """180 degrees: every point was behind the camera, where projection mirrors it."""
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(4):
        denoiser.denoise(make_frame(radiance=50.0))
    frame = make_frame(radiance=1.0)
    frame["normal"][:] = [0.0, 0.0, -1.0]
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    frame["motion"][..., 0], frame["motion"][..., 1] = WIDTH - 1 - 2.0 * x, HEIGHT - 1 - 2.0 * y
    frame["motion"][..., 2] = -20.0
    result = denoiser.denoise(frame)
    assert (result["history_length"] == 1.0).all()
    np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])


@pytest.mark.parametrize("kind", ["dolly", "zoom"])
@pytest.mark.parametrize("method", TEMPORAL)
def test_coming_nearer_keeps_the_history(device, method, kind):
    """2 % a frame along a floor that recedes; nothing is hidden, so 95 % of the pixels go on."""
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    position = np.stack([x, y], axis=-1)
    center = (np.float64([WIDTH, HEIGHT]) - 1.0) / 2.0
    focal, height_above, horizon = 40.0, 1.0, -12.0
    for step in range(8):
        frame = make_frame()
        if kind == "dolly":
            depth = focal * height_above / (y - horizon + 2.0)
            previous_depth = depth + 0.02
            back = center + (position - center) * (depth / previous_depth)[..., None]
            # The floor's rows are measured from the horizon, which the camera moves towards.
            back[..., 1] = horizon - 2.0 + (y - horizon + 2.0) * depth / previous_depth
            gradient = -depth * depth / (focal * height_above)
        else:
            scale = 1.02**step
            depth = focal * scale * height_above / (y - center[1] + (center[1] - horizon + 2.0) * scale)
            previous_depth = depth
            back = center + (position - center) / 1.02
            gradient = -depth * depth / (focal * scale * height_above)
        frame["depth"] = depth.astype(np.float32)
        frame["depth_gradient"][..., 1] = gradient
        moved = [back - position, (previous_depth - depth)[..., None]]
        frame["motion"] = np.concatenate(moved, axis=-1).astype(np.float32)
        frame["normal"][:] = [0.0, 1.0, 0.0]
        result = denoiser.denoise(frame)
    assert (result["history_length"] > 7.5).mean() >= 0.95


@pytest.mark.parametrize("method", TEMPORAL)
def test_a_dropped_frame_leaves_no_ghost(device, method):
    """The square moved twice as far as its motion says, because a frame is missing: light of neither side stays on the
    other."""
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    wall = make_frame()
    for step in range(4):
        frame = put_square(wall, 4 + 2 * step)
        frame["motion"][frame["object_id"] == 2, 0] = -2.0 if step else 0.0
        denoiser.denoise(frame)
    frame = put_square(wall, 14)
    frame["motion"][frame["object_id"] == 2, 0] = -2.0
    result = denoiser.denoise(frame)
    # Edges are resolved over a few frames; inside and outside of them nothing may be left.
    inside, outside = np.s_[9:15, 15:23], np.s_[9:15, 8:13]
    np.testing.assert_allclose(result["color"][inside], 2.5, rtol=1e-3)
    np.testing.assert_allclose(result["color"][outside], 0.5, rtol=1e-3)


# --- Surfaces that come and go ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_thin_wires_neither_fade_nor_smear(device, method):
    """One pixel wide, bright, in front of a wall, and a pixel further in every frame."""
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for step in range(12):
        frame = make_frame()
        column = 8 + step
        frame["diffuse"][:, column], frame["depth"][:, column], frame["object_id"][:, column] = 5.0, 4.0, 2
        frame["motion"][:, column, 0] = -1.0
        result = denoiser.denoise(frame)
        assert_sound(result)
    wire, wall = result["color"][:, column], np.delete(result["color"], [column - 1, column, column + 1], axis=1)
    np.testing.assert_allclose(wall, 0.5, rtol=max(1e-3, ROUNDING[method]))
    np.testing.assert_allclose(wire, 5.0, rtol=max(1e-3, ROUNDING[method]))


@pytest.mark.parametrize("method", METHODS)
def test_checkerboard_normals_keep_their_sides_apart(device, method):
    """Neighbours face opposite ways, one way lit ten times as brightly as the other."""
    rng = np.random.default_rng(13)
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    odd = (x + y) % 2 == 1
    for _ in range(8):
        frame = make_frame()
        frame["normal"][odd] = [1.0, 0.0, 0.0]
        frame["diffuse"][odd] *= 10.0
        result = denoiser.denoise(add_noise(frame, rng, 0.3))
        assert_sound(result)
    inner = np.zeros(odd.shape, bool)
    inner[2:-2, 2:-2] = True
    assert result["color"][odd & inner].mean() == pytest.approx(5.0, rel=0.1)
    assert result["color"][~odd & inner].mean() == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_flickering_ids_lose_history_and_no_light(device, method):
    """Every frame numbers its objects anew: no pixel has history, none is dark or bright for it."""
    rng = np.random.default_rng(14)
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for step in range(6):
        frame = make_frame()
        frame["object_id"][:] = 1 + step
        frame["object_id"][:, WIDTH // 2 :] = 100 + step
        result = denoiser.denoise(add_noise(frame, rng, 0.5))
        assert_sound(result)
        assert (result["history_length"] == 1.0).all()
    assert result["color"].mean() == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_ids_of_noise_stay_finite(device, method):
    """A new random id for every pixel of every frame: nothing can be shared, and the frame stays what it is."""
    rng = np.random.default_rng(15)
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for _ in range(4):
        frame = make_frame()
        frame["object_id"] = rng.integers(1, 2**31 - 1, (HEIGHT, WIDTH)).astype(np.int32)
        result = denoiser.denoise(frame)
        assert_sound(result)
    np.testing.assert_allclose(result["color"], 0.5, rtol=ROUNDING[method])


# --- For a long time -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", TEMPORAL)
def test_ten_thousand_frames(device, method):
    """A view that pans to and fro: memory stays what it was, and the error at the end that of the beginning."""
    if device.name == "reference":
        pytest.skip("ten thousand frames in numpy take ten minutes")
    height, width = 12, 20
    rng = np.random.default_rng(16)
    denoiser = Denoiser(width, height, device, method)
    truth = make_frame(height, width)
    y, x = np.mgrid[:height, :width]
    truth["diffuse"] *= (1.0 + 0.5 * np.sin(0.4 * y))[..., None].astype(np.float32)
    noise = [rng.gamma(2.0, 0.5, (height, width, 1)).astype(np.float32) for _ in range(61)]
    errors = {"begin": [], "end": []}
    for index in range(10_000):
        frame = dict(truth)
        frame["diffuse"] = truth["diffuse"] * noise[index % len(noise)]
        frame["motion"] = np.full((height, width, 3), np.float32([0.3 if index % 40 < 20 else -0.3, 0.0, 0.0]))
        result = denoiser.denoise(frame)
        if 500 <= index < 1500 or index >= 9000:
            errors["begin" if index < 1500 else "end"].append(relative_mse(result["color"], truth["diffuse"]))
        if index == 500:
            buffers, resident = denoiser.buffers, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert_sound(result)
    assert denoiser.buffers == buffers
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident < 4096  # KiB
    # The same 61 samples come again and again: both means are of the same values.
    assert np.mean(errors["end"]) == pytest.approx(np.mean(errors["begin"]), rel=0.1)


def test_mirrors_that_turn_stay_finite(device):
    """A mirror that flips between two frames, rendered and denoised: every guide changes at once."""
    renderer = Renderer(Settings(24, 14), device)
    before = transform()
    for step in range(4):
        turned = transform(linear=np.diag([1.0, (-1.0) ** step, (-1.0) ** step]))
        view = camera((0, -2, 4), (0, 0, 0))
        scene = build([(quad(4.0), turned, [MIRROR], before)], view, frame=step + 1)
        before = turned
        frame = renderer.render(scene)
        assert np.isfinite(frame.color).all() and (frame.color >= 0.0).all()
