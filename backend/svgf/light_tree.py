# SPDX-License-Identifier: Apache-2.0
"""The light tree: bounds of groups of lights, by which one of many is chosen at a point [Conty18].

A complete binary tree over the lights that are somewhere (suns and the environment are everywhere): each level halves
the lights of every node by count, along the longest side of the box around their centres. Its leaves are in the order
of their numbers, so the way to a light is the number of its leaf in binary.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class LightBounds:
    """Rows of lights or nodes. low, high: [n, 3] box. axis: [n, 3] unit, where they shine to; two_sided: and to the
    opposite. cos_normals: [n], cosine of the half angle of the cone of their normals. cos_emission: [n], of the angle
    from a normal within which they shine. intensity: [n], W / sr along the axis, 0 for none."""

    low: np.ndarray
    high: np.ndarray
    axis: np.ndarray
    cos_normals: np.ndarray
    cos_emission: np.ndarray
    intensity: np.ndarray
    two_sided: np.ndarray

    def rows(self, chosen: np.ndarray) -> LightBounds:
        return LightBounds(*(values[chosen] for values in vars(self).values()))


def build_light_tree(bounds: LightBounds) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [2^(depth + 1) - 1, 12] (the children of node i are 2 i + 1 and 2 i + 2) and the light of each leaf, int32
    [2^depth], -1 for none. Both are empty without lights.

    Columns: low 0:3, high 3:6, axis 6:9, cos_normals 9, cos_emission 10, intensity 11, which is negative where the
    lights shine both ways.
    """
    count = len(bounds.intensity)
    if not count:
        return np.zeros((0, 12)), np.zeros(0, dtype=np.int32)
    depth = int(np.ceil(np.log2(count)))
    leaves = _order(bounds, depth)
    level = bounds.rows(np.maximum(leaves, 0))
    level.intensity = np.where(leaves >= 0, level.intensity, 0.0)
    levels = [level]
    for _ in range(depth):
        levels.insert(0, _union(levels[0].rows(slice(0, None, 2)), levels[0].rows(slice(1, None, 2))))
    # Rounded as devices hold them: the sine of a cosine near 1 is sensitive to it.
    nodes = np.concatenate([
        np.column_stack([
            level.low, level.high, level.axis, level.cos_normals, level.cos_emission,
            np.where(level.two_sided, -level.intensity, level.intensity),
        ])
        for level in levels
    ])  # fmt: skip
    return nodes.astype(np.float32).astype(np.float64), leaves.astype(np.int32)


def _order(bounds: LightBounds, depth: int) -> np.ndarray:
    """[2^depth], the light of each leaf, -1 where there are more leaves than lights."""
    order = np.full(1 << depth, -1, dtype=np.int64)
    order[: len(bounds.intensity)] = np.arange(len(bounds.intensity))
    centre = (bounds.low + bounds.high) / 2.0
    order = order[None]
    for _ in range(depth):
        points = np.where((order >= 0)[..., None], centre[order], np.nan)
        with np.errstate(invalid="ignore"):
            size = np.fmax.reduce(points, axis=1) - np.fmin.reduce(points, axis=1)
        axis = np.argmax(np.nan_to_num(size), axis=1)
        # NaN sorts last, so what is missing gathers on one side.
        keys = np.take_along_axis(points, axis[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(order, np.argsort(keys, axis=1, kind="stable"), axis=1)
        order = order.reshape(2 * len(order), -1)
    return order.ravel()


def _union(a: LightBounds, b: LightBounds) -> LightBounds:
    """Row by row. What has no intensity counts for nothing."""
    only_a, only_b = b.intensity <= 0.0, (a.intensity <= 0.0) & (b.intensity > 0.0)
    two_sided = a.two_sided | b.two_sided
    cosine = np.einsum("ni,ni->n", a.axis, b.axis)
    # Lights that shine both ways point either way.
    other = np.where((two_sided & (cosine < 0.0))[:, None], -b.axis, b.axis)
    angle_a, angle_b = np.arccos(a.cos_normals), np.arccos(b.cos_normals)
    between = np.arccos(np.clip(np.einsum("ni,ni->n", a.axis, other), -1.0, 1.0))
    half = np.minimum((angle_a + between + angle_b) / 2.0, np.pi)
    inside_a = np.minimum(between + angle_b, np.pi) <= angle_a
    inside_b = np.minimum(between + angle_a, np.pi) <= angle_b
    turned = _turn(a.axis, other, half - angle_a, between)
    axis = np.where(inside_a[:, None], a.axis, np.where(inside_b[:, None], other, turned))
    half = np.where(inside_a, angle_a, np.where(inside_b, angle_b, half))

    def pick(joined: np.ndarray, of_a: np.ndarray, of_b: np.ndarray) -> np.ndarray:
        shape = (-1,) + (1,) * (joined.ndim - 1)
        return np.where(only_a.reshape(shape), of_a, np.where(only_b.reshape(shape), of_b, joined))

    return LightBounds(
        low=pick(np.minimum(a.low, b.low), a.low, b.low),
        high=pick(np.maximum(a.high, b.high), a.high, b.high),
        axis=pick(axis, a.axis, b.axis),
        cos_normals=pick(np.cos(half), a.cos_normals, b.cos_normals),
        cos_emission=pick(np.minimum(a.cos_emission, b.cos_emission), a.cos_emission, b.cos_emission),
        intensity=a.intensity + b.intensity,
        two_sided=pick(two_sided, a.two_sided, b.two_sided),
    )


def _turn(axis: np.ndarray, towards: np.ndarray, angle: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Axes turned by an angle towards others, `between` away. Opposite ones are turned any way: their cone is all
    directions then."""
    sine = np.sin(between)
    plain = sine < 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = (np.sin(between - angle) / sine)[:, None] * axis + (np.sin(angle) / sine)[:, None] * towards
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return np.where(plain[:, None], axis, turned)
