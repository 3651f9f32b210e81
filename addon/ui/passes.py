# SPDX-License-Identifier: GPL-3.0-or-later
"""Which passes a view layer asks for: Blender's own switches, and svgf's (view_layer.svgf) for what Blender has
none."""

from __future__ import annotations

import bpy
from svgf.passes import PASSES, Pass

from .panels import EnginePanel

# Blender's switches, and the pass of each.
_BLENDERS = {
    "use_pass_z": "Depth",
    "use_pass_normal": "Normal",
    "use_pass_vector": "Vector",
    "use_pass_object_index": "Object Index",
}
# Ours, by pass.
_OWN = {
    "Noisy Image": ("use_pass_noisy", "What the path tracer saw, before it was denoised"),
    "Denoising Albedo": ("use_pass_albedo", "Diffuse plus specular reflectance"),
    "Denoising Roughness": ("use_pass_roughness", "Roughness of the surface"),
    "Depth Change": ("use_pass_depth_change", "Depth that the surface had at the previous frame, minus depth now"),
    "Variance": ("use_pass_variance", "Variance of the luminance that the filter left over"),
    "History Length": ("use_pass_history", "Frames in the temporal mean of each pixel"),
}
# Combined is always there; accuracy is no pass.
_NO_PASSES = {"use_pass_combined", "use_pass_cryptomatte_accurate"}
# Switches of Cycles' own.
_CYCLES = (
    *("use_pass_volume_direct", "use_pass_volume_indirect", "use_pass_volume_scatter", "use_pass_volume_transmit"),
    *("use_pass_volume_majorant", "use_pass_shadow_catcher", "denoising_store_passes"),
    *("pass_debug_sample_count", "pass_render_time"),
)
_OLDER_NAMES = {} if bpy.app.version >= (5, 0, 0) else {"Object Index": "IndexOB"}

SVGFPasses = type(
    "SVGFPasses",
    (bpy.types.PropertyGroup,),
    {
        "__doc__": "Passes beyond those that Blender has switches for.",
        "__annotations__": {
            switch: bpy.props.BoolProperty(name=name, description=description, default=False)
            for name, (switch, description) in _OWN.items()
        },
    },
)


def wanted_passes(view_layer: bpy.types.ViewLayer) -> dict[str, Pass]:
    """By the name that this Blender gives it."""
    names = ["Combined"]
    names += [name for switch, name in _BLENDERS.items() if getattr(view_layer, switch)]
    names += [name for name, (switch, _) in _OWN.items() if getattr(view_layer.svgf, switch)]
    return {_OLDER_NAMES.get(name, name): PASSES[name] for name in names}


def unsupported_passes(view_layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """A sentence where the view layer asks for passes that svgf does not make."""
    names = [
        item.name
        for item in view_layer.bl_rna.properties
        if item.identifier.startswith("use_pass_")
        and item.identifier not in _NO_PASSES | _BLENDERS.keys()
        and getattr(view_layer, item.identifier)
    ]
    names += [f"{aov.name} (AOV)" for aov in view_layer.aovs]
    names += [f"{group.name} (light group)" for group in view_layer.lightgroups]
    cycles = getattr(view_layer, "cycles", None)  # absent where the Cycles add-on is disabled
    names += [cycles.bl_rna.properties[name].name for name in _CYCLES if getattr(cycles, name, False)]
    if not names:
        return ()
    return (f'View layer "{view_layer.name}": passes are not supported yet and left out: {", ".join(names)}.',)


class SVGF_PT_passes(EnginePanel, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.columns()
        for switch in _BLENDERS:
            column.prop(context.view_layer, switch)
        column.separator()
        for switch, _ in _OWN.values():
            column.prop(context.view_layer.svgf, switch)


def register() -> None:
    bpy.utils.register_class(SVGFPasses)
    bpy.types.ViewLayer.svgf = bpy.props.PointerProperty(type=SVGFPasses)
    bpy.utils.register_class(SVGF_PT_passes)


def unregister() -> None:
    bpy.utils.unregister_class(SVGF_PT_passes)
    del bpy.types.ViewLayer.svgf
    bpy.utils.unregister_class(SVGFPasses)
