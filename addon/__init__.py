# SPDX-License-Identifier: GPL-3.0-or-later
"""SVGF as a render engine in Blender."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from . import installation

# Properties come first, because the others refer to them.
_MODULES = (
    *("ui.properties", "session", "viewport.views", "engine"),
    *("ui.panels", "ui.visibility", "ui.passes", "ui.devices", "ui.culprits", "ui.statistics"),
)

_unregister: list[Callable[[], None]] = []  # of what is registered


def register() -> None:
    """Whatever is wrong with the installation, Blender starts, and says it where SVGF's settings would be."""
    problem = installation.find_problem()
    if problem:
        installation.register(problem)
        _unregister.append(installation.unregister)
        return
    for name in _MODULES:
        module = import_module(f".{name}", __name__)
        module.register()
        _unregister.append(module.unregister)


def unregister() -> None:
    while _unregister:
        _unregister.pop()()
