# SPDX-License-Identifier: GPL-3.0-or-later
"""Which rays see what."""

from __future__ import annotations

import bpy
from svgf.scene import RayVisibility


def ray_visibility(owner: bpy.types.Object | bpy.types.bpy_struct, prefix: str = "visible_") -> RayVisibility:
    """Of an object, or of the world's settings for Cycles, whose flags have no prefix."""
    visibility = RayVisibility.NONE
    for ray in RayVisibility:
        if getattr(owner, prefix + ray.name.lower(), True):
            visibility |= ray
    return visibility
