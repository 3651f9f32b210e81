# SPDX-License-Identifier: GPL-3.0-or-later
"""svgf.Settings as properties of Blender's scene (scene.svgf), made from the settings' own fields.

Size, bounces and exposure are not among them: they are what Blender's output and Cycles' light path settings say, so
that a file renders alike from the command line.
"""

from __future__ import annotations

from dataclasses import Field, fields
from typing import Any

import bpy
import numpy as np
from svgf.devices import NAMES as DEVICES
from svgf.settings import METHODS, PIXEL_FILTERS, SIGNALS, DenoiseSettings, Settings

from ..viewport.picture import OVERLAYS

_LARGEST_INT = 2**31 - 1  # of Blender's integer properties

# Blender stores the number of a choice in the file: numbers are never given to another one.
_METHODS = {
    "svgf+": (
        "SVGF+",
        "Spatiotemporal variance-guided filtering, improved: fireflies, lag, anti-aliasing, still views that converge",
        3,
    ),
    "svgf": (
        "SVGF",
        "Spatiotemporal variance-guided filtering [Schied17]: history and a filter as wide as the noise asks for",
        0,
    ),
    "eaw": ("Edge-Avoiding Wavelets", "Edge-avoiding a-trous wavelets [Dammertz10]: each frame by itself", 1),
    "none": ("None", "The path tracer's own picture", 2),
}
_SIGNALS = {
    "diffuse_specular": ("Diffuse, Specular", "Filter diffuse and specular light apart", 0),
    "direct_indirect": ("Direct, Indirect", "Filter direct and indirect light apart", 1),
}
_PIXEL_FILTERS = {
    "auto": ("Automatic", "Box without denoiser, else center", 0),
    "box": ("Box", "The mean over the pixel: smooth edges, but a G-buffer that jitters", 1),
    "center": ("Center", "The middle of the pixel: a steady G-buffer, but jagged edges", 2),
}
_DEVICES = {
    "auto": ("Automatic", "The GPU where there is a usable one, else the CPU", 0),
    "cuda": ("CUDA", "NVIDIA GPU", 1),
    "cpu": ("CPU", "All cores of the processor", 2),
    "reference": ("Reference", "numpy in float64: slow, for tests", 3),
}


def _items(names: tuple[str, ...], texts: dict[str, tuple[str, str, int]]) -> list[tuple[str, str, str, int]]:
    return [(name, *texts[name]) for name in names]


def _redraw_views(_properties, _context) -> None:
    """Drawing is what tells a viewport its settings, and an assignment in Python does not draw."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _number_property(item: Field) -> Any:
    """The property of a field whose metadata holds its range, meaning, unit and symbol."""
    data = item.metadata
    notes = [f"Unit: {data['unit']}"] * bool(data["unit"]) + [f"Symbol in the paper: {data['symbol']}"] * bool(
        data["symbol"]
    )
    # Blender ends a description with a full stop itself.
    description = ". ".join([data["meaning"].rstrip("."), *notes])
    make = bpy.props.IntProperty if item.type == "int" else bpy.props.FloatProperty
    options = {} if item.type == "int" else {"precision": 3}
    return make(
        name=item.name.replace("_", " ").title(),
        description=description,
        default=item.default,
        min=data["minimum"],
        max=data["maximum"],
        update=_redraw_views,
        **options,
    )


SVGFDenoiseSettings = type(
    "SVGFDenoiseSettings",
    (bpy.types.PropertyGroup,),
    {
        "__doc__": "svgf.DenoiseSettings, field by field.",
        "__annotations__": {item.name: _number_property(item) for item in fields(DenoiseSettings)},
    },
)


class SVGFSettings(bpy.types.PropertyGroup):
    """svgf.Settings, and the device that renders."""

    device: bpy.props.EnumProperty(
        name="Device",
        description="What renders the image",
        items=_items(DEVICES, _DEVICES),
        default=DEVICES[0],
        update=_redraw_views,
    )
    samples: bpy.props.IntProperty(
        name="Samples",
        description="Paths per pixel and frame",
        default=Settings.samples,
        min=1,
        soft_max=64,
        max=_LARGEST_INT,
    )
    viewport_samples: bpy.props.IntProperty(
        name="Viewport Samples",
        description="Frames that a viewport renders of a scene that stands still, before it rests",
        default=256,
        min=1,
        soft_max=4096,
        max=_LARGEST_INT,
        update=_redraw_views,
    )
    viewport_overlay: bpy.props.EnumProperty(
        name="Viewport Shows",
        description="The result, or one of the images that it is made from",
        items=[(name, *text[:2], "", text[2]) for name, text in OVERLAYS.items()],
        default="result",
        update=_redraw_views,
    )
    seed: bpy.props.IntProperty(
        name="Seed",
        description="Seed of the random numbers",
        default=Settings.seed,
        min=0,
        max=_LARGEST_INT,
        update=_redraw_views,
    )
    method: bpy.props.EnumProperty(
        name="Method",
        description="How the picture is denoised",
        items=_items(METHODS, _METHODS),
        default=Settings.method,
        update=_redraw_views,
    )
    signals: bpy.props.EnumProperty(
        name="Signals",
        description="Which parts of the light are filtered apart",
        items=_items(SIGNALS, _SIGNALS),
        default=Settings.signals,
        update=_redraw_views,
    )
    pixel_filter: bpy.props.EnumProperty(
        name="Pixel Filter",
        description="Where in the pixel camera rays start",
        items=_items(PIXEL_FILTERS, _PIXEL_FILTERS),
        default=Settings.pixel_filter,
        update=_redraw_views,
    )
    denoise: bpy.props.PointerProperty(type=SVGFDenoiseSettings)

    def to_settings(self, samples: int | None = None) -> Settings:
        """The settings of a render; samples: instead of the file's. Raises InputError like Settings."""
        denoise = {item.name: _as_written(getattr(self.denoise, item.name)) for item in fields(DenoiseSettings)}
        return Settings(
            samples=samples or self.samples,
            seed=self.seed,
            method=self.method,
            signals=self.signals,
            pixel_filter=self.pixel_filter,
            denoise=DenoiseSettings(**denoise),
        )


def _as_written(value: float | int) -> float | int:
    """The decimal number that was typed in: Blender keeps 0.2 as 0.200000003, with which pixels would differ."""
    return value if isinstance(value, int) else float(str(np.float32(value)))


def register() -> None:
    bpy.utils.register_class(SVGFDenoiseSettings)
    bpy.utils.register_class(SVGFSettings)
    bpy.types.Scene.svgf = bpy.props.PointerProperty(type=SVGFSettings)


def unregister() -> None:
    del bpy.types.Scene.svgf
    bpy.utils.unregister_class(SVGFSettings)
    bpy.utils.unregister_class(SVGFDenoiseSettings)
