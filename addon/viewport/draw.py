# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture on the screen."""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from .worker import Part

# From (0, 0) at the bottom left to (1, 1) at the top right of what is drawn to.
_UNIT_SQUARE = Matrix(((2, 0, 0, -1), (0, 2, 0, -1), (0, 0, 1, 0), (0, 0, 0, 1)))


class PictureTexture:
    """The newest picture on the GPU, in float32: converting it to half would take longer than the upload.

    Blender's Python has no call that writes to an existing texture, so each picture becomes one, at its first draw;
    further draws (of overlays, menus, other areas) use it as it is.
    """

    def __init__(self) -> None:
        self._texture: gpu.types.GPUTexture | None = None
        self._picture: np.ndarray | None = None

    def upload(self, picture: np.ndarray, smooth: bool) -> None:
        """Unless it is there already. No pixel is touched in Python: the buffer is the picture's own memory. smooth:
        interpolated where the screen has more pixels.
        """
        if picture is self._picture:
            return
        height, width = picture.shape[:2]
        self._texture = None  # the old one is free before the new one asks for memory
        pixels = gpu.types.Buffer("FLOAT", picture.size, picture.reshape(-1))
        self._texture = gpu.types.GPUTexture((width, height), format="RGBA32F", data=pixels)
        if hasattr(self._texture, "filter_mode"):  # not before Blender 5.1
            self._texture.filter_mode(smooth)
        self._picture = picture

    def draw_light(
        self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene, picture: np.ndarray, part: Part, region
    ) -> None:
        """Linear radiance, before Blender's view transform. picture: float32 [H, W, 4], finite in half, alpha
        premultiplied. part: of the region, where it goes.
        """
        self.upload(picture, smooth=True)
        left, bottom, right, top = part
        engine.bind_display_space_shader(scene)
        gpu.state.blend_set("ALPHA_PREMULT")
        place = left * region.width, bottom * region.height
        draw_texture_2d(self._texture, place, (right - left) * region.width, (top - bottom) * region.height)
        gpu.state.blend_set("NONE")
        engine.unbind_display_space_shader()

    def draw_data(self, picture: np.ndarray, part: Part) -> None:
        """Numbers from 0 to 1 as the screen's own, after the view transform; in a draw handler of the view. Each pixel
        as it is: a colour between two reasons would be a third one's.
        """
        self.upload(picture, smooth=False)
        left, bottom, right, top = part
        with gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
            gpu.matrix.load_identity()
            gpu.matrix.load_projection_matrix(_UNIT_SQUARE)
            draw_texture_2d(self._texture, (left, bottom), right - left, top - bottom)
