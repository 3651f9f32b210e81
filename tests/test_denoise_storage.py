# SPDX-License-Identifier: Apache-2.0
"""The fast filter and its packed images: what they keep of the float64 values, what they cost, the same bits twice."""

from __future__ import annotations

import math

import numpy as np
import pytest

from svgf.denoiser import Denoiser
from svgf.reference.denoiser import Denoiser as ReferenceDenoiser
from svgf.settings import DenoiseSettings

from .test_denoise_stages import GUIDES, HEIGHT, WIDTH, as_reference_images, light, make_images, run

# Of a channel, as a share of the largest one of its pixel (core/packing.h), with float32's own rounding.
COLOR_ERROR = 2.0**-14
DEVIATION_ERROR = 2.0**-8
# Chord between unit vectors, of 12 bits for each coordinate of the octahedron.
NORMAL_ERROR = 8e-4
# svgf+ as a plain mean.
NO_LIMITS = {"firefly_limit": 1e9, "history_clamp": 1e6, "change_threshold": 1e6, "antialias_frames": 1.0}


@pytest.fixture
def device(device):
    if device.name == "reference":
        pytest.skip("the reference keeps float64")
    return device


def assert_colors_agree(actual, expected, error=COLOR_ERROR):
    largest = expected.max(axis=-1, keepdims=True)
    assert (np.abs(actual - expected) <= error * largest + 1e-18).all()


# --- What is kept ----------------------------------------------------------------------------------------------------


