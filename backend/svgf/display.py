# SPDX-License-Identifier: Apache-2.0
"""Images as a screen takes them."""

from __future__ import annotations

import numpy as np

from .devices import load_native


def write_display(rgba: np.ndarray, image: np.ndarray, largest: float) -> None:
    """Writes an image as opaque pixels, as OpenGL's textures are: bottom row first.

    rgba: float32 [H, W, 4]. image: float32 [H, W], [H, W, 1] or [H, W, 3]. Both may be parts of larger ones. Values are
    limited to [0, largest]; what is no number becomes 0. Raises InputError where the shapes do not fit.
    """
    load_native("cpu").write_display(rgba, image if image.ndim == 3 else image[..., None], largest)
