# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluated dependency graph, frame after frame, as scenes that know what moved."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import bpy
import numpy as np
from svgf.errors import InputError
from svgf.light_paths import LightPaths
from svgf.scene import Camera, Instances, Light, Material, Mesh, RenderDefaults, Scene, Texture, World

from .camera import export_camera, render_size
from .changes import Changes
from .findings import Finding, Findings
from .instances import Key, Layout, collect, moved_matrices, object_ids
from .materials import MaterialCache, MaterialTable
from .meshes import MeshCache
from .tangents import TangentCache, add_tangents
from .textures import TextureCache
from .unsupported import find_in_scene
from .uv_maps import find_uv_layers
from .world import export_world

_T = TypeVar("_T")


def never() -> bool:
    """Of Exporter.should_stop."""
    return False


@dataclass(frozen=True, eq=False)
class _Snapshot:
    """All of one frame but what moved since the one before. The keys are those of the rows of matrices."""

    frame: int
    camera_name: str
    camera: Camera
    keys: dict[Key, int]
    object_id: np.ndarray
    layout: Layout
    matrices: np.ndarray
    meshes: tuple[Mesh, ...]
    instance_mesh: np.ndarray
    material_start: np.ndarray
    visibility: np.ndarray
    terminator_offset: np.ndarray
    material_table: np.ndarray
    materials: tuple[Material, ...]
    textures: tuple[Texture, ...]
    lights: tuple[Light, ...]
    world: World
    defaults: RenderDefaults
    name: str
    warnings: tuple[str, ...]


@dataclass
class ExportCounters:
    """What an exporter did since it was made.

    exports: scenes that were made. walks: of these, made by looking at every object. full: walks that read every mesh.
    meshes: read from Blender. instances, materials, lights: that were new or differed from those of the export before.
    """

    exports: int = 0
    walks: int = 0
    full: int = 0
    meshes: int = 0
    instances: int = 0
    materials: int = 0
    lights: int = 0


