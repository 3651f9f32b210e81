# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether svgf can run in this Blender, and what takes the engine's place where it cannot.

Imports nothing of svgf before it is asked, so that the add-on can always be registered.
"""

from __future__ import annotations

import importlib
import platform
import textwrap
import tomllib
from pathlib import Path

import bpy

_ENGINE = "SVGF"
_MANIFEST = Path(__file__).with_name("blender_manifest.toml")
_LETTERS = 48  # of a line in the panel

_problem = ""


def find_problem() -> str:
    """Why svgf cannot run and what to do about it; empty where it can. Loads native code, but touches no GPU."""
    install_again = (
        f"Remove the extension and install its zip for Blender {bpy.app.version[0]}.{bpy.app.version[1]} "
        f"on {platform.system()}, then restart Blender."
    )
    try:
        loaded = importlib.import_module("svgf").__version__
    except ImportError as error:
        return f"Python {platform.python_version()} finds no package svgf ({error}). {install_again}"
    version = tomllib.loads(_MANIFEST.read_text(encoding="utf-8"))["version"]
    if loaded != version:
        # Native code cannot be loaded twice, so the old one stays until Blender ends.
        return f"Version {version} of SVGF was installed while {loaded} was at work. Restart Blender."
    try:
        importlib.import_module("svgf.devices").load_native("cpu")
    except Exception as error:  # whatever it is, Blender has to start
        return f"{getattr(error, 'message', error)} {install_again}"
    return ""


class UnavailableEngine(bpy.types.RenderEngine):
    """Keeps SVGF in the list of engines, and in files that use it, while it cannot render."""

    bl_idname = _ENGINE
    bl_label = "SVGF"
    bl_use_preview = False
    bl_use_eevee_viewport = True

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        self.report({"ERROR"}, _problem)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        self.update_stats("", _problem)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        self.update_stats("", _problem)


class SVGF_PT_unavailable(bpy.types.Panel):
    """The reason, where the settings would be."""

    bl_label = "SVGF Cannot Run"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {_ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context: bpy.types.Context) -> None:
        write(self.layout, _problem, "ERROR")


def write(layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """In as many lines as it takes: labels end at the panel's edge."""
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, _LETTERS)):
        column.label(text=line, icon="BLANK1" if number else icon)


def register(problem: str) -> None:
    """In place of everything else; problem: a sentence and its remedy."""
    global _problem
    _problem = problem
    print(f"SVGF: {problem}")
    bpy.utils.register_class(UnavailableEngine)
    bpy.utils.register_class(SVGF_PT_unavailable)


def unregister() -> None:
    bpy.utils.unregister_class(SVGF_PT_unavailable)
    bpy.utils.unregister_class(UnavailableEngine)
