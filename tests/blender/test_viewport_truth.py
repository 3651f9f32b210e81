# SPDX-License-Identifier: Apache-2.0
"""The picture at which a still viewport comes to rest is that of a final render, and Cycles'."""

from __future__ import annotations

import time
from dataclasses import replace

import bpy
import numpy as np
import pytest
from blend import add_cube, add_light, add_material, add_mesh, export
from scipy import stats
from svgf.devices import available_devices
from svgf.renderer import Renderer
from svgf.settings import Settings
from svgf_blender.viewport.worker import Request, Worker

DEVICE = next(info.name for info in reversed(available_devices()[1:]) if info.available and info.name == "cpu")
SIZE = (32, 18)
BATCHES, SAMPLES = 24, 64
ERROR_RATE = 1e-4
MEAN = Settings(method="none")


@pytest.fixture
def scene():
    """Diffuse things under lamps: what both engines have alike."""
    add_material("Floor", add_mesh("Floor", location=(0, 0, -1)), Base_Color=(0.7, 0.5, 0.3), Specular_IOR_Level=0.0)
    bpy.data.objects["Floor"].scale = (6, 6, 1)
    add_material("Box", add_cube(), Base_Color=(0.2, 0.4, 0.7), Specular_IOR_Level=0.0)
    add_light("AREA", location=(2, -2, 4), energy=300, size=2.0)
    add_light("POINT", name="Point", location=(-3, -3, 2), energy=100, shadow_soft_size=0.3)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    scene.cycles.max_bounces, scene.cycles.sample_clamp_indirect, scene.cycles.blur_glossy = 4, 0.0, 0.0
    scene.camera.location = (0, -9, 2)
    scene.camera.rotation_euler.x = 1.35
    return scene


def settled(worker: Worker, scene, seed: int, settings: Settings = MEAN, samples: int = SAMPLES) -> np.ndarray:
    """What a view shows of a still scene when it has come to rest."""
    worker.submit(Request(scene, replace(settings, seed=seed), DEVICE, samples))
    end = time.monotonic() + 120
    while worker.busy:
        assert time.monotonic() < end
        time.sleep(0.005)
    assert not worker.result.error and worker.result.samples == samples
    return worker.result.frame.color


def assert_same_means(first: np.ndarray, second: np.ndarray) -> None:
    """Welch's t-test of each pixel's channels over batches [N, H, W, 3], with Sidak's correction for their number, and
    of the whole picture."""
    statistic, probability = stats.ttest_ind(first, second, axis=0, equal_var=False)
    known = np.isfinite(statistic)
    smallest = 1 - (1 - ERROR_RATE) ** (1 / known.sum())
    worst = np.unravel_index(np.nanargmin(probability), probability.shape)
    assert np.nanmin(probability) >= smallest, (worst, first[:, *worst].mean(), second[:, *worst].mean())
    assert np.allclose(first[:, ~known].mean(axis=0), second[:, ~known].mean(axis=0), rtol=1e-5, atol=1e-6)
    whole = stats.ttest_ind(first.mean(axis=(1, 2, 3)), second.mean(axis=(1, 2, 3)), equal_var=False)
    assert whole.pvalue >= ERROR_RATE, (first.mean(), second.mean())


@pytest.fixture
def viewport(scene):
    exported = export(size=SIZE)
    worker = Worker()
    # Batches with seeds of their own are independent, whatever the sampler stratifies within one.
    yield np.stack([settled(worker, replace(exported), seed) for seed in range(BATCHES)])
    worker.close()


def test_is_the_final_render(scene, viewport):
    exported = export(size=SIZE)
    final = [
        Renderer(Settings(method="none", samples=SAMPLES, seed=seed), DEVICE).render(exported).color
        for seed in range(BATCHES, 2 * BATCHES)
    ]
    assert_same_means(viewport, np.stack(final))


@pytest.mark.skipif("cycles" not in bpy.context.preferences.addons, reason="needs Cycles")
def test_is_cycles_picture(scene, viewport, tmp_path):
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = SAMPLES, False, False
    cycles.pixel_filter_type = "BOX"
    cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = cycles.max_bounces
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    images = []
    for seed in range(BATCHES):
        cycles.seed = seed
        path = tmp_path / f"{seed}.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(path))
        pixels = np.empty(SIZE[0] * SIZE[1] * 4, np.float32)
        image.pixels.foreach_get(pixels)
        images.append(pixels.reshape(SIZE[1], SIZE[0], 4)[::-1, :, :3])
    assert_same_means(viewport, np.stack(images))


def test_svgf_plus_comes_to_rest_at_the_same_picture(scene):
    """The default method filters less and less while a view stands still, and never more than the noise that is left:
    it is no farther from the truth than the mean of its samples, and the distance falls as that of the mean does.
    Edges are smooth."""
    exported = export(size=SIZE)
    plain = Settings(method="none", pixel_filter="box")
    truth = Renderer(replace(plain, samples=64 * SAMPLES, seed=BATCHES), DEVICE).render(exported).color
    few, many, mean = (
        root_mean_square(settings, samples, exported, truth)
        for settings, samples in ((Settings(), SAMPLES // 4), (Settings(), 16 * SAMPLES), (plain, 16 * SAMPLES))
    )
    assert many < 1.1 * mean and many < few / 2


def root_mean_square(settings: Settings, samples: int, exported, truth: np.ndarray) -> float:
    """Of a still view's distance from the truth, over some seeds."""
    worker = Worker()
    views = [settled(worker, replace(exported), seed, settings, samples) for seed in range(4)]
    worker.close()
    return float(np.sqrt(((np.stack(views) - truth) ** 2).mean()))