def test_demodulated_images_keep_their_values(device):
    rng = np.random.default_rng(1)
    images = make_images(rng)
    # Over 30 decades, channels far apart, and the extremes.
    images["diffuse"] *= 10.0 ** rng.uniform(-15.0, 15.0, (HEIGHT, WIDTH, 1)).astype(np.float32)
    images["specular"] *= 10.0 ** rng.uniform(-3.0, 0.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    images["diffuse"][3, 4], images["diffuse"][3, 5] = 1e15, 0.0
    images["depth"][5, 6], images["depth"][5, 7] = 1e-3, 1e7
    images["depth_gradient"][6, 7] = [1e10, -1e-10]
    images["normal"][7, :] = rng.normal(size=(WIDTH, 3))
    images["normal"][7, :6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    inputs = {name: images[name] for name in (*GUIDES, "diffuse", "diffuse_albedo", "specular", "specular_albedo")}
    oracle = ReferenceDenoiser(None, WIDTH, HEIGHT, "svgf", {})
    expected = oracle.stage("demodulate", as_reference_images(inputs))
    actual, repaired = run(device, "svgf+", "demodulate", inputs)
    assert repaired == oracle.repaired()
    surface = expected["object_id"] != 0
    for signal in ("illumination0", "illumination1"):
        assert_colors_agree(actual[signal], expected[signal])
    np.testing.assert_allclose(actual["depth"], expected["depth"], rtol=2.0**-18)
    np.testing.assert_allclose(actual["depth_gradient"][surface], expected["depth_gradient"][surface], rtol=2.0**-9)
    chord = np.linalg.norm(actual["normal"] - expected["normal"], axis=-1)
    assert chord[surface].max() < NORMAL_ERROR
    np.testing.assert_allclose(np.linalg.norm(actual["normal"][surface], axis=-1), 1.0, atol=1e-6)
    np.testing.assert_array_equal(actual["object_id"] != 0, surface)


def test_objects_stay_apart(device):
    """Ids are kept in 16 bits: 0 stays 0, and small numbers do not collide."""
    images = make_images(np.random.default_rng(2), 1)
    images["object_id"] = np.arange(HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    images["depth"][:] = 5.0
    images["normal"][:] = [0.0, 0.0, 1.0]
    inputs = {name: images[name] for name in (*GUIDES, "diffuse", "diffuse_albedo")}
    actual, _ = run(device, "svgf+", "demodulate", inputs)
    assert actual["object_id"][0, 0] == 0
    assert len(np.unique(actual["object_id"])) == HEIGHT * WIDTH


def test_a_long_mean_of_skewed_samples_has_no_bias(device):
    """One sample in 20 is bright. With rounding to nearest, the many small steps down of a 16-bit mean would be lost
    and the few large ones up kept: after 1500 frames it would be several times too large."""
    rng = np.random.default_rng(4)
    images = make_images(rng, 1)
    for prefix in ("", "prev_"):
        images[f"{prefix}object_id"][:], images[f"{prefix}depth"][:] = 1, 5.0
        images[f"{prefix}depth_gradient"][:], images[f"{prefix}normal"][:] = 0.0, [0.0, 0.0, 1.0]
    images["motion"][:] = 0.0
    native = device.denoiser(WIDTH, HEIGHT, "svgf+", {**NO_LIMITS, "levels": 0})
    frame = {name: images[name] for name in ("normal", "depth_gradient", "motion")}
    frame["depth"] = images["depth"]
    frame["object_id"] = images["object_id"].astype(np.int32)
    total = np.zeros((HEIGHT, WIDTH))
    frames = 1500
    for index in range(frames):
        bright = rng.random((HEIGHT, WIDTH)) < 0.05
        frame["color"] = np.repeat(np.where(bright, 20.0, 0.01).astype(np.float32)[..., None], 3, axis=-1)
        total += frame["color"][..., 0]
        result = native.denoise({n: device.upload(np.ascontiguousarray(i)) for n, i in frame.items()}, reset=index == 0)
    color = device.to_numpy(result["color"])[..., 0].astype(float)
    # Up to 2^-15 is rounded off in frame k, which weighs k / N in the end: 2.3 % if all went one way.
    np.testing.assert_allclose(color, total / frames, rtol=0.5 * frames * 2.0**-15)
    assert color.mean() == pytest.approx(total.mean() / frames, rel=2e-3)
    # Frames are counted in 9 bits, rounded at random.
    counted = device.to_numpy(result["history_length"]).astype(float)
    assert counted.mean() == pytest.approx(frames, rel=0.05)
    # The variance of the mean; that of these samples strays from it by 0.5 %.
    variance = device.to_numpy(result["variance"]).astype(float) * counted
    assert variance.mean() == pytest.approx(0.05 * 0.95 * 19.99**2, rel=0.02)


# --- The filter ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, 1, 2, 3, 4])
def test_fast_atrous_is_its_formula(device, level):
    """3x3 binomial, exp(sigma_n (cosine - 1)) for Eq. 4, a Gaussian for Eq. 5 over the larger of both variances.
    The centre's is prefiltered at the first level; the tap's counts less the glossier the tap is."""
    images = make_images(np.random.default_rng(5), 2)
    actual, _ = run(device, "svgf+", "atrous", images, level)
    for signal in (0, 1):
        _assert_atrous_is_its_formula(images, actual, signal, level)


def _assert_atrous_is_its_formula(images, actual, signal, level):
    settings = DenoiseSettings()
    color, variance = images[f"color{signal}"].astype(float), images[f"variance{signal}"].astype(float)
    # Mirror-like up to a roughness of 0.1, matte from 0.4 on, in thirds.
    matte = np.round(np.clip((images["roughness"].astype(float) - 0.1) / 0.3, 0.0, 1.0) * 3.0) / 3.0
    matte = matte if signal == 1 else np.ones_like(matte)
    surface = images["object_id"] != 0
    kernel = {-1: 0.25, 0: 0.5, 1: 0.25}
    expected_color, expected_variance = color.copy(), np.zeros_like(variance)
    for y, x in zip(*np.nonzero(surface), strict=True):
        blurred = norm = 0.0
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                v, u = y + j * 2**level, x + i * 2**level
                if 0 <= v < HEIGHT and 0 <= u < WIDTH and surface[v, u]:
                    blurred += kernel[i] * kernel[j] * variance[v, u]
                    norm += kernel[i] * kernel[j]
        c_sum, v_sum, w_sum = np.zeros(3), 0.0, 0.0
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                v, u = y + j * 2**level, x + i * 2**level
                if not (0 <= v < HEIGHT and 0 <= u < WIDTH and surface[v, u]):
                    continue
                z_p, z_q = float(images["depth"][y, x]), float(images["depth"][v, u])
                explained = abs(float(images["depth_gradient"][y, x] @ np.float32([u - x, v - y])))
                cosine = float(images["normal"][y, x].astype(float) @ images["normal"][v, u].astype(float))
                difference = abs(light(color[y, x]) - light(color[v, u]))
                exponent = -abs(z_p - z_q) / (settings.plus_sigma_depth * explained + 1e-3 * z_p)
                exponent += settings.plus_sigma_normal * (cosine - 1.0) if (i, j) != (0, 0) else 0.0
                own = blurred / norm if level == 0 else variance[y, x]
                larger = max(own, matte[v, u] * variance[v, u])
                exponent -= difference**2 / (settings.plus_sigma_luminance**2 * larger + 1e-20)
                w = kernel[i] * kernel[j] * math.exp(exponent)
                c_sum, v_sum, w_sum = c_sum + w * color[v, u], v_sum + w * w * variance[v, u], w_sum + w
        expected_color[y, x], expected_variance[y, x] = c_sum / w_sum, v_sum / w_sum**2
    # Weights feel the rounding of normals (1e-4 rad times sigma_n times the angle), gradients and deviations.
    assert_colors_agree(actual[f"color{signal}"], expected_color, error=0.02)
    errors = np.abs(actual[f"color{signal}"] - expected_color) / expected_color.max(axis=-1, keepdims=True)
    assert errors.mean() < 1e-3
    np.testing.assert_allclose(actual[f"variance{signal}"], expected_variance, rtol=0.05, atol=1e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (33, 17), (2, 65), (70, 40)])
@pytest.mark.parametrize("levels", [0, 1, 2, 3, 4, 5, 8])
def test_constant_radiance_is_a_fixed_point_at_any_size(device, size, levels):
    """Also that no number of levels reads the colour image while it is written."""
    width, height = size
    frame = {
        "color": np.full((height, width, 3), 1.5, np.float32),
        "normal": np.broadcast_to(np.float32([0, 0, 1]), (height, width, 3)).copy(),
        "depth": np.full((height, width), 5.0, np.float32),
        "motion": np.zeros((height, width, 3), np.float32),
    }
    for method in ("svgf", "svgf+"):
        native = device.denoiser(width, height, method, {"levels": levels})
        for index in range(3):
            result = native.denoise({n: device.upload(i) for n, i in frame.items()}, reset=False)
            np.testing.assert_allclose(device.to_numpy(result["color"]), 1.5, rtol=1e-4)
            np.testing.assert_array_equal(device.to_numpy(result["history_length"]), index + 1)


# --- What it costs, and repeats --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "limits"), [("svgf+", (48, 72)), ("svgf", (112, 160))])
def test_memory(device, method, limits):
    width, height = 64, 32
    native = device.denoiser(width, height, method, {})
    rng = np.random.default_rng(6)
    images = make_images(rng, 2, height, width)
    names = (*GUIDES, "motion", "diffuse", "diffuse_albedo", "specular", "specular_albedo")
    frame = {name: images[name] for name in names} | {"object_id": images["object_id"].astype(np.int32)}
    one = {name: image for name, image in frame.items() if not name.startswith("specular")}
    for inputs, limit in zip((one, frame), limits, strict=True):
        native.denoise({n: device.upload(i) for n, i in inputs.items()}, reset=False)
        buffers = dict(native.buffers())
        assert buffers.pop("repair counter") == 4
        assert buffers.pop("firefly counter", 16) == 16
        assert sum(buffers.values()) <= limit * width * height


@pytest.mark.parametrize("method", ["svgf", "svgf+"])
def test_same_inputs_same_bits(device, method):
    results = []
    for _ in range(2):
        rng = np.random.default_rng(7)
        native = device.denoiser(WIDTH, HEIGHT, method, {})
        for _ in range(4):
            images = make_images(rng)
            names = (*GUIDES, "motion", "diffuse", "diffuse_albedo", "specular", "specular_albedo", "emission")
            frame = {name: images[name] for name in names} | {"object_id": images["object_id"].astype(np.int32)}
            result = native.denoise({n: device.upload(i) for n, i in frame.items()}, reset=False)
        results.append({name: device.to_numpy(image).tobytes() for name, image in result.items()})
    assert results[0] == results[1]


def test_buffers_are_told():
    denoiser = Denoiser(64, 32, "cpu")
    assert sum(denoiser.buffers.values()) >= 64 * 32 * 40
