# SPDX-License-Identifier: Apache-2.0
"""Stage "atrous": one level of the edge-avoiding a-trous wavelet transform, of [Schied17] and of [Dammertz10]."""

from __future__ import annotations

import math
from typing import Any

from ..settings import PlusStep
from .guides import Guides, edge_weight, luminance, namespace, tap

# B3 spline, taps 0, 1, 2 away from the centre [Dammertz10].
KERNEL = (3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0)
# 3x3 Gaussian, per axis.
GAUSSIAN = (1.0 / 2.0, 1.0 / 4.0)
# [Schied17, Eq. 5] epsilon, radiance; only keeps 0 / 0 away.
LUMINANCE_EPSILON = 1e-10


def prefilter(variance: Any, guides: Guides) -> Any:
    """g_3x3(Var) [Schied17, Eq. 5], over the surfaces inside the frame."""
    xp = namespace(variance)
    total, weight = xp.zeros(variance.shape), xp.zeros(variance.shape)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            inside, value, surface = tap(dx, dy, variance, guides.surface)
            w = xp.where(inside & surface, GAUSSIAN[abs(dx)] * GAUSSIAN[abs(dy)], 0.0)
            total, weight = total + w * value, weight + w
    return total / xp.where(weight > 0.0, weight, 1.0)


def luminance_weight(difference: Any, filtered_variance: Any, sigma_luminance: float) -> Any:
    """w_l of |l(p) - l(q)| [Schied17, Eq. 5]."""
    xp = namespace(difference)
    return xp.exp(-difference / (sigma_luminance * xp.sqrt(filtered_variance) + LUMINANCE_EPSILON))


def atrous(
    color: list[Any], variance: list[Any], guides: Guides, level: int, settings: Any
) -> tuple[list[Any], list[Any]]:
    """Level `level` of the transform [Schied17, Eq. 1, 2]: taps 2^level pixels apart.

    color: per signal [H, W, 3]. variance: per signal [H, W]. Pixels without a surface stay as they are.
    """
    xp = namespace(guides.depth)
    step = 2**level
    light = [luminance(c) for c in color]
    filtered = [prefilter(v, guides) for v in variance]
    weight = [xp.zeros(light[0].shape) for _ in color]
    color_sum = [xp.zeros(c.shape) for c in color]
    variance_sum = [xp.zeros(v.shape) for v in variance]
    for j in range(-2, 3):
        for i in range(-2, 3):
            dx, dy = i * step, j * step
            w_geometry = edge_weight(guides, dx, dy, settings.sigma_depth, settings.sigma_normal)
            w_geometry = w_geometry * KERNEL[abs(i)] * KERNEL[abs(j)]
            for s in range(len(color)):
                _, tap_color, tap_variance, tap_light = tap(dx, dy, color[s], variance[s], light[s])
                w = w_geometry * luminance_weight(xp.abs(light[s] - tap_light), filtered[s], settings.sigma_luminance)
                weight[s] = weight[s] + w
                color_sum[s] = color_sum[s] + w[..., None] * tap_color
                variance_sum[s] = variance_sum[s] + w**2 * tap_variance
    total = [xp.where(guides.surface, w, 1.0) for w in weight]
    surface = guides.surface
    return (
        [xp.where(surface[..., None], c / w[..., None], o) for c, w, o in zip(color_sum, total, color, strict=True)],
        [xp.where(surface, v / w**2, 0.0) for v, w in zip(variance_sum, total, strict=True)],
    )


# svgf+: 3x3 binomial, per axis.
BINOMIAL = (1.0 / 2.0, 1.0 / 4.0)


