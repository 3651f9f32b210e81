# SPDX-License-Identifier: Apache-2.0
"""Scripts in a Blender with a window, which only renders its viewports between the steps of a script.

    blender --python tests/gui/SCRIPT.py -- SITE [ARGUMENT ...]

SITE: a folder that holds svgf (an unpacked wheel) and the add-on as svgf_blender. Each script says what else it takes.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator

import bpy

SITE, *ARGUMENTS = sys.argv[sys.argv.index("--") + 1 :]
sys.path.insert(0, SITE)

import svgf_blender  # noqa: E402
from svgf_blender.viewport import views  # noqa: E402

_STEP_SECONDS = 0.05


def play(script: Callable[[], Iterator[float]]) -> None:
    """Runs a generator that yields how many seconds of Blender's main loop it wants. Quits Blender with its success."""
    svgf_blender.register()
    bpy.context.preferences.view.show_splash = False
    steps = script()

    def step() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            print("passed")
            svgf_blender.unregister()
            bpy.ops.wm.quit_blender()
        except BaseException:
            traceback.print_exc()
            sys.stdout.flush()
            svgf_blender.unregister()
            sys.exit(1)
        return None

    # Persistent, because scripts open files.
    bpy.app.timers.register(step, first_interval=0.5, persistent=True)


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def areas(kind: str) -> list[bpy.types.Area]:
    return [area for area in window().screen.areas if area.type == kind]


def space() -> bpy.types.SpaceView3D:
    return areas("VIEW_3D")[0].spaces.active


def override() -> object:
    """The context of an operator that needs a 3D view."""
    area = areas("VIEW_3D")[0]
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window(), area=area, region=region)


def start_engine(pixel_size: str = "4", samples: int = 8, budget: float = 0) -> bpy.types.Scene:
    """SVGF in the first 3D view, coarse enough for a slow machine. budget: milliseconds; 0: in full resolution."""
    scene = window().scene
    scene.render.engine = "SVGF"
    scene.render.preview_pixel_size = pixel_size
    scene.svgf.device, scene.svgf.viewport_samples, scene.svgf.viewport_budget = "cpu", samples, budget
    space().shading.type = "RENDERED"
    return scene


def session():
    """Of the view with the newest picture."""
    return views.sessions_of(window().scene)[-1]


def settled(seconds: float = 60) -> Iterator[float]:
    """Waits until the picture on the screen is the last one. Fails after some seconds."""
    end = time.monotonic() + seconds
    yield 6 * _STEP_SECONDS  # Blender evaluates and draws first what the script has changed
    while not views.sessions_of(window().scene) or session().busy or session().has_news:
        assert time.monotonic() < end, "The viewport does not come to rest."
        yield _STEP_SECONDS
    assert not session().error, session().error


def until(condition: Callable[[], bool], what: str, seconds: float = 60) -> Iterator[float]:
    """Waits for something, however slow the machine is."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, what
        yield _STEP_SECONDS


def mouse(*command: str | int) -> None:
    """From outside, as a user does."""
    subprocess.run(["xdotool", *map(str, command)], check=True)


def drag_edge(area: bpy.types.Area, distance: int) -> Iterator[float]:
    """Moves the right edge of an area as a user does: the mouse is pressed on it, moved and let go."""
    x, y = area.x + area.width, window().height - (area.y + area.height // 2)
    mouse("mousemove", x, y)
    yield 0.05
    mouse("mousedown", 1)
    yield 0.05
    mouse("mousemove", x + distance, y)
    yield 0.05
    mouse("mouseup", 1)
    yield 0.1


def picture(name: str) -> Iterator[float]:
    """Of the whole screen, into the folder that is the first argument; without one, nothing."""
    if ARGUMENTS:
        yield 0.3
        subprocess.run(["import", "-window", "root", f"{ARGUMENTS[0]}/{name}.png"], check=True)


def memory_mb() -> float:
    """Resident now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20
