# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the dependency graph places in the world, one row for each placement of a mesh."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from zlib import crc32

import bpy
import numpy as np
from svgf.scene import Light, Mesh, RayVisibility

from .findings import Findings
from .lights import export_light
from .materials import MaterialTable
from .meshes import MeshCache
from .unsupported import find_in_object
from .uv_maps import UvUse
from .visibility import ray_visibility

# Names a placement in every frame: the object, and for an instance also its parent and its number there.
Key = tuple[str, str, bytes]

# Exact in the float32 channel of an object index pass.
_LARGEST_OBJECT_ID = (1 << 24) - 1
# A cosine; beyond it nothing changes.
_LARGEST_TERMINATOR_OFFSET = 1e6

_UNSUPPORTED_TYPES = {
    "CURVES": "hair curves are",
    "POINTCLOUD": "point clouds are",
    "VOLUME": "volumes are",
    "GREASEPENCIL": "grease pencil is",
}


@dataclass(frozen=True, eq=False)
class Layout:
    """Which of the depsgraph's instances became rows: as long as they stay the same, their matrices are all to read.

    persistent_ids: int32 [I, 8] of all instances. rows: those that are placements. still: int [J], instances whose
    matrix matters to more than a placement (lamps), or that were left out for it. matrices: float32 [J, 4, 4] of these.
    """

    persistent_ids: np.ndarray
    rows: np.ndarray
    still: np.ndarray
    matrices: np.ndarray


@dataclass
class Placements:
    """Rows of mesh placements, and the lamps. The lists and matrices have one entry a row.

    mesh: index into meshes. matrices: float64 [N, 3, 4], object to world. material_start: into material_table.
    visibility: bits of RayVisibility. terminator_offset: see svgf.scene.Instances.
    """

    meshes: list[Mesh] = field(default_factory=list)
    keys: list[Key] = field(default_factory=list)
    mesh: list[int] = field(default_factory=list)
    material_start: list[int] = field(default_factory=list)
    visibility: list[int] = field(default_factory=list)
    terminator_offset: list[float] = field(default_factory=list)
    material_table: list[int] = field(default_factory=list)
    matrices: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 4)))
    lights: list[Light] = field(default_factory=list)
    layout: Layout | None = None

    def uv_use(self) -> UvUse:
        scales = np.cbrt(np.abs(np.linalg.det(self.matrices[:, :, :3])))
        return UvUse(self.meshes, zip(self.mesh, self.material_start, strict=True), self.material_table, scales)


def collect(
    depsgraph: bpy.types.Depsgraph,
    mesh_cache: MeshCache,
    materials: MaterialTable,
    findings: Findings,
    space: bpy.types.SpaceView3D | None = None,
) -> Placements:
    """Reads all object instances of the evaluated frame, those that `space` hides (as in its local view) left out."""
    return _Collector(mesh_cache, materials, findings, depsgraph, space).collect()


def moved_matrices(depsgraph: bpy.types.Depsgraph, layout: Layout) -> np.ndarray | None:
    """Placements.matrices where objects have moved and nothing else; None where that is not all there is to read."""
    matrices, persistent_ids = _read(depsgraph)
    if not np.array_equal(persistent_ids, layout.persistent_ids):
        return None
    if not np.array_equal(matrices[layout.still], layout.matrices, equal_nan=True):
        return None
    moved = matrices[layout.rows, :3].astype(np.float64)
    return moved if np.isfinite(moved).all() else None


def _read(depsgraph: bpy.types.Depsgraph) -> tuple[np.ndarray, np.ndarray]:
    """Of all instances: matrices, float32 [N, 4, 4], and persistent ids, int32 [N, 8]."""
    instances = depsgraph.object_instances
    count = len(instances)
    matrices = np.empty((count, 4, 4), np.float32)
    persistent_ids = np.empty((count, 8), np.int32)
    instances.foreach_get("matrix_world", matrices.ravel())
    instances.foreach_get("persistent_id", persistent_ids.ravel())
    return matrices.transpose(0, 2, 1), persistent_ids  # Blender stores matrices by columns


def object_ids(keys: Iterable[Key]) -> np.ndarray:
    """int32 [N] in [1, 2^24): hashes of the keys, so that any frame of an animation gives an object the same number.

    Of two keys with the same hash the one that sorts first keeps it and the other takes the next free number.
    """
    keys = list(keys)
    hashes = {key: crc32("\0".join(key[:2]).encode() + key[2]) % _LARGEST_OBJECT_ID + 1 for key in keys}
    if len(set(hashes.values())) < len(hashes):
        taken: set[int] = set()
        for key in sorted(hashes):
            number = hashes[key]
            while number in taken:
                number = number % _LARGEST_OBJECT_ID + 1
            taken.add(number)
            hashes[key] = number
    return np.array([hashes[key] for key in keys], np.int32)