class Exporter:
    """Exports the frames of one scene and view layer in turn. What did not change is the same object in each of them.

    The state at the previous frame is that of the last call, whichever frame it was for: ``observe`` takes one in
    without making a scene of it.

    should_stop: is asked before each mesh is read; where it says so, the call raises Interrupted, and is the last one.
    """

    def __init__(self) -> None:
        self.counters = ExportCounters()
        self.findings: tuple[Finding, ...] = ()  # of the last call
        self.should_stop: Callable[[], bool] = never
        self._meshes = MeshCache()
        self._tangents = TangentCache()
        self._textures = TextureCache()
        self._materials = MaterialCache()
        self._last: _Snapshot | None = None
        self._instances: Instances | None = None

    @property
    def frame(self) -> int | None:
        """The frame of the last call."""
        return self._last and self._last.frame

    def observe(
        self,
        depsgraph: bpy.types.Depsgraph,
        size: tuple[int, int] | None = None,
        camera: bpy.types.Object | None = None,
    ) -> None:
        """Makes the depsgraph's frame the previous one of the next export. Arguments as for ``export``."""
        self._take(depsgraph, size, camera)

    def export(
        self,
        depsgraph: bpy.types.Depsgraph,
        size: tuple[int, int] | None = None,
        camera: bpy.types.Object | None = None,
    ) -> Scene:
        """The depsgraph's frame as a scene.

        size: (width, height) of the image in pixels, those of the render settings by default. camera: an evaluated
        object, the scene's camera by default. Without a call before, nothing moves.
        Raises InputError without a camera or a mesh.
        """
        last = self._last
        now = self._take(depsgraph, size, camera)
        if not now.meshes:
            raise InputError(
                f'Scene "{now.name}" has no mesh to render at frame {now.frame}.',
                "Add one, or enable its rendering (the camera icon in the outliner).",
            )
        return self._scene(now, last)

    def export_view(
        self,
        depsgraph: bpy.types.Depsgraph,
        camera: Camera,
        changes: Changes | None = None,
        space: bpy.types.SpaceView3D | None = None,
    ) -> Scene:
        """The depsgraph's frame as a 3D view shows it, if need be without a mesh or a camera of its own.

        camera: of the view. changes: since the last call; None: unknown. space: hides what is not in its local view.
        """
        last = self._last
        if changes is not None:
            if changes.moves_only and last is not None and self._move(depsgraph, camera):
                return self._scene(self._last, last)
            self._textures.forget(changes.images)
        if changes is None or changes.images or changes.materials is None:
            self._materials.forget()
        else:
            self._materials.forget(changes.materials)
        geometry = changes.geometry if changes is not None and last is not None else None
        now = self._snapshot(
            depsgraph, render_size(depsgraph.scene_eval.render), "", camera, Findings(), geometry, space, waits=False
        )
        return self._scene(now, last)

    def _move(self, depsgraph: bpy.types.Depsgraph, camera: Camera) -> bool:
        """Brings the last snapshot up to date where nothing but matrices differs; False where there is more to read."""
        last = self._last
        matrices = moved_matrices(depsgraph, last.layout)
        if matrices is None:
            return False
        frame = depsgraph.scene_eval.frame_current
        self._last = replace(last, frame=frame, camera=_keep(camera, last.camera), matrices=matrices)
        self.counters.exports += 1
        self.counters.instances += _moved_count(self._last, last)
        return True

    def _take(
        self, depsgraph: bpy.types.Depsgraph, size: tuple[int, int] | None, camera: bpy.types.Object | None
    ) -> _Snapshot:
        """The frame as the scene's camera, or another one, sees it."""
        scene, findings = depsgraph.scene_eval, Findings()
        size, camera = size or render_size(scene.render), camera or scene.camera
        exported = export_camera(camera, scene, size, findings)
        self._materials.forget()
        return self._snapshot(depsgraph, size, camera.name_full, exported, findings)

    def _snapshot(
        self,
        depsgraph: bpy.types.Depsgraph,
        size: tuple[int, int],
        camera_name: str,
        camera: Camera,
        findings: Findings,
        changed: Set[str] | None = None,
        space: bpy.types.SpaceView3D | None = None,
        waits: bool = True,
    ) -> _Snapshot:
        """waits: for what others compute."""
        last, scene, view_layer = self._last, depsgraph.scene_eval, depsgraph.view_layer_eval
        find_in_scene(scene, view_layer, findings)
        layers = find_uv_layers(bpy.data.materials, bpy.data.meshes)
        materials = MaterialTable(self._textures, self._materials, findings, layers)
        self._meshes.start_frame(self.should_stop, changed, layers.names)
        placements = collect(depsgraph, self._meshes, materials, findings, space)
        use = placements.uv_use()
        materials.read(use)
        meshes = add_tangents(placements.meshes, materials.mesh_tangents(use), self._tangents)
        world = getattr(view_layer, "world_override", None) or scene.world
        waits = waits or bpy.app.background
        world, pictures = export_world(world, self._textures, findings, self.should_stop if waits else None)
        first = len(materials.textures)
        world = replace(
            world,
            environment=world.environment + first if world.environment >= 0 else -1,
            backdrop_environment=world.backdrop_environment + first if world.backdrop_environment >= 0 else -1,
        )
        textures = [*materials.textures, *pictures]
        keys = {key: row for row, key in enumerate(placements.keys)}
        self._last = _Snapshot(
            frame=scene.frame_current,
            camera_name=camera_name,
            camera=_keep(camera, last and last.camera),
            keys=keys,
            object_id=last.object_id if last and keys == last.keys else object_ids(keys),
            layout=placements.layout,
            matrices=placements.matrices,
            meshes=_keep_all(meshes, last and last.meshes),
            instance_mesh=np.array(placements.mesh, np.int32),
            material_start=np.array(placements.material_start, np.int32),
            visibility=np.array(placements.visibility, np.uint8),
            terminator_offset=np.array(placements.terminator_offset, np.float32),
            material_table=np.array(placements.material_table, np.int32),
            materials=_keep_all(materials.materials, last and last.materials),
            textures=_keep_all(textures, last and last.textures),
            lights=_keep_all(placements.lights, last and last.lights),
            world=_keep(world, last and last.world),
            defaults=render_defaults(scene, size),
            name=scene.name,
            warnings=findings.sentences(),
        )
        self.findings = findings.found()
        self._count(self._last, last, full=changed is None)
        return self._last

    def _count(self, now: _Snapshot, last: _Snapshot | None, full: bool) -> None:
        counters = self.counters
        counters.exports += 1
        counters.walks += 1
        counters.full += full
        counters.meshes = self._meshes.reads
        counters.instances += _moved_count(now, last)
        counters.materials += _new_count(now.materials, last and last.materials)
        counters.lights += _new_count(now.lights, last and last.lights)

    def _scene(self, now: _Snapshot, last: _Snapshot | None) -> Scene:
        instances = Instances(
            mesh=now.instance_mesh,
            object_to_world=now.matrices,
            previous_object_to_world=_previous_matrices(now, last),
            object_id=now.object_id,
            material_start=now.material_start,
            material_table=now.material_table,
            visibility=now.visibility,
            terminator_offset=now.terminator_offset,
        )
        self._instances = _keep(instances, self._instances)
        return Scene(
            meshes=now.meshes,
            instances=self._instances,
            materials=now.materials,
            camera=now.camera,
            previous_camera=last.camera if last else now.camera,
            textures=now.textures,
            lights=now.lights,
            world=now.world,
            frame=now.frame,
            cut=last is not None and last.camera_name != now.camera_name,
            name=now.name,
            defaults=now.defaults,
            warnings=now.warnings,
        )


