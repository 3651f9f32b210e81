# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the render engine, and which of Blender's own panels show up for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, fields

import bpy
from svgf.light_paths import LightPaths
from svgf.settings import DenoiseSettings

_ENGINE = "SVGF"
# Blender marks panels that suit any engine with the name of its engine of old.
_ANY_ENGINE = "BLENDER_RENDER"
# Panels that are marked so, but show what SVGF does not simulate, or what a panel below shows better.
_LEFT_OUT = {"DATA_PT_light", "NODE_DATA_PT_light", "EEVEE_MATERIAL_PT_viewport_settings"}
_LEFT_OUT_PARTS = ("freestyle", "lightprobe", "gpencil", "grease_pencil", "RENDER_PT_simplify")
# Panels of other engines that show exactly what SVGF reads.
_BORROWED = {
    "DATA_PT_EEVEE_light",
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "OBJECT_PT_shadow_terminator",
    "VIEWLAYER_PT_override",
}
# Settings of denoisers that are for artists; the others are the papers' own.
_EVERYDAY = {"levels", "history_frames", "history_seconds", "firefly_limit"}
# Settings of svgf that svgf+ reads too.
_SHARED = {"depth_tolerance", "normal_tolerance"}
_OWN_LIGHT_PATHS = ("bounces", None, *(item.name for item in fields(LightPaths)))
_CYCLES_LIGHT_PATHS = (
    *("max_bounces", None, "diffuse_bounces", "glossy_bounces", "transmission_bounces", "transparent_max_bounces"),
    *(None, "sample_clamp_direct", "sample_clamp_indirect"),
    *(None, "blur_glossy", "caustics_reflective", "caustics_refractive"),
)


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
        settings, column = context.scene.svgf, self.columns()
        column.prop(settings, "device")
        column.prop(settings, "quality")
        column.separator()
        column.prop(settings, "viewport_samples")
        column.prop(settings, "viewport_budget", text="Frame Budget (ms)")
        column.separator()
        column.prop(settings, "samples", text="Render Samples")


class SVGF_PT_sampling_advanced(EnginePanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "SVGF_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for name in ("seed", "pixel_filter"):
            column.prop(context.scene.svgf, name)


class SVGF_PT_light_paths(EnginePanel, bpy.types.Panel):
    """Cycles' own settings, so that both engines render alike, unless the scene has some for svgf."""

    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings, column = context.scene.svgf, self.columns()
        column.prop(settings, "use_own_light_paths")
        if settings.use_own_light_paths:
            _list_properties(column, settings.light_paths, _OWN_LIGHT_PATHS)
        elif hasattr(context.scene, "cycles"):
            _list_properties(column, context.scene.cycles, _CYCLES_LIGHT_PATHS)


class SVGF_PT_film(EnginePanel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        if hasattr(context.scene, "cycles"):
            column.prop(context.scene.cycles, "film_exposure", text="Exposure")
        column.prop(context.scene.render, "film_transparent", text="Transparent")


class SVGF_PT_denoiser(EnginePanel, bpy.types.Panel):
    bl_label = "Denoiser"

    def draw(self, context: bpy.types.Context) -> None:
        settings, column = context.scene.svgf, self.columns()
        column.prop(settings, "method")
        if settings.method == "none":
            return
        column.prop(settings, "signals")
        for item in fields(DenoiseSettings):
            if item.name in _EVERYDAY and _is_read_by(settings.method, item):
                row = column.row()
                row.active = item.name != "history_frames" or settings.denoise.history_seconds == 0
                row.prop(settings.denoise, item.name)
                if item.name == "history_seconds":
                    _draw_longest_history(column, settings.to_settings().denoise)


def _draw_longest_history(column: bpy.types.UILayout, denoise: DenoiseSettings) -> None:
    frames = denoise.longest_history
    row = column.split(factor=0.4)  # as properties are
    row.label()
    row.label(text=f"{frames:.0f} frames, {frames / denoise.frame_rate:.2f} s in playback")


class SVGF_PT_denoiser_advanced(EnginePanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "SVGF_PT_denoiser"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.scene.svgf.method != "none"

    def draw(self, context: bpy.types.Context) -> None:
        settings, column = context.scene.svgf, self.columns()
        for item in fields(DenoiseSettings):
            own = item.name in settings.denoise.bl_rna.properties
            if own and item.name not in _EVERYDAY and _is_read_by(settings.method, item):
                symbol = item.metadata["symbol"]
                name = settings.denoise.bl_rna.properties[item.name].name
                column.prop(settings.denoise, item.name, text=f"{name} ({symbol})" if symbol else name)


class SVGF_PT_simplify(EnginePanel, bpy.types.Panel):
    """Blender's own would come before all of ours, and has settings of what SVGF does not draw."""

    bl_label = "Simplify"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.render, "use_simplify", text="")

    def draw(self, context: bpy.types.Context) -> None:
        render, column = context.scene.render, self.columns()
        column.active = render.use_simplify
        for view, render_only, text in (
            ("simplify_subdivision", "simplify_subdivision_render", "Viewport Subdivision"),
            ("simplify_child_particles", "simplify_child_particles_render", "Viewport Child Particles"),
        ):
            column.prop(render, view, text=text)
            column.prop(render, render_only, text="Render")
            column.separator()


class SVGF_PT_viewport(EnginePanel, bpy.types.Panel):
    bl_label = "Viewport Shows"

    def draw(self, context: bpy.types.Context) -> None:
        draw_overlay_menu(self.columns(), context)


class SVGF_PT_shading_overlay(bpy.types.Panel):
    """The same in the 3D view's own shading menu."""

    bl_label = "SVGF Shows"
    bl_space_type = "VIEW_3D"
    bl_region_type = "HEADER"
    bl_parent_id = "VIEW3D_PT_shading"
    COMPAT_ENGINES = {_ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES and context.space_data.shading.type == "RENDERED"

    def draw(self, context: bpy.types.Context) -> None:
        draw_overlay_menu(self.layout.column(), context)


def draw_overlay_menu(column: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.svgf
    column.prop(settings, "viewport_overlay", text="")
    if settings.viewport_overlay == "split":
        column.prop(settings, "viewport_split")


def _list_properties(column: bpy.types.UILayout, owner: bpy.types.bpy_struct, names: tuple[str | None, ...]) -> None:
    """None: a gap."""
    for name in names:
        column.separator() if name is None else column.prop(owner, name)


def _is_read_by(method: str, item: Field) -> bool:
    """Whether a method of denoising reads one of the settings."""
    if item.name == "levels":
        return True
    if item.name.startswith("eaw_"):
        return method == "eaw"
    if item.metadata["meaning"].startswith("svgf+:"):
        return method == "svgf+"
    return method == "svgf" or (method == "svgf+" and item.name in _SHARED)


_PANELS = (
    *(SVGF_PT_sampling, SVGF_PT_sampling_advanced, SVGF_PT_light_paths, SVGF_PT_film),
    *(SVGF_PT_denoiser, SVGF_PT_denoiser_advanced, SVGF_PT_simplify, SVGF_PT_viewport, SVGF_PT_shading_overlay),
)


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
