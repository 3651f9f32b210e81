# SPDX-License-Identifier: Apache-2.0
"""The frame's way as a whole: when history goes on, which noise a frame has, and what becomes of settings."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from svgf import renderer as renderer_module
from svgf.errors import InputError
from svgf.renderer import Renderer
from svgf.settings import DenoiseSettings, Settings

from . import scenes

SMALL = Settings(width=32, height=18, bounces=2)
PLAIN_MEAN = DenoiseSettings(alpha=0.0, levels=0)


def numbered(scene, frame, **changes):
    return dataclasses.replace(scene, frame=frame, **changes)


def test_history_goes_on_where_frames_follow_each_other(device):
    renderer, scene = Renderer(SMALL, device), scenes.textured_scene()
    frames = [renderer.render(numbered(scene, number)) for number in (5, 6, 7)]
    assert [frame.reset for frame in frames] == ["first frame", "", ""]
    assert [frame.history_length.max() for frame in frames] == [1, 2, 3]


@pytest.mark.parametrize("number, cut, reason", [(9, False, "frame 9 does not follow frame 6"), (7, True, "camera cut")])
def test_history_ends(device, number, cut, reason):
    renderer, scene = Renderer(SMALL, device), scenes.textured_scene()
    for before in (5, 6):
        renderer.render(numbered(scene, before))
    frame = renderer.render(numbered(scene, number, cut=cut))
    assert frame.reset == reason
    assert frame.history_length.max() == 1


def test_reset_by_name(device):
    renderer, scene = Renderer(SMALL, device), scenes.textured_scene()
    renderer.render(scene)
    renderer.reset("materials were edited")
    assert renderer.render(scene).reset == "materials were edited"
    assert renderer.render(scene).reset == ""


def test_same_scene_again_stands_still_and_gets_new_samples(device):
    """Whatever moved on the way to this frame, it does not move on."""
    renderer, scene = Renderer(SMALL, device), scenes.moving_scene()
    first, second, third = (renderer.render(scene) for _ in range(3))
    assert np.abs(first.motion[first.object_id > 0]).max() > 0.1
    assert not second.motion.any()
    assert third.history_length.max() == 3
    assert (first.noisy != second.noisy).any()
    assert (second.noisy != third.noisy).any()


def test_static_history_is_the_mean_of_its_frames(device):
    renderer = Renderer(dataclasses.replace(SMALL, method="svgf", denoise=PLAIN_MEAN), device)
    scene = scenes.box_scene()
    frames = [renderer.render(scene) for _ in range(8)]
    mean = np.mean([frame.noisy.astype(np.float64) for frame in frames], axis=0)
    np.testing.assert_allclose(frames[-1].color, mean, rtol=1e-4, atol=1e-6)


def test_camera_cut_leaves_no_ghost(device):
    """The first frame after a cut is that of a renderer which never saw anything else."""
    scene = scenes.textured_scene()
    there = scenes.camera((-2.0, 2.5, 1.0), (0, 0, 0))
    other = numbered(scene, 3, camera=there, previous_camera=scene.camera, cut=True)
    renderer = Renderer(SMALL, device)
    for number in (1, 2):
        renderer.render(numbered(scene, number))
    np.testing.assert_array_equal(renderer.render(other).color, Renderer(SMALL, device).render(other).color)


def test_a_jump_that_nobody_announced_leaves_no_ghost(device):
    """Nothing of the old view fits the new one, which reprojection must find by itself."""
    lit = scenes.build(
        [(scenes.quad(4.0), scenes.transform(), [scenes.WHITE])],
        scenes.camera((0, -3, 2), (0, 0, 0)),
        world=scenes.World((50.0, 0.0, 0.0)),
    )
    dark = scenes.build(
        [(scenes.quad(4.0), scenes.transform((100, 0, 0)), [scenes.WHITE])],
        scenes.camera((100, -3, 2), (100, 0, 0)),
        previous_view=scenes.camera((0, -3, 2), (0, 0, 0)),
        world=scenes.World((0.0, 1.0, 0.0)),
        frame=2,
    )
    renderer = Renderer(SMALL, device)
    renderer.render(lit)
    frame = renderer.render(dark)
    assert frame.reset == ""
    assert frame.color[..., 0].max() == 0


def test_noise_of_a_frame_does_not_depend_on_where_the_animation_starts(device):
    scene = scenes.box_scene()
    plain = dataclasses.replace(SMALL, method="none")
    renderer = Renderer(plain, device)
    run = [renderer.render(numbered(scene, number)) for number in (1, 2, 3)]
    alone = Renderer(plain, device).render(numbered(scene, 3))
    np.testing.assert_array_equal(run[-1].color, alone.color)
    other_seed = Renderer(dataclasses.replace(plain, seed=1), device).render(numbered(scene, 3))
    assert (other_seed.color != alone.color).any()


def test_many_samples_in_several_launches(device, monkeypatch):
    settings = dataclasses.replace(SMALL, width=16, height=9, samples=10)
    whole = Renderer(settings, device).render(scenes.box_scene())
    monkeypatch.setattr(renderer_module, "SAMPLES_PER_LAUNCH", 4)
    shares = []
    parts = Renderer(settings, device).render(scenes.box_scene(), progress=shares.append)
    np.testing.assert_allclose(parts.noisy, whole.noisy, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(parts.color, whole.color, rtol=1e-3, atol=1e-5)
    assert shares == [0.4, 0.8, 1.0]


def test_without_denoising_the_picture_is_the_noisy_one(device):
    frame = Renderer(dataclasses.replace(SMALL, method="none"), device).render(scenes.box_scene())
    np.testing.assert_allclose(frame.color, frame.noisy, rtol=1e-5, atol=1e-7)


def test_variants_are_what_renderers_of_their_own_give(device):
    """To the bit, through three frames and a change of size: none reads another's history, nor changes its input."""
    variants = [
        dataclasses.replace(SMALL, pixel_filter="box", method=method, denoise=denoise)
        for method, denoise in (("svgf+", DenoiseSettings()), ("none", DenoiseSettings()), ("svgf", PLAIN_MEAN))
    ]
    together, apart = Renderer(variants[0], device), [Renderer(variant, device) for variant in variants]
    for number, width in ((1, 32), (2, 32), (3, 24)):
        scene = numbered(scenes.moving_scene(), number)
        for renderer in (together, *apart):
            renderer.settings = dataclasses.replace(renderer.settings, width=width)
        frames = together.render_variants(scene, variants)
        for frame, renderer in zip(frames, apart, strict=True):
            np.testing.assert_array_equal(frame.color, renderer.render(scene).color)
    assert "path" in frames[0].timings and "path" not in frames[1].timings


