# SPDX-License-Identifier: Apache-2.0
"""Opening devices, stopping them, running out of memory, and that the same frame gives the same bits."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from svgf.devices import NAMES, available_devices, open_device
from svgf.errors import DeviceError, InputError, Interrupted, OutOfMemory
from svgf.renderer import SAMPLES_PER_LAUNCH, Renderer
from svgf.settings import Settings

from . import scenes

SMALL = Settings(width=24, height=14, bounces=2)


def test_every_device_is_listed_and_says_why_it_is_missing():
    devices = available_devices()
    assert [info.name for info in devices] == list(NAMES[1:])
    for info in devices:
        assert info.available != bool(info.reason)
    assert devices[-1].available


def test_unknown_device():
    with pytest.raises(InputError, match='There is no device "gpu". Choose one of auto, cuda, cpu, reference.'):
        open_device("gpu")


def test_device_that_is_not_available():
    info = available_devices()[0]
    if info.available:
        pytest.skip("this machine has a GPU")
    with pytest.raises(DeviceError, match='Device "cuda" is not available: '):
        open_device("cuda")


def test_auto_takes_the_fastest():
    best = next(info.name for info in available_devices() if info.available)
    assert open_device("auto").name == best


def test_stages_are_timed_under_the_names_of_their_files(device):
    frame = Renderer(SMALL, device).render(scenes.box_scene())
    stages = ["update", "gbuffer", "path", "demodulate", "temporal", "atrous", "modulate", "antialias"]
    # One launch can be two stages, "modulate+antialias"; of several launches, "gbuffer hits", the sum is told.
    assert list(dict.fromkeys(name for row in frame.timings for name in row.split("+"))) == stages
    assert all(milliseconds >= 0 for milliseconds in frame.timings.values())


def test_same_frame_same_bits(device):
    first, second = (Renderer(SMALL, device).render(scenes.box_scene()) for _ in range(2))
    for name in ("color", "noisy", "depth", "motion", "variance", "history_length"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_images_that_wait_unread_keep_their_pixels():
    """Frames of many sizes come and go: on the CPU their images lie beside each other in large pages of memory."""
    pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    device = open_device("cpu")
    sizes = [(40, 40), (96, 60), (200, 110), (400, 220)]

    def render(size):
        return Renderer(Settings(*size, bounces=1, method="none"), device).render(scenes.box_scene())

    wanted = {size: render(size).noisy.copy() for size in sizes}
    waiting = [(size, render(size)) for size in sizes * 3]
    del waiting[::2]
    waiting += [(size, render(size)) for size in reversed(sizes)]
    for size, frame in waiting:
        np.testing.assert_array_equal(frame.noisy, wanted[size])


@pytest.mark.parametrize("threads", [1, 3])
def test_number_of_threads_does_not_matter(threads):
    """One thread, or more than there are cores."""
    pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    program = (
        "import zlib; from svgf.renderer import Renderer; from svgf.settings import Settings; from tests import scenes;"
        "print(zlib.crc32(Renderer(Settings(width=48, height=27, bounces=2), 'cpu').render(scenes.box_scene()).color))"
    )
    folder = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    checksums = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **environment},
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for environment in ({}, {"SVGF_THREADS": str(threads)})
    }
    assert len(checksums) == 1


def test_interrupt_stops_a_frame_and_the_next_one_runs(device):
    """Ten thousand samples would take minutes."""
    renderer = Renderer(Settings(width=64, height=36, samples=10_000, method="none"), device)
    started = threading.Event()
    outcome = []

    def render():
        try:
            renderer.render(scenes.box_scene(), progress=lambda share: started.set())
        except Interrupted as error:
            outcome.append(error)

    thread = threading.Thread(target=render)
    thread.start()
    assert started.wait(60)
    start = time.monotonic()
    renderer.interrupt()
    thread.join(30)
    assert not thread.is_alive()
    assert outcome, f"the frame went on for {time.monotonic() - start:.1f} s and ended"

    again = Renderer(SMALL, device).render(scenes.box_scene())
    assert np.isfinite(again.color).all()


def test_interrupt_while_nothing_runs_is_forgotten(device):
    renderer = Renderer(SMALL, device)
    renderer.interrupt()
    assert renderer.render(scenes.box_scene()).color.any()


def test_frame_after_an_interrupted_one_starts_without_history(device):
    renderer = Renderer(SMALL, device)
    scene = scenes.box_scene()
    renderer.render(scene)

    def stop(share):
        renderer.interrupt()

    with pytest.raises(Interrupted):
        renderer.render(scene, progress=stop)
    frame = renderer.render(scene)
    assert frame.reset == "the last frame was not finished"
    assert frame.history_length.max() == 1


def test_frame_after_one_that_was_interrupted_while_it_was_traced_goes_on(device):
    """The denoiser has not touched its history by then."""
    renderer = Renderer(replace(SMALL, samples=2 * SAMPLES_PER_LAUNCH), device)
    scene = scenes.box_scene()
    renderer.render(scene)
    with pytest.raises(Interrupted):
        renderer.render(replace(scene, frame=scene.frame + 1), progress=lambda _share: renderer.interrupt())
    frame = renderer.render(replace(scene, frame=scene.frame + 1))
    assert frame.reset == "" and frame.history_length.max() == 2


@pytest.mark.gpu
def test_more_than_the_gpu_has():
    """One piece of memory that is larger than any GPU's."""
    if not available_devices()[0].available:
        pytest.skip(available_devices()[0].reason)
    device = open_device("cuda")
    with pytest.raises(OutOfMemory, match="The GPU has no room for copy source .* MiB free"):
        device.copy_bandwidth(2**44)
    assert Renderer(SMALL, device).render(scenes.box_scene()).color.any()


@pytest.mark.gpu
@pytest.mark.skipif(
    int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")) > 1,
    reason="takes all of the GPU's memory, and from the tests beside it: run it with -n 0",
)
def test_gpu_without_room():
    """Says what there was no room for, and goes on with what fits."""
    if not available_devices()[0].available:
        pytest.skip(available_devices()[0].reason)
    device = open_device("cuda")
    with pytest.raises(OutOfMemory, match="The GPU has no room for .* MiB free"):
        Renderer(Settings(width=32000, height=32000, bounces=0), device).render(scenes.box_scene())
    assert Renderer(SMALL, device).render(scenes.box_scene()).color.any()
