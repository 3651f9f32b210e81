# SPDX-License-Identifier: Apache-2.0
"""svgf: real-time path tracing for Blender, denoised with Spatiotemporal Variance-Guided Filtering.

    scene = svgf.load("atrium.svgf", frame=1)
    frame = svgf.Renderer(svgf.Settings(width=960, height=540)).render(scene)

Names are imported on first use, so that ``import svgf`` is quick and touches no GPU.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

__version__ = "0.1.0"

_MODULE_OF = {
    "Camera": "scene",
    "DenoiseSettings": "settings",
    "Denoiser": "denoiser",
    "DeviceError": "errors",
    "Effects": "effects",
    "Error": "errors",
    "Frame": "frame",
    "InputError": "errors",
    "Instances": "scene",
    "Interrupted": "errors",
    "Light": "scene",
    "LightKind": "scene",
    "Material": "scene",
    "Mesh": "scene",
    "OutOfMemory": "errors",
    "Renderer": "renderer",
    "Scene": "scene",
    "SceneFile": "scene_file",
    "Settings": "settings",
    "Texture": "scene",
    "World": "scene",
    "available_devices": "devices",
    "load": "scene_file",
    "save": "scene_file",
}

__all__ = sorted(_MODULE_OF)

if TYPE_CHECKING:
    from .denoiser import Denoiser
    from .devices import available_devices
    from .effects import Effects
    from .errors import DeviceError, Error, InputError, Interrupted, OutOfMemory
    from .frame import Frame
    from .renderer import Renderer
    from .scene import Camera, Instances, Light, LightKind, Material, Mesh, Scene, Texture, World
    from .scene_file import SceneFile, load, save
    from .settings import DenoiseSettings, Settings


def __getattr__(name: str):
    try:
        module = _MODULE_OF[name]
    except KeyError:
        raise AttributeError(f"module 'svgf' has no attribute {name!r}") from None
    value = getattr(importlib.import_module(f".{module}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
