# SPDX-License-Identifier: Apache-2.0
"""Where scenes come from: .svgf files, .blend files (through the add-on's exporter), and those that ship with svgf."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import InputError
from ..frame_range import format_frames
from ..framing import reframe
from ..scene import Scene
from ..scene_file import SceneFile
from .progress import silence

_Report = Callable[[int, int], None]


@contextmanager
def open_scenes(
    path: Path, frames: tuple[int, ...] | None, size: tuple[int, int] | None, report: _Report | None = None
) -> Iterator[Iterator[Scene]]:
    """The scenes of a file, one after the other; frames: which ones, all by default. Closes the file at the end.

    size: (width, height) instead of the file's, for which the camera is framed. report: called with the number of
    scenes that are done and of all. Raises InputError as reading does, and where a frame is not there.
    """
    kind = path.suffix.lower()
    if kind == ".svgf":
        with SceneFile(path) as file:
            wanted = file.frames if frames is None else frames
            missing = set(wanted) - set(file.frames)
            if missing:
                raise InputError(
                    f"{path} has no frame {format_frames(missing)}.", f"It holds {format_frames(file.frames)}."
                )
            yield _read(file, wanted, size, report)
    elif kind == ".blend":
        if not path.is_file():
            raise InputError(f"Cannot read {path}: there is no such file.", "Check the path.")
        scenes = load_exporter()(path, frames=frames, size=size, report=report)
        try:
            yield _silenced(scenes)
        finally:
            scenes.close()
    else:
        raise InputError(f"{path} is neither a .svgf nor a .blend file.", "Give one of these.")


def load_exporter() -> Callable[..., Iterator[Scene]]:
    """The add-on's ``export_file``. Raises InputError where Blender's module or the add-on is not installed."""
    return _import_addon("export").export_file


def load_export_timings() -> Callable[[int], list[Any]]:
    """The add-on's ``export.timings.measure``. Raises InputError like ``load_exporter``."""
    return _import_addon("export.timings").measure


def _import_addon(module: str) -> ModuleType:
    try:
        return importlib.import_module(f"svgf_blender.{module}")
    except ModuleNotFoundError as error:
        if error.name in ("bpy", "mathutils"):
            raise InputError(
                "Reading .blend files needs the bpy package.", "Install it with: pip install 'svgf[blender]'"
            ) from error
        if (error.name or "").startswith("svgf_blender"):
            raise InputError(
                "Reading .blend files needs svgf's add-on, which this installation lacks.", "Install svgf again."
            ) from error
        raise


def shipped_scenes() -> dict[str, Path]:
    """The scenes that come with svgf, by name; empty where it was installed without them."""
    folder = resources.files("svgf") / "scenes"
    if not folder.is_dir():
        return {}
    paths = (Path(str(entry)) for entry in folder.iterdir() if entry.name.endswith(".svgf"))
    return {path.stem: path for path in sorted(paths)}


def shipped_scene(name: str) -> Path:
    """The file of one of them. Raises InputError that lists what there is."""
    scenes = shipped_scenes()
    if not scenes:
        raise InputError("This installation of svgf has no scenes.", "Install svgf again, or give a file.")
    if name not in scenes:
        raise InputError(f'svgf ships no scene "{name}".', f"Choose one of {', '.join(scenes)}.")
    return scenes[name]


def _silenced(scenes: Iterator[Scene]) -> Iterator[Scene]:
    while True:
        with silence(1):
            scene = next(scenes, None)
        if scene is None:
            return
        yield scene


def _read(
    file: SceneFile, frames: tuple[int, ...], size: tuple[int, int] | None, report: _Report | None
) -> Iterator[Scene]:
    for done, frame in enumerate(frames, start=1):
        scene = file.scene(frame)
        yield scene if size is None else reframe(scene, *size)
        if report:
            report(done, len(frames))
