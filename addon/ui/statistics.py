# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels that say what the viewport's newest frame cost, what it simulated and what it could not."""

from __future__ import annotations

import textwrap

import bpy
from svgf.effects import Effects, find_effects

from ..viewport.session import ViewSession
from ..viewport.views import sessions_of
from .panels import EnginePanel

_PIXELS_PER_LETTER = 7

# What an artist calls each effect.
_EFFECTS = {
    Effects.TEXTURES: "Image textures",
    Effects.SPECULAR: "Reflections",
    Effects.TRANSMISSION: "Glass",
    Effects.MESH_LIGHTS: "Emissive meshes",
    Effects.DELTA_LIGHTS: "Lamps without size",
    Effects.AREA_LIGHTS: "Lamps with size",
    Effects.ENVIRONMENT: "Light of the world",
    Effects.CAMERA_MOTION: "Camera motion",
    Effects.OBJECT_MOTION: "Object motion",
    Effects.DEFORMATION: "Deformation",
}


class _StatisticsPanel(EnginePanel):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and cls.session(context) is not None

    @classmethod
    def session(cls, context: bpy.types.Context) -> ViewSession | None:
        """Of the view with the newest picture."""
        sessions = sessions_of(context.scene)
        return sessions[-1] if sessions else None


class SVGF_PT_cost(_StatisticsPanel, bpy.types.Panel):
    bl_label = "Cost of a Frame"

    def draw(self, context: bpy.types.Context) -> None:
        session = self.session(context)
        result = session.result
        column = self.layout.column(align=True)
        if session.error:
            _write(column, context, session.error, "ERROR")
        frame = result.frame
        if frame is None:
            return
        for stage, milliseconds in frame.timings.items():
            _row(column, stage, f"{milliseconds:.1f} ms")
        _row(column, "all in all", f"{result.milliseconds:.1f} ms")
        column.separator()
        _row(column, "Resolution", f"{frame.width} x {frame.height}")
        _row(column, "Samples", f"{result.samples} of {session.sample_limit}")
        _row(column, "Frames of history", f"{frame.history_length.max():.0f}")
        _row(column, "Device", result.device)
        _write(column, context, f"History restarted {result.frames} frames ago: {result.reset}", "FILE_REFRESH")


class SVGF_PT_effects(_StatisticsPanel, bpy.types.Panel):
    bl_label = "Effects in This Scene"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        scene = self.session(context).result.scene
        column = self.layout.column(align=True)
        if scene is not None:
            effects = find_effects(scene)
            for effect, name in _EFFECTS.items():
                column.label(text=name, icon="CHECKBOX_HLT" if effect in effects else "CHECKBOX_DEHLT")


class SVGF_PT_warnings(_StatisticsPanel, bpy.types.Panel):
    bl_label = "Not as in Blender"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and bool(cls.session(context).warnings)

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        for warning in self.session(context).warnings:
            _write(column, context, warning, "ERROR")


def _row(column: bpy.types.UILayout, name: str, value: str) -> None:
    row = column.row()
    row.label(text=name)
    cell = row.row()
    cell.alignment = "RIGHT"
    cell.label(text=value)


def _write(column: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str) -> None:
    """Broken into lines, because labels are cut off at the panel's edge."""
    letters = max(int(context.region.width / (_PIXELS_PER_LETTER * context.preferences.system.ui_scale)) - 6, 20)
    for number, line in enumerate(textwrap.wrap(text, letters)):
        column.label(text=line, icon="BLANK1" if number else icon)


_PANELS = (SVGF_PT_cost, SVGF_PT_effects, SVGF_PT_warnings)


def register() -> None:
    for panel in _PANELS:
        bpy.utils.register_class(panel)


def unregister() -> None:
    for panel in reversed(_PANELS):
        bpy.utils.unregister_class(panel)
