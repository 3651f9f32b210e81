# SPDX-License-Identifier: Apache-2.0
"""``svgf denoise`` on what this Blender's Cycles writes: names, parts and vectors as they are, not as we believe."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_cube, add_light, add_material, add_mesh, add_world, animate
from svgf.cli import app
from svgf.cycles import preflight
from svgf.io import exr
from svgf.sequence import find_sequence
from typer.testing import CliRunner

WIDTH, HEIGHT = 64, 36


@pytest.fixture
def noisy(tmp_path):
    """Renders frames 1 to last with every pass that the denoiser can use; returns their folder."""
    add_mesh("Floor", location=(0, 0, -1)).scale = (5, 5, 1)
    cube = add_cube("Moving")
    cube.pass_index = 3
    add_material("Paint", cube, Base_Color=(0.8, 0.2, 0.1), Roughness=0.3)
    animate(cube, "location", (1, -1.5), (4, 1.5), index=0)
    add_light("AREA", location=(0, -2, 4), energy=300)
    add_world((0.5, 0.5, 0.5), 0.2)
    scene, view_layer = bpy.context.scene, bpy.context.view_layer
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_animated_seed = 1, False, True
    names = ("diffuse", "glossy", "transmission")
    passes = [f"{name}_{part}" for name in names for part in ("direct", "indirect", "color")]
    for name in ("z", "normal", "vector", "object_index", "emit", "environment", *passes):
        setattr(view_layer, f"use_pass_{name}", True)
    view_layer.cycles.denoising_store_passes = True
    settings = scene.render.image_settings
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"

    def render(last: int):
        scene.frame_start, scene.frame_end = 1, last
        scene.render.filepath = str(tmp_path / "noisy" / "frame_")
        bpy.ops.render.render(animation=True)
        return tmp_path / "noisy"

    return render


def denoise(source, output, *arguments: str):
    return CliRunner().invoke(app, ["denoise", str(source), "-o", str(output), "--device", "reference", *arguments])


def test_frames_of_cycles_are_denoised(noisy, tmp_path):
    source = noisy(2)
    result = denoise(source, tmp_path / "out", "--png")
    assert result.exit_code == 0 and result.stderr == "", result.output
    for path in source.iterdir():
        given, written = exr.read(path), exr.read(tmp_path / "out" / path.name)
        assert given.keys() == written.keys()
        for name, pixels in given.items():
            if name == "ViewLayer.Combined":
                difference = written[name][..., :3] - pixels[..., :3]
                assert np.isfinite(difference).all() and np.abs(difference).max() > 0.01
                assert np.array_equal(written[name][..., 3], pixels[..., 3])
                assert abs(difference.mean()) < 0.05 * pixels[..., :3].mean()
            else:
                assert np.array_equal(written[name], pixels), name


def test_vectors_and_light_passes_are_what_we_take_them_for(noisy):
    plan = preflight.check(find_sequence(noisy(3)), "svgf")
    (reading,) = plan.readings
    assert plan.warnings == () and reading.light_passes and reading.vector_signs == (1.0, -1.0)


def test_a_fixed_seed_is_noticed(noisy):
    bpy.context.scene.cycles.use_animated_seed = False
    bpy.context.scene.render.resolution_percentage = 200
    (warning,) = preflight.check(find_sequence(noisy(2)), "svgf").warnings
    assert "carry the same noise" in warning


def test_a_pass_that_is_off_is_named_as_blender_names_it(noisy, tmp_path):
    bpy.context.view_layer.use_pass_vector = False
    result = denoise(noisy(2), tmp_path / "out")
    assert result.exit_code == 2 and 'layer "ViewLayer" has no pass "Vector"' in result.stderr
    assert not (tmp_path / "out").exists()
