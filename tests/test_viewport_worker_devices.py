# SPDX-License-Identifier: Apache-2.0
"""The thread that renders for a view, on every device of this machine and without Blender: on a GPU machine too."""

from __future__ import annotations

import importlib
import sys
import time
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import svgf
from svgf.errors import DeviceError
from svgf.scene import RenderDefaults
from svgf.settings import Settings

ROOT = Path(__file__).parents[1]
SIZE = (48, 28)
SAMPLES = 4


@pytest.fixture(scope="module")
def module():
    """addon/viewport/worker.py. The package around it registers things in Blender, so a bare one takes its place."""
    package = types.ModuleType("viewport_without_blender")
    package.__path__ = [str(ROOT / "addon" / "viewport")]
    sys.modules[package.__name__] = package
    blender = "bpy" in sys.modules
    yield importlib.import_module(f"{package.__name__}.worker")
    assert blender or "bpy" not in sys.modules
    for name in [name for name in sys.modules if name.startswith(package.__name__)]:
        del sys.modules[name]


@pytest.fixture
def scene():
    with svgf.SceneFile(ROOT / "blender_scenes" / "cornell.svgf") as file:
        scene = file.scene(file.frames[0])
    width, height = SIZE
    return replace(scene, defaults=replace(scene.defaults, width=width, height=height))


@pytest.fixture
def worker(module, request):
    """Views are the same thread on any device: those that run in real time are enough."""
    if "device" in request.fixturenames and request.getfixturevalue("device").name == "reference":
        pytest.skip("seconds per frame")
    worker = module.Worker()
    yield worker
    worker.close()
    assert not worker.alive


def ask(module, worker, device, scene, limit=SAMPLES, seconds=120, **changes):
    """The result at which the worker has come to rest. device: an opened one, or a name."""
    request = module.Request(scene, Settings(), getattr(device, "name", device), limit)
    worker.submit(replace(request, **changes))
    end = time.monotonic() + seconds
    while worker.busy:
        assert time.monotonic() < end
        time.sleep(0.005)
    assert not worker.result.error
    return worker.result


def test_still_view_is_the_renderers_picture(module, worker, device, scene):
    result = ask(module, worker, device, scene)
    assert (result.samples, result.reset, result.note) == (SAMPLES, "first frame", "")
    assert result.device == device.description and result.frame.timings["path"] > 0
    still = replace(scene.at_rest(), frame=1)
    renderer = svgf.Renderer(Settings(), device)
    expected = [renderer.render(still) for _ in range(SAMPLES)][-1]
    assert np.array_equal(result.frame.color, expected.color)
    assert np.array_equal(result.picture[::-1, :, :3], expected.color) and (result.picture[..., 3] == 1).all()


def test_view_that_turns_keeps_history(module, worker, device, scene):
    ask(module, worker, device, scene)
    left, right, bottom, top = scene.camera.window
    shift = 2 / SIZE[0] * (right - left)  # two pixels
    camera = replace(scene.camera, window=(left + shift, right + shift, bottom, top))
    frame = ask(module, worker, device, replace(scene, camera=camera), limit=1).frame
    surface = frame.object_id > 0
    assert frame.reset == "" and np.allclose(frame.motion[surface][:, 0], 2, atol=1e-2)
    seen_before = surface & (np.indices(surface.shape)[1] < SIZE[0] - 2)
    assert (frame.history_length[seen_before] > 1).mean() > 0.8


def test_object_that_moves_has_motion(module, worker, device, scene):
    ask(module, worker, device, scene)
    transforms = scene.instances.object_to_world.copy()
    moved = len(transforms) - 1
    transforms[moved, :, 3] += scene.camera.camera_to_world[:, 0] * 0.05
    instances = replace(scene.instances, object_to_world=transforms)
    frame = ask(module, worker, device, replace(scene, instances=instances), limit=1).frame
    assert frame.reset == ""
    moving = np.unique(frame.object_id[np.abs(frame.motion[..., 0]) > 0.1])
    assert moving.tolist() == [scene.instances.object_id[moved]]


def test_sizes_come_and_go(module, worker, device, scene):
    for width, height in ((17, 9), SIZE, (1, 1), SIZE):
        defaults: RenderDefaults = replace(scene.defaults, width=width, height=height)
        result = ask(module, worker, device, replace(scene, defaults=defaults), limit=2)
        assert result.picture.shape == (height, width, 4) and np.isfinite(result.picture).all()


def test_two_views_at_once(module, device, scene):
    """Two workers, each with a device of its own: neither disturbs the other's history."""
    workers = [module.Worker() for _ in range(2)]
    for worker in workers:
        worker.submit(module.Request(scene, Settings(), device.name, SAMPLES))
    results = [ask(module, worker, device, worker._request.scene) for worker in workers]
    assert np.array_equal(results[0].frame.color, results[1].frame.color)
    for worker in workers:
        worker.close()


def test_every_image_can_be_shown(module, worker, device, scene):
    picture = importlib.import_module(f"{module.__package__}.picture")
    frame = ask(module, worker, device, scene, look=picture.Look("reset_reason")).frame
    constant = {"motion", *(name for name, each in picture.OVERLAYS.items() if each.diagnoses)}
    for overlay in picture.OVERLAYS:
        pixels = picture.paint(frame, picture.Look(overlay))
        assert np.isfinite(pixels).all() and pixels.shape == (SIZE[1], SIZE[0], 4), overlay
        assert overlay in constant or np.ptp(pixels[..., :3]) > 0, overlay


def test_device_that_fails_gives_way_to_the_cpu(module, worker, device, scene, monkeypatch):
    """As after a sticky CUDA error: the picture goes on, and says why it is slower."""
    ask(module, worker, device, scene)
    if device.name == "cpu":
        pytest.skip("there is nothing left to give way to")
    render = module.Renderer.render

    def failing(self, scene, *arguments):
        if self.device.name == device.name:
            raise DeviceError("The device failed.", "Restart Blender.", stage="path")
        return render(self, scene, *arguments)

    monkeypatch.setattr(module.Renderer, "render", failing)
    result = ask(module, worker, device, replace(scene), limit=2)
    assert result.note == "The device failed. Restart Blender. The CPU goes on." and result.samples == 2
    assert "CPU" in result.device or result.device != device.description


def test_closing_does_not_wait_for_a_long_frame(module, device, scene):
    worker = module.Worker()
    large = replace(scene, defaults=replace(scene.defaults, width=1920, height=1080))
    worker.submit(module.Request(large, Settings(), device.name, 10**6))
    worker.close()
    assert not worker.alive and worker.result.error == ""
