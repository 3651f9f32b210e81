# SPDX-License-Identifier: Apache-2.0
"""Images as a screen takes them, against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from svgf.display import write_display
from svgf.errors import InputError


def expected(image: np.ndarray, largest: float) -> np.ndarray:
    image = image if image.ndim == 3 else image[..., None]
    limited = np.clip(np.where(np.isnan(image), 0, image), 0, largest)
    rgba = np.ones((*image.shape[:2], 4), np.float32)
    rgba[..., :3] = limited[::-1]
    return rgba


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 5), (7, 5, 1), (64, 33, 3)])
def test_limited_opaque_and_upside_down(shape):
    image = np.random.default_rng(0).normal(0, 3, shape).astype(np.float32)
    image.flat[::7], image.flat[1::7], image.flat[2::7] = np.nan, np.inf, -np.inf
    rgba = np.full((*shape[:2], 4), -1, np.float32)
    write_display(rgba, image, 2.0)
    np.testing.assert_array_equal(rgba, expected(image, 2.0))


def test_parts_of_larger_images():
    random = np.random.default_rng(0)
    image, rgba = random.random((6, 9, 3), np.float32), np.full((6, 11, 4), -1, np.float32)
    write_display(rgba[1:, 2:7], image[1:, 4:], 1.0)
    np.testing.assert_array_equal(rgba[1:, 2:7], expected(image[1:, 4:], 1.0))
    rgba[1:, 2:7] = -1
    assert (rgba == -1).all()


@pytest.mark.parametrize("shape", [(3, 4, 4), (3, 4, 2), (4, 4, 3), (3, 5, 3)])
def test_what_does_not_fit_is_refused(shape):
    with pytest.raises(InputError, match="is displayed as pixels"):
        write_display(np.zeros((3, 4, 4), np.float32), np.zeros(shape, np.float32), 1.0)


def test_pixels_that_could_not_be_written_are_refused():
    image = np.zeros((3, 4, 3), np.float32)
    with pytest.raises(TypeError):
        write_display(np.zeros((3, 4, 4), np.float64), image, 1.0)
    with pytest.raises(InputError, match="side by side"):
        write_display(np.zeros((4, 4, 3), np.float32).transpose(2, 1, 0), image, 1.0)
