# SPDX-License-Identifier: GPL-3.0-or-later
"""Tangents of normal maps, as whoever baked the maps had them: MikkTSpace [Mikkelsen08], on triangles as in Cycles.

Blender's own ``calc_tangents`` refuses meshes with larger faces than quads, and takes quads as a whole. One thing is
simpler here than in MikkTSpace: corners that share position, normal, UV and handedness share a tangent even where their
triangles are not connected. Normals between corners keep the length that interpolation gives them, as bakers have it and
Cycles had it up to Blender 5.0; Cycles 5.2 makes it 1, which moves slopes by up to 4 % on a ball of 16 x 8 faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from svgf.scene import Mesh


@dataclass(frozen=True, eq=False)
class _Entry:
    source: Mesh
    mesh: Mesh


class TangentCache:
    """Meshes with their tangents: those of this frame, and of the last one to take over what is the same."""

    def __init__(self) -> None:
        self._last: dict[int, _Entry] = {}
        self._now: dict[int, _Entry] = {}

    def start_frame(self) -> None:
        self._last, self._now = self._now, {}

    def add(self, mesh: Mesh, layer: int) -> Mesh:
        """The mesh with tangents of a UV layer; the very Mesh of the last frame where nothing changed."""
        key = id(mesh.positions)  # which the entry keeps alive
        last = self._last.get(key)
        if last is not None and last.source is mesh and last.mesh.tangent_layer == layer:
            added = last.mesh
        elif last is not None and last.mesh.tangent_layer == layer and _same_shape(last.source, mesh):
            added = replace(mesh, tangents=last.mesh.tangents, tangent_layer=layer)
        else:
            uvs = mesh.uvs if mesh.uvs.ndim == 3 else mesh.uvs[layer]
            tangents = corner_tangents(mesh.positions, mesh.triangles, mesh.normals, uvs)
            added = replace(mesh, tangents=tangents, tangent_layer=layer)
        self._now[key] = _Entry(mesh, added)
        return added


def add_tangents(meshes: Sequence[Mesh], layers: dict[int, int], cache: TangentCache) -> list[Mesh]:
    """The meshes, those that layers has the index of with tangents of that UV layer."""
    cache.start_frame()
    return [
        cache.add(mesh, layers[index]) if index in layers and mesh.uvs is not None else mesh
        for index, mesh in enumerate(meshes)
    ]


def corner_tangents(positions: np.ndarray, triangles: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """float32 [T, 3, 4]: unit tangents, and 1, or -1 where V lies to their right; 0 where the UVs say nothing.

    Arguments as of svgf.scene.Mesh, uvs [T, 3, 2].
    """
    corners = positions[triangles].astype(np.float64)
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u1, v1), (u2, v2) = (uvs[:, 1] - uvs[:, 0]).astype(np.float64).T, (uvs[:, 2] - uvs[:, 0]).astype(np.float64).T
    area = u1 * v2 - u2 * v1
    along = (edge1 * v2[:, None] - edge2 * v1[:, None]) * np.sign(area)[:, None]
    shading = normals.astype(np.float64)
    flat = ~normals.any(axis=(1, 2))
    shading[flat] = _unit(np.cross(edge1[flat], edge2[flat]))[:, None]

    # The mean over the triangles around a vertex, by their angles, in the plane that its normal stands on.
    tangents = _unit(_in_plane(along[:, None], shading)) * _angles(corners, shading)[..., None]
    mirrored = area < 0
    group = _groups(corners, shading, uvs)
    sums = _sums(2 * group + mirrored[:, None], tangents, 2 * group.max(initial=-1) + 2)
    # A triangle without area in UV takes what the others around its corners have.
    empty = area == 0
    other = ~sums[2 * group].any(axis=2)
    side = np.where(empty[:, None], other, mirrored[:, None])
    result = np.empty((*triangles.shape, 4), np.float32)
    result[..., :3] = _unit(sums[2 * group + side])
    result[..., 3] = np.where(side, -1, 1)
    return result


def _same_shape(a: Mesh, b: Mesh) -> bool:
    return all(getattr(a, name) is getattr(b, name) for name in ("positions", "triangles", "normals", "uvs"))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """0 where there is no direction."""
    lengths = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)


def _in_plane(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return vectors - normals * np.einsum("...i,...i->...", vectors, normals)[..., None]


def _angles(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """[T, 3] of triangles at their corners, seen along the normals there."""
    to_next = _unit(_in_plane(np.roll(corners, -1, axis=1) - corners, normals))
    to_last = _unit(_in_plane(np.roll(corners, 1, axis=1) - corners, normals))
    return np.arccos(np.clip(np.einsum("tci,tci->tc", to_next, to_last), -1, 1))


def _groups(corners: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """int [T, 3]: corners with the same number have the same position, normal and UV."""
    parts = [part.reshape(-1, part.shape[-1]) for part in (corners, normals, uvs)]
    rows = np.concatenate(parts, axis=1, dtype=np.float32)
    bits = np.ascontiguousarray(rows + 0.0).view(np.uint32).astype(np.uint64)  # + 0.0: -0 is 0
    # Their hashes stand for the rows: of a million, two differing ones agree once in 10^7 meshes.
    keys = np.zeros(len(bits), np.uint64)
    for column in bits.T:
        keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    _, numbers = np.unique(keys, return_inverse=True)
    return numbers.reshape(corners.shape[:2])


def _sums(groups: np.ndarray, vectors: np.ndarray, count: int) -> np.ndarray:
    """float64 [count, 3] of [T, 3, 3] vectors by their groups [T, 3]."""
    return np.stack(
        [np.bincount(groups.ravel(), vectors[..., axis].ravel(), minlength=count) for axis in range(3)], axis=1
    )
