# SPDX-License-Identifier: Apache-2.0
"""History of one image size as that of another: each pixel the nearest one's or the mean of those that it covers, frames
in proportion to its area."""

from __future__ import annotations

import numpy as np
import pytest

from .test_denoiser import HEIGHT, WIDTH, add_noise, make_frame

TEMPORAL = ("svgf+", "svgf")
SIZES = ((2 * WIDTH, 2 * HEIGHT), (WIDTH + 7, HEIGHT - 5))


def after_frames(device, method, count, frame, seed=0):
    """A denoiser that has seen so many noisy frames."""
    rng = np.random.default_rng(seed)
    denoiser = device.denoiser(frame["depth"].shape[1], frame["depth"].shape[0], method, {})
    for _ in range(count):
        step(device, denoiser, add_noise(frame, rng))
    return denoiser


def step(device, denoiser, frame):
    result = denoiser.denoise({name: device.upload(image) for name, image in frame.items()}, reset=False)
    return {name: np.asarray(device.to_numpy(image), np.float32) for name, image in result.items()}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("method", TEMPORAL)
def test_each_pixel_is_the_nearest_ones(device, method, size):
    denoiser = after_frames(device, method, 5, make_frame())
    before = denoiser.history_images()
    denoiser.resize(*size)
    after = denoiser.history_images()
    width, height = size
    rows = ((np.arange(height) + 0.5) * HEIGHT / height).astype(int)
    columns = ((np.arange(width) + 0.5) * WIDTH / width).astype(int)
    assert after.keys() == before.keys() and "color0" in after
    for name, image in after.items():
        expected = np.asarray(before[name])[rows[:, None], columns]
        if name.startswith("frames"):
            expected = np.maximum(expected * min(1, WIDTH * HEIGHT / (width * height)), 1)
            np.testing.assert_allclose(image, expected, rtol=4e-3)  # 9 bits of frames + 1
        else:
            np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("divisor", [2, 4])
@pytest.mark.parametrize("method", TEMPORAL)
def test_larger_pixels_are_means_of_their_object(device, method, divisor):
    """The left half is another object, whose border lies within the pixels of the fourth column."""
    frame, edge = make_frame(), 3 * divisor + 1
    frame["object_id"][:, :edge], frame["depth"][:, :edge] = 2, 5.0
    denoiser = after_frames(device, method, 5, frame)
    before = np.asarray(denoiser.history_images()["color0"], float)
    width, height = WIDTH // divisor, HEIGHT // divisor
    denoiser.resize(width, height)
    after = denoiser.history_images()["color0"]
    blocks = before.reshape(height, divisor, width, divisor, 3)
    expected = blocks.mean(axis=(1, 3))
    is_left = edge - 3 * divisor > divisor // 2  # the pixel's centre decides
    expected[:, 3] = blocks[:, :, 3][:, :, slice(0, 1) if is_left else slice(1, None)].mean(axis=(1, 2))
    np.testing.assert_allclose(after, expected, rtol=2e-4, atol=1e-4)


@pytest.mark.parametrize("method", TEMPORAL)
def test_picture_goes_on(device, method):
    """A much noisier first frame of the new size does not show: it is one of many."""
    denoiser, rng = after_frames(device, method, 32, make_frame()), np.random.default_rng(1)
    fresh = device.denoiser(2 * WIDTH // 3, HEIGHT // 2, method, {})
    denoiser.resize(2 * WIDTH // 3, HEIGHT // 2)
    noisy = add_noise(make_frame(HEIGHT // 2, 2 * WIDTH // 3), rng, strength=2.0)
    image, other = step(device, denoiser, noisy), step(device, fresh, noisy)
    off, fresh_off = (np.abs(each["color"] - 0.5).mean() for each in (image, other))
    assert off < 0.75 * fresh_off and np.median(image["history_length"]) > 30


def test_no_noisy_frame_shows_in_a_resized_picture(device):
    """A still picture goes on with its noisy frames; after a change of size with denoised ones. One bright sample in a
    frame of constant light stands for their noise: 2 % of it is more than the filter leaves."""
    denoiser = device.denoiser(WIDTH, HEIGHT, "svgf+", {})
    for _ in range(40):
        step(device, denoiser, make_frame())
    denoiser.resize(WIDTH // 2, HEIGHT // 2)
    frame = make_frame(HEIGHT // 2, WIDTH // 2)
    frame["diffuse"][HEIGHT // 4, WIDTH // 4] = 20.0
    assert step(device, denoiser, frame)["color"].max() < 0.5 + 0.02 * 20.0


@pytest.mark.parametrize("divisor", [2, 3])
@pytest.mark.parametrize("method", TEMPORAL)
def test_slanted_surfaces_go_on_in_finer_pixels(device, method, divisor):
    """A plane at 60 degrees: a fine pixel's depth is not that of the coarse one around it."""

    def slanted(height, width):
        frame = make_frame(height, width)
        slope = 10.0 * np.tan(np.radians(60)) * 0.72 / width
        frame["depth"] += (slope * (np.arange(width) + 0.5 - width / 2)).astype(np.float32)
        frame["depth_gradient"][..., 0] = slope
        frame["normal"][:] = np.float32([-np.sin(np.radians(60)), 0, 0.5])
        return frame

    denoiser = after_frames(device, method, 8, slanted(HEIGHT, WIDTH))
    denoiser.resize(divisor * WIDTH, divisor * HEIGHT)
    image = step(device, denoiser, slanted(divisor * HEIGHT, divisor * WIDTH))
    assert (image["history_length"] > 1).mean() > 0.97


@pytest.mark.parametrize("method", [*TEMPORAL, "eaw", "none"])
def test_sizes_come_and_go(device, method):
    denoiser = device.denoiser(WIDTH, HEIGHT, method, {})
    for width, height in ((3, 5), (WIDTH, HEIGHT), (64, 1), (1, 1), (WIDTH, HEIGHT)):
        denoiser.resize(width, height)
        denoiser.resize(width, height)
        frame = make_frame(height, width)
        two = {**frame, "specular": frame["diffuse"], "specular_albedo": frame["diffuse_albedo"]}
        for inputs, radiance in ((frame, 0.5), (two, 1.0)):
            np.testing.assert_allclose(step(device, denoiser, inputs)["color"], radiance, rtol=5e-3)
