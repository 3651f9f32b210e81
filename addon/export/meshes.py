# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated meshes as triangles, read in bulk, and recognised again from one frame to the next."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, replace

import bpy
import numpy as np
from svgf.errors import Interrupted
from svgf.scene import Mesh

from .findings import Findings


@dataclass(frozen=True, eq=False)
class _Source:
    """Blender's arrays of an evaluated mesh: V vertices, C corners, F faces.

    positions: float32 [V, 3]. corner_vertices: int32 [C]. face_starts: int32 [F], first corner.
    normals: float32 [C, 3] or None where all faces are flat. uvs: float32 [L, C, 2] or None.
    slots: int32 [F] or None where all are 0. flat: bool [F] or None where no face is flat.
    """

    positions: np.ndarray
    corner_vertices: np.ndarray
    face_starts: np.ndarray
    normals: np.ndarray | None
    uvs: np.ndarray | None
    slots: np.ndarray | None
    flat: np.ndarray | None

    def shape(self) -> tuple[int, int, int]:
        return len(self.positions), len(self.corner_vertices), len(self.face_starts)

    def same_topology(self, other: _Source) -> bool:
        return (
            self.shape() == other.shape()
            and np.array_equal(self.corner_vertices, other.corner_vertices)
            and np.array_equal(self.face_starts, other.face_starts)
        )

    def same(self, other: _Source) -> bool:
        # The positions first: they are what usually differs.
        return (
            self.shape() == other.shape()
            and np.array_equal(self.positions, other.positions)
            and self.same_topology(other)
            and _equal(self.normals, other.normals)
            and _equal(self.uvs, other.uvs)
            and _equal(self.slots, other.slots)
            and _equal(self.flat, other.flat)
        )


@dataclass(frozen=True, eq=False)
class _Entry:
    source: _Source
    mesh: Mesh | None  # None without triangles


class MeshCache:
    """The meshes of this frame, and of the last one to compare them with.

    A mesh is looked up by its owner's name. Where the owner is new, one of equal content is looked for, so that
    instances keep their mesh when the first of them is hidden.

    reads: how often a mesh was read from Blender.
    """

    def __init__(self) -> None:
        self.reads = 0
        self._uv_maps: tuple[str, ...] = ("",)
        self._last: dict[tuple[str, int], _Entry] = {}
        self._by_shape: dict[tuple[int, int, int], list[_Entry]] = {}
        self._now: dict[tuple[str, int], _Entry] = {}
        self._counts: dict[str, int] = {}

    def start_frame(
        self, should_stop: Callable[[], bool], changed: Set[str] | None = None, uv_maps: tuple[str, ...] = ("",)
    ) -> None:
        """changed: full names of the objects whose geometry may differ from the last frame's; None: any.

        uv_maps: names of the UV layers to read; "" is the active one.
        """
        self._should_stop = should_stop
        self._changed = changed if uv_maps == self._uv_maps else None
        self._uv_maps = uv_maps
        self._last, self._now, self._counts = self._now, {}, {}
        self._by_shape = {}
        for entry in self._last.values():
            self._by_shape.setdefault(entry.source.shape(), []).append(entry)

    def get(self, owner: bpy.types.Object, findings: Findings) -> Mesh | None:
        """The triangles of an evaluated mesh object, to be asked once a frame for each mesh. None if it has none.

        The very Mesh of the last frame where nothing changed. With previous_positions where the vertices moved.
        Raises Interrupted where the export should stop.
        """
        # An object owns several meshes where its geometry nodes make instances of meshes.
        name = owner.name_full
        key = (name, self._counts.setdefault(name, 0))
        self._counts[name] += 1
        last = self._last.get(key)
        if last is not None and self._changed is not None and name not in self._changed:
            self._now[key] = _at_rest(last)
            return self._now[key].mesh
        if self._should_stop():
            raise Interrupted("The export was cancelled.")
        data = owner.to_mesh()
        source = _read(data, self._uv_maps)
        self.reads += 1
        if last is None:
            last = next((entry for entry in self._by_shape.get(source.shape(), ()) if source.same(entry.source)), None)
        entry = _advance(source, last) or _Entry(source, _build(owner, data, source, last, findings))
        owner.to_mesh_clear()
        self._now[key] = entry
        return entry.mesh


