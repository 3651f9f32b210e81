# SPDX-License-Identifier: Apache-2.0
"""What each effect costs: the same scene with and without it, and with the kernel that simulates everything.

Times are the device's own, of stages gbuffer and path together at one sample per pixel: medians over launches that
take turns, so that a change of the clock reaches both sides. Bytes are those of the images that a frame hands to the
denoiser.
"""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..devices import Device
from ..effects import Effects
from ..flatten import flatten
from ..light_paths import LightPaths
from ..renderer import SceneUploader
from ..scene import Aperture, Camera, LightKind, Material, MaterialKind, RayVisibility, Scene, World

FULL_KERNEL = "full kernel"


@dataclass(frozen=True)
class EffectCost:
    """what: an effect, or FULL_KERNEL: "on" is then the kernel that simulates everything, "off" the one that the
    scene takes.
    milliseconds and bytes per pixel of a frame with it and without."""

    scene: str
    what: str
    on_ms: float
    off_ms: float
    on_bytes: float
    off_bytes: float


def measure(
    device: Device, name: str, scene: Scene, size: tuple[int, int], bounces: int | None = None, count: int = 16
) -> list[EffectCost]:
    """One row for each effect that the scene has, then one for the full kernel. count: launches of each side."""
    effects = flatten(scene).effects
    bounces = scene.defaults.bounces if bounces is None else bounces
    whole = _Run(device, scene, size, bounces)
    rows = []
    for effect in Effects:
        if effect in effects:
            without = _Run(device, WITHOUT[effect](scene), size, bounces)
            rows.append(_compare(name, effect.name, whole, without, count))
    full = _Run(device, scene, size, bounces, kernel=device.kernels[-1])
    rows.append(_compare(name, FULL_KERNEL, full, whole, count))
    return rows