def export_scene(
    depsgraph: bpy.types.Depsgraph, *, previous: Exporter | None = None, size: tuple[int, int] | None = None
) -> Scene:
    """One evaluated frame as a scene.

    previous: the exporter of the frame before, which is brought up to date; without one, nothing moves.
    size: (width, height) of the image in pixels, those of the render settings by default.
    Raises InputError without a camera or a mesh.
    """
    return (previous or Exporter()).export(depsgraph, size)


def _previous_matrices(now: _Snapshot, last: _Snapshot | None) -> np.ndarray:
    """float64 [N, 3, 4]: an object that was not there at the previous frame has not moved."""
    if last is None or not len(now.matrices):
        return now.matrices
    rows = _rows_before(now, last)
    known = rows >= 0
    previous = np.where(known[:, None, None], last.matrices[rows], now.matrices) if len(last.matrices) else now.matrices
    return now.matrices if np.array_equal(previous, now.matrices) else previous


def _moved_count(now: _Snapshot, last: _Snapshot | None) -> int:
    """Placements that are new, or elsewhere than in the last snapshot."""
    if last is None:
        return len(now.keys)
    rows = _rows_before(now, last)
    known = rows >= 0
    same = (now.matrices[known] == last.matrices[rows[known]]).all(axis=(1, 2))
    return len(rows) - int(np.count_nonzero(same))


def _rows_before(now: _Snapshot, last: _Snapshot) -> np.ndarray:
    """int [N] row of each placement in the last snapshot, -1 where it was not there."""
    if now.keys is last.keys:
        return np.arange(len(now.keys))
    return np.array([last.keys.get(key, -1) for key in now.keys], int)


def _new_count(now: tuple[_T, ...], last: tuple[_T, ...] | None) -> int:
    kept = {id(item) for item in last or ()}
    return sum(id(item) not in kept for item in now)


def render_defaults(scene: bpy.types.Scene, size: tuple[int, int]) -> RenderDefaults:
    """What an evaluated or original scene says about its render, for an image of this size."""
    render = scene.render
    cycles = getattr(scene, "cycles", None)  # absent where the Cycles add-on is disabled
    return RenderDefaults(
        *size,
        frames_per_second=render.fps / render.fps_base,
        bounces=getattr(cycles, "max_bounces", RenderDefaults.bounces),
        exposure=getattr(cycles, "film_exposure", RenderDefaults.exposure),
        light_paths=LightPaths() if cycles is None else _light_paths(cycles),
        transparent_film=render.film_transparent,
    )


def _light_paths(cycles: bpy.types.PropertyGroup) -> LightPaths:
    """Cycles' own settings of a scene."""
    return LightPaths(
        diffuse_bounces=cycles.diffuse_bounces,
        glossy_bounces=cycles.glossy_bounces,
        transmission_bounces=cycles.transmission_bounces,
        transparent_bounces=cycles.transparent_max_bounces,
        reflective_caustics=cycles.caustics_reflective,
        refractive_caustics=cycles.caustics_refractive,
        clamp_direct=cycles.sample_clamp_direct,
        clamp_indirect=cycles.sample_clamp_indirect,
        filter_glossy=cycles.blur_glossy,
    )


def _keep(new: _T, old: _T | None) -> _T:
    """The old object where the new one holds the same."""
    return old if old is not None and _same(new, old) else new


def _keep_all(new: list[_T], old: tuple[_T, ...] | None) -> tuple[_T, ...]:
    """The old tuple, or at least its members, where the new ones hold the same."""
    old = old or ()
    kept = tuple(_keep(item, old[index]) if index < len(old) else item for index, item in enumerate(new))
    return old if len(kept) == len(old) and all(a is b for a, b in zip(kept, old, strict=True)) else kept


def _same(a: Any, b: Any) -> bool:
    """Whether two dataclasses hold equal values. Large ones come from a cache and are compared by identity there."""
    if a is b or isinstance(a, Mesh | Texture):
        return a is b
    return all(np.array_equal(getattr(a, field.name), getattr(b, field.name)) for field in fields(a))