def _advance(source: _Source, last: _Entry | None) -> _Entry | None:
    """The last frame's entry where nothing changed."""
    return None if last is None or not source.same(last.source) else _at_rest(last)


def _at_rest(last: _Entry) -> _Entry:
    """The last frame's entry; it may have moved at that time and come to rest now."""
    if last.mesh is None or last.mesh.previous_positions is None:
        return last
    return _Entry(last.source, replace(last.mesh, previous_positions=None))


def _build(
    owner: bpy.types.Object, data: bpy.types.Mesh, source: _Source, last: _Entry | None, findings: Findings
) -> Mesh | None:
    if not len(source.face_starts):
        return None
    corners = _triangle_corners(data, source)
    faces = _triangle_faces(source)
    triangles = source.corner_vertices[corners]
    finite = np.isfinite(source.positions).all(axis=1)
    if not finite.all():
        kept = finite[triangles].all(axis=1)
        findings.add(owner, f"{np.count_nonzero(~kept)} triangles with vertices that are not finite are left out.")
        corners, faces, triangles = corners[kept], faces[kept], triangles[kept]
    if not len(triangles):
        return None
    return Mesh(
        name=owner.name,
        positions=np.where(finite[:, None], source.positions, np.float32(0)) if not finite.all() else source.positions,
        triangles=triangles,
        normals=_normals(source, corners, faces),
        material_slots=np.zeros(len(faces), np.int32) if source.slots is None else source.slots[faces],
        uvs=_corner_uvs(source.uvs, corners),
        previous_positions=_previous_positions(source, last),
    )


def _previous_positions(source: _Source, last: _Entry | None) -> np.ndarray | None:
    if last is None or last.mesh is None or not source.same_topology(last.source):
        return None
    moved = not np.array_equal(last.source.positions, source.positions, equal_nan=True)
    return last.mesh.positions if moved else None


def _read(data: bpy.types.Mesh, uv_maps: tuple[str, ...]) -> _Source:
    corner_count, face_count = len(data.loops), len(data.polygons)
    positions = np.empty((len(data.vertices), 3), np.float32)
    corner_vertices = np.empty(corner_count, np.int32)
    face_starts = np.empty(face_count, np.int32)
    # The attributes are copied as blocks, a hundred times faster than the same data through vertices and loops.
    if len(positions):
        data.attributes["position"].data.foreach_get("vector", positions.ravel())
    if corner_count:
        data.attributes[".corner_vert"].data.foreach_get("value", corner_vertices)
    data.polygons.foreach_get("loop_start", face_starts)
    normals = None
    if data.normals_domain != "FACE" or data.has_custom_normals:
        normals = np.empty((corner_count, 3), np.float32)
        data.corner_normals.foreach_get("vector", normals.ravel())
    return _Source(
        positions,
        corner_vertices,
        face_starts,
        normals,
        _read_uvs(data, corner_count, uv_maps),
        _read_face_attribute(data, "material_index", np.int32),
        None if normals is None or data.has_custom_normals else _read_face_attribute(data, "sharp_face", bool),
    )


def _read_uvs(data: bpy.types.Mesh, corner_count: int, uv_maps: tuple[str, ...]) -> np.ndarray | None:
    """A layer that the mesh does not have is 0; None where it has none of them."""
    found = [
        next((layer for layer in data.uv_layers if (layer.name == name if name else layer.active_render)), None)
        for name in uv_maps
    ]
    if not any(found) or not corner_count:
        return None
    uvs = np.zeros((len(uv_maps), corner_count, 2), np.float32)
    for index, layer in enumerate(found):
        if layer is not None:
            layer.uv.foreach_get("vector", uvs[index].ravel())
    return uvs