def atrous_plus(
    color: list[Any], variance: list[Any], gloss: list[Any], guides: Guides, level: int, settings: Any
) -> tuple[list[Any], list[Any]]:
    """As ``atrous``, for svgf+ (native/denoise/method.h): 3x3 taps; exp(sigma_n (cosine - 1)) for Eq. 4; a Gaussian
    of the luminance difference for Eq. 5, over the larger of the centre's variance, prefiltered at the first level, and
    the tap's. gloss: per signal, None for diffuse light; else [H, W] or a number, by which a tap's variance counts for
    less."""
    xp = namespace(guides.depth)
    light = [luminance(c) for c in color]
    prefilters = level == 0 and settings.has(PlusStep.PREFILTER)
    filtered = [prefilter(v, guides) if prefilters else v for v in variance]
    if not settings.has(PlusStep.BOTH_VARIANCES):
        gloss = [1.0 for _ in color]
    blunt = [xp.broadcast_to(1.0 - (0.0 if g is None else g), guides.depth.shape) for g in gloss]
    weight = [xp.zeros(light[0].shape) for _ in color]
    color_sum = [xp.zeros(c.shape) for c in color]
    variance_sum = [xp.zeros(v.shape) for v in variance]
    for j in (-1, 0, 1):
        for i in (-1, 0, 1):
            dx, dy = i * 2**level, j * 2**level
            w_geometry = edge_weight(guides, dx, dy, settings.plus_sigma_depth, 0.0)
            if (dx, dy) != (0, 0):
                _, normal = tap(dx, dy, guides.normal)
                cosine = (guides.normal * normal).sum(axis=-1)
                w_geometry = w_geometry * xp.exp(settings.plus_sigma_normal * (cosine - 1.0))
            w_geometry = w_geometry * BINOMIAL[abs(i)] * BINOMIAL[abs(j)]
            for s in range(len(color)):
                _, tap_color, tap_variance, tap_light, tap_blunt = tap(
                    dx, dy, color[s], variance[s], light[s], blunt[s]
                )
                own, tapped = (
                    settings.plus_sigma_luminance**2 * v + LUMINANCE_EPSILON**2 / math.log(2.0)
                    for v in (filtered[s], tap_variance)
                )
                larger = xp.maximum(own, tapped * tap_blunt)
                w = w_geometry * xp.exp(-((light[s] - tap_light) ** 2) / larger)
                weight[s] = weight[s] + w
                color_sum[s] = color_sum[s] + w[..., None] * tap_color
                variance_sum[s] = variance_sum[s] + w**2 * tap_variance
    surface = guides.surface
    total = [xp.where(surface, w, 1.0) for w in weight]
    return (
        [xp.where(surface[..., None], c / w[..., None], o) for c, w, o in zip(color_sum, total, color, strict=True)],
        [xp.where(surface, v / w**2, 0.0) for v, w in zip(variance_sum, total, strict=True)],
    )


def camera_position(depth: Any, window: Any) -> Any:
    """[H, W, 3] where the surface is, in camera space. window: left, right, bottom, top of the image one unit ahead."""
    xp = namespace(depth)
    height, width = depth.shape
    left, right, bottom, top = (float(edge) for edge in window)
    u = left + (right - left) * (xp.arange(width) + 0.5) / width
    v = top + (bottom - top) * (xp.arange(height) + 0.5) / height
    return xp.stack([u[None, :] * depth, v[:, None] * depth, -depth], axis=-1)


def edge_avoiding(color: list[Any], guides: Guides, window: Any, level: int, settings: Any) -> list[Any]:
    """Level `level` as in [Dammertz10, Sec. 3 and the listing at its end]: Gaussians of the squared distances between
    colours, normals (over the squared tap spacing) and world positions; sigma_rt is halved at each level.

    Distances are the same in world and camera space, so positions stay in the latter, near the origin.
    """
    xp = namespace(guides.depth)
    step = 2**level
    sigma_color = settings.eaw_sigma_color / step
    position = camera_position(guides.depth, window)
    weight = [xp.zeros(guides.depth.shape) for _ in color]
    color_sum = [xp.zeros(c.shape) for c in color]
    for j in range(-2, 3):
        for i in range(-2, 3):
            inside, tap_surface, tap_normal, tap_position = tap(
                i * step, j * step, guides.surface, guides.normal, position
            )
            normal_distance = ((guides.normal - tap_normal) ** 2).sum(axis=-1) / step**2
            position_distance = ((position - tap_position) ** 2).sum(axis=-1)
            w_geometry = KERNEL[abs(i)] * KERNEL[abs(j)] * xp.exp(
                -normal_distance / settings.eaw_sigma_normal**2 - position_distance / settings.eaw_sigma_position**2
            )
            w_geometry = xp.where(inside & tap_surface & guides.surface, w_geometry, 0.0)
            for s in range(len(color)):
                _, tap_color = tap(i * step, j * step, color[s])
                w = w_geometry * xp.exp(-((color[s] - tap_color) ** 2).sum(axis=-1) / sigma_color**2)
                weight[s] = weight[s] + w
                color_sum[s] = color_sum[s] + w[..., None] * tap_color
    return [
        xp.where(guides.surface[..., None], c / xp.where(guides.surface, w, 1.0)[..., None], o)
        for c, w, o in zip(color_sum, weight, color, strict=True)
    ]