class _Run:
    """One way to trace a scene."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        bounces: int,
        kernel: Effects = Effects.NONE,
    ) -> None:
        flat = flatten(scene)
        self._device = device
        self._tracer = device.tracer()
        SceneUploader(device, self._tracer).upload(flat)
        self._arguments: dict[str, Any] = {
            "width": size[0],
            "height": size[1],
            "samples": 1,
            "seed": 0,
            "bounces": bounces,
            "effects": int(flat.effects),
            "pixel_filter": "center",
            "signals": "diffuse_specular",
            "light_paths": dataclasses.astuple(scene.defaults.light_paths),
            "kernel": int(kernel),
        }
        images = self._tracer.trace(sample=0, **self._arguments)
        # All of them have four bytes per channel.
        self.bytes_per_pixel = sum(4.0 * int(np.prod(image.shape[2:])) for image in images.values())
        device.take_timings()

    def milliseconds(self, sample: int) -> float:
        self._tracer.trace(sample=sample, **self._arguments)
        return sum(self._device.take_timings().values())


def _compare(scene: str, what: str, on: _Run, off: _Run, count: int) -> EffectCost:
    times = [(on.milliseconds(sample), off.milliseconds(sample)) for sample in range(count + 1)][1:]
    on_ms, off_ms = (statistics.median(side) for side in zip(*times))
    return EffectCost(scene, what, on_ms, off_ms, on.bytes_per_pixel, off.bytes_per_pixel)


def _materials(scene: Scene, kinds: tuple[MaterialKind, ...] = (), **constants: Any) -> Scene:
    """All materials with these constants in place of whatever they had, and those of these kinds as DIFFUSE."""

    def changed(material: Material) -> Material:
        maps = {name: texture for name, texture in material.maps.items() if name not in constants}
        kind = MaterialKind.DIFFUSE if material.kind in kinds else material.kind
        return dataclasses.replace(material, kind=kind, maps=maps, **constants)

    return dataclasses.replace(scene, materials=tuple(map(changed, scene.materials)))


def _without_maps(scene: Scene, *names: str) -> Scene:
    """Without the maps of these inputs; of all, if none is named."""
    materials = tuple(
        dataclasses.replace(
            material, maps={name: texture for name, texture in material.maps.items() if names and name not in names}
        )
        for material in scene.materials
    )
    return dataclasses.replace(scene, materials=materials)


def _without_mixes(scene: Scene) -> Scene:
    """Each mix is its first part."""

    def part(material: Material) -> Material:
        return part(scene.materials[material.first]) if material.is_mix else material

    return dataclasses.replace(scene, materials=tuple(map(part, scene.materials)))


def _without_lamps(scene: Scene, sized: bool) -> Scene:
    area = (LightKind.RECTANGLE, LightKind.ELLIPSE)
    lights = tuple(light for light in scene.lights if (light.kind in area or light.size[0] > 0.0) != sized)
    return dataclasses.replace(scene, lights=lights)


def _without_object_motion(scene: Scene) -> Scene:
    instances = dataclasses.replace(scene.instances, previous_object_to_world=scene.instances.object_to_world)
    return dataclasses.replace(scene, instances=instances)


def _without_deformation(scene: Scene) -> Scene:
    meshes = tuple(dataclasses.replace(mesh, previous_positions=None) for mesh in scene.meshes)
    return dataclasses.replace(scene, meshes=meshes)


def _without_depth_of_field(scene: Scene) -> Scene:
    def in_focus(camera: Camera) -> Camera:
        return dataclasses.replace(camera, aperture=Aperture())

    return dataclasses.replace(scene, camera=in_focus(scene.camera), previous_camera=in_focus(scene.previous_camera))


def _seen_by_all(scene: Scene) -> Scene:
    # Lamps stay unseen by the camera, as they are unless told otherwise.
    lights = tuple(
        dataclasses.replace(light, visibility=light.visibility | RayVisibility.ALL & ~RayVisibility.CAMERA)
        for light in scene.lights
    )
    instances = dataclasses.replace(scene.instances, visibility=None)
    world = dataclasses.replace(scene.world, visibility=RayVisibility.ALL)
    return dataclasses.replace(scene, lights=lights, instances=instances, world=world)


def _without_light_path_limits(scene: Scene) -> Scene:
    # What alpha lets through stays: that is no such limit.
    limits = LightPaths(transparent_bounces=scene.defaults.light_paths.transparent_bounces)
    return dataclasses.replace(scene, defaults=dataclasses.replace(scene.defaults, light_paths=limits))


def _with_one_light(scene: Scene) -> Scene:
    """Of lamps the one of the most power; without lamps it is dark."""
    lights = sorted(scene.lights, key=lambda light: max(light.power))[-1:]
    world = dataclasses.replace(scene.world, environment=-1)
    return dataclasses.replace(_materials(scene, emission=(0.0, 0.0, 0.0)), lights=tuple(lights), world=world)


def _without_perfect_specular(scene: Scene) -> Scene:
    """Mirrors and glass with the least roughness that scatters."""

    def frosted(material: Material) -> Material:
        least = {name: max(getattr(material, name), 0.05) for name in ("roughness", "coat_roughness")}
        ior = material.ior if material.ior != 1.0 else 1.01
        maps = {name: texture for name, texture in material.maps.items() if name not in (*least, "ior")}
        return dataclasses.replace(material, maps=maps, ior=ior, **least)

    return dataclasses.replace(scene, materials=tuple(map(frosted, scene.materials)))


WITHOUT: dict[Effects, Callable[[Scene], Scene]] = {
    Effects.TEXTURES: _without_maps,
    Effects.SPECULAR: lambda scene: _materials(
        scene,
        (MaterialKind.GLOSSY, MaterialKind.GLASS, MaterialKind.REFRACTION),
        metallic=0.0,
        transmission=0.0,
        specular_ior_level=0.0,
        coat_weight=0.0,
        sheen_weight=0.0,
        diffuse_roughness=0.0,
    ),
    Effects.TRANSMISSION: lambda scene: _materials(
        scene, (MaterialKind.GLASS, MaterialKind.REFRACTION, MaterialKind.TRANSLUCENT), transmission=0.0
    ),
    Effects.PERFECT_SPECULAR: _without_perfect_specular,
    Effects.MESH_LIGHTS: lambda scene: _materials(scene, emission=(0.0, 0.0, 0.0)),
    Effects.ALPHA: lambda scene: _materials(scene, (MaterialKind.TRANSPARENT,), alpha=1.0),
    Effects.NORMAL_MAPS: lambda scene: _without_maps(scene, "normal"),
    Effects.COAT: lambda scene: _materials(scene, coat_weight=0.0),
    Effects.SHEEN: lambda scene: _materials(scene, sheen_weight=0.0),
    Effects.ANISOTROPY: lambda scene: _materials(scene, anisotropic=0.0),
    Effects.MATERIAL_MIXES: _without_mixes,
    Effects.DELTA_LIGHTS: lambda scene: _without_lamps(scene, sized=False),
    Effects.AREA_LIGHTS: lambda scene: _without_lamps(scene, sized=True),
    Effects.ENVIRONMENT: lambda scene: dataclasses.replace(scene, world=World()),
    Effects.ENVIRONMENT_MAP: lambda scene: dataclasses.replace(
        scene, world=dataclasses.replace(scene.world, environment=-1)
    ),
    Effects.DEPTH_OF_FIELD: _without_depth_of_field,
    Effects.RAY_VISIBILITY: _seen_by_all,
    Effects.LIGHT_PATH_LIMITS: _without_light_path_limits,
    Effects.MANY_LIGHTS: _with_one_light,
    Effects.CAMERA_MOTION: lambda scene: dataclasses.replace(scene, previous_camera=scene.camera),
    Effects.OBJECT_MOTION: _without_object_motion,
    Effects.DEFORMATION: _without_deformation,
}


def plot(rows: Sequence[EffectCost], title: str) -> bytes:
    """A PNG: milliseconds with and without each effect, one column of bars per scene."""
    import io

    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(row.scene for row in rows))
    most = max(sum(row.scene == scene for row in rows) for scene in scenes)
    figure = Figure(figsize=(5 * len(scenes), 1.2 + 0.5 * most), layout="constrained")
    figure.suptitle(title)
    for column, scene in enumerate(scenes):
        axes = figure.add_subplot(1, len(scenes), column + 1)
        mine = [row for row in rows if row.scene == scene]
        places = np.arange(len(mine))
        axes.barh(places - 0.2, [row.on_ms for row in mine], 0.4, label="on")
        axes.barh(places + 0.2, [row.off_ms for row in mine], 0.4, label="off")
        axes.set_yticks(places, [row.what.lower().replace("_", " ") for row in mine])
        axes.invert_yaxis()
        axes.set_xlabel("ms per frame (gbuffer and path)")
        axes.set_title(scene)
        if column == 0:
            axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
