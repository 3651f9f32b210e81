# SPDX-License-Identifier: Apache-2.0
"""Each stage of the denoiser alone: against the papers' formulas written out pixel by pixel, and every device against
the float64 reference on the same inputs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from svgf.reference.denoiser import Denoiser as ReferenceDenoiser
from svgf.settings import DenoiseSettings

HEIGHT, WIDTH = 17, 33
GUIDES = ("normal", "depth", "depth_gradient", "object_id")


def make_guides(rng, height=HEIGHT, width=WIDTH):
    """A tilted plane, a nearer box in front of it that is bent a little, and background in a corner."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    depth = 8.0 + 0.05 * x - 0.03 * y
    gradient = np.broadcast_to([0.05, -0.03], (height, width, 2)).copy()
    normal = np.broadcast_to([0.0, 0.0, 1.0], (height, width, 3)).copy()
    object_id = np.ones((height, width), np.int32)
    box = (x > width * 0.3) & (x < width * 0.7) & (y > height * 0.2) & (y < height * 0.8)
    depth[box] = 5.0 + 0.02 * y[box]
    gradient[box] = [0.0, 0.02]
    normal[box] = [0.6, 0.0, 0.8]
    object_id[box] = 2
    normal += rng.normal(0.0, 0.03, normal.shape)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    background = (x < width * 0.2) & (y < height * 0.25)
    depth[background], object_id[background] = 1e10, 0
    gradient[background], normal[background] = 0.0, 0.0
    return {"normal": normal, "depth": depth, "depth_gradient": gradient, "object_id": object_id}


def make_images(rng, signals=2, height=HEIGHT, width=WIDTH):
    """What a stage of `signals` signals may ask for, all of it good."""
    images = make_guides(rng, height, width)
    images |= {f"prev_{name}": image for name, image in make_guides(rng, height, width).items()}
    images["motion"] = rng.normal(0.0, 0.8, (height, width, 3)) * [1.0, 1.0, 0.02]
    images["hist_length"] = rng.integers(1, 9, (height, width)).astype(float)
    images["history_length"] = np.where(images["object_id"] == 0, 0.0, rng.integers(1, 7, (height, width)))
    for s in range(signals):
        for name in ("illumination", "color", "hist_color"):
            images[f"{name}{s}"] = rng.gamma(0.7, 1.5, (height, width, 3))
        images[f"variance{s}"] = rng.gamma(0.7, 0.5, (height, width))
        for name in ("moments", "hist_moments"):
            images[f"{name}{s}"] = rng.gamma(1.0, 1.0, (height, width, 2)) * (images["object_id"] != 0)[..., None]
    for name in ("diffuse", "specular")[:signals]:
        images[name] = rng.gamma(0.5, 1.0, (height, width, 3))
        images[f"{name}_albedo"] = rng.uniform(0.0, 1.0, (height, width, 3))
    images["roughness"] = rng.uniform(0.0, 0.5, (height, width))
    images["emission"] = rng.gamma(0.3, 1.0, (height, width, 3))
    return {name: np.asarray(image, np.float32) for name, image in images.items()}


def as_reference_images(images):
    return {n: image.astype(np.int32 if n.endswith("object_id") else np.float64) for n, image in images.items()}


def run(device, method, stage, images, level=0, **settings):
    height, width = images["depth"].shape
    denoiser = device.denoiser(width, height, method, settings)
    arrays = as_reference_images(images) if device.name == "reference" else images
    result = denoiser.stage(stage, arrays, level)
    return {name: np.asarray(image, np.float64) for name, image in result.items()}, denoiser.repaired()


def assert_agrees(device, method, stage, images, level=0, **settings):
    """The device gives the reference's images; returns them."""
    height, width = images["depth"].shape
    oracle = ReferenceDenoiser(None, width, height, method, settings)
    expected = oracle.stage(stage, as_reference_images(images), level)
    actual, repaired = run(device, method, stage, images, level, **settings)
    assert repaired == oracle.repaired()
    assert expected.keys() <= actual.keys()
    for name, image in expected.items():
        scale = np.abs(image)[image < 1e9].max(initial=1e-6)
        np.testing.assert_allclose(actual[name], image, rtol=1e-4, atol=1e-6 * scale, err_msg=name)
    return actual


def without(images, *names):
    return {name: image for name, image in images.items() if name not in names}


