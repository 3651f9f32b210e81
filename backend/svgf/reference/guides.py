# SPDX-License-Identifier: Apache-2.0
"""What the stages know of the surfaces behind the pixels, repaired, and the edge weights that follow from it."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

# Public convention of the G-buffer: no surface at this depth or beyond.
BACKGROUND_DEPTH = 1e10
# Radiance over albedo outside [0, LARGEST_RADIANCE] is no radiance; its square still fits float32.
LARGEST_RADIANCE = 1e18
# Steepest depth gradient (per pixel) that a G-buffer holds.
LARGEST_GRADIENT = 1e10
# Share of depth that Eq. 3 forgives where the gradient vanishes, instead of the paper's absolute epsilon: curvature
# and rounding grow with depth, and a scene may be of any scale.
DEPTH_EPSILON = 1e-3
# Roughness of surfaces whose reflections are as sharp as a mirror's, and as smooth as diffuse light.
MIRROR_ROUGHNESS, MATTE_ROUGHNESS = 0.1, 0.4
GLOSS_STEPS = 3


def namespace(array: Any) -> ModuleType:
    """numpy or cupy, whichever the array belongs to."""
    return sys.modules["cupy"] if type(array).__module__.partition(".")[0] == "cupy" else np


@dataclass(frozen=True, eq=False)
class Guides:
    """The repaired G-buffer, float64: normal [H, W, 3] unit or zero, depth [H, W], gradient [H, W, 2] of depth per
    pixel, object_id int [H, W]. Where there is no surface: object_id 0, depth BACKGROUND_DEPTH, the rest 0."""

    normal: Any
    depth: Any
    gradient: Any
    object_id: Any

    @property
    def surface(self) -> Any:
        """bool [H, W]: the pixel takes part in the filter."""
        return self.object_id != 0


def luminance(color: Any) -> Any:
    """color [..., 3] linear Rec.709 -> [...]."""
    return color[..., 0] * 0.2126 + color[..., 1] * 0.7152 + color[..., 2] * 0.0722


def gloss_of(roughness: Any) -> Any:
    """How sharp reflections are, [0, 1] in thirds. What is no roughness counts as a mirror's."""
    xp = namespace(roughness)
    roughness = xp.where(in_range(roughness, 0.0, 1.0), roughness, 0.0)
    gloss = xp.clip((MATTE_ROUGHNESS - roughness) / (MATTE_ROUGHNESS - MIRROR_ROUGHNESS), 0.0, 1.0)
    return xp.floor(gloss * GLOSS_STEPS + 0.5) / GLOSS_STEPS


def in_range(values: Any, low: float, high: float) -> Any:
    """False for NaN too, without a warning."""
    xp = namespace(values)
    with np.errstate(invalid="ignore"):
        return xp.logical_and(values >= low, values <= high)


def repair_guides(normal: Any, depth: Any, depth_gradient: Any = None, object_id: Any = None) -> tuple[Guides, int]:
    """Guides from public images (contract of ``Denoiser.denoise``), and how many values were bad.

    A surface whose depth or normal is not a number is taken for background: nothing can be said about its neighbours.
    Without object_id everything nearer than BACKGROUND_DEPTH is one object. Without depth_gradient it is the smaller of
    the two one-sided differences within the object, so that a silhouette beside the pixel does not count as slope.
    """
    xp = namespace(depth)
    depth = depth.astype(xp.float64)
    if object_id is None:
        object_id = xp.where(depth >= BACKGROUND_DEPTH, 0, 1)
    good = in_range(depth, 0.0, LARGEST_RADIANCE)
    good &= in_range(normal.astype(xp.float64), -LARGEST_RADIANCE, LARGEST_RADIANCE).all(axis=-1)
    named = object_id != 0
    repaired = int((named & ~good).sum())
    surface = named & good & (xp.where(good, depth, BACKGROUND_DEPTH) < BACKGROUND_DEPTH)

    depth = xp.where(surface, depth, BACKGROUND_DEPTH)
    object_id = xp.where(surface, object_id, 0)
    normal = xp.where(surface[..., None], normal, 0.0).astype(xp.float64)
    length = xp.sqrt((normal**2).sum(axis=-1, keepdims=True))
    normal = normal / xp.where(length > 0.0, length, 1.0)
    if depth_gradient is None:
        gradient = _gradient_from_differences(depth, object_id)
    else:
        finite = xp.isfinite(depth_gradient)
        repaired += int((~finite & surface[..., None]).sum())
        gradient = xp.where(finite & surface[..., None], depth_gradient, 0.0).astype(xp.float64)
        gradient = xp.clip(gradient, -LARGEST_GRADIENT, LARGEST_GRADIENT)
    return Guides(normal, depth, gradient, object_id), repaired


def _gradient_from_differences(depth: Any, object_id: Any) -> Any:
    xp = namespace(depth)
    components = []
    for dx, dy in ((1, 0), (0, 1)):
        best = xp.full(depth.shape, xp.inf)
        for sign in (1, -1):
            inside, neighbour, other = tap(sign * dx, sign * dy, depth, object_id)
            slope = (neighbour - depth) * sign
            usable = inside & (other == object_id) & (object_id != 0)
            best = xp.where(usable & (xp.abs(slope) < xp.abs(best)), slope, best)
        components.append(xp.where(xp.isfinite(best), best, 0.0))
    return xp.clip(xp.stack(components, axis=-1), -LARGEST_GRADIENT, LARGEST_GRADIENT)


def tap(dx: int, dy: int, *images: Any) -> tuple[Any, ...]:
    """bool [H, W]: the pixel (x + dx, y + dy) is inside the frame; and each image as seen there (clamped outside)."""
    xp = namespace(images[0])
    height, width = images[0].shape[:2]
    rows, columns = xp.arange(height) + dy, xp.arange(width) + dx
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    rows, columns = xp.clip(rows, 0, height - 1)[:, None], xp.clip(columns, 0, width - 1)[None, :]
    return inside, *(image[rows, columns] for image in images)


def edge_weight(guides: Guides, dx: int, dy: int, sigma_depth: float, sigma_normal: float) -> Any:
    """w_z w_n of every pixel p and its tap q = p + (dx, dy), 0 where either is no surface [Schied17, Eq. 3, 4]."""
    xp = namespace(guides.depth)
    if dx == 0 and dy == 0:
        return guides.surface.astype(xp.float64)
    inside, depth, normal, surface = tap(dx, dy, guides.depth, guides.normal, guides.surface)
    explained = xp.abs(guides.gradient[..., 0] * dx + guides.gradient[..., 1] * dy)
    w_z = xp.exp(-xp.abs(guides.depth - depth) / (sigma_depth * explained + DEPTH_EPSILON * guides.depth + 1e-30))
    cosine = (guides.normal * normal).sum(axis=-1)
    w_n = xp.where(cosine > 0.0, xp.maximum(cosine, 0.0) ** sigma_normal, 0.0)
    return xp.where(inside & surface & guides.surface, w_z * w_n, 0.0)
