# SPDX-License-Identifier: Apache-2.0
"""The shadow terminator of coarse meshes with smooth normals, whose triangles lie below the surface that the normals
describe: rays to lights that graze an object start above it, on a patch that its corner normals span over the triangle
[Hanika21], as in Cycles. Arrays have one row per hit."""

from __future__ import annotations

import numpy as np

from .intersect import offset_origin
from .vec import dot, transform_vector


def find_patch_offsets(
    corners: np.ndarray, normals: np.ndarray, weights: np.ndarray, to_world: np.ndarray, geometric_normal: np.ndarray
) -> np.ndarray:
    """From points of triangles to their patches, [n, 2, 3], world: on the side of geometric_normal and on the other.

    corners, normals: [n, 3, 3], object space, normals unit or 0. weights: [n, 3] of the corners. to_world: [n, 3, 4].
    """
    points = np.einsum("nc,nci->ni", weights, corners)
    normal = np.einsum("nc,nci->ni", weights, normals)
    facing = np.where(dot(transform_vector(to_world, normal), geometric_normal) < 0.0, -1.0, 1.0)
    offsets = []
    for side in (facing, -facing):
        heights = patch_heights(corners, normals * side[:, None, None], weights, points)
        offsets.append(transform_vector(to_world, normal * (side * heights)[:, None]))
    result = np.stack(offsets, axis=1)
    return np.where(np.isfinite(result).all(axis=2, keepdims=True), result, 0.0)


def patch_heights(corners: np.ndarray, normals: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Heights [n] of patches over points of triangles, in units of the interpolated normal.

    Half of a quadratic patch, exact for a sphere, but nowhere lower than the tangent planes of the corners, each lifted
    until no other corner is above it.
    """
    quadratic = np.zeros(len(points))
    tangents = []
    for i in range(3):
        for j in range(i):
            bend = dot(normals[:, i] - normals[:, j], corners[:, i] - corners[:, j])
            quadratic += weights[:, i] * weights[:, j] * bend
        above = np.einsum("nci,ni->nc", corners - corners[:, i : i + 1], normals[:, i]).max(axis=1)
        tangents.append(dot(corners[:, i] - points, normals[:, i]) + above)
    return np.maximum(np.maximum(np.min(tangents, axis=0), 0.0), 0.5 * quadratic)


def terminator_share(cos_smooth: np.ndarray, cos_geometric: np.ndarray, terminator_offset: np.ndarray) -> np.ndarray:
    """Share [n] of the height of the patch at which a ray to a light starts. Cosines with the light of the smooth
    normal, >= 0, and of the geometric one on the same side."""
    grazing = np.where(cos_smooth < terminator_offset, 1.0 - cos_smooth / terminator_offset, 0.0)
    return np.clip(1.0 + grazing - cos_geometric / terminator_offset, 0.0, 1.0)


def find_light_side(surface, geometric_normal: np.ndarray, light: np.ndarray) -> np.ndarray:
    """[n], by sign: the side of a surface that a light [n, 3] is on, that of geometric_normal being positive."""
    cosine = dot(surface.smooth_normal, light)
    cosine = np.where(dot(surface.smooth_normal, geometric_normal) < 0.0, -cosine, cosine)
    return np.where(surface.terminator_offset > 0.0, cosine, dot(geometric_normal, light))


def shadow_rays(
    surface, light: np.ndarray, distance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origin [n, 3], direction [n, 3], unit, and length [n] of rays to points of lights, which from the hits are in
    directions light [n, 3] at distances [n]."""
    cosine = dot(surface.smooth_normal, light)
    outside = cosine * dot(surface.smooth_normal, surface.geometric_normal) >= 0.0
    outwards = np.where(outside[:, None], surface.geometric_normal, -surface.geometric_normal)
    has_patch = surface.terminator_offset > 0.0
    limit = np.where(has_patch, surface.terminator_offset, 1.0)
    share = np.where(has_patch, terminator_share(np.abs(cosine), dot(outwards, light), limit), 0.0)
    offset = np.where(outside[:, None], surface.patch_offset[:, 0], surface.patch_offset[:, 1])
    leaving = np.where(has_patch[:, None], outwards, light)
    start = offset_origin(surface.position, surface.magnitude, surface.geometric_normal, leaving)
    origin = start + offset * share[:, None]
    is_near = np.isfinite(distance)
    to_light = surface.position - origin + light * np.where(is_near, distance, 0.0)[:, None]
    length = np.linalg.norm(to_light, axis=1)
    direction = np.where(is_near[:, None], to_light / np.where(length > 0.0, length, 1.0)[:, None], light)
    return origin, direction, np.where(is_near, length, distance)
