# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render engine, and which of Blender's own panels show up for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import bpy
from svgf.settings import DenoiseSettings

_ENGINE = "SVGF"
# Blender marks panels that suit any engine with the name of its engine of old.
_ANY_ENGINE = "BLENDER_RENDER"
# Panels that are marked so, but show what SVGF does not simulate, or what a panel below shows better.
_LEFT_OUT = {"DATA_PT_light", "NODE_DATA_PT_light", "EEVEE_MATERIAL_PT_viewport_settings"}
_LEFT_OUT_PARTS = ("freestyle", "lightprobe", "gpencil", "grease_pencil")
# Panels of other engines that show exactly what SVGF reads.
_BORROWED = {
    "DATA_PT_EEVEE_light",
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "VIEWLAYER_PT_override",
}


class EnginePanel:
    """A panel of the render properties."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {_ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def columns(self) -> bpy.types.UILayout:
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        return layout.column()


class SVGF_PT_sampling(EnginePanel, bpy.types.Panel):
    bl_label = "Sampling"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for name in ("device", "samples", "viewport_samples", "viewport_overlay", "seed", "pixel_filter"):
            column.prop(context.scene.svgf, name)


class SVGF_PT_light_paths(EnginePanel, bpy.types.Panel):
    """Cycles' own settings, so that both engines render alike."""

    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and hasattr(context.scene, "cycles")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        column.prop(context.scene.cycles, "max_bounces", text="Bounces")
        column.prop(context.scene.cycles, "film_exposure", text="Exposure")


class SVGF_PT_denoiser(EnginePanel, bpy.types.Panel):
    bl_label = "Denoiser"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for name in ("method", "signals"):
            column.prop(context.scene.svgf, name)


class SVGF_PT_denoiser_advanced(EnginePanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "SVGF_PT_denoiser"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.scene.svgf.method != "none"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        wavelets = context.scene.svgf.method == "eaw"
        for item in fields(DenoiseSettings):
            if item.name == "levels" or item.name.startswith("eaw_") == wavelets:
                column.prop(context.scene.svgf.denoise, item.name)


_PANELS = (SVGF_PT_sampling, SVGF_PT_light_paths, SVGF_PT_denoiser, SVGF_PT_denoiser_advanced)


def _blender_panels() -> Iterator[type[bpy.types.Panel]]:
    for panel in bpy.types.Panel.__subclasses__():
        name, engines = panel.__name__, getattr(panel, "COMPAT_ENGINES", ())
        left_out = name in _LEFT_OUT or any(part in name for part in _LEFT_OUT_PARTS)
        if name in _BORROWED or (_ANY_ENGINE in engines and not left_out):
            yield panel


def register() -> None:
    for panel in _PANELS:
        bpy.utils.register_class(panel)
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.add(_ENGINE)


def unregister() -> None:
    for panel in _blender_panels():
        panel.COMPAT_ENGINES.discard(_ENGINE)
    for panel in reversed(_PANELS):
        bpy.utils.unregister_class(panel)
