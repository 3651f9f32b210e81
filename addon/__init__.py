# SPDX-License-Identifier: GPL-3.0-or-later
"""SVGF as a render engine in Blender."""

from . import engine, session
from .ui import panels, properties, statistics
from .viewport import views

# Properties come first, because the others refer to them.
_MODULES = (properties, session, views, engine, panels, statistics)


def register() -> None:
    for module in _MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(_MODULES):
        module.unregister()
