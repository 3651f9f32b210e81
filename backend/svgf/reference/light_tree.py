# SPDX-License-Identifier: Apache-2.0
"""Choosing one of many lights by what they are likely to contribute at a point: a walk down the tree [Conty18]."""

from __future__ import annotations

import numpy as np

from .vec import dot

# Levels of the tree that the first random number decides; the second one decides the others.
LEVELS_OF_FIRST = 8


def _difference(cos_a, sin_a, cos_b, sin_b) -> tuple[np.ndarray, np.ndarray]:
    """Cosine and sine of max(0, a - b) for angles in [0, pi]."""
    smaller = cos_a > cos_b
    return (
        np.where(smaller, 1.0, cos_a * cos_b + sin_a * sin_b),
        np.where(smaller, 0.0, sin_a * cos_b - cos_a * sin_b),
    )


def _sine(cosine) -> np.ndarray:
    return np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine))


def light_importance(node: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """[n]: a bound of what the lights of nodes [n, 12] contribute at points [n, 3], up to a factor [Conty18, Eq. 3].
    normal: of the receivers, both of whose sides may be lit. Where it is 0, nothing arrives."""
    low, high, axis = node[:, 0:3], node[:, 3:6], node[:, 6:9]
    cos_normals, cos_emission, power = node[:, 9], node[:, 10], node[:, 11]
    extent = (high - low) / 2.0
    from_point = low + extent - point
    distance_squared, radius_squared = dot(from_point, from_point), dot(extent, extent)
    falloff = np.abs(power) / np.maximum(np.maximum(distance_squared, radius_squared), 1e-30)
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = from_point / np.sqrt(distance_squared)[:, None]
        sin_box = np.minimum(1.0, np.sqrt(radius_squared / distance_squared) * 1.001 + 1e-3)
    cos_box = _sine(sin_box)
    towards = dot(axis, direction)
    cos_axis = np.where(power < 0.0, np.abs(towards), -towards)
    from_normals = _difference(cos_axis, _sine(cos_axis), cos_normals, _sine(cos_normals))
    cos_light, _ = _difference(*from_normals, cos_box, sin_box)
    cos_receiver = np.abs(dot(normal, direction))
    receiver, _ = _difference(cos_receiver, _sine(cos_receiver), cos_box, sin_box)
    seen = np.where(cos_light > cos_emission, falloff * np.maximum(cos_light, 0.0) * receiver, 0.0)
    return np.where(distance_squared <= radius_squared, falloff, seen)


def walk_light_tree(
    nodes: np.ndarray, point: np.ndarray, normal: np.ndarray, u: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The leaf [n] that u [n, 2] chooses, or target [n] where that is >= 0, and the probability of getting there, 0
    where no light of the tree reaches the point."""
    depth = int(np.log2(len(nodes) + 1)) - 1
    node = np.zeros(len(point), dtype=np.int64)
    probability = np.ones(len(point))
    u = u.copy()
    for level in range(depth):
        left = light_importance(nodes[2 * node + 1], point, normal)
        right = light_importance(nodes[2 * node + 2], point, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            left_share = left / (left + right)
            number = u[:, 0 if level < LEVELS_OF_FIRST else 1]
            goes_left = np.where(target >= 0, (target >> (depth - 1 - level)) & 1 == 0, number < left_share)
            share = np.where(goes_left, left_share, 1.0 - left_share)
            number[:] = np.minimum(np.where(goes_left, number, number - left_share) / share, 1.0 - 2.0**-24)
        probability *= np.where(left + right > 0.0, share, 0.0)
        node = 2 * node + np.where(goes_left, 1, 2)
    return node - ((1 << depth) - 1), np.nan_to_num(probability)
