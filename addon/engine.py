# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine that Blender calls."""

from __future__ import annotations

from concurrent.futures import Future
from concurrent.futures import wait as wait_for

import bpy
import numpy as np
from svgf.errors import Error, InputError, Interrupted
from svgf.frame import Frame

from .export import export_frame
from .session import Session, find_session
from .ui.passes import unsupported_passes, wanted_passes
from .viewport import views

_POLL_SECONDS = 0.02  # between looks for Esc
_STOP_SECONDS = 0.05  # for a frame to end after it; while a tree is built, nothing can stop it
_KINDS = {"RGBA": "COLOR", "RGB": "COLOR", "XYZ": "VECTOR", "XYZW": "VECTOR"}  # of a pass by its channels


class SVGFRenderEngine(bpy.types.RenderEngine):
    """Real-time path tracing, denoised with spatiotemporal variance-guided filtering."""

    bl_idname = "SVGF"
    bl_label = "SVGF"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # for Material Preview
    bl_use_shading_nodes_custom = False  # materials are made of Cycles' nodes

    def __init__(self, *arguments, **named) -> None:
        super().__init__(*arguments, **named)
        self.token = object()  # tells instances apart, even where one takes another's place in memory

    def update_render_passes(self, scene: bpy.types.Scene | None = None, renderlayer=None) -> None:
        """Tells Blender which passes there will be."""
        for name, entry in wanted_passes(renderlayer).items():
            kind = _KINDS.get(entry.channels, "VALUE")
            self.register_pass(scene, renderlayer, name, len(entry.channels), entry.channels, kind)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Blender's data changed, or the view has just become a rendered one."""
        if context.region_data is not None:  # a script may draw a view where there is none
            views.update(self, context, depsgraph)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """The view is drawn anew: it was moved, or has news."""
        if context.region_data is not None:
            views.draw(self, context, depsgraph)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """One frame of a final render.

        Whatever goes wrong is reported as an error, on which Blender writes no file and ends an animation.
        """
        try:
            self._write(self._render_frame(depsgraph), depsgraph)
        except Interrupted:
            return
        except Error as error:
            self.report({"ERROR"}, str(error))
        except BaseException as error:
            self.report({"ERROR"}, f"svgf failed: {error!r}. The traceback is in the console.")
            raise

    def _render_frame(self, depsgraph: bpy.types.Depsgraph) -> Frame:
        if depsgraph.scene.render.use_multiview:
            raise InputError("Stereo rendering is not supported.", "Turn Stereoscopy off in the output properties.")
        session = find_session(depsgraph.scene, depsgraph.view_layer)
        self.update_stats("", "Exporting the scene")
        scene = export_frame(self, depsgraph, session.exporter)
        self._warn(session, *scene.warnings, *unsupported_passes(depsgraph.view_layer))
        properties = depsgraph.scene.svgf
        self.update_stats("", "Rendering")
        settings = properties.to_settings(depsgraph.view_layer.samples or None)
        future = session.start(scene, settings, properties.device)
        frame = self._wait(session, future, settings.samples)
        if session.note:
            self._warn(session, session.note)
        return frame

    def _warn(self, session: Session, *warnings: str) -> None:
        """Of each thing once in a job."""
        for warning in warnings:
            if warning not in session.reported:
                session.reported.add(warning)
                self.report({"WARNING"}, warning)

    def _wait(self, session: Session, future: Future[Frame], samples: int) -> Frame:
        """The finished frame. Raises Interrupted soon after the user pressed Esc, even if the thread takes longer."""
        while not future.done():
            if self.test_break():
                session.stop()
                wait_for([future], timeout=_STOP_SECONDS)
                raise Interrupted("The render was cancelled.")
            wait_for([future], timeout=_POLL_SECONDS)
            self.update_progress(session.progress)
            if samples > 1:
                self.update_stats("", f"Sample {round(session.progress * samples)}/{samples}")
        return future.result()

    def _write(self, frame: Frame, depsgraph: bpy.types.Depsgraph) -> None:
        """Into Blender's render result, whose bottom row comes first."""
        rows, columns = _region(frame, depsgraph.scene.render)
        result = self.begin_result(
            0, 0, columns.stop - columns.start, rows.stop - rows.start, layer=depsgraph.view_layer.name
        )
        wanted = wanted_passes(depsgraph.view_layer)
        for render_pass in result.layers[0].passes:
            entry = wanted.get(render_pass.name)
            if entry is not None:
                part = entry.image(frame)[rows, columns][::-1]
                render_pass.rect.foreach_set(np.ascontiguousarray(part, np.float32).ravel())
        self.end_result(result)


def _region(frame: Frame, render: bpy.types.RenderSettings) -> tuple[slice, slice]:
    """Rows and columns of the image that Blender's result holds: all of them without a render region."""
    if not render.use_border:
        return slice(0, frame.height), slice(0, frame.width)
    # Rounded as Blender does, in float32.
    left, right = (int(np.float32(x) * np.float32(frame.width)) for x in (render.border_min_x, render.border_max_x))
    bottom, top = (int(np.float32(y) * np.float32(frame.height)) for y in (render.border_min_y, render.border_max_y))
    return slice(frame.height - top, frame.height - bottom), slice(left, right)


def register() -> None:
    bpy.utils.register_class(SVGFRenderEngine)


def unregister() -> None:
    bpy.utils.unregister_class(SVGFRenderEngine)