# --- Against the reference -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signals", [1, 2])
def test_demodulate_agrees(device, signals):
    images = make_images(np.random.default_rng(1), signals)
    images["diffuse"][3, 4] = [np.nan, np.inf, -1.0]
    images["diffuse"][5, 6, 0] = 1e38
    images["diffuse_albedo"][7, 8, 1] = np.nan
    images["diffuse_albedo"][9, 9] = 0.0
    images["normal"][10, 20, 2] = np.nan
    images["depth"][11, 21] = np.inf
    images["depth_gradient"][12, 22, 0] = np.nan
    images["depth_gradient"][12, 23, 0] = 1e30
    inputs = {name: images[name] for name in (*GUIDES, "diffuse", "diffuse_albedo")}
    if signals == 2:
        inputs |= {name: images[name] for name in ("specular", "specular_albedo")}
    actual, repaired = run(device, "svgf", "demodulate", inputs)
    assert_agrees(device, "svgf", "demodulate", inputs)
    assert repaired == 8
    assert all(np.isfinite(image).all() for image in actual.values())
    assert actual["illumination0"].min() >= 0.0
    assert actual["object_id"][10, 20] == 0 and actual["object_id"][11, 21] == 0


def test_demodulate_direct_and_indirect_divide_by_both_albedos(device):
    images = make_images(np.random.default_rng(2))
    inputs = {name: images[name] for name in (*GUIDES, "diffuse_albedo", "specular_albedo")}
    inputs |= {"direct": images["diffuse"], "indirect": images["specular"]}
    actual = assert_agrees(device, "svgf", "demodulate", inputs)
    divisor = np.maximum(images["diffuse_albedo"].astype(float) + images["specular_albedo"], 1e-3)
    np.testing.assert_allclose(actual["illumination1"], images["specular"] / divisor, rtol=1e-5)


def test_depth_gradient_from_differences_is_the_plane_s(device):
    images = make_images(np.random.default_rng(3), 1)
    inputs = {name: images[name] for name in ("normal", "depth", "object_id", "diffuse", "diffuse_albedo")}
    actual = assert_agrees(device, "svgf", "demodulate", inputs)
    np.testing.assert_allclose(actual["depth_gradient"], images["depth_gradient"], atol=2e-5)


@pytest.mark.parametrize("signals", [1, 2])
@pytest.mark.parametrize("channels", [2, 3])
def test_temporal_agrees(device, signals, channels):
    images = make_images(np.random.default_rng(4), signals)
    images["motion"] = images["motion"][..., :channels].copy()
    actual = assert_agrees(device, "svgf", "temporal", images)
    assert (actual["history_length"] > 1.0).any() and (actual["history_length"] == 1.0).any()
    assert (actual["moments0"][..., 1] >= 0.0).all()


def test_temporal_without_history_keeps_the_frame(device):
    images = make_images(np.random.default_rng(5))
    images = {name: image for name, image in images.items() if not name.startswith(("prev_", "hist_"))}
    actual = assert_agrees(device, "svgf", "temporal", images)
    np.testing.assert_array_equal(actual["color0"], images["illumination0"].astype(float))
    np.testing.assert_array_equal(actual["history_length"], images["object_id"] != 0)


@pytest.mark.parametrize("signals", [1, 2])
def test_variance_agrees(device, signals):
    actual = assert_agrees(device, "svgf", "variance", make_images(np.random.default_rng(6), signals))
    assert (actual["variance0"] >= 0.0).all()


@pytest.mark.parametrize("signals", [1, 2])
@pytest.mark.parametrize("level", range(5))
def test_atrous_agrees(device, signals, level):
    assert_agrees(device, "svgf", "atrous", make_images(np.random.default_rng(7), signals), level)


@pytest.mark.parametrize("signals", [1, 2])
@pytest.mark.parametrize("level", range(5))
def test_edge_avoiding_agrees(device, signals, level):
    images = make_images(np.random.default_rng(8), signals)
    images["window"] = np.array([-0.5, 0.5, -0.3, 0.28], np.float32)
    assert_agrees(device, "eaw", "atrous", images, level)


@pytest.mark.parametrize("signals", [1, 2])
def test_modulate_agrees(device, signals):
    images = make_images(np.random.default_rng(9), signals)
    images["emission"][2, 3] = [np.nan, np.inf, -2.0]
    actual = assert_agrees(device, "svgf", "modulate", images)
    assert np.isfinite(actual["color"]).all()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 7), (7, 1), (2, 2)])
