# SPDX-License-Identifier: Apache-2.0
"""Another image size for a scene that was exported at one."""

from __future__ import annotations

from dataclasses import replace

from .scene import Camera, Scene


def reframe(scene: Scene, width: int, height: int) -> Scene:
    """The scene as Blender would have exported it at this size, with sensor fit Auto: the longer side keeps its view.

    A size of the same proportions keeps the cameras to the bit. Pixels keep their aspect ratio. The result's defaults
    say the new size.
    """
    defaults = scene.defaults
    resized = replace(defaults, width=width, height=height)
    if width * defaults.height == height * defaults.width:
        return replace(scene, defaults=resized)
    before, after = (defaults.width, defaults.height), (width, height)
    return replace(
        scene,
        camera=_refit(scene.camera, before, after),
        previous_camera=_refit(scene.previous_camera, before, after),
        defaults=resized,
    )


def _refit(camera: Camera, before: tuple[int, int], after: tuple[int, int]) -> Camera:
    left, right, bottom, top = camera.window
    # Blender measures sensor and shift against the longer side, so the window's centre stays and its longer side too.
    pixel_width, pixel_height = (right - left) / before[0], (top - bottom) / before[1]
    longer_before = max(right - left, top - bottom)
    longer_after = max(pixel_width * after[0], pixel_height * after[1])
    scale = 0.5 * longer_before / longer_after
    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
    half_width, half_height = scale * pixel_width * after[0], scale * pixel_height * after[1]
    return replace(camera, window=(x - half_width, x + half_width, y - half_height, y + half_height))