def test_both_splits_hold_the_same_light(device):
    images = [
        Renderer(dataclasses.replace(SMALL, signals=signals), device).render(scenes.box_scene()).noisy
        for signals in ("diffuse_specular", "direct_indirect")
    ]
    np.testing.assert_allclose(images[0], images[1], rtol=1e-4, atol=1e-6)


def test_exposure_scales_light_and_variance(device):
    plain = Renderer(dataclasses.replace(SMALL, exposure=1.0), device).render(scenes.box_scene())
    bright = Renderer(dataclasses.replace(SMALL, exposure=4.0), device).render(scenes.box_scene())
    np.testing.assert_allclose(bright.color, 4 * plain.color, rtol=1e-6)
    np.testing.assert_allclose(bright.noisy, 4 * plain.noisy, rtol=1e-6)
    np.testing.assert_allclose(bright.variance, 16 * plain.variance, rtol=1e-6)
    np.testing.assert_array_equal(bright.depth, plain.depth)


def test_size_and_bounces_default_to_what_the_scene_says(device):
    defaults = scenes.box_scene().defaults
    scene = dataclasses.replace(
        scenes.box_scene(), defaults=dataclasses.replace(defaults, width=20, height=12, bounces=0, exposure=2.0)
    )
    implied = Renderer(Settings(), device).render(scene)
    stated = Renderer(Settings(width=20, height=12, bounces=0, exposure=2.0), device).render(scene)
    assert (implied.width, implied.height) == (20, 12)
    np.testing.assert_array_equal(implied.color, stated.color)


def test_what_changes_is_what_is_seen(device):
    """One renderer over edits of every part of a scene, against a new renderer for each."""
    scene = scenes.textured_scene()
    moved = dataclasses.replace(scene.instances, object_to_world=scene.instances.object_to_world + np.eye(3, 4, 3) * 0.2)
    edits = [
        numbered(scene, 2, instances=moved),
        numbered(scene, 3, materials=(dataclasses.replace(scene.materials[0], roughness=0.1, metallic=1.0),)),
        numbered(scene, 4, lights=(dataclasses.replace(scene.lights[0], power=(1.0, 9.0, 1.0)),)),
        numbered(scene, 5, textures=(dataclasses.replace(scene.textures[0], pixels=255 - scene.textures[0].pixels),)),
        numbered(scene, 6, meshes=(scenes.quad(2.0),)),
        numbered(scene, 7, world=scenes.World((3.0, 0.0, 0.0))),
    ]
    plain = dataclasses.replace(SMALL, method="none", bounces=1)
    renderer = Renderer(plain, device)
    last = renderer.render(scene).color
    for edit in edits:
        color = renderer.render(edit).color
        np.testing.assert_array_equal(color, Renderer(plain, device).render(edit).color)
        assert (color != last).any()
        last = color


def test_invalid_scene_names_the_field(device):
    scene = scenes.textured_scene()
    broken = dataclasses.replace(scene, materials=())
    with pytest.raises(InputError, match="material"):
        Renderer(SMALL, device).render(broken)
