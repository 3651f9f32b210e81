# SPDX-License-Identifier: Apache-2.0
"""``svgf doctor``: what is installed, which devices work and why one does not, and what a scene asks of them."""

from __future__ import annotations

import importlib
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.table import Table

    from ..effects import Effects
    from ..scene import Scene

_PACKAGES = {"numpy": "numpy", "OpenEXR": "OpenEXR", "bpy": "bpy", "cupy": "cupy-cuda13x"}


def doctor(
    file: Annotated[
        Path | None, typer.Argument(help="A .svgf or .blend file to look into.", show_default=False)
    ] = None,
) -> None:
    """Show versions and devices, and for a scene what is in it and which effects it calls for."""
    from rich.console import Console

    console = Console(highlight=False)

    def show(title: str, table: Table) -> None:
        console.print(title, markup=False, soft_wrap=True)
        console.print(table)

    show("Versions", _versions())
    show("Devices", _devices())
    if file is not None:
        scenes = _read(file)
        show(f"{file}, frame {scenes[0].frame}", _contents(file, scenes))
        show("Effects", _effects(scenes))
        show("Kernel of each device", _kernels(scenes))
        for warning in dict.fromkeys(warning for scene in scenes for warning in scene.warnings):
            console.print(f"Warning: {warning}", markup=False, soft_wrap=True)


def _table(*columns: str) -> Table:
    from rich.table import Table

    table = Table(show_header=len(columns) > 2)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _versions() -> Table:
    from .. import __version__

    table = _table("package", "version")
    table.add_row("svgf", __version__)
    table.add_row("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    for name, distribution in _PACKAGES.items():
        table.add_row(name, _version(name, distribution))
    return table


def _version(module: str, distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        pass
    # cupy comes under many names; Blender's own Python has bpy without a distribution.
    try:
        return str(getattr(importlib.import_module(module), "__version__", "present"))
    except Exception:  # a broken optional package must not keep the doctor from reporting the rest
        return "not installed (optional)" if module in ("bpy", "cupy") else "cannot be imported"


def _devices() -> Table:
    from ..devices import available_devices

    table = _table("device", "usable", "what it is, or why not")
    for info in available_devices():
        memory = f", {info.memory_bytes / 2**30:.1f} GiB" if info.memory_bytes else ""
        table.add_row(
            info.name,
            "yes" if info.available else "no",
            f"{info.description}{memory}" if info.available else info.reason,
        )
    return table


def _read(file: Path) -> list[Scene]:
    """All frames of an .svgf, the first of a .blend: stepping through one takes as long as exporting it."""
    from .progress import progress_bar
    from .sources import open_scenes

    with progress_bar(file.name, None) as bar, open_scenes(file, None, None, bar.report) as scenes:
        return [next(scenes)] if file.suffix.lower() == ".blend" else list(scenes)


def _contents(file: Path, scenes: Sequence[Scene]) -> Table:
    import numpy as np

    from ..frame_range import format_frames
    from ..scene import LightKind

    scene = scenes[0]
    counts = np.bincount(scene.instances.mesh, minlength=len(scene.meshes))
    triangles = np.array([len(mesh.triangles) for mesh in scene.meshes], np.int64)
    kinds = [kind.name.lower() for kind in LightKind for light in scene.lights if light.kind is kind]
    table = _table("what", "how many")
    frames = format_frames(scene.frame for scene in scenes)
    table.add_row(
        "frames", f"{frames} (the first one only was looked at)" if file.suffix.lower() == ".blend" else frames
    )
    table.add_row("size", f"{scene.defaults.width}x{scene.defaults.height}, {scene.defaults.frames_per_second:g} fps")
    table.add_row("bounces", str(scene.defaults.bounces))
    table.add_row("meshes", f"{len(scene.meshes)}, {triangles.sum():,} triangles")
    table.add_row("instances", f"{len(scene.instances.mesh)}, {(triangles * counts).sum():,} triangles in all")
    table.add_row("materials", str(len(scene.materials)))
    table.add_row("textures", str(len(scene.textures)))
    table.add_row("lights", ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none")
    return table


def _effects(scenes: Sequence[Scene]) -> Table:
    from ..effects import Effects, find_effects

    found: dict[Effects, str] = {}
    for scene in scenes:
        for effect in find_effects(scene) & ~Effects(sum(found)):
            found[effect] = f"{_reason(scene, effect)}{f' (frame {scene.frame})' if len(scenes) > 1 else ''}"
    table = _table("effect", "simulated", "because of")
    for effect in Effects:
        table.add_row(effect.name, "yes" if effect in found else "no", found.get(effect, ""))
    return table


def _kernels(scenes: Sequence[Scene]) -> Table:
    """The kernel that the scene's most demanding frame takes."""
    from functools import reduce

    from ..devices import available_devices, open_device
    from ..effects import Effects, find_effects

    effects = reduce(Effects.__or__, map(find_effects, scenes))
    table = _table("device", "kernel", "compiled without")
    for info in available_devices():
        if not info.available:
            continue
        device = open_device(info.name)
        kernel = device.kernel_for(effects)
        place = f"{device.kernels.index(kernel) + 1} of {len(device.kernels)}"
        left_out = ", ".join(effect.name for effect in Effects if effect not in kernel)
        table.add_row(info.name, place, left_out or "nothing")
    return table


def _reason(scene: Scene, effect: Effects) -> str:
    """What in the scene calls for the effect."""
    import numpy as np

    from ..effects import Effects, used_materials
    from ..scene import LightKind

    materials = [scene.materials[index] for index in np.flatnonzero(used_materials(scene))]
    sized = [
        light for light in scene.lights if light.kind in (LightKind.RECTANGLE, LightKind.ELLIPSE) or light.size[0] > 0.0
    ]
    lit = [light for light in scene.lights if max(light.power) > 0.0]
    instances = scene.instances
    moving = (instances.object_to_world != instances.previous_object_to_world).any(axis=(1, 2))
    deforming = [mesh.name for mesh in scene.meshes if mesh.previous_positions is not None]
    match effect:
        case Effects.TEXTURES:
            return _names("material", [material.name for material in materials if material.maps])
        case Effects.TRANSMISSION:
            return _names("material", [material.name for material in materials if material.transmission > 0.0])
        case Effects.MESH_LIGHTS:
            return _names("material", [material.name for material in materials if max(material.emission) > 0.0])
        case Effects.SPECULAR:
            specular = (
                material.name
                for material in materials
                if material.metallic > 0.0
                or material.transmission > 0.0
                or (material.specular_ior_level > 0.0 and material.ior != 1.0)
            )
            return _names("material", list(specular))
        case Effects.AREA_LIGHTS:
            return _names("lamp", [light.name for light in lit if light in sized])
        case Effects.DELTA_LIGHTS:
            return _names("lamp", [light.name for light in lit if light not in sized])
        case Effects.ENVIRONMENT:
            return "the world's radiance is {:.3g}, {:.3g}, {:.3g}".format(*scene.world.radiance)
        case Effects.CAMERA_MOTION:
            return "the camera moved"
        case Effects.OBJECT_MOTION:
            return f"{np.count_nonzero(moving)} of {len(moving)} instances moved"
        case Effects.DEFORMATION:
            return _names("mesh", deforming)
    return ""


def _names(what: str, names: list[str]) -> str:
    shown = ", ".join(names[:4])
    return f"{what} {shown}" + (f" and {len(names) - 4} more" if len(names) > 4 else "")
