# SPDX-License-Identifier: Apache-2.0
"""The three ways to run a frame, behind one set of names: ``cuda``, ``cpu`` and ``reference``.

``open_device(name)`` gives a Device whose mesh, texture, tracer and denoiser factories have the same signatures on
each.
"""

from __future__ import annotations

import importlib
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from . import _native
from .effects import Effects
from .errors import DeviceError, InputError

NAMES = ("auto", "cuda", "cpu", "reference")

_INSTALL_AGAIN = "Install svgf again on this machine: pip install --force-reinstall --no-deps svgf"


@dataclass(frozen=True)
class DeviceInfo:
    """name: what ``open_device`` takes. description: the hardware. reason: why it is not available, else empty."""

    name: str
    description: str
    available: bool
    reason: str = ""
    memory_bytes: int = 0


class Device:
    """One opened device. Not shared between threads, but for ``interrupt``.

    name: "cuda", "cpu" or "reference". description: the hardware, for tables and headers.
    """

    def __init__(self, name: str, description: str, module: ModuleType) -> None:
        self.name = name
        self.description = description
        self._module = module
        self._device = module.Device(0)

    def mesh(self, *arguments: Any, **named: Any) -> Any:
        return self._module.Mesh(self._device, *arguments, **named)

    def refit(
        self,
        mesh: Any,
        positions: np.ndarray,
        normals: np.ndarray,
        previous_positions: np.ndarray,
        tangents: np.ndarray | None = None,
    ) -> bool:
        """Moves the vertices of a mesh of this device that was made with previous positions; its triangles, slots and
        UVs stay. Returns False where that does not pay: the mesh can then no longer be used."""
        return mesh.refit(self._device, positions, normals, previous_positions, tangents)

    def texture(self, *arguments: Any, **named: Any) -> Any:
        return self._module.Texture(self._device, *arguments, **named)

    def tracer(self) -> Any:
        return self._module.Tracer(self._device)

    def denoiser(self, *arguments: Any, **named: Any) -> Any:
        return self._module.Denoiser(self._device, *arguments, **named)

    @property
    def kernels(self) -> tuple[Effects, ...]:
        """What each compiled kernel simulates, from the cheapest on: a frame takes the first that covers its
        effects."""
        return tuple(Effects(bits) for bits in self._module.kernels())

    def kernel_for(self, effects: Effects) -> Effects:
        """The one of ``kernels`` that a frame with these effects takes."""
        return next(kernel for kernel in self.kernels if effects & kernel == effects)

    def take_timings(self) -> dict[str, float]:
        """Milliseconds per stage since the last call. Waits for the device."""
        return self._device.take_timings()

    def synchronize(self) -> None:
        """Waits until the device has done all that it was asked to."""
        self._device.synchronize()

    def interrupt(self) -> None:
        """From any thread: the running stage, or else the next one, raises Interrupted."""
        self._device.interrupt()

    def clear_interrupt(self) -> None:
        """Forgets an interrupt that came while nothing ran."""
        self._device.clear_interrupt()

    def to_numpy(self, image: Any) -> np.ndarray:
        """A copy on the host of an image that a tracer or a denoiser of this device returned."""
        return self._device.to_numpy(image)

    def upload(self, image: np.ndarray) -> Any:
        """The inverse of ``to_numpy``: float32 or int32 [H, W] or [H, W, C], C-contiguous, as this device's denoiser
        takes it without a copy."""
        return self._device.upload(image)

    def copy_bandwidth(self, size: int, repetitions: int = 9) -> float:
        """Bytes read and written per second by a plain copy of ``size`` bytes: the median. Forgets the timings."""
        return self._device.copy_bandwidth(size, repetitions)

    def __repr__(self) -> str:
        return f"<svgf.Device {self.name}: {self.description}>"


def load_native(name: str) -> ModuleType:
    """The native module "cpu", "cpu_avx2" or "cuda", which touches no GPU yet. Raises DeviceError that says why not."""
    try:
        return importlib.import_module(f"._native.{name}", __package__)
    except ImportError as error:
        raise DeviceError(_why_not_loaded(name, error), _INSTALL_AGAIN) from error


def _why_not_loaded(name: str, error: ImportError) -> str:
    module, folder = f"The native module svgf._native.{name}", Path(_native.__path__[0])
    python = f"Python {sys.version_info.major}.{sys.version_info.minor}"
    if isinstance(error, ModuleNotFoundError):
        others = ", ".join(sorted(file.name for file in folder.glob(f"{name}.*")))
        if others:
            return f"{module} is made for another Python than {python}: {others}."
        return "This build of svgf has no CUDA module." if name == "cuda" else f"{module} is missing in {folder}."
    if "undefined symbol: Py" in str(error):
        return f"{module} is made for a newer Python than {python}."
    library = re.search(r"`((?:GLIBC|GLIBCXX|CXXABI)_[\d.]+)' not found", str(error))
    if library:
        return f"{module} needs {library[1]}, which this system is too old to have."
    return f"{module} cannot be loaded: {error}."


def _cpu_module() -> ModuleType:
    """The fastest build that this processor can run."""
    baseline = load_native("cpu")
    return load_native("cpu_avx2") if baseline.has_avx2_build and baseline.processor_has_avx2() else baseline


def _info(name: str) -> DeviceInfo:
    if name == "reference":
        return DeviceInfo(name, f"numpy {np.__version__}, float64", True)
    try:
        module = _cpu_module() if name == "cpu" else load_native("cuda")
    except DeviceError as error:
        return DeviceInfo(name, "-", False, str(error))
    description, memory, reason = module.list_devices()[0]
    return DeviceInfo(name, description, not reason, reason, memory)


def available_devices() -> list[DeviceInfo]:
    """cuda, cpu and reference, in this order, whether they can be used or not."""
    return [_info(name) for name in NAMES[1:]]


def open_device(name: str = "auto") -> Device:
    """name: "cuda", "cpu", "reference", or "auto": cuda where there is a usable GPU and driver, else cpu.

    Raises InputError for an unknown name, DeviceError with the reason for a device that is not available.
    """
    if name not in NAMES:
        raise InputError(f'There is no device "{name}".', f"Choose one of {', '.join(NAMES)}.")
    if name == "auto":
        name = "cuda" if _info("cuda").available else "cpu"
    info = _info(name)
    if not info.available:
        raise DeviceError(f'Device "{name}" is not available: {info.reason}')
    if name == "reference":
        from . import reference

        return Device(name, info.description, reference)
    return Device(name, info.description, _cpu_module() if name == "cpu" else load_native("cuda"))
