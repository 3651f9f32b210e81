# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels that say what the viewport's newest frame cost, what it simulated and what it could not."""

from __future__ import annotations

import math
import textwrap

import bpy
from svgf.effects import Effects, find_causes

from ..viewport.session import ViewSession
from ..viewport.views import sessions_of
from .panels import EnginePanel

_PIXELS_PER_LETTER = 7

# What an artist calls each effect.
_EFFECTS = {
    Effects.TEXTURES: "Image textures",
    Effects.SPECULAR: "Reflections",
    Effects.TRANSMISSION: "Glass",
    Effects.PERFECT_SPECULAR: "Mirrors and clear glass",
    Effects.MESH_LIGHTS: "Emissive meshes",
    Effects.DELTA_LIGHTS: "Lamps without size",
    Effects.AREA_LIGHTS: "Lamps with size",
    Effects.ENVIRONMENT: "Light of the world",
    Effects.CAMERA_MOTION: "Camera motion",
    Effects.OBJECT_MOTION: "Object motion",
    Effects.DEFORMATION: "Deformation",
}
_CAUSES_SHOWN = 4


def list_causes(names: tuple[str, ...]) -> str:
    """Such as ``Material "Oak", "Wool" and 17 more``: of several of one kind the kind is named once."""
    parts, last = [], ""
    for name in names[:_CAUSES_SHOWN]:
        kind, quote, rest = name.partition(' "')
        parts.append(f'"{rest}' if quote and kind == last else name)
        last = kind
    more = f" and {len(names) - _CAUSES_SHOWN} more" if len(names) > _CAUSES_SHOWN else ""
    text = ", ".join(parts) + more
    return text[:1].upper() + text[1:]


def effect_name(effect: Effects) -> str:
    return _EFFECTS.get(effect) or effect.name.replace("_", " ").capitalize()


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
        _row(column, "view", f"{result.painting:.1f} ms")
        column.separator()
        _row(column, "Frame", f"{result.milliseconds + result.painting:.1f} ms")
        divided = f" (1/{session.divisor})" if session.divisor > 1 else ""
        _row(column, "Resolution", f"{frame.width} x {frame.height}{divided}")
        _row(column, "Samples", f"{result.samples} of {session.sample_limit}")
        _row(column, "Frames of history", f"{result.history:.0f}")
        _row(column, "Estimated error", "unknown" if math.isnan(result.noise) else f"{result.noise:.1%}")
        _row(column, "Device", result.device)
        _write(column, context, f"History restarted {result.frames} frames ago: {result.reset}", "FILE_REFRESH")


class SVGF_PT_effects(_StatisticsPanel, bpy.types.Panel):
    """What the scene calls for and why; nothing else is simulated."""

    bl_label = "Effects in This Scene"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        session = self.session(context)
        result, column = session.result, self.layout.column(align=True)
        if result.scene is None:
            return
        row = column.row()
        row.enabled = not session.measuring
        text = "Measuring" if session.measuring else SVGF_OT_measure_effects.bl_label
        row.operator(SVGF_OT_measure_effects.bl_idname, text=text, icon="TIME")
        column.separator()
        causes = find_causes(result.scene)
        for effect, names in causes.items():
            row = column.row()
            row.label(text=effect_name(effect), icon="CHECKBOX_HLT")
            cell = row.row()
            cell.alignment = "RIGHT"
            cell.label(text=_cost(result.costs[effect]) if effect in result.costs else "")
            _write(column, context, list_causes(names), "BLANK1")
        left_out = [effect_name(effect) for effect in Effects if effect not in causes]
        column.separator()
        _write(column, context, f"Not here, and not paid for: {', '.join(left_out)}", "CHECKBOX_DEHLT")


class SVGF_OT_measure_effects(bpy.types.Operator):
    """Render a few frames of this view with and without each effect, to tell what it costs"""

    bl_idname = "svgf.measure_effects"
    bl_label = "Measure What Each Costs"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return bool(sessions_of(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        sessions_of(context.scene)[-1].measure_effects()
        return {"FINISHED"}


class SVGF_PT_warnings(_StatisticsPanel, bpy.types.Panel):
    bl_label = "Not as in Blender"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        session = cls.session(context) if super().poll(context) else None
        return session is not None and bool(session.findings or session.result.note)

    def draw(self, context: bpy.types.Context) -> None:
        session, column = self.session(context), self.layout.column()
        if session.result.note:
            _write(column.column(align=True), context, session.result.note, "ERROR")
        for number, finding in enumerate(session.findings):
            row = column.row()
            _write(row.column(align=True), context, finding.sentence, "ERROR")
            row.operator("svgf.select_culprit", text="", icon="RESTRICT_SELECT_OFF").finding = number


def _cost(milliseconds: float) -> str:
    """What is measured to save time is what cannot be told from noise."""
    return f"+{milliseconds:.1f} ms" if milliseconds >= 0.05 else "about 0 ms"


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


_CLASSES = (SVGF_PT_warnings, SVGF_PT_cost, SVGF_OT_measure_effects, SVGF_PT_effects)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
