# SPDX-License-Identifier: GPL-3.0-or-later
"""svgf.Settings as properties of Blender's scene (scene.svgf), made from the settings' own fields.

Size and exposure are not among them: they are what Blender's output and Cycles' film settings say. Light paths are
Cycles' too, unless the scene asks for its own.
"""

from __future__ import annotations

from dataclasses import Field, fields
from typing import Any

import bpy
import numpy as np
from svgf.devices import NAMES as DEVICES
from svgf.light_paths import LARGEST_BOUNCES, LIGHT_PATH_RANGES, LightPaths
from svgf.scene import RenderDefaults
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
    "auto": ("Automatic", "Box; center for the denoisers of the papers", 0),
    "box": ("Box", "The mean over the pixel: smooth edges, but a G-buffer that jitters", 1),
    "center": ("Center", "The middle of the pixel: a steady G-buffer, but jagged edges", 2),
}
_DEVICES = {
    "auto": ("Automatic", "The GPU where there is a usable one, else the CPU", 0),
    "cuda": ("CUDA", "NVIDIA GPU", 1),
    "cpu": ("CPU", "All cores of the processor", 2),
    "reference": ("Reference", "numpy in float64: slow, for tests", 3),
}


# Blender's numbers are float32 and int, so that what a preset sets can be found again.
_PRESETS = {
    "draft": {"samples": 1, "viewport_samples": 32, "viewport_budget": 20.0},
    "balanced": {"samples": 1, "viewport_samples": 256, "viewport_budget": 50.0},
    "final": {"samples": 64, "viewport_samples": 4096, "viewport_budget": 100.0},
}
_CUSTOM = "custom"
_QUALITIES = (
    ("draft", "Draft", "1 sample per frame; views stay fluid and rest soon", 0),
    ("balanced", "Balanced", "1 sample per frame; views rest after 256", 1),
    ("final", "Final", "64 samples per frame; views go on to 4096", 2),
    (_CUSTOM, "Custom", "Samples and frame budget as they are set below", 3),
)
_LIGHT_PATHS = {
    "diffuse_bounces": "Bounces off diffuse surfaces; a path that has made them all still finds light directly",
    "glossy_bounces": "Bounces off glossy surfaces",
    "transmission_bounces": "Bounces through glass",
    "transparent_bounces": "Transparent surfaces that a ray goes straight through",
    "reflective_caustics": "Light that a diffuse surface gets by way of a mirror; the main source of noise",
    "refractive_caustics": "Light that a diffuse surface gets through glass; the main source of noise",
    "clamp_direct": "Largest light of one sample that comes straight from a lamp; 0 keeps all, and no energy is lost",
    "clamp_indirect": "Largest light of one sample that comes by other surfaces; 0 keeps all, and no energy is lost",
    "filter_glossy": "Blurs reflections that are seen by way of others, which lessens noise; 0 keeps them sharp",
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
    name = item.name.removeprefix("plus_").removeprefix("eaw_")  # of methods that are never shown together
    options = {} if item.type == "int" else {"precision": 3 if item.default < 1 else 1}
    if data["unit"] == "s":
        options["unit"] = "TIME_ABSOLUTE"
    return make(
        name=name.replace("_", " ").title(),
        description=description,
        default=item.default,
        min=data["minimum"],
        max=data["maximum"],
        update=_redraw_views,
        **options,
    )


# Without the steps, which are there to be measured.
_DENOISE_SETTINGS = [item for item in fields(DenoiseSettings) if item.name not in ("frame_rate", "steps")]

SVGFDenoiseSettings = type(
    "SVGFDenoiseSettings",
    (bpy.types.PropertyGroup,),
    {
        "__doc__": "svgf.DenoiseSettings, field by field; the frame rate is that of Blender's output.",
        "__annotations__": {item.name: _number_property(item) for item in _DENOISE_SETTINGS},
    },
)


def _light_path_property(item: Field) -> Any:
    named = {
        "name": item.name.replace("_", " ").title(),
        "description": _LIGHT_PATHS[item.name],
        "default": item.default,
        "update": _redraw_views,
    }
    if item.type == "bool":
        return bpy.props.BoolProperty(**named)
    smallest, largest = LIGHT_PATH_RANGES[item.name]
    if item.type == "int":
        return bpy.props.IntProperty(min=smallest, soft_max=32, max=largest, **named)
    return bpy.props.FloatProperty(min=smallest, soft_max=10.0, max=largest, **named)


SVGFLightPaths = type(
    "SVGFLightPaths",
    (bpy.types.PropertyGroup,),
    {
        "__doc__": "svgf.scene.LightPaths, field by field, and the number of all bounces.",
        "__annotations__": {
            "bounces": bpy.props.IntProperty(
                name="Bounces",
                description="Bounces of any kind after the first hit; 0 shows direct light only",
                default=RenderDefaults.bounces,
                min=0,
                soft_max=32,
                max=LARGEST_BOUNCES,
                update=_redraw_views,
            ),
            **{item.name: _light_path_property(item) for item in fields(LightPaths)},
        },
    },
)


def _find_quality(settings: SVGFSettings) -> int:
    for name, _, _, number in _QUALITIES[:-1]:
        if all(getattr(settings, key) == value for key, value in _PRESETS[name].items()):
            return number
    return _QUALITIES[-1][-1]


def _set_quality(settings: SVGFSettings, number: int) -> None:
    for key, value in _PRESETS.get(_QUALITIES[number][0], {}).items():
        setattr(settings, key, value)


class SVGFSettings(bpy.types.PropertyGroup):
    """svgf.Settings, and the device that renders."""

    device: bpy.props.EnumProperty(
        name="Device",
        description="What renders the image",
        items=_items(DEVICES, _DEVICES),
        default=DEVICES[0],
        update=_redraw_views,
    )
    quality: bpy.props.EnumProperty(
        name="Quality",
        description="Sets the samples and the frame budget of this scene at once",
        items=_QUALITIES,
        get=_find_quality,
        set=_set_quality,
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
        items=[(name, each.label, each.description, "", each.number) for name, each in OVERLAYS.items()],
        default="result",
        update=_redraw_views,
    )
    viewport_split: bpy.props.FloatProperty(
        name="Split",
        description="Where the noisy input ends and the result begins, as a share of the view's width",
        default=0.5,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
        update=_redraw_views,
    )
    viewport_budget: bpy.props.FloatProperty(
        name="Frame Budget",
        description=(
            "Milliseconds that a frame may take while the view or the scene changes. The resolution drops as far as "
            "that asks for, and is whole again when nothing changes; 0 keeps it whole"
        ),
        default=50.0,
        min=0.0,
        soft_max=1000.0,
        max=1e5,
        precision=0,
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
        description="Where in the pixel camera rays start; Cycles' own pixel filter is for Cycles alone",
        items=_items(PIXEL_FILTERS, _PIXEL_FILTERS),
        default=Settings.pixel_filter,
        update=_redraw_views,
    )
    denoise: bpy.props.PointerProperty(type=SVGFDenoiseSettings)
    use_own_light_paths: bpy.props.BoolProperty(
        name="Own Light Paths",
        description="Follow light as far as is set here, instead of as far as Cycles does",
        default=False,
        update=_redraw_views,
    )
    light_paths: bpy.props.PointerProperty(type=SVGFLightPaths)

    def to_settings(self, samples: int | None = None) -> Settings:
        """The settings of a render; samples: instead of the file's. Raises InputError like Settings."""
        denoise = {item.name: _as_written(getattr(self.denoise, item.name)) for item in _DENOISE_SETTINGS}
        render = self.id_data.render
        light_paths = {}
        if self.use_own_light_paths:
            names = ("bounces", *(item.name for item in fields(LightPaths)))
            light_paths = {name: _as_written(getattr(self.light_paths, name)) for name in names}
        return Settings(
            **light_paths,
            samples=samples or self.samples,
            seed=self.seed,
            method=self.method,
            signals=self.signals,
            pixel_filter=self.pixel_filter,
            denoise=DenoiseSettings(**denoise, frame_rate=render.fps / render.fps_base),
        )


def _as_written(value: float | int) -> float | int:
    """The decimal number that was typed in: Blender keeps 0.2 as 0.200000003, with which pixels would differ."""
    return value if isinstance(value, int) else float(str(np.float32(value)))


_CLASSES = (SVGFDenoiseSettings, SVGFLightPaths, SVGFSettings)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.svgf = bpy.props.PointerProperty(type=SVGFSettings)


def unregister() -> None:
    del bpy.types.Scene.svgf
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
