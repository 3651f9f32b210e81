# SPDX-License-Identifier: Apache-2.0
"""Metrics against values worked out by hand."""

from __future__ import annotations

import flip_evaluator
import numpy as np
import pytest

from svgf import metrics
from svgf.errors import InputError


def flat(value: float, height: int = 16, width: int = 20) -> np.ndarray:
    return np.full((height, width, 3), value, np.float32)


def noise(seed: int, height: int = 24, width: int = 31) -> np.ndarray:
    return np.random.default_rng(seed).exponential(1.0, (height, width, 3)).astype(np.float32)


def test_tonemap() -> None:
    np.testing.assert_allclose(
        metrics.tonemap([-1.0, 0.0, 1.0, 3.0, np.inf]), [0.0, 0.0, 0.5 ** (1 / 2.2), 0.75 ** (1 / 2.2), 1.0]
    )
    assert np.isnan(metrics.tonemap(np.nan))


def test_equal_images() -> None:
    image = noise(0)
    assert metrics.relative_mse(image, image) == 0.0
    assert metrics.psnr(image, image) == float("inf")
    assert metrics.ssim(image, image) == pytest.approx(1.0, abs=1e-12)
    assert metrics.flip(image, image) == 0.0


def test_relative_mse() -> None:
    assert metrics.relative_mse(flat(3.0), flat(2.0)) == pytest.approx(1.0 / 4.01)
    assert metrics.relative_mse(flat(1.0), flat(0.0)) == pytest.approx(100.0)
    half = flat(2.0)
    half[: len(half) // 2] = 3.0
    assert metrics.relative_mse(half, flat(2.0)) == pytest.approx(0.5 / 4.01)


def test_relative_mse_is_not_symmetric() -> None:
    """The second image is the truth."""
    assert metrics.relative_mse(flat(0.0), flat(1.0)) == pytest.approx(1 / 1.01)


def test_psnr() -> None:
    # 1 and 3 become 0.5 and 0.75 before gamma.
    difference = 0.75 ** (1 / 2.2) - 0.5 ** (1 / 2.2)
    assert metrics.psnr(flat(3.0), flat(1.0)) == pytest.approx(-20 * np.log10(difference))
    assert metrics.psnr(flat(np.inf), flat(0.0)) == pytest.approx(0.0)


def test_ssim_of_flat_images() -> None:
    x, r = 0.75 ** (1 / 2.2), 0.5 ** (1 / 2.2)
    expected = (2 * x * r + 1e-4) / (x * x + r * r + 1e-4)
    assert metrics.ssim(flat(3.0), flat(1.0)) == pytest.approx(expected)


def test_ssim_by_definition() -> None:
    """Window by window, as [Wang04] states it."""
    image, reference = noise(1, 13, 14), noise(2, 13, 14)
    x, r = metrics.tonemap(image), metrics.tonemap(reference)
    axis = np.arange(-5, 6)
    window = np.exp(-(axis[:, None] ** 2 + axis[None, :] ** 2) / (2 * 1.5**2))
    window = (window / window.sum())[..., None]
    values = []
    for top in range(3):
        for left in range(4):
            a, b = x[top : top + 11, left : left + 11], r[top : top + 11, left : left + 11]
            mean_a, mean_b = (window * a).sum((0, 1)), (window * b).sum((0, 1))
            variance_a, variance_b = (window * (a - mean_a) ** 2).sum((0, 1)), (window * (b - mean_b) ** 2).sum((0, 1))
            covariance = (window * (a - mean_a) * (b - mean_b)).sum((0, 1))
            values.append(
                (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4)
                / ((mean_a**2 + mean_b**2 + 1e-4) * (variance_a + variance_b + 9e-4))
            )  # fmt: skip
    assert metrics.ssim(image, reference) == pytest.approx(np.mean(values), abs=1e-12)


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (10, 10), (11, 11)])
def test_ssim_of_small_images(size: tuple[int, int]) -> None:
    assert metrics.ssim(flat(1.0, *size), flat(1.0, *size)) == pytest.approx(1.0)
    assert -1.0 <= metrics.ssim(noise(1, *size), noise(2, *size)) < 1.0


