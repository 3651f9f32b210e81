# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees as graphs of numpy functions that fold constants, know what they depend on, and have a content hash."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .images import Image

# Points that are evaluated at a time: few enough for the arrays of a step to stay in the processor's cache.
_CHUNK = 1 << 15


@dataclass(frozen=True, eq=False)
class Expression:
    """A number or a vector for each point.

    function: of the inputs' arrays, with the settings as keywords; None for constants and coordinates.
    value: [1] or [1, 3] of a constant, else None. coordinates: names of the coordinates that it depends on.
    """

    function: Callable[..., np.ndarray] | None
    settings: Mapping[str, Any]
    inputs: tuple[Expression, ...]
    value: np.ndarray | None
    coordinates: frozenset[str]

    @cached_property
    def digest(self) -> bytes:
        """Equal for equal functions of equal inputs."""
        state = hashlib.sha1(usedforsecurity=False)
        for part in self._parts():
            state.update(len(part).to_bytes(8, "little") + part)
        return state.digest()

    def _parts(self) -> Iterator[bytes]:
        if self.value is not None:
            yield self.value.tobytes()
            return
        yield self.function.__qualname__.encode() if self.function else b""
        for name, setting in sorted(self.settings.items()):
            yield name.encode()
            if isinstance(setting, Image):
                yield setting.digest
            else:
                yield setting.tobytes() if isinstance(setting, np.ndarray) else repr(setting).encode()
        for member in self.inputs:
            yield member.digest

    def number(self) -> float:
        """Of a constant number."""
        return float(self.value[0])

    def vector(self) -> tuple[float, float, float]:
        """Of a constant vector."""
        return tuple(float(part) for part in self.value[0])


def constant(value: float | tuple[float, ...]) -> Expression:
    """A number, or the first three components of a vector or colour."""
    array = np.array([value if np.ndim(value) == 0 else tuple(value)[:3]], np.float32)
    return Expression(None, {}, (), array, frozenset())


def coordinate(name: str) -> Expression:
    """A vector that the caller of ``evaluate`` gives."""
    return Expression(None, {"name": name}, (), None, frozenset({name}))


def apply(function: Callable[..., np.ndarray], *inputs: Expression, **settings: Any) -> Expression:
    """The function of the inputs, at once where all of them are constant."""
    coordinates = frozenset().union(*(member.coordinates for member in inputs))
    value = None
    if not coordinates:
        with np.errstate(all="ignore"):
            value = np.asarray(function(*(member.value for member in inputs), **settings), np.float32)
        value = np.nan_to_num(value, posinf=0, neginf=0)
    return Expression(function, settings, inputs, value, coordinates)


def evaluate(expression: Expression, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """float32 [n] or [n, 3] at points: float32 [n, 3] for each coordinate by name. What is not finite becomes 0."""
    count = len(next(iter(points.values())))
    shape = (count, 3) if is_vector(expression) else (count,)
    result = np.empty(shape, np.float32)
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        with np.errstate(all="ignore"):
            result[part] = _evaluate(expression, {name: array[part] for name, array in points.items()}, {})
    return np.nan_to_num(result, copy=False, nan=0, posinf=0, neginf=0)


def is_vector(expression: Expression) -> bool:
    """Whether it has three components. One point tells."""
    with np.errstate(all="ignore"):
        points = {name: np.zeros((1, 3), np.float32) for name in expression.coordinates}
        return _evaluate(expression, points, {}).ndim == 2


def walk(expression: Expression) -> list[Expression]:
    """The graph's members, each once; nothing that became a constant."""
    seen: dict[int, Expression] = {}
    waiting = [expression]
    while waiting:
        member = waiting.pop()
        if id(member) not in seen:
            seen[id(member)] = member
            waiting.extend(member.inputs if member.value is None else ())
    return list(seen.values())


def _evaluate(expression: Expression, points: Mapping[str, np.ndarray], known: dict[int, np.ndarray]) -> np.ndarray:
    if expression.value is not None:
        return expression.value
    if expression.function is None:
        return points[expression.settings["name"]]
    if id(expression) not in known:
        inputs = (_evaluate(member, points, known) for member in expression.inputs)
        known[id(expression)] = np.asarray(expression.function(*inputs, **expression.settings), np.float32)
    return known[id(expression)]