@pytest.mark.parametrize("stage", ["temporal", "variance", "atrous", "modulate"])
def test_stages_agree_at_odd_sizes(device, stage, height, width):
    images = make_images(np.random.default_rng(10), 1, height, width)
    assert_agrees(device, "svgf", stage, images, 2 if stage == "atrous" else 0)


# --- Against the papers' formulas, pixel by pixel --------------------------------------------------------------------

B3_SPLINE = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)


def light(color):
    return 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]


def scalar_edge_weight(images, y, x, v, u, settings):
    """[Schied17, Eq. 3, 4] for the pixel (x, y) and its tap (u, v)."""
    if images["object_id"][v, u] == 0:
        return 0.0
    if (v, u) == (y, x):
        return 1.0
    z_p, z_q = float(images["depth"][y, x]), float(images["depth"][v, u])
    gradient = images["depth_gradient"][y, x].astype(float)
    explained = abs(gradient[0] * (x - u) + gradient[1] * (y - v))
    w_z = math.exp(-abs(z_p - z_q) / (settings.sigma_depth * explained + 1e-3 * z_p))
    cosine = float(np.dot(images["normal"][y, x].astype(float), images["normal"][v, u].astype(float)))
    return w_z * max(0.0, cosine) ** settings.sigma_normal


@pytest.mark.parametrize("level", [0, 1, 3])
def test_atrous_is_the_formula(device, level):
    """[Schied17, Eq. 1, 2, 5]"""
    images = make_images(np.random.default_rng(11), 1)
    settings = DenoiseSettings()
    color, variance = images["color0"].astype(float), images["variance0"].astype(float)
    surface = images["object_id"] != 0
    expected_color, expected_variance = color.copy(), np.zeros_like(variance)
    for y in range(HEIGHT):
        for x in range(WIDTH):
            if not surface[y, x]:
                continue
            blurred = norm = 0.0
            for j, g_j in zip((-1, 0, 1), (0.25, 0.5, 0.25), strict=True):
                for i, g_i in zip((-1, 0, 1), (0.25, 0.5, 0.25), strict=True):
                    v, u = y + j, x + i
                    if 0 <= v < HEIGHT and 0 <= u < WIDTH and surface[v, u]:
                        blurred += g_i * g_j * variance[v, u]
                        norm += g_i * g_j
            deviation = math.sqrt(blurred / norm)
            c_sum, v_sum, w_sum = np.zeros(3), 0.0, 0.0
            for j in range(-2, 3):
                for i in range(-2, 3):
                    v, u = y + j * 2**level, x + i * 2**level
                    if not (0 <= v < HEIGHT and 0 <= u < WIDTH):
                        continue
                    w = scalar_edge_weight(images, y, x, v, u, settings)
                    difference = abs(light(color[y, x]) - light(color[v, u]))
                    w *= math.exp(-difference / (settings.sigma_luminance * deviation + 1e-10))
                    w *= B3_SPLINE[i + 2] * B3_SPLINE[j + 2]
                    c_sum += w * color[v, u]
                    v_sum += w * w * variance[v, u]
                    w_sum += w
            expected_color[y, x], expected_variance[y, x] = c_sum / w_sum, v_sum / w_sum**2
    actual, _ = run(device, "svgf", "atrous", images, level)
    np.testing.assert_allclose(actual["color0"], expected_color, rtol=1e-4)
    np.testing.assert_allclose(actual["variance0"], expected_variance, rtol=2e-4)


