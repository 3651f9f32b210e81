# SPDX-License-Identifier: GPL-3.0-or-later
"""The sessions of all views: found again by scene and view, looked after by a timer, closed with their view."""

from __future__ import annotations

import atexit
import math
import time
import traceback
from collections.abc import Iterator
from dataclasses import replace

import bpy
from svgf.errors import Error
from svgf.scene import Aperture

from ..export.camera import export_aperture
from ..export.exporter import render_defaults
from ..export.findings import Finding, Findings
from ..export.unsupported import find_in_camera
from .camera import View, border_in_frame, cut_out, view_camera
from .draw import PictureTexture
from .picture import OVERLAYS, Look
from .session import ViewSession
from .worker import WHOLE, Part

Key = tuple[int, str, int]  # scene, view layer, address of the view

_ENGINE = "SVGF"
_BUSY_SECONDS = 1 / 60
_IDLE_SECONDS = 0.1
_PANEL_SECONDS = 0.25  # between redraws of the panels that show what a frame costs

_sessions: dict[Key, tuple[ViewSession, PictureTexture]] = {}
_stopped: list[ViewSession] = []  # their threads may still be at work
_panels = {"numbers": (), "time": 0.0}  # which results they show, and since when
_draw_handlers: list[object] = []


def update(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Blender's data changed."""
    session, _ = _find(context, depsgraph)
    _sync(session, engine, context, depsgraph)


def draw(engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Draws the newest picture, and asks for the next one where the view or the settings changed."""
    session, texture = _find(context, depsgraph)
    if session.engine != engine.token:  # a file or an undo has closed the session that this engine knew
        _sync(session, engine, context, depsgraph)
    try:
        _show(session, context, depsgraph, engine)
        result = session.result
        session.drawn = result.number
        if result.picture is not None and not OVERLAYS[result.request.look.overlay].is_data:
            texture.draw_light(engine, depsgraph.scene, result.picture, result.request.part, context.region)
        engine.update_stats("", session.status())
    except Error as error:
        engine.update_stats("", str(error))
    except Exception as error:  # An exception here would come with every redraw.
        traceback.print_exc()
        engine.update_stats("", f"Drawing failed: {error!r}. The traceback is in the console.")


def _draw_data() -> None:
    """Pictures of data go over the view, because Blender sends what an engine draws through the view transform."""
    context = bpy.context
    if context.engine != _ENGINE or context.space_data.shading.type != "RENDERED":
        return
    session, texture = _sessions.get(_key(context.scene, context.view_layer, context.region_data), (None, None))
    if session is None:
        return
    result = session.result
    if result.picture is not None and OVERLAYS[result.request.look.overlay].is_data:
        texture.draw_data(result.picture, result.request.part)


def sessions_of(scene: bpy.types.Scene) -> list[ViewSession]:
    """The sessions of the views that show a scene, the one with the newest picture last."""
    uid = scene.original.session_uid
    found = [session for key, (session, _) in _sessions.items() if key[0] == uid]
    return sorted(found, key=lambda session: session.result.number)


def close_all() -> None:
    """Waits for all workers to end."""
    _stop_all()
    while _stopped:
        _stopped.pop().close()


def _find(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> tuple[ViewSession, PictureTexture]:
    key = _key(depsgraph.scene.original, depsgraph.view_layer, context.region_data)
    if key not in _sessions:
        _sessions[key] = ViewSession(), PictureTexture()
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, persistent=True)
    return _sessions[key]


def _key(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, region_view: bpy.types.RegionView3D) -> Key:
    return scene.session_uid, view_layer.name, region_view.as_pointer()


def _sync(session: ViewSession, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph) -> None:
    session.sync(depsgraph, context.space_data, whole=session.engine != engine.token)
    session.engine = engine.token


def _show(
    session: ViewSession,
    context: bpy.types.Context,
    depsgraph: bpy.types.Depsgraph,
    engine: bpy.types.RenderEngine,
) -> None:
    scene, region = depsgraph.scene_eval, context.region
    pixel_size = int(engine.get_preview_pixel_size(scene))
    view = _view(context, scene, (math.ceil(region.width / pixel_size), math.ceil(region.height / pixel_size)))
    session.camera_findings = _camera_findings(context)
    defaults, properties = render_defaults(scene, view.size), scene.svgf
    session.show(
        view,
        defaults,
        properties.to_settings(samples=1),
        properties.device,
        properties.viewport_samples,
        Look(properties.viewport_overlay, properties.viewport_split),
        properties.viewport_budget,
    )


def _view(context: bpy.types.Context, scene: bpy.types.Scene, size: tuple[int, int]) -> View:
    """size: of the whole view, in pixels."""
    space, region_view, camera = context.space_data, context.region_data, _camera(context)
    clip, border, aperture = (space.clip_start, space.clip_end), WHOLE, Aperture()
    if camera is not None:
        data, render = camera.data, scene.render
        clip, aperture = (data.clip_start, data.clip_end), export_aperture(camera)
        if render.use_border:
            border = border_in_frame(region_view.window_matrix, data.view_frame(scene=scene), _border(render))
    elif space.use_render_border:
        border = _border(space)
    seen = view_camera(region_view.view_matrix, region_view.window_matrix, clip)
    return cut_out(replace(seen, aperture=aperture), size, border)


def _camera(context: bpy.types.Context) -> bpy.types.Object | None:
    """That the view looks through."""
    camera = context.space_data.camera
    looks = context.region_data.view_perspective == "CAMERA" and camera is not None and camera.type == "CAMERA"
    return camera if looks else None


def _camera_findings(context: bpy.types.Context) -> tuple[Finding, ...]:
    """Not of the export, which knows no camera: turning one exports nothing."""
    camera, findings = _camera(context), Findings()
    if camera is not None:
        find_in_camera(camera, findings)
    return findings.found()


def _border(owner: bpy.types.RenderSettings | bpy.types.SpaceView3D) -> Part:
    sides = ("border_min_x", "border_min_y", "border_max_x", "border_max_y")
    prefix = "" if isinstance(owner, bpy.types.RenderSettings) else "render_"
    return tuple(getattr(owner, prefix + side) for side in sides)


def _tick() -> float | None:
    """Redraws views with news, ends the sessions of views that are gone; the end of the timer without sessions."""
    regions = dict(_rendered_regions())
    for key in [key for key in _sessions if key[0::2] not in regions]:
        session, _ = _sessions.pop(key)
        session.stop()
        _stopped.append(session)
    _stopped[:] = [session for session in _stopped if session.alive]
    for key, (session, _) in _sessions.items():
        if session.has_news:
            regions[key[0::2]].tag_redraw()
    _refresh_panels()
    if not _sessions and not _stopped:
        return None
    return _BUSY_SECONDS if any(session.busy for session, _ in _sessions.values()) else _IDLE_SECONDS


def _rendered_regions() -> Iterator[tuple[tuple[int, int], bpy.types.Region]]:
    """((scene, view), region) of all views in Rendered shading."""
    for window in bpy.context.window_manager.windows:
        scene = window.scene
        if scene.render.engine != _ENGINE:
            continue
        for area in window.screen.areas:
            space = area.spaces.active
            if space.type == "VIEW_3D" and space.shading.type == "RENDERED":
                for region in area.regions:
                    if region.type == "WINDOW":
                        yield (scene.session_uid, region.data.as_pointer()), region


def _refresh_panels() -> None:
    """Redraws the render properties where there are new results, but not as often as there are."""
    numbers, now = tuple(session.result.number for session, _ in _sessions.values()), time.monotonic()
    if numbers == _panels["numbers"] or now < _panels["time"] + _PANEL_SECONDS:
        return
    _panels.update(numbers=numbers, time=now)
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if space.type == "PROPERTIES" and space.context == "RENDER":
                area.tag_redraw()


@bpy.app.handlers.persistent
def _stop_all(*_arguments) -> None:
    """Ends all sessions, but does not wait for the frames in the making: they hold nothing of Blender's."""
    while _sessions:
        _, (session, _) = _sessions.popitem()
        session.stop()
        _stopped.append(session)


@bpy.app.handlers.persistent
def _forget_engines(*_arguments) -> None:
    """After an undo the depsgraph does not name all that differs."""
    for session, _ in _sessions.values():
        session.engine = None


def _handlers() -> Iterator[tuple[list, object]]:
    handlers = bpy.app.handlers
    yield handlers.load_pre, _stop_all
    yield handlers.undo_post, _forget_engines
    yield handlers.redo_post, _forget_engines


def register() -> None:
    for handlers, function in _handlers():
        handlers.append(function)
    _draw_handlers.append(bpy.types.SpaceView3D.draw_handler_add(_draw_data, (), "WINDOW", "POST_VIEW"))
    # A Blender that quits without disabling the add-on must not end under a thread that renders.
    atexit.register(close_all)


def unregister() -> None:
    atexit.unregister(close_all)
    while _draw_handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_draw_handlers.pop(), "WINDOW")
    for handlers, function in _handlers():
        handlers.remove(function)
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    close_all()
