# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture on the screen."""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d


class PictureTexture:
    """The newest picture on the GPU.

    Blender's Python has no call that writes to an existing texture, so each picture becomes one, at its first draw;
    further draws (of overlays, menus, other areas) use it as it is.
    """

    def __init__(self) -> None:
        self._texture: gpu.types.GPUTexture | None = None
        self._picture: np.ndarray | None = None

    def draw(self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene, picture: np.ndarray, region) -> None:
        """Over the whole region, through Blender's colour management. picture: float32 [H, W, 4], finite in half."""
        if picture is not self._picture:
            height, width = picture.shape[:2]
            self._texture = None  # the old one is free before the new one asks for memory
            pixels = gpu.types.Buffer("FLOAT", picture.size, picture.reshape(-1))
            self._texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)
            self._picture = picture
        engine.bind_display_space_shader(scene)
        draw_texture_2d(self._texture, (0, 0), region.width, region.height)
        engine.unbind_display_space_shader()