def test_spatial_variance_is_the_formula(device):
    """Second moment minus squared mean over 7x7 pixels, weighed by [Schied17, Eq. 3, 4]."""
    images = make_images(np.random.default_rng(12), 1)
    settings = DenoiseSettings()
    mean, spread = np.moveaxis(images["moments0"].astype(float), -1, 0)
    expected = spread.copy()
    for y in range(HEIGHT):
        for x in range(WIDTH):
            if images["object_id"][y, x] == 0:
                continue
            if images["history_length"][y, x] >= 4:
                continue
            m1 = m2 = w_sum = 0.0
            for v in range(max(0, y - 3), min(HEIGHT, y + 4)):
                for u in range(max(0, x - 3), min(WIDTH, x + 4)):
                    w = scalar_edge_weight(images, y, x, v, u, settings)
                    m1 += w * mean[v, u]
                    m2 += w * (spread[v, u] + mean[v, u] ** 2)
                    w_sum += w
            expected[y, x] = m2 / w_sum - (m1 / w_sum) ** 2
    actual, _ = run(device, "svgf", "variance", images)
    surface = images["object_id"] != 0
    np.testing.assert_allclose(actual["variance0"][surface], expected[surface], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("level", [0, 2])
def test_edge_avoiding_is_the_formula(device, level):
    """The listing at the end of [Dammertz10], with phi = sigma^2."""
    images = make_images(np.random.default_rng(13), 1)
    window = (-0.5, 0.5, -0.3, 0.28)
    settings = DenoiseSettings()
    step = 2**level
    phi_color = (settings.eaw_sigma_color / step) ** 2
    phi_normal, phi_position = settings.eaw_sigma_normal**2, settings.eaw_sigma_position**2
    color, normal = images["color0"].astype(float), images["normal"].astype(float)

    def position(y, x):
        z = float(images["depth"][y, x])
        u = window[0] + (window[1] - window[0]) * (x + 0.5) / WIDTH
        v = window[3] + (window[2] - window[3]) * (y + 0.5) / HEIGHT
        return np.array([u * z, v * z, -z])

    expected = color.copy()
    for y in range(HEIGHT):
        for x in range(WIDTH):
            if images["object_id"][y, x] == 0:
                continue
            total, cumulative = np.zeros(3), 0.0
            for j in range(-2, 3):
                for i in range(-2, 3):
                    v, u = y + j * step, x + i * step
                    if not (0 <= v < HEIGHT and 0 <= u < WIDTH) or images["object_id"][v, u] == 0:
                        continue
                    weight = B3_SPLINE[i + 2] * B3_SPLINE[j + 2]
                    weight *= math.exp(-np.sum((color[y, x] - color[v, u]) ** 2) / phi_color)
                    weight *= math.exp(-np.sum((normal[y, x] - normal[v, u]) ** 2) / step**2 / phi_normal)
                    weight *= math.exp(-np.sum((position(y, x) - position(v, u)) ** 2) / phi_position)
                    total += weight * color[v, u]
                    cumulative += weight
            expected[y, x] = total / cumulative
    actual, _ = run(device, "eaw", "atrous", {**images, "window": np.array(window, np.float32)}, level)
    np.testing.assert_allclose(actual["color0"], expected, rtol=1e-4)


def test_temporal_is_the_formula(device):
    """Where nothing moves: [Schied17, Sec. 4.1] with alpha = max(0.2, 1 / N), and the moments' textbook form."""
    images = make_images(np.random.default_rng(14), 1)
    for name in GUIDES:
        images[f"prev_{name}"] = images[name]
    images["motion"][:] = 0.0
    surface = images["object_id"] != 0
    actual, _ = run(device, "svgf", "temporal", images)
    length = images["hist_length"].astype(float) + 1.0
    alpha = np.maximum(0.2, 1.0 / length)
    color = (1.0 - alpha)[..., None] * images["hist_color0"] + alpha[..., None] * images["illumination0"].astype(float)
    luminance = images["illumination0"].astype(float) @ [0.2126, 0.7152, 0.0722]
    old_mean, old_variance = np.moveaxis(images["hist_moments0"].astype(float), -1, 0)
    mean = (1.0 - alpha) * old_mean + alpha * luminance
    second = (1.0 - alpha) * (old_variance + old_mean**2) + alpha * luminance**2
    np.testing.assert_allclose(actual["history_length"][surface], length[surface])
    np.testing.assert_allclose(actual["color0"][surface], color[surface], rtol=1e-5)
    np.testing.assert_allclose(actual["moments0"][surface, 0], mean[surface], rtol=1e-5)
    np.testing.assert_allclose(actual["moments0"][surface, 1], (second - mean**2)[surface], rtol=1e-4, atol=1e-6)


def test_bilinear_history_is_the_mean_of_its_taps(device):
    images = make_images(np.random.default_rng(15), 1)
    for prefix in ("", "prev_"):
        images[f"{prefix}object_id"][:] = 1
        images[f"{prefix}depth"][:] = 4.0
        images[f"{prefix}depth_gradient"][:] = 0.0
        images[f"{prefix}normal"][:] = [0.0, 0.0, 1.0]
    images["motion"][:] = [0.25, -0.5, 0.0]
    actual, _ = run(device, "svgf", "temporal", images, alpha=0.0)
    y, x = 8, 16
    taps = [(y - 1, x, 0.375), (y - 1, x + 1, 0.125), (y, x, 0.375), (y, x + 1, 0.125)]
    length = sum(w * float(images["hist_length"][v, u]) for v, u, w in taps)
    color = sum(w * images["hist_color0"][v, u].astype(float) for v, u, w in taps)
    alpha = 1.0 / (length + 1.0)
    assert actual["history_length"][y, x] == pytest.approx(length + 1.0, rel=1e-6)
    np.testing.assert_allclose(
        actual["color0"][y, x], (1.0 - alpha) * color + alpha * images["illumination0"][y, x], rtol=1e-5
    )


# --- What may not happen ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 1e38])
@pytest.mark.parametrize("where", ["hist_color0", "hist_moments0", "hist_length"])
def test_bad_history_is_not_read(device, bad, where):
    images = make_images(np.random.default_rng(16), 1)
    for name in GUIDES:
        images[f"prev_{name}"] = images[name]
    images["motion"][:] = 0.0
    clean, _ = run(device, "svgf", "temporal", images)
    images[where][8, 16] = bad
    actual, repaired = run(device, "svgf", "temporal", images)
    for name, image in actual.items():
        assert np.isfinite(image).all(), name
        same = np.isclose(image, clean[name]).reshape(HEIGHT, WIDTH, -1).all(axis=-1)
        same[8, 16] = True
        assert same.all(), f"{name}: a neighbour of the bad pixel changed"
    assert repaired >= 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_bad_motion_means_no_history(device, bad, channel):
    images = make_images(np.random.default_rng(17), 1)
    images["motion"][8, 16, channel] = bad
    actual, repaired = run(device, "svgf", "temporal", images)
    assert repaired == 1
    assert actual["history_length"][8, 16] == 1.0
    np.testing.assert_allclose(actual["color0"][8, 16], images["illumination0"][8, 16])


@pytest.mark.parametrize("motion", [1e6, -1e6, 3e9, -1e30, 33.0, -33.0])
def test_motion_out_of_the_frame_means_no_history(device, motion):
    images = make_images(np.random.default_rng(18), 1)
    images["motion"][:] = [motion, 0.0, 0.0]
    actual, repaired = run(device, "svgf", "temporal", images)
    assert repaired == 0
    np.testing.assert_array_equal(actual["history_length"], images["object_id"] != 0)


def test_variance_does_not_cancel(device):
    """Luminance 1e4 +- 1: E[x^2] - E[x]^2 in float32 would be off by several times the answer."""
    rng = np.random.default_rng(19)
    images = make_images(rng, 1)
    for name in GUIDES:
        images[f"prev_{name}"] = images[name]
    images["motion"][:] = 0.0
    surface = images["object_id"] != 0
    images["hist_moments0"][:] = [1e4, 0.0]
    images["hist_color0"][:] = 1e4
    images["hist_length"][:] = 1.0
    for frame in range(60):
        images["illumination0"] = np.float32(1e4) + rng.choice([-1.0, 1.0], (HEIGHT, WIDTH, 1)).astype(np.float32)
        images["illumination0"] = np.repeat(images["illumination0"], 3, axis=-1)
        actual, _ = run(device, "svgf", "temporal", images, alpha_moments=0.0)
        assert (actual["moments0"][..., 1] >= 0.0).all()
        images["hist_moments0"] = actual["moments0"].astype(np.float32)
        images["hist_length"] = np.maximum(actual["history_length"], 1.0).astype(np.float32)
    assert actual["moments0"][surface, 1].mean() == pytest.approx(1.0, rel=0.05)


def test_atrous_divides_variance_as_independent_noise(device):
    """A flat surface of equal luminance: Eq. 2 gives the sum of the squared kernel."""
    images = make_images(np.random.default_rng(20), 1)
    images["object_id"][:], images["depth"][:], images["depth_gradient"][:] = 1, 4.0, 0.0
    images["normal"][:] = [0.0, 0.0, 1.0]
    images["color0"][:], images["variance0"][:] = 0.5, 2.0
    actual, _ = run(device, "svgf", "atrous", images)
    assert actual["variance0"][8, 16] == pytest.approx(2.0 * sum(h * h for h in B3_SPLINE) ** 2, rel=1e-5)