def test_flip() -> None:
    image, reference = noise(1), noise(2)
    tonemapped = (metrics.tonemap(reference).astype(np.float32), metrics.tonemap(image).astype(np.float32))
    _, expected, _ = flip_evaluator.evaluate(*tonemapped, "LDR", inputsRGB=True, applyMagma=False)
    assert metrics.flip(image, reference) == pytest.approx(expected)
    assert (
        0.0
        < metrics.flip(image, image * 1.1)
        < metrics.flip(image, image * 2)
        < metrics.flip(flat(1e9), flat(0.0))
        <= 1.0
    )


def test_what_is_not_finite_shows() -> None:
    image = flat(1.0)
    image[3, 4, 0] = np.nan
    for metric in (metrics.relative_mse, metrics.psnr, metrics.ssim, metrics.flip):
        assert np.isnan(metric(image, flat(1.0))), metric


def test_flicker_is_what_changes_beyond_the_truth() -> None:
    a, b = metrics.tonemap(1.0), metrics.tonemap(3.0)
    # A truth that changes is no flicker, nor is an error that stays.
    assert metrics.flicker([flat(1.0), flat(3.0)], [flat(1.0), flat(3.0)]) == 0.0
    assert metrics.flicker([flat(3.0), flat(3.0)], [flat(1.0), flat(1.0)]) == 0.0
    # An error that comes and goes.
    assert metrics.flicker([flat(1.0), flat(3.0), flat(1.0)], [flat(1.0)] * 3) == pytest.approx(b - a)
    assert metrics.flicker([flat(1.0), flat(3.0), flat(3.0)], [flat(1.0)] * 3) == pytest.approx((b - a) / 2)


def test_flicker_across_a_gap_does_not_count() -> None:
    flicker = metrics.Flicker()
    assert flicker.value is None
    flicker.add(flat(1.0), flat(1.0))
    flicker.cut()
    flicker.add(flat(3.0), flat(1.0))
    assert flicker.value is None
    flicker.add(flat(3.0), flat(1.0))
    assert flicker.value == 0.0


def test_flicker_reads_generators() -> None:
    assert metrics.flicker((flat(1.0) for _ in range(5)), (flat(2.0) for _ in range(5))) == 0.0


@pytest.mark.parametrize(
    ("images", "references", "message"),
    [
        ([flat(1.0)], [flat(1.0)], "at least two frames"),
        ([flat(1.0)] * 3, [flat(1.0)] * 2, "as many references as images"),
        ([flat(1.0)] * 2, [flat(1.0)] * 3, "as many references as images"),
        (
            [flat(1.0), flat(1.0, 8, 8)],
            [flat(1.0), flat(1.0, 8, 8)],
            "size changes within the sequence, from 20x16 to 8x8",
        ),
    ],
)
def test_flicker_of_wrong_sequences(images: list, references: list, message: str) -> None:
    with pytest.raises(InputError, match=message):
        metrics.flicker(images, references)


@pytest.mark.parametrize("metric", [metrics.relative_mse, metrics.psnr, metrics.ssim, metrics.flip])
def test_images_that_cannot_be_compared(metric) -> None:
    with pytest.raises(InputError, match="different sizes cannot be compared: 20x16 and 8x8"):
        metric(flat(1.0), flat(1.0, 8, 8))
    with pytest.raises(InputError, match=r"\[H, W, 3\], not \[16, 20\]"):
        metric(flat(1.0)[..., 0], flat(1.0)[..., 0])
    with pytest.raises(InputError, match=r"not \[0, 20, 3\]"):
        metric(flat(1.0, 0), flat(1.0, 0))
