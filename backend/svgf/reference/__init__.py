# SPDX-License-Identifier: Apache-2.0
"""The renderer in numpy, float64: an independent statement of the maths, to be read beside the papers.

One module per stage, with the names that ``native`` has. The classes have the interface of the native ones, and ignore
the device they are given.
"""

from __future__ import annotations

from importlib import import_module

_MODULES = {"Device": "device", "Mesh": "surface", "Texture": "texture", "Tracer": "tracer", "Denoiser": "denoiser"}

__all__ = ["Denoiser", "Device", "Mesh", "Texture", "Tracer"]


def kernels() -> list[int]:
    """Bits of the effects that each kernel simulates: there is one, for all of them."""
    from ..effects import Effects

    return [int(~Effects.NONE)]


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)
