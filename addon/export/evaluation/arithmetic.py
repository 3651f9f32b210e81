# SPDX-License-Identifier: GPL-3.0-or-later
"""The Math, Vector Math, Map Range, Clamp, Mapping and Vector Rotate nodes. What has no value, as x / 0, is 0."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_EPSILON = np.finfo(np.float32).eps


def safe_divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = np.broadcast_arrays(a, b)
    return np.divide(a, b, out=np.zeros(a.shape, np.float32), where=b != 0)


def power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """0 for a negative base with a broken exponent."""
    return np.where((a < 0) & (b != np.trunc(b)), 0, np.where((a == 0) & (b != 0), 0, np.power(a, b)))


def _logarithm(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    positive = (a > 0) & (b > 0)
    return np.where(positive, safe_divide(np.log(np.where(positive, a, 1)), np.log(np.where(positive, b, 2))), 0)


def _wrap(value: np.ndarray, upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    span = upper - lower
    return np.where(span != 0, value - span * np.floor(safe_divide(value - lower, span)), lower)


def _pingpong(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    phase = safe_divide(a - b, b * 2)
    return np.where(b != 0, np.abs((phase - np.floor(phase)) * b * 2 - b), 0)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    h = safe_divide(np.maximum(k - np.abs(a - b), 0), k)
    return np.minimum(a, b) - h * h * h * k / 6



_MATH: dict[str, Callable] = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: safe_divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: power(a, b),
    "LOGARITHM": lambda a, b, c: _logarithm(a, b),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    "INVERSE_SQRT": lambda a, b, c: np.where(a > 0, 1 / np.sqrt(np.where(a > 0, a, 1)), 0),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: a < b,
    "GREATER_THAN": lambda a, b, c: a > b,
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": lambda a, b, c: (a == b) | (np.abs(a - b) <= np.maximum(c, _EPSILON)),
    "SMOOTH_MIN": lambda a, b, c: _smooth_minimum(a, b, c),
    "SMOOTH_MAX": lambda a, b, c: -_smooth_minimum(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + np.float32(0.5)),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: a - np.floor(a),
    "MODULO": lambda a, b, c: np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0),
    "FLOORED_MODULO": lambda a, b, c: np.where(b != 0, a - np.floor(safe_divide(a, b)) * b, 0),
    "WRAP": _wrap,
    "SNAP": lambda a, b, c: np.floor(safe_divide(a, b)) * b,
    "PINGPONG": lambda a, b, c: _pingpong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


def math(a: np.ndarray, b: np.ndarray, c: np.ndarray, *, operation: str, clamp: bool) -> np.ndarray:
    value = np.asarray(_MATH[operation](a, b, c), np.float32)
    return np.clip(value, 0, 1) if clamp else value


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(-1)


def normalize(a: np.ndarray) -> np.ndarray:
    """Zero vectors stay as they are."""
    return safe_divide(a, np.sqrt(_dot(a, a))[..., None])


def _refract(a: np.ndarray, b: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    normal = normalize(b)
    cosine = _dot(normal, a)
    k = 1 - ratio**2 * (1 - cosine**2)
    bent = ratio[:, None] * a - (ratio * cosine + np.sqrt(np.maximum(k, 0)))[:, None] * normal
    return np.where(k[:, None] < 0, 0, bent)


def _reflect(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    normal = normalize(b)
    return a - 2 * _dot(a, normal)[..., None] * normal


_VECTOR_MATH: dict[str, Callable] = {
    "DIVIDE": lambda a, b, c, s: safe_divide(a, b),
    "CROSS_PRODUCT": lambda a, b, c, s: np.cross(a, b),
    "PROJECT": lambda a, b, c, s: safe_divide(_dot(a, b), _dot(b, b))[..., None] * b,
    "REFLECT": lambda a, b, c, s: _reflect(a, b),
    "REFRACT": lambda a, b, c, s: _refract(a, b, s),
    "FACEFORWARD": lambda a, b, c, s: np.where(_dot(c, b)[..., None] < 0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, s: _dot(a, b),
    "DISTANCE": lambda a, b, c, s: np.sqrt(_dot(a - b, a - b)),
    "LENGTH": lambda a, b, c, s: np.sqrt(_dot(a, a)),
    "SCALE": lambda a, b, c, s: a * s[:, None],
    "NORMALIZE": lambda a, b, c, s: normalize(a),
    "FRACTION": lambda a, b, c, s: a - np.floor(a),
}
# Componentwise, as the Math node does them.
_SAME_IN_MATH = (
    "ADD SUBTRACT MULTIPLY MULTIPLY_ADD SNAP FLOOR CEIL MODULO WRAP ABSOLUTE POWER SIGN MINIMUM MAXIMUM SINE COSINE"
    " TANGENT ROUND"
).split()


def vector_math(a: np.ndarray, b: np.ndarray, c: np.ndarray, scale: np.ndarray, *, operation: str) -> np.ndarray:
    """[n] for Dot Product, Distance and Length, else [n, 3]."""
    if operation in _SAME_IN_MATH:
        return np.asarray(_MATH[operation](a, b, c), np.float32)
    return np.asarray(_VECTOR_MATH[operation](a, b, c, scale), np.float32)


def map_range(
    value: np.ndarray,
    from_min: np.ndarray,
    from_max: np.ndarray,
    to_min: np.ndarray,
    to_max: np.ndarray,
    steps: np.ndarray,
    *,
    kind: str,
    clamp: bool,
) -> np.ndarray:
    """Numbers and vectors alike; an empty range of numbers gives 0, one of vectors the lower end."""
    factor = safe_divide(value - from_min, from_max - from_min)
    if kind == "STEPPED":
        factor = safe_divide(np.floor(factor * (steps + 1)), np.maximum(steps, 0))
    elif kind in {"SMOOTHSTEP", "SMOOTHERSTEP"}:
        t = np.clip(factor, 0, 1)
        factor = t * t * (3 - 2 * t) if kind == "SMOOTHSTEP" else t * t * t * (t * (t * 6 - 15) + 10)
    result = to_min + factor * (to_max - to_min)
    if value.ndim == 1:
        result = np.where(from_max == from_min, 0, result)
    if clamp and not kind.startswith("SMOOTH"):
        result = np.clip(result, np.minimum(to_min, to_max), np.maximum(to_min, to_max))
    return result.astype(np.float32)


def clamp(value: np.ndarray, low: np.ndarray, high: np.ndarray, *, kind: str) -> np.ndarray:
    if kind == "RANGE":
        low, high = np.minimum(low, high), np.maximum(low, high)
    return np.minimum(np.maximum(value, low), high)


def rotation_matrices(angles: np.ndarray) -> np.ndarray:
    """[n, 3, 3] of XYZ Euler angles [n, 3]."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cy * cz, sy * sx * cz - cx * sz, sy * cx * cz + sx * sz],
        [cy * sz, sy * sx * sz + cx * cz, sy * cx * sz - sx * cz],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows, np.float32), 2, 0)


