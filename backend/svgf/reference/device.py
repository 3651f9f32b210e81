# SPDX-License-Identifier: Apache-2.0
"""The device of the reference: this process. It keeps the timings and can be interrupted, as a native one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..errors import Interrupted


class Device:
    def __init__(self, index: int = 0) -> None:
        self._timings: dict[str, float] = {}
        self._interrupted = False

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Times a stage. Raises Interrupted where it was asked for since the last stage."""
        if self._interrupted:
            self._interrupted = False
            raise Interrupted(f"Stage {name} was interrupted.")
        start = time.perf_counter()
        yield
        self._timings[name] = self._timings.get(name, 0.0) + (time.perf_counter() - start) * 1e3

    def take_timings(self) -> dict[str, float]:
        """Milliseconds per stage since the last call."""
        timings, self._timings = self._timings, {}
        return timings

    def synchronize(self) -> None:
        """Nothing is ever under way."""

    def interrupt(self) -> None:
        self._interrupted = True

    def clear_interrupt(self) -> None:
        self._interrupted = False

    def upload(self, image: np.ndarray) -> np.ndarray:
        return image

    def copy_bandwidth(self, size: int, repetitions: int) -> float:
        """Bytes read and written per second by a copy of ``size`` bytes."""
        source, target = np.ones(size // 8), np.empty(size // 8)
        times = []
        for _ in range(repetitions):
            start = time.perf_counter()
            np.copyto(target, source)
            times.append(time.perf_counter() - start)
        return 2 * source.nbytes / sorted(times)[repetitions // 2]

    def to_numpy(self, image: np.ndarray) -> np.ndarray:
        return np.array(image)