def _corner_uvs(uvs: np.ndarray | None, corners: np.ndarray) -> np.ndarray | None:
    """[T, 3, 2] of one layer, [L, T, 3, 2] of several."""
    if uvs is None:
        return None
    return _finite(_rows(uvs[0], corners) if len(uvs) == 1 else np.stack([_rows(layer, corners) for layer in uvs]))


def _read_face_attribute(data: bpy.types.Mesh, name: str, dtype: type) -> np.ndarray | None:
    """A face attribute, None where it is absent or all zero."""
    attribute = data.attributes.get(name)
    if attribute is None or attribute.domain != "FACE":
        return None
    values = np.empty(len(data.polygons), dtype)
    attribute.data.foreach_get("value", values)
    return values if values.any() else None


def _face_sizes(source: _Source) -> np.ndarray:
    return np.diff(source.face_starts, append=np.int32(len(source.corner_vertices)))


def _triangle_corners(data: bpy.types.Mesh, source: _Source) -> np.ndarray:
    """int32 [T, 3] corners, in the order of the faces."""
    corner_count, face_count = len(source.corner_vertices), len(source.face_starts)
    if corner_count == 3 * face_count:
        return np.arange(corner_count, dtype=np.int32).reshape(-1, 3)
    sizes = _face_sizes(source)
    if sizes.max() <= 4:
        return _split_quads(source, sizes)
    data.calc_loop_triangles()
    corners = np.empty((corner_count - 2 * face_count, 3), np.int32)
    data.loop_triangles.foreach_get("loops", corners.ravel())
    return corners


def _split_quads(source: _Source, sizes: np.ndarray) -> np.ndarray:
    """As Blender splits them, but read in a fraction of the time: along the diagonal from the first corner to the
    third, unless the other two lie on the same side of it."""
    quads = source.face_starts[sizes == 4]
    first, second, third, fourth = (
        _rows(source.positions, source.corner_vertices[quads + corner]) for corner in range(4)
    )
    a, diagonal, b = second - first, third - first, fourth - first
    # cross(a, diagonal) . cross(b, diagonal) > 0
    flipped = _dots(a, b) * _dots(diagonal, diagonal) > _dots(a, diagonal) * _dots(b, diagonal)
    corners = np.repeat(source.face_starts, sizes - 2)[:, None] + np.array([0, 1, 2], np.int32)
    last = np.cumsum(sizes - 2)[sizes == 4] - 1
    corners[last, 1:] += 1
    corners[last[flipped] - 1, 2] += 1
    corners[last[flipped], 0] += 1
    return corners


def _dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[N] of [N, 3] vectors."""
    return np.einsum("ij,ij->i", a, b)


def _triangle_faces(source: _Source) -> np.ndarray:
    """int32 [T] face of each triangle: a face of n corners has n - 2."""
    faces = np.arange(len(source.face_starts), dtype=np.int32)
    return np.repeat(faces, _face_sizes(source) - 2)


def _normals(source: _Source, corners: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Zero, which stands for the triangle's own normal, on flat faces: as in Cycles, even where a quad is bent."""
    if source.normals is None:
        return np.zeros((*corners.shape, 3), np.float32)
    normals = _finite(_rows(source.normals, corners))
    if source.flat is not None:
        normals[source.flat[faces]] = 0
    return normals


def _rows(values: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """values[indices], in half the time or less where rows are short."""
    return np.take(values, indices, axis=0)


def _finite(values: np.ndarray) -> np.ndarray:
    """0 for what is not finite. The check is much cheaper than the repair, which is hardly ever needed."""
    return values if np.isfinite(values).all() else np.nan_to_num(values, posinf=0, neginf=0)


def _equal(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))
