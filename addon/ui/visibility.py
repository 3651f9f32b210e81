# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of what SVGF reads of objects, lamps and the world, and no panel of Blender's shows for any engine."""

from __future__ import annotations

import bpy

from .panels import EnginePanel

_SEEN = {"MESH", "CURVE", "SURFACE", "META", "FONT", "LIGHT"}
_RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow")


class SVGF_PT_ray_visibility(EnginePanel, bpy.types.Panel):
    """Of an object, or of all that an empty places."""

    bl_label = "Ray Visibility"
    bl_context = "object"
    bl_parent_id = "OBJECT_PT_visibility"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = context.object
        return super().poll(context) and obj is not None and (obj.type in _SEEN or obj.instance_type != "NONE")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for ray in _RAYS:
            if ray != "shadow" or context.object.type != "LIGHT":
                column.prop(context.object, f"visible_{ray}", text=ray.capitalize())


class SVGF_PT_world_visibility(EnginePanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_context = "world"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for ray in _RAYS:
            if ray != "shadow":
                column.prop(context.world.cycles_visibility, ray)


class SVGF_PT_beam(EnginePanel, bpy.types.Panel):
    """Of area lamps; Blender's own panel has that of spot lamps."""

    bl_label = "Beam Shape"
    bl_context = "data"
    bl_parent_id = "DATA_PT_EEVEE_light"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and getattr(context.light, "type", "") == "AREA"

    def draw(self, context: bpy.types.Context) -> None:
        self.columns().prop(context.light, "spread")


_CLASSES = (SVGF_PT_ray_visibility, SVGF_PT_world_visibility, SVGF_PT_beam)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
