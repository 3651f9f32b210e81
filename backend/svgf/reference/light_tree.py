# SPDX-License-Identifier: Apache-2.0
"""Choosing one of several lights by what they are likely to contribute at a point: one of the nodes of a level of the
light tree, or of the lights beside it, and then a walk down the tree [Conty18]."""

from __future__ import annotations

import numpy as np

from .vec import dot

# Levels of the tree that the first random number decides; the second one decides the others.
LEVELS_OF_FIRST = 8

# Walks start there, or at the leaves where these are higher up.
START_LEVEL = 3

# Light from below the horizon counts as if it came at this cosine: a coat may have a normal of its own.
LEAST_COS_RECEIVER = 0.02


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
    """[n]: an estimate of the irradiance of the lights of nodes [n, 12] at points [n, 3], up to a factor [Conty18,
    Eq. 3]. normal: of the receivers, see lit_normal() of Bsdf. Where it is 0, nothing arrives."""
    low, high, axis = node[:, 0:3], node[:, 3:6], node[:, 6:9]
    cos_normals, cos_emission, intensity = node[:, 9], node[:, 10], node[:, 11]
    extent = (high - low) / 2.0
    from_point = low + extent - point
    distance_squared, radius_squared = dot(from_point, from_point), dot(extent, extent)
    falloff = np.abs(intensity) / np.maximum(np.maximum(distance_squared, radius_squared), 1e-30)
    with np.errstate(divide="ignore", invalid="ignore"):
        direction = from_point / np.sqrt(distance_squared)[:, None]
        sin_box = np.minimum(1.0, np.sqrt(radius_squared / distance_squared) * 1.001 + 1e-3)
    cos_box = _sine(sin_box)
    towards = dot(axis, direction)
    cos_axis = np.where(intensity < 0.0, np.abs(towards), -towards)
    from_normals = _difference(cos_axis, _sine(cos_axis), cos_normals, _sine(cos_normals))
    cos_light, _ = _difference(*from_normals, cos_box, sin_box)
    cos_receiver = dot(normal, direction)
    receiver, _ = _difference(cos_receiver, _sine(cos_receiver), cos_box, sin_box)
    receiver = np.where(normal.any(axis=1), np.maximum(receiver, LEAST_COS_RECEIVER), 1.0)
    seen = np.where(cos_light > cos_emission, falloff * np.maximum(cos_light, 0.0) * receiver, 0.0)
    return np.where(distance_squared <= radius_squared, falloff, seen)


def tree_depth(nodes: np.ndarray) -> int:
    return max(int(np.log2(len(nodes) + 1)) - 1, 0)


def start_level(nodes: np.ndarray) -> int:
    return min(tree_depth(nodes), START_LEVEL)


def start_importance(nodes: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """[n, 2^start_level]: of the nodes at which walks start; [n, 0] without a tree."""
    count = 1 << start_level(nodes) if len(nodes) else 0
    each = [light_importance(np.tile(node, (len(point), 1)), point, normal) for node in nodes[count - 1 :][:count]]
    return np.stack(each, axis=1) if each else np.zeros((len(point), 0))


def choose_start(importance: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By importance [n, m] and u [n]: the column that u chooses, the place of u within it, and its probability, 0 where
    all are 0."""
    ends = np.cumsum(importance, axis=1)
    total = ends[:, -1]
    # What roundings leave beyond the last column that counts is its own.
    last = importance.shape[1] - 1 - np.argmax(importance[:, ::-1] > 0.0, axis=1)
    column = np.minimum((ends <= (u * total)[:, None]).sum(axis=1), last)
    width = np.take_along_axis(importance, column[:, None], axis=1)[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = (u * total - np.take_along_axis(ends, column[:, None], axis=1)[:, 0] + width) / width
        chance = width / total
    return column, np.clip(np.nan_to_num(place), 0.0, 1.0 - 2.0**-24), np.nan_to_num(chance)


def walk_light_tree(
    nodes: np.ndarray, start: np.ndarray, point: np.ndarray, normal: np.ndarray, u: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The leaf [n] that u [n, 2] chooses, or target [n] where that is >= 0, and the probability of getting there from
    node start [n] of the start level, 0 where no light below it reaches the point; and what is left of u, [n]."""
    depth, first = tree_depth(nodes), start_level(nodes)
    node = (1 << first) - 1 + start
    probability = np.ones(len(point))
    u = u.copy()
    for level in range(first, depth):
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
    return node - ((1 << depth) - 1), np.nan_to_num(probability), u[:, 0 if depth < LEVELS_OF_FIRST else 1]