class _Collector:
    def __init__(
        self,
        mesh_cache: MeshCache,
        materials: MaterialTable,
        findings: Findings,
        depsgraph: bpy.types.Depsgraph,
        space: bpy.types.SpaceView3D | None,
    ) -> None:
        self._mesh_cache = mesh_cache
        self._materials = materials
        self._findings = findings
        self._depsgraph = depsgraph
        self._view_layer = depsgraph.view_layer
        self._override = depsgraph.view_layer_eval.material_override
        self._space = space
        self._visibilities: dict[str, RayVisibility] = {}
        self._rows: list[int] = []
        self._placements = Placements()
        self._meshes: dict[int, int | None] = {}  # address of Blender's mesh -> index, None without triangles
        self._mesh_indices: dict[int, int] = {}  # id of a Mesh -> index
        self._slot_counts: list[int] = []  # that each mesh asks for
        self._geometry: dict[tuple[str, int], tuple[int, int] | None] = {}
        self._table_starts: dict[tuple[int, ...], int] = {}
        self._used_keys: dict[Key, int] = {}

    def collect(self) -> Placements:
        stored, persistent_ids = _read(self._depsgraph)
        matrices = stored.astype(np.float64)
        finite = np.isfinite(matrices).all(axis=(1, 2))
        id_bytes = persistent_ids.tobytes()
        still = []
        for row, instance in enumerate(self._depsgraph.object_instances):
            owner = instance.object
            kind = owner.type
            if kind not in {"MESH", "LIGHT"} or not instance.show_self:
                if kind in _UNSUPPORTED_TYPES:
                    self._findings.add(owner, f"{_UNSUPPORTED_TYPES[kind]} not supported yet; the object is left out.")
                continue
            if self._space is not None and not self._is_in_view(instance):
                continue
            if kind == "LIGHT" or not finite[row]:
                still.append(row)
            if not finite[row]:
                self._findings.add(owner, "its transform is not finite; it is left out.")
            elif kind == "LIGHT":
                light = export_light(owner, matrices[row], self._findings)
                if light is not None:
                    self._placements.lights.append(light)
            else:
                key: Key = (owner.name_full, "", b"")
                if instance.is_instance:
                    key = (owner.name_full, instance.parent.name_full, id_bytes[32 * row : 32 * row + 32])
                self._add_mesh(owner, row, key, self._visibility(instance))
        self._placements.matrices = matrices[self._rows, :3]
        self._placements.layout = Layout(persistent_ids, np.array(self._rows, int), np.array(still, int), stored[still])
        return self._placements

    def _is_in_view(self, instance: bpy.types.DepsgraphObjectInstance) -> bool:
        """An instance is where its instancer is."""
        return (instance.parent if instance.is_instance else instance.object).visible_in_viewport_get(self._space)

    def _visibility(self, instance: bpy.types.DepsgraphObjectInstance) -> RayVisibility:
        """Rays see an instance that see both the object and its instancer."""
        rays = self._visibility_of(instance.object)
        return rays & self._visibility_of(instance.parent) if instance.is_instance else rays

    def _visibility_of(self, obj: bpy.types.Object) -> RayVisibility:
        name = obj.name_full
        if name not in self._visibilities:
            rays, original = ray_visibility(obj), obj.original
            if original.holdout_get(view_layer=self._view_layer):
                self._findings.add(obj, "holdouts are not supported yet; the object is an ordinary one.")
            elif original.indirect_only_get(view_layer=self._view_layer):
                rays &= ~RayVisibility.CAMERA
            self._visibilities[name] = rays
        return self._visibilities[name]

    def _add_mesh(self, owner: bpy.types.Object, row: int, key: Key, visibility: RayVisibility) -> None:
        if not visibility:
            return
        data = owner.data
        geometry_key = (key[0], data.as_pointer())
        if geometry_key not in self._geometry:
            self._geometry[geometry_key] = self._find_geometry(owner, data)
        geometry = self._geometry[geometry_key]
        if geometry is None:
            return
        # One object may place several meshes at once, under the same key.
        number = self._used_keys.get(key, 0)
        self._used_keys[key] = number + 1
        if number:
            key = (*key[:2], key[2] + number.to_bytes(4, "little"))
        self._rows.append(row)
        self._placements.keys.append(key)
        self._placements.mesh.append(geometry[0])
        self._placements.material_start.append(geometry[1])
        self._placements.visibility.append(int(visibility))
        # Of an instance its own, not the instancer's, as in Cycles.
        offset = min(owner.shadow_terminator_geometry_offset, _LARGEST_TERMINATOR_OFFSET)
        self._placements.terminator_offset.append(offset)

    def _find_geometry(self, owner: bpy.types.Object, data: bpy.types.Mesh) -> tuple[int, int] | None:
        """Mesh index and material start; None where there is nothing to see."""
        find_in_object(owner, self._findings)
        pointer = data.as_pointer()
        if pointer not in self._meshes:
            mesh = self._mesh_cache.get(owner, self._findings)
            self._meshes[pointer] = None if mesh is None else self._mesh_index(mesh)
        index = self._meshes[pointer]
        if index is None:
            return None
        # Indices beyond the slots mean the last one, as in Cycles.
        table = [self._materials.index(self._override or material) for material in _slots(owner, data)]
        table += table[-1:] * (self._slot_counts[index] - len(table))
        return index, self._table_start(tuple(table))

    def _mesh_index(self, mesh: Mesh) -> int:
        """Two of Blender's meshes may have become the same Mesh."""
        if id(mesh) not in self._mesh_indices:
            self._mesh_indices[id(mesh)] = len(self._placements.meshes)
            self._placements.meshes.append(mesh)
            self._slot_counts.append(int(mesh.material_slots.max()) + 1)
        return self._mesh_indices[id(mesh)]

    def _table_start(self, table: tuple[int, ...]) -> int:
        if table not in self._table_starts:
            self._table_starts[table] = len(self._placements.material_table)
            self._placements.material_table.extend(table)
        return self._table_starts[table]


def _slots(owner: bpy.types.Object, data: bpy.types.Mesh) -> list[bpy.types.Material | None]:
    """The materials of the evaluated mesh, each replaced by the object's own where a slot is linked to the object."""
    materials = list(data.materials) or [None]
    for index, slot in enumerate(owner.material_slots[: len(materials)]):
        if slot.link == "OBJECT":
            materials[index] = slot.material
    return materials
