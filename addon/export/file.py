# SPDX-License-Identifier: GPL-3.0-or-later
""".blend files to scenes, for the command line: Blender as a module opens the file and steps through its frames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import bpy
from svgf.errors import InputError
from svgf.scene import Scene

from .camera import check_camera
from .exporter import Exporter
from .frames import export_frame

_SCRIPTS_NOT_RUN = ("Scripts and Python drivers of the file are not run; what they animate stands still.",)

_WHOLE_FRAME = ("The render region is not exported; the whole frame is.",)


class _ExportEngine(bpy.types.RenderEngine):
    """Renders nothing: Blender builds a dependency graph with render visibility and levels for render engines alone."""

    bl_idname = "SVGF_EXPORT"
    bl_label = "SVGF Export"
    bl_use_preview = False

    # What one call of the render operator takes and gives; Blender makes the engine's instances itself.
    exporter: Exporter
    size: tuple[int, int] | None
    scene: Scene | None
    error: BaseException | None

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        cls = _ExportEngine
        try:
            cls.scene = export_frame(self, depsgraph, cls.exporter, cls.size)
        except BaseException as error:  # Blender would print it and go on.
            cls.error = error


def export_file(
    path: str | os.PathLike[str],
    frames: Iterable[int] | None = None,
    size: tuple[int, int] | None = None,
    report: Callable[[int, int], None] | None = None,
) -> Iterator[Scene]:
    """The frames of a .blend file, one after the other. What did not change is the same object in each of them.

    Opening the file replaces what Blender has open.

    frames: numbers, ascending; those of the file's frame range by default. size: (width, height) in pixels instead of
    the file's. report: called with the number of finished frames and of all frames, at first with 0.
    Raises InputError for a file that cannot be read, has no camera or nothing to render.
    """
    _open(path)
    scene = bpy.context.scene
    if frames is None:
        frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    frames = tuple(frames)
    if report:
        report(0, len(frames))
    warnings = _SCRIPTS_NOT_RUN if bpy.app.autoexec_fail else ()
    warnings += _WHOLE_FRAME if scene.render.use_border else ()
    bpy.utils.register_class(_ExportEngine)
    try:
        _prepare(scene)
        exporter = Exporter()
        for done, frame in enumerate(frames, start=1):
            exported = _export(scene, frame, exporter, size)
            yield replace(exported, warnings=warnings + exported.warnings)
            if report:
                report(done, len(frames))
    finally:
        bpy.utils.unregister_class(_ExportEngine)


def _open(path: str | os.PathLike[str]) -> None:
    path = os.path.abspath(path)
    if not os.path.isfile(path):
        raise InputError(f"There is no file {path}.", "Check the path.")
    try:
        # Scripts in files of unknown origin stay where they are, as in Blender's own default.
        bpy.ops.wm.open_mainfile(filepath=path, load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise InputError(
            f"Blender {bpy.app.version_string} cannot open {path}.",
            "It is damaged, no .blend file, or made by a newer Blender.",
        ) from error


def _prepare(scene: bpy.types.Scene) -> None:
    """Only this scene's own picture is wanted, and nothing may be written."""
    scene.render.engine = _ExportEngine.bl_idname
    scene.render.use_compositing = False
    scene.render.use_sequencer = False


def _export(scene: bpy.types.Scene, frame: int, exporter: Exporter, size: tuple[int, int] | None) -> Scene:
    cls = _ExportEngine
    cls.exporter, cls.size, cls.scene, cls.error = exporter, size, None, None
    scene.frame_set(frame)
    check_camera(scene.camera, scene)  # Blender would refuse to start
    try:
        bpy.ops.render.render(scene=scene.name, layer=bpy.context.view_layer.name)
    except RuntimeError as error:
        raise InputError(f'Blender cannot render scene "{scene.name}": {error}') from error
    if cls.error is not None:
        raise cls.error
    if cls.scene is None:
        raise InputError(f'Blender did not render frame {frame} of scene "{scene.name}".', "See its messages above.")
    return cls.scene
