# SPDX-License-Identifier: Apache-2.0
"""The thread that renders for a view: until its limit, with history, through errors, to its end."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from blend import add_cube, add_light, export
from svgf.devices import available_devices
from svgf.diagnostics import ResetReason
from svgf.effects import Effects, find_effects
from svgf.errors import DeviceError, InputError, Interrupted
from svgf.settings import Settings
from svgf_blender.viewport import worker as module
from svgf_blender.viewport.picture import OVERLAYS, RESET_COLORS, Look, PictureMemory, paint
from svgf_blender.viewport.worker import Request, Worker

DEVICE = next(info.name for info in reversed(available_devices()[1:]) if info.available and info.name == "cpu")


@pytest.fixture
def scene():
    add_cube()
    add_light("AREA", location=(0, -2, 4), energy=200)
    return export(size=(24, 14))


@pytest.fixture
def worker():
    worker = Worker()
    yield worker
    worker.close()
    assert not worker.alive


def ask(worker, scene, limit=4, seconds=30, **changes):
    """The result at which the worker has come to rest."""
    request = replace(Request(scene, Settings(), DEVICE, limit), **changes)
    worker.submit(request)
    end = time.monotonic() + seconds
    while worker.busy:
        assert time.monotonic() < end
        time.sleep(0.005)
    return worker.result


def test_rests_at_the_sample_limit(worker, scene):
    result = ask(worker, scene)
    assert (result.samples, result.frames, result.reset, result.error) == (4, 4, "first frame", "")
    assert result.frame.history_length.max() == 4 and result.frame.timings["path"] > 0
    used = time.process_time()
    time.sleep(0.3)
    assert worker.result is result and time.process_time() - used < 0.1
    assert ask(worker, scene, limit=6).samples == 6
    assert ask(worker, scene, limit=2).samples == 6


def test_still_view_has_no_motion(worker, scene):
    assert not ask(worker, scene).frame.motion[..., :2].any()


def test_view_that_turns_keeps_history(worker, scene):
    ask(worker, scene)
    left, right, bottom, top = scene.camera.window
    camera = replace(scene.camera, window=(left + 0.02, right + 0.02, bottom, top))
    result = ask(worker, replace(scene, camera=camera), limit=1)
    assert result.frame.reset == "" and result.frame.history_length.max() > 4
    motion = result.frame.motion[result.frame.object_id > 0]
    assert np.allclose(motion[:, 0], 0.02 / (right - left) * 24, atol=1e-3)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda scene: {"scene": replace(scene, lights=tuple(scene.lights))}, ""),
        (lambda scene: {"scene": replace(scene, lights=())}, "the lights changed"),
        (lambda scene: {"scene": replace(scene, defaults=replace(scene.defaults, width=12))}, ""),
        (lambda scene: {"settings": Settings(seed=1)}, "the settings changed"),
        (lambda scene: {"device": "reference"}, "the device changed"),
    ],
)
def test_changes_restart_with_their_reason(worker, scene, change, reason):
    ask(worker, scene)
    result = ask(worker, **{"scene": scene, "limit": 1, **change(scene)})
    assert result.frame.reset == reason and result.reset == (reason or "first frame") and result.samples == 1
    assert not result.error


def test_without_denoiser_the_mean_is_shown(worker, scene):
    result = ask(worker, scene, limit=8, settings=Settings(method="none"))
    mean = result.frame.color
    result = ask(worker, replace(scene), limit=1, settings=Settings(method="none"))
    assert np.abs(result.frame.color - mean).max() > 0 and np.isfinite(mean).all()
    frames = ask(worker, scene, limit=64, settings=Settings(method="none")).frame
    assert np.abs(frames.color - frames.noisy).mean() > 1e-4


def test_still_view_becomes_what_a_final_render_is(worker, scene):
    """Without denoiser: the mean of many frames of one sample is one frame of many samples."""
    color = ask(worker, scene, limit=128, settings=Settings(method="none")).frame.color
    final = module.Renderer(Settings(method="none", samples=128), DEVICE).render(scene).color
    assert np.abs(color - final).mean() < 0.02 * final.mean()
    assert color.mean() == pytest.approx(final.mean(), rel=0.005)


def test_memory_of_pictures_is_used_again_when_nobody_holds_them():
    memory = PictureMemory()
    shown, waiting = memory.new(4, 6), memory.new(4, 6)
    shown[:], waiting[:] = 1, 2
    address = waiting.ctypes.data
    del waiting
    again = memory.new(4, 6)
    again[:] = 3
    assert again.ctypes.data == address and (shown == 1).all()
    del again
    assert memory.new(2, 2).shape == (2, 2, 4), "Another size does not fit."


def test_overlay_paints_the_same_frame_again(worker, scene):
    first = ask(worker, scene)
    second = ask(worker, scene, look=Look("normal"))
    assert second.frame is first.frame and second.number == first.number + 1
    assert np.array_equal(second.picture, paint(first.frame, Look("normal")))


def test_pictures_are_what_a_half_float_texture_takes(worker, scene):
    frame = ask(worker, scene, limit=1, look=Look("reset_reason")).frame
    color = frame.color.copy()
    color[0, 0], color[0, 1] = (np.nan, np.inf, 1e9), (-1, 0, -np.inf)
    for overlay in OVERLAYS:
        picture = paint(replace(frame, color=color), Look(overlay))
        assert picture.shape == (14, 24, 4) and picture.dtype == np.float32 and picture.flags.c_contiguous
        assert np.isfinite(picture.astype(np.float16)).all() and picture.min() >= 0 and (picture[..., 3] == 1).all()
    picture = paint(replace(frame, color=color), Look())
    assert picture[-1, 0, :3].tolist() == [0, 65504, 65504], "The bottom row comes first."


def test_overlays_of_an_empty_scene(worker, scene):
    instances = scene.instances
    rows = {name: rows[:0] for name, rows in vars(instances).items() if rows is not None}
    empty = replace(instances, **rows)
    frame = ask(worker, replace(scene, meshes=(), instances=empty), limit=1, look=Look("reset_reason")).frame
    for overlay in OVERLAYS:
        assert np.isfinite(paint(frame, Look(overlay))).all()


def test_error_is_shown_and_the_next_request_goes_on(worker, scene):
    picture = ask(worker, scene).picture
    result = ask(worker, replace(scene, defaults=replace(scene.defaults, bounces=-1)))
    assert "bounces" in result.error and result.picture is picture
    assert ask(worker, scene).error == ""


def test_fault_of_ours_is_shown(worker, scene, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(module, "follow", lambda *_: 1 / 0)
        assert "ZeroDivisionError" in ask(worker, scene).error
    assert ask(worker, replace(scene)).error == ""


def test_lost_device_gives_way_to_the_cpu(scene):
    def open_device(name):
        if name != "cpu":
            raise DeviceError("The GPU is lost.", "Restart Blender.")
        return module.open_device(name)

    worker = Worker(open_device)
    result = ask(worker, scene, device="cuda")
    assert result.samples == 4 and result.note == "The GPU is lost. Restart Blender. The CPU goes on."
    worker.close()


def test_device_that_is_lost_while_it_renders(worker, scene, monkeypatch):
    render = module.Renderer.render

    def failing(self, scene, *arguments):
        if self.device.name == "reference":
            raise DeviceError("The device failed.", stage="path")
        return render(self, scene, *arguments)

    monkeypatch.setattr(module.Renderer, "render", failing)
    result = ask(worker, scene, device="reference")
    assert result.samples == 4 and result.note == "The device failed. The CPU goes on."


def test_cpu_that_fails_is_an_error(scene):
    worker = Worker(lambda name: (_ for _ in ()).throw(DeviceError("No module.")))
    assert ask(worker, scene, device="cpu").error == "No module."
    worker.close()


def test_closing_interrupts_the_frame(worker, scene, monkeypatch):
    stopped, started = threading.Event(), threading.Event()

    def endless(self, scene, *arguments):
        started.set()
        assert stopped.wait(10)
        raise Interrupted("Stopped.")

    monkeypatch.setattr(module.Renderer, "render", endless)
    monkeypatch.setattr(module.Renderer, "interrupt", lambda self: stopped.set())
    worker.submit(Request(scene, Settings(), DEVICE, 4))
    assert started.wait(10)
    worker.close()
    assert not worker.alive and worker.result.error == ""


def test_requests_are_not_queued(worker, scene):
    """A hundred views in the time of a few frames: only the newest one counts."""
    ask(worker, scene)
    for step in range(100):
        window = tuple(side + step * 1e-4 for side in scene.camera.window)
        last = replace(scene, camera=replace(scene.camera, window=window))
        worker.submit(Request(last, Settings(), DEVICE, 1))
    result = ask(worker, last, limit=1)
    assert result.scene.camera is last.camera and result.error == ""


def test_coarser_picture_interrupts_the_frame(worker, scene, monkeypatch):
    render, started, stopped = module.Renderer.render, threading.Event(), threading.Event()

    def slow(self, scene, *arguments):
        if scene.defaults.width == 24 and not stopped.is_set():
            started.set()
            assert stopped.wait(10)
            raise Interrupted("Stopped.")
        return render(self, scene, *arguments)

    monkeypatch.setattr(module.Renderer, "render", slow)
    monkeypatch.setattr(module.Renderer, "interrupt", lambda self: stopped.set())
    worker.submit(Request(scene, Settings(), DEVICE, 4))
    assert started.wait(10)
    worker.submit(Request(replace(scene), Settings(), DEVICE, 4))
    assert not stopped.is_set(), "A frame of the same size is finished."
    small = replace(scene, defaults=replace(scene.defaults, width=12, height=7))
    result = ask(worker, small)
    assert stopped.is_set() and result.frame.width == 12 and result.error == "" and result.samples == 4


def test_history_survives_the_steps_of_resolution(worker, scene):
    ask(worker, scene, limit=16)
    full = scene.defaults
    for divisor in (2, 1, 3):
        defaults = replace(full, width=full.width // divisor, height=full.height // divisor)
        last = ask(worker, replace(scene, defaults=defaults), limit=1, look=Look("reset_reason"))
        assert last.frame.reset == "" and last.frame.color.shape[1] == defaults.width
        surface = last.frame.object_id > 0
        assert (last.frame.reset_reason[surface] == ResetReason.KEPT).all()
        assert (last.frame.history_length[surface] > 1).all()


def test_noise_of_a_mean_falls_with_its_samples(worker, scene):
    few = ask(worker, scene, limit=4, settings=Settings(method="none")).noise
    many = ask(worker, scene, limit=64, settings=Settings(method="none")).noise
    assert many == pytest.approx(few / 4, rel=0.4)


def test_split_screen(worker, scene):
    frame = ask(worker, scene, limit=8).frame
    noisy, result, split = (paint(frame, Look(name, split=0.5)) for name in ("noisy", "result", "split"))
    assert np.array_equal(split[:, :11], noisy[:, :11]) and np.array_equal(split[:, 12:], result[:, 12:])
    assert (split[:, 11] == 1).all()
    assert np.array_equal(paint(frame, Look("split", split=0.0)), result)


def test_transparent_film_lets_the_background_through(worker, scene):
    scene = replace(scene, defaults=replace(scene.defaults, transparent_film=True))
    frame = ask(worker, scene, limit=1).frame
    background = frame.object_id[::-1] == 0
    assert background.any() and not background.all()
    picture = paint(frame, Look())
    assert not picture[background].any() and (picture[~background, 3] > 0).all()
    assert (paint(frame, Look("depth"))[..., 3] == 1).all(), "Data has no background."


def test_alpha_of_a_view_at_rest_is_the_mean_of_its_frames(worker, scene):
    """Half of a pixel that a silhouette halves; a single frame knows all or nothing of it."""
    scene = replace(scene, defaults=replace(scene.defaults, transparent_film=True))
    for settings in (Settings(), Settings(method="none")):
        alpha = ask(worker, scene, limit=64, settings=settings).frame.alpha
        edge = (alpha > 0) & (alpha < 1)
        assert np.allclose(alpha * 64, np.round(alpha * 64), atol=1e-3) and edge.sum() > 10
    again = ask(worker, replace(scene, name="again"), limit=1).frame.alpha
    assert set(np.unique(again)) <= {0.0, 1.0}, "The mean starts afresh where something changes."


def test_diagnostics_are_made_only_while_they_are_shown(worker, scene):
    """By the denoiser itself, in one more frame where the view rests; its history goes on."""
    first = ask(worker, scene)
    assert first.frame.reset_reason is None and "diagnose" not in first.frame.timings
    second = ask(worker, scene, look=Look("reset_reason"))
    assert second.samples == first.samples + 1 and second.frame.reset == ""
    assert set(np.unique(second.frame.reset_reason)) == {ResetReason.KEPT, ResetReason.BACKGROUND}
    assert "diagnose" in second.frame.timings
    assert ask(worker, scene, look=Look("motion_error")).frame is second.frame
    third = ask(worker, scene, limit=8)
    assert third.frame.reset_reason is None and third.frames == 8 and "diagnose" not in third.frame.timings


@pytest.mark.parametrize("overlay", [name for name, each in OVERLAYS.items() if each.diagnoses])
@pytest.mark.parametrize("method", ["svgf+", "svgf", "eaw", "none"])
def test_diagnostics_can_be_shown_with_every_method(worker, scene, method, overlay):
    result = ask(worker, scene, limit=2, settings=Settings(method=method), look=Look(overlay))
    assert not result.error and np.array_equal(result.picture, paint(result.frame, Look(overlay)))


def test_repaired_values_are_marked(worker, scene):
    frame = ask(worker, scene, limit=1, look=Look("repaired_values")).frame
    assert not frame.repaired_values.any()
    repaired = np.zeros_like(frame.repaired_values)
    repaired[1, 2] = 3
    marked = paint(frame.with_images(repaired_values=repaired), Look("repaired_values"))[::-1]
    assert marked[1, 2, 0] == 1 and np.count_nonzero(marked[..., 0] >= 0.5) == 1


def test_reset_reasons(worker, scene):
    """Each pixel says why it has no history, or that it has one."""
    look = Look("reset_reason")
    first = ask(worker, scene, limit=1, look=look)
    assert colors_of_surfaces(first) == {color_of(ResetReason.RESTARTED)}
    assert colors_of_surfaces(ask(worker, scene, limit=2, look=look)) == {color_of(ResetReason.KEPT)}
    left, right, bottom, top = scene.camera.window
    camera = replace(scene.camera, window=(left, right, bottom + 0.05, top + 0.05))
    turned = ask(worker, replace(scene, camera=camera), limit=1, look=look)
    assert color_of(ResetReason.KEPT) in colors_of_surfaces(turned)
    camera = replace(scene.camera, window=(right - 0.1, 2 * right - left - 0.1, bottom, top))
    away = ask(worker, replace(scene, camera=camera), limit=1, look=look)
    back = ask(worker, scene, limit=1, look=look)
    assert (away.picture[..., :3] == RESET_COLORS[ResetReason.BACKGROUND][0]).all(axis=2).any()
    assert color_of(ResetReason.OUTSIDE) in colors_of_surfaces(back)


def test_every_reset_reason_has_a_color():
    assert set(RESET_COLORS) == set(ResetReason)
    assert len({color for color, _ in RESET_COLORS.values()}) == len(ResetReason)


def colors_of_surfaces(result):
    surface = result.frame.object_id[::-1] > 0
    return {tuple(color) for color in result.picture[surface][:, :3].tolist()}


def color_of(reason):
    return tuple(np.float32(RESET_COLORS[reason][0]).tolist())


def test_costs_of_effects_come_when_asked_for(worker, scene):
    pytest.importorskip("svgf.bench.effects")
    result = ask(worker, scene)
    assert not result.costs
    worker.measure_effects()
    measured = ask(worker, scene)
    assert Effects.AREA_LIGHTS in measured.costs and measured.costs.keys() <= set(find_effects(scene))
    assert measured.frame is result.frame and not worker.busy, "Measured once, and no frame is rendered for it."
    assert ask(worker, scene, limit=5).costs == measured.costs


def test_costs_that_cannot_be_measured_stop_no_picture(worker, scene, monkeypatch):
    effects = pytest.importorskip("svgf.bench.effects")
    ask(worker, scene)
    monkeypatch.setattr(effects, "measure", lambda *_: 1 / 0)
    worker.measure_effects()
    result = ask(worker, scene)
    assert "ZeroDivisionError" in result.note and not result.costs and not result.error
    assert ask(worker, scene, limit=5).samples == 5


def test_stopped_worker_ends_by_itself(worker, scene):
    worker.submit(Request(scene, Settings(), DEVICE, 10**6))
    worker.stop()
    end = time.monotonic() + 10
    while worker.alive:
        assert time.monotonic() < end
        time.sleep(0.01)


def test_worker_that_never_started_closes():
    worker = Worker()
    worker.close()
    assert not worker.alive and not worker.busy


def test_names_are_checked(scene, worker):
    with pytest.raises(InputError):
        Settings(method="magic")
    assert "no device" in ask(worker, scene, device="magic").error
