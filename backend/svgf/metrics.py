# SPDX-License-Identifier: Apache-2.0
"""How far an image is from the truth, and how much a sequence flickers.

Images are linear radiance, [H, W, 3]; the reference comes second and is taken as the truth. relMSE is measured on the
radiance itself and is dominated by bright outliers, as it should be for noise; the others are measured on what an eye
would see, after ``tonemap``. A value that is not finite makes the result not finite: nothing is hidden.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import zip_longest

import numpy as np

from .errors import InputError

_SSIM_RADIUS = 5
_SSIM_SIGMA = 1.5


def tonemap(image: np.ndarray) -> np.ndarray:
    """x / (1 + x), then gamma 2.2: radiance [0, inf) to [0, 1], negative values to 0. float64."""
    positive = np.maximum(np.asarray(image, np.float64), 0.0)
    # Written so that +inf becomes 1, not NaN.
    return (1.0 - 1.0 / (1.0 + positive)) ** (1 / 2.2)


def relative_mse(image: np.ndarray, reference: np.ndarray) -> float:
    """relMSE = mean((x - r)^2 / (r^2 + 0.01)), [0, inf); 0 for equal images."""
    image, reference = _pair(image, reference)
    return float(np.mean((image - reference) ** 2 / (reference**2 + 0.01)))


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB with a peak of 1; inf for equal images."""
    image, reference = _pair(image, reference)
    error = float(np.mean((tonemap(image) - tonemap(reference)) ** 2))
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Structural similarity [Wang04], [-1, 1]: 11x11 Gaussian window, sigma 1.5, K = (0.01, 0.03), mean over channels.

    Only windows that lie inside the image count; an image smaller than the window is mirrored at its borders.
    """
    image, reference = _pair(image, reference)
    x, r = tonemap(image), tonemap(reference)
    if min(x.shape[:2]) <= 2 * _SSIM_RADIUS:
        border = ((_SSIM_RADIUS, _SSIM_RADIUS), (_SSIM_RADIUS, _SSIM_RADIUS), (0, 0))
        x, r = np.pad(x, border, mode="symmetric"), np.pad(r, border, mode="symmetric")
    mean_x, mean_r = _gaussian(x), _gaussian(r)
    variance_x = _gaussian(x * x) - mean_x**2
    variance_r = _gaussian(r * r) - mean_r**2
    covariance = _gaussian(x * r) - mean_x * mean_r
    luminance = (2 * mean_x * mean_r + 0.01**2) / (mean_x**2 + mean_r**2 + 0.01**2)
    structure = (2 * covariance + 0.03**2) / (variance_x + variance_r + 0.03**2)
    return float(np.mean(luminance * structure))


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean LDR-FLIP [Andersson20], [0, 1], at 67 pixels per degree: a difference as seen when two images alternate."""
    import flip_evaluator

    image, reference = _pair(image, reference)
    x, r = tonemap(image).astype(np.float32), tonemap(reference).astype(np.float32)
    if not (np.isfinite(x).all() and np.isfinite(r).all()):
        return float("nan")
    _, mean, _ = flip_evaluator.evaluate(r, x, "LDR", inputsRGB=True, applyMagma=False)
    return float(mean)


class Flicker:
    """mean |(d_t - r_t) - (d_{t-1} - r_{t-1})| over consecutive frames, after ``tonemap``, [0, 2]: what changes from
    frame to frame beyond what truly changes. Holds one frame, so that sequences of any length can be measured."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._changes: list[float] = []

    def add(self, image: np.ndarray, reference: np.ndarray) -> None:
        """The next frame. Raises InputError where its size is not that of the frame before."""
        image, reference = _pair(image, reference)
        error = tonemap(image) - tonemap(reference)
        if self._last is not None:
            if self._last.shape != error.shape:
                raise InputError(
                    f"The size changes within the sequence, from {_size(self._last)} to {_size(error)}.",
                    "Compare frames of one size.",
                )
            self._changes.append(float(np.mean(np.abs(error - self._last))))
        self._last = error

    def cut(self) -> None:
        """The next frame does not follow the last one."""
        self._last = None

    @property
    def value(self) -> float | None:
        """None until two consecutive frames were added."""
        return float(np.mean(self._changes)) if self._changes else None


def flicker(images: Iterable[np.ndarray], references: Iterable[np.ndarray]) -> float:
    """``Flicker`` of two sequences, each read once. Raises InputError where they differ in length, or have fewer than
    two frames."""
    measured = Flicker()
    missing = object()
    for image, reference in zip_longest(images, references, fillvalue=missing):
        if image is missing or reference is missing:
            raise InputError("Flicker needs as many references as images.")
        measured.add(image, reference)
    if measured.value is None:
        raise InputError("Flicker needs at least two frames.")
    return measured.value


def _pair(image: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image, reference = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    if image.shape != reference.shape:
        raise InputError(
            f"Images of different sizes cannot be compared: {_size(image)} and {_size(reference)}.",
            "Render both at one size.",
        )
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"Metrics need images [H, W, 3], not {list(image.shape)}.")
    return image, reference


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]}x{image.shape[0]}" if image.ndim >= 2 else str(list(image.shape))


def _gaussian(image: np.ndarray) -> np.ndarray:
    """The windowed mean at every pixel whose window lies inside: [H, W, C] -> [H - 10, W - 10, C]."""
    offsets = np.arange(-_SSIM_RADIUS, _SSIM_RADIUS + 1)
    weights = np.exp(-0.5 * (offsets / _SSIM_SIGMA) ** 2)
    weights /= weights.sum()
    height, width = image.shape[0] - 2 * _SSIM_RADIUS, image.shape[1] - 2 * _SSIM_RADIUS
    rows = sum(weight * image[i : i + height] for i, weight in enumerate(weights))
    return sum(weight * rows[:, i : i + width] for i, weight in enumerate(weights))