def _rotated(vector: np.ndarray, angles: np.ndarray, inverse: bool = False) -> np.ndarray:
    matrices = rotation_matrices(angles)
    return (matrices.transpose(0, 2, 1) if inverse else matrices) @ vector[..., None]


def mapping(
    vector: np.ndarray, location: np.ndarray, rotation: np.ndarray, scale: np.ndarray, *, kind: str
) -> np.ndarray:
    if kind == "TEXTURE":
        return safe_divide(_rotated(vector - location, rotation, inverse=True)[..., 0], scale)
    if kind == "NORMAL":
        return normalize(_rotated(safe_divide(vector, scale), rotation)[..., 0])
    result = _rotated(vector * scale, rotation)[..., 0]
    return result + location if kind == "POINT" else result


def vector_rotate(
    vector: np.ndarray,
    center: np.ndarray,
    axis: np.ndarray,
    angle: np.ndarray,
    rotation: np.ndarray,
    *,
    kind: str,
    invert: bool,
) -> np.ndarray:
    if kind == "EULER_XYZ":
        return _rotated(vector - center, rotation, invert)[..., 0] + center
    if kind != "AXIS_ANGLE":
        axis = np.eye(3, dtype=np.float32)["XYZ".index(kind[0])][None]
    angle = -angle if invert else angle
    length = np.sqrt(_dot(axis, axis))[..., None]
    unit, offset = safe_divide(axis, length), vector - center
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned = offset * cosine + np.cross(unit, offset) * sine + unit * _dot(unit, offset)[..., None] * (1 - cosine)
    return np.where(length != 0, turned + center, vector)
