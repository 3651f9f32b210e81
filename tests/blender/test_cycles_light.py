# SPDX-License-Identifier: Apache-2.0
"""Lamps, world, light paths and cameras against Cycles: the same .blend, the same picture.

Both render few pixels with many samples. Their noise is unknown pixel by pixel, so each of them is rendered twice with
different seeds; half of the squared difference of the two is the variance of one. A pixel agrees within 4.5 standard
deviations of the difference of the means (error rate 1e-5 each) and half a percent.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from blend import (
    add_image,
    add_light,
    add_material,
    add_mesh,
    add_shader,
    add_world,
    export,
    split_by_camera_ray,
)
from mathutils import Euler

pytestmark = pytest.mark.skipif(not hasattr(bpy.types.Scene, "cycles"), reason="The Cycles add-on is disabled.")

WIDTH, HEIGHT = 24, 14
SAMPLES = 512
# Share of pixels that must agree: an edge of an object or a shadow lies elsewhere by a rounding.
SHARE = 0.97


def render_cycles(path: Path, samples: int, seed: int) -> np.ndarray:
    """[HEIGHT, WIDTH, 4] of Combined."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, seed
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.image_settings.color_depth = "32"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.filepath = str(path / f"cycles{seed}.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Linear Rec.709"
    pixels = np.empty(HEIGHT * WIDTH * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(HEIGHT, WIDTH, 4)[::-1].astype(np.float64)


def render_svgf(samples: int, seed: int, **instances) -> np.ndarray:
    """instances: fields to replace."""
    from svgf.renderer import Renderer
    from svgf.settings import Settings

    scene = export(size=(WIDTH, HEIGHT))
    scene = replace(scene, instances=replace(scene.instances, **instances))
    frame = Renderer(Settings(samples=samples, seed=seed, method="none"), "cpu").render(scene)
    alpha = np.ones((HEIGHT, WIDTH)) if frame.alpha is None else frame.alpha
    return np.dstack([frame.noisy, alpha]).astype(np.float64)


def assert_same_picture(
    path: Path, samples: int = SAMPLES, bias: float = 0.005, in_cycles: AbstractContextManager = nullcontext()
) -> None:
    """in_cycles: entered while Cycles renders."""
    with in_cycles:
        cycles = [render_cycles(path, samples, seed) for seed in (1, 2)]
    ours = [render_svgf(samples, seed) for seed in (1, 2)]
    means = [np.mean(pair, axis=0) for pair in (cycles, ours)]
    # Of one pixel two samples say little about the variance; its neighbours have about the same.
    variance = sum(_smooth((pair[0] - pair[1]) ** 2) / 4 for pair in (cycles, ours))
    scale = np.maximum(means[0], means[0][..., :3].mean())
    difference = np.abs(means[1] - means[0])
    same = (difference <= 4.5 * np.sqrt(variance) + bias * scale).all(axis=2)
    assert means[0][..., :3].max() > 0
    assert same.mean() >= SHARE, f"{same.mean():.3f} of the pixels agree"
    luminance = [mean[..., :3].mean() for mean in means]
    # Of the mean over both samples of all pixels, from what the pixels differ by.
    noise = np.sqrt(
        sum(np.mean((pair[0] - pair[1])[..., :3].mean(axis=2) ** 2) / 4 for pair in (cycles, ours)) / same.size
    )
    assert abs(luminance[1] / luminance[0] - 1) <= bias + 3 * noise / luminance[0]


def _smooth(values: np.ndarray) -> np.ndarray:
    """The mean over 5 x 5 pixels."""
    padded = np.pad(values, ((2, 2), (2, 2), (0, 0)), mode="edge")
    return np.mean([padded[y : y + HEIGHT, x : x + WIDTH] for y in range(5) for x in range(5)], axis=0)


@pytest.fixture
def room():
    """A gray floor and a red wall, seen at an angle; nothing lights them yet."""
    scene = bpy.context.scene
    floor = add_mesh("Floor")
    floor.scale = (3, 3, 1)
    add_shader(add_material("Gray", floor), "ShaderNodeBsdfDiffuse", Color=(0.6, 0.6, 0.6))
    wall = add_mesh("Wall", location=(0, 1.5, 0))
    wall.scale, wall.rotation_euler = (3, 2, 1), Euler((np.pi / 2, 0, 0))
    add_shader(add_material("Red", wall), "ShaderNodeBsdfDiffuse", Color=(0.7, 0.2, 0.1))
    camera = scene.camera
    camera.location, camera.rotation_euler = (0.3, -5, 2.2), Euler((1.2, 0, 0.05))
    cycles = scene.cycles
    cycles.max_bounces, cycles.blur_glossy, cycles.sample_clamp_indirect = 3, 0.0, 0.0
    scene.render.film_transparent = False
    return floor, wall


def add_ball(location=(0.6, 0, 0.5), radius=0.5, **material):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12, radius=radius, location=location)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    add_shader(add_material("Ball", ball), material.pop("kind", "ShaderNodeBsdfDiffuse"), **material)
    return ball


@pytest.mark.parametrize("spread", [0.5, 1.5, 2.8])
def test_spread_of_an_area_lamp(room, tmp_path, spread):
    lamp = add_light("AREA", energy=60, size=0.8, shape="RECTANGLE", spread=spread, location=(0, 0, 1.8))
    lamp.data.size_y = 0.4
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path)


@pytest.mark.parametrize("kind", ["POINT", "SPOT", "AREA", "SUN"])
def test_lamps_that_the_camera_sees(room, tmp_path, kind):
    size = {"POINT": {"shadow_soft_size": 0.3}, "SPOT": {"shadow_soft_size": 0.3, "spot_size": 2.0},
            "AREA": {"size": 0.8}, "SUN": {"angle": 0.6}}[kind]
    lamp = add_light(kind, energy=3 if kind == "SUN" else 40, location=(-0.5, 0.5, 1.0), **size)
    lamp.rotation_euler = Euler((1.0, 0.1, 0.3)) if kind != "SUN" else Euler((-1.5, 0, 0))
    lamp.visible_camera = True
    if kind == "SUN":
        bpy.data.objects.remove(room[1])
    bpy.context.scene.cycles.max_bounces = 1
    assert_same_picture(tmp_path)


@pytest.mark.parametrize("ray", ["camera", "diffuse", "glossy", "transmission", "shadow"])
def test_ray_visibility_of_an_object(room, tmp_path, ray):
    add_light("POINT", energy=100, location=(1, -1, 2.5), shadow_soft_size=0.2)
    ball = add_ball()
    setattr(ball, f"visible_{ray}", False)
    add_ball((-0.7, 0.2, 0.5), kind="ShaderNodeBsdfGlossy", Roughness=0.3)
    assert_same_picture(tmp_path, 256)


@pytest.mark.parametrize("ray", ["diffuse", "glossy"])
def test_ray_visibility_of_a_lamp(room, tmp_path, ray):
    lamp = add_light("AREA", energy=60, size=1.0, location=(0, 0, 2))
    setattr(lamp, f"visible_{ray}", False)
    add_ball(kind="ShaderNodeBsdfGlossy", Roughness=0.3)
    assert_same_picture(tmp_path, 256)


@pytest.mark.parametrize(
    "limits",
    [
        {"max_bounces": 0},
        {"max_bounces": 1},
        {"max_bounces": 4, "diffuse_bounces": 0},
        {"max_bounces": 4, "diffuse_bounces": 1},
        {"max_bounces": 4, "glossy_bounces": 0},
        {"max_bounces": 4, "glossy_bounces": 1},
        {"max_bounces": 6, "transmission_bounces": 1},
        {"max_bounces": 4, "caustics_reflective": False},
        {"max_bounces": 4, "caustics_refractive": False},
    ],
    ids=str,
)
def test_limits_of_light_paths(room, tmp_path, limits):
    scene = bpy.context.scene
    for name, value in limits.items():
        setattr(scene.cycles, name, value)
    add_world((0.3, 0.4, 0.6), 0.5)
    add_light("AREA", energy=60, size=1.0, location=(0, 0, 2.5))
    add_ball(kind="ShaderNodeBsdfGlossy", Roughness=0.4)
    if "transmission_bounces" in limits or "caustics_refractive" in limits:
        add_ball((-0.7, -0.4, 0.5), kind="ShaderNodeBsdfGlass", Roughness=0.3, IOR=1.4)
    else:
        add_ball((-0.7, -0.4, 0.5), kind="ShaderNodeBsdfGlossy", Roughness=0.5)
    assert_same_picture(tmp_path, 256, bias=0.015)


def test_world_that_the_camera_sees_otherwise(room, tmp_path):
    """A mirror shows what lights the scene, the camera another colour."""
    world = add_world((0.9, 0.5, 0.2), 1.0)
    add_ball(kind="ShaderNodeBsdfAnisotropic", Roughness=0.0)
    bpy.data.objects.remove(room[1])
    split_by_camera_ray(world, (0.1, 0.3, 0.8))
    assert_same_picture(tmp_path)


def test_clamps(room, tmp_path):
    cycles = bpy.context.scene.cycles
    cycles.sample_clamp_direct, cycles.sample_clamp_indirect = 0.4, 0.05
    add_light("POINT", energy=100, location=(0.5, -0.5, 1.5), shadow_soft_size=0.0)
    # One lamp without size: each contribution of direct light is the same in every sample.
    cycles.max_bounces = 0
    assert_same_picture(tmp_path, 256)


def test_filter_glossy(room, tmp_path):
    """Caustics of a mirror ball: what a diffuse ray sees of it is rough."""
    cycles = bpy.context.scene.cycles
    cycles.blur_glossy, cycles.max_bounces = 1.0, 2
    add_light("AREA", energy=60, size=1.0, location=(0, 0, 2.5))
    add_ball(kind="ShaderNodeBsdfGlossy", Roughness=0.0)
    assert_same_picture(tmp_path, bias=0.01)


@pytest.mark.parametrize("projection", ["EQUIRECTANGULAR", "MIRROR_BALL"])
def test_environment_image(room, tmp_path, projection):
    world = add_world(strength=1.0)
    rows, columns = np.mgrid[0:16, 0:32]
    pixels = np.ones((16, 32, 4))
    pixels[..., 0] = 0.2 + 0.8 * (rows / 16)
    pixels[..., 1] = 0.3 + 0.3 * np.sin(columns / 32 * 2 * np.pi)
    pixels[12, 20, :3] = 60.0
    tree = world.node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.projection = projection
    node.image = add_image("Sky", pixels, "Linear Rec.709", is_float=True)
    mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Rotation"].default_value = (0.2, 0.1, 2.0)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], node.inputs["Vector"])
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    tree.links.new(node.outputs[0], background.inputs["Color"])
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    bpy.context.scene.cycles.max_bounces = 1
    if projection == "MIRROR_BALL":
        # Its bake is an image of another map: a texel's light is spread otherwise.
        node.image.pixels.foreach_set(np.where(pixels > 2, 1.0, pixels).astype(np.float32).ravel())
    assert_same_picture(tmp_path, bias=0.02 if projection == "MIRROR_BALL" else 0.01)


@pytest.mark.parametrize("mirrored", [False, True])
def test_normal_map(room, tmp_path, mirrored):
    """On the floor, whose UVs may be turned over: then the map's green points the other way around its red."""
    floor, _ = room
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float32) * (2, 1.5)
    if mirrored:
        corners[:, 0] *= -1
    layer = floor.data.uv_layers.new(name="UVMap")
    for corner, uv in zip(floor.data.loops, corners, strict=True):
        layer.uv[corner.index].vector = uv
    rows, columns = np.mgrid[0:16, 0:16]
    pixels = np.ones((16, 16, 4))
    pixels[..., 0] = 0.5 + 0.35 * np.sin(columns / 16 * 2 * np.pi)
    pixels[..., 1] = 0.5 + 0.25 * np.cos(rows / 16 * 2 * np.pi)
    material = floor.data.materials[0]
    tree = material.node_tree
    image, normal_map = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    image.image = add_image("Bumps", pixels, "Non-Color", is_float=True)
    shader = next(node for node in tree.nodes if node.type == "BSDF_DIFFUSE")
    tree.links.new(image.outputs["Color"], normal_map.inputs["Color"])
    tree.links.new(normal_map.outputs["Normal"], shader.inputs["Normal"])
    add_light("AREA", energy=80, size=1.0, location=(1.5, -1, 2.5)).rotation_euler = Euler((0.3, 0.5, 0))
    assert_same_picture(tmp_path, bias=0.01)


@pytest.mark.parametrize("model", ["PREETHAM", "SCATTERING"])
def test_sky(room, tmp_path, model):
    """A sky without a sun, and one with it."""
    world = add_world(strength=0.1)
    tree = world.node_tree
    node = tree.nodes.new("ShaderNodeTexSky")
    kinds = [kind.identifier for kind in type(node).bl_rna.properties["sky_type"].enum_items]
    node.sky_type = model if model in kinds else next(k for k in kinds if k in ("MULTIPLE_SCATTERING", "NISHITA"))
    node.sun_elevation, node.sun_rotation, node.sun_size = 0.6, 0.7, 0.05
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    tree.links.new(node.outputs[0], background.inputs["Color"])
    bpy.context.scene.cycles.max_bounces = 1
    assert_same_picture(tmp_path, bias=0.01)


def test_orthographic_camera(room, tmp_path):
    data = bpy.context.scene.camera.data
    data.type, data.ortho_scale, data.shift_x, data.shift_y = "ORTHO", 5.0, 0.1, -0.05
    add_light("SUN", energy=3, angle=0.1, location=(0, 0, 5)).rotation_euler = Euler((0.5, 0.3, 0))
    add_ball()
    assert_same_picture(tmp_path, 256)


@pytest.mark.parametrize("blades", [0, 5])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_depth_of_field(room, tmp_path, kind, blades):
    """A small light far out of focus shows the shape of the opening."""
    data = bpy.context.scene.camera.data
    data.type, data.ortho_scale, data.dof.use_dof = kind, 4.0, True
    data.dof.focus_distance = 2.0
    data.dof.aperture_fstop = 0.06 if kind == "PERSP" else 1.5
    data.dof.aperture_blades, data.dof.aperture_rotation, data.dof.aperture_ratio = blades, 0.5, 1.6
    glow = add_ball((0, 0.2, 0.8), 0.12)
    add_shader(glow.data.materials[0], "ShaderNodeEmission", Strength=20)
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path)


def add_coarse_ball(location=(0, 0, 0)) -> bpy.types.Object:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=4, radius=1.0, location=location)
    ball = bpy.context.object
    ball.data.shade_smooth()
    add_shader(add_material("Ball", ball), "ShaderNodeBsdfDiffuse", Color=(0.6, 0.6, 0.6))
    return ball


def add_curtain(**material) -> bpy.types.Object:
    """Folds of single quads with smooth normals."""
    count = 9
    rows = [[(x, -0.2 * (-1) ** i, z) for i, x in enumerate(np.linspace(-1.8, 1.8, count))] for z in (0.1, 1.9)]
    quads = [(i, i + 1, count + i + 1, count + i) for i in range(count - 1)]
    curtain = add_mesh("Curtain", (rows[0] + rows[1], quads), (0, 0.6, 0))
    curtain.data.shade_smooth()
    add_shader(add_material("Cloth", curtain), material.pop("kind", "ShaderNodeBsdfDiffuse"), **material)
    return curtain


@pytest.mark.parametrize("offset", [0.1, 0.5])
@pytest.mark.parametrize("kind", ["SUN", "POINT"])
def test_shadow_terminator(room, tmp_path, kind, offset):
    """Along a curtain; a mirror shows its other side."""
    curtain = add_curtain()
    size = {"SUN": {"angle": 0.02}, "POINT": {"shadow_soft_size": 0.05}}[kind]
    lamp = add_light(kind, energy=3 if kind == "SUN" else 300, location=(4, 0.3, 1.2), **size)
    lamp.rotation_euler = Euler((1.2, 0, 1.35))
    room[1].data.materials.clear()
    add_shader(add_material("Mirror", room[1]), "ShaderNodeBsdfGlossy", Roughness=0.0)
    bpy.context.scene.cycles.max_bounces = 1
    dark = render_svgf(64, 1, terminator_offset=None)
    curtain.shadow_terminator_geometry_offset = offset
    assert np.mean(render_svgf(64, 1) > 1.2 * dark + 0.02) > 0.05
    assert_same_picture(tmp_path, 256)


def test_no_shadow_terminator_offset(room, tmp_path):
    ball = add_coarse_ball((0, 0, 1))
    ball.shadow_terminator_geometry_offset = 0.0
    add_light("SUN", energy=3, angle=0.02).rotation_euler = Euler((1.2, 0, 1.0))
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path, 256)


@pytest.mark.parametrize("kind", ["Translucent", "Glossy", "Principled"])
def test_shadow_terminator_of_other_lobes(room, tmp_path, kind):
    add_curtain(kind=f"ShaderNodeBsdf{kind}", **({} if kind == "Translucent" else {"Roughness": 0.4}))
    # From behind the curtain, or from the front.
    around = 1.8 if kind == "Translucent" else 1.35
    add_light("SUN", energy=3, angle=0.02).rotation_euler = Euler((1.2, 0, around))
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path, 256)


@pytest.mark.parametrize("scale", [(0.4, 0.4, 0.4), (-1, 1, 1), (1.0, 0.5, 1.3)], ids=str)
def test_shadow_terminator_of_instances(room, tmp_path, scale):
    """Two of a mesh each: Cycles leaves such objects in their own space."""
    ball = add_coarse_ball()
    other = ball.copy()
    bpy.context.scene.collection.objects.link(other)
    for obj, x in ((ball, -1.0), (other, 1.0)):
        obj.location, obj.scale, obj.rotation_euler = (x * abs(scale[0]), 0, 1), scale, Euler((0.3, 0.2 * x, 0))
        obj.shadow_terminator_geometry_offset = 0.5
    camera = bpy.context.scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", 5.0 * abs(scale[0])
    camera.location, camera.rotation_euler = (0, -5, 1), Euler((np.pi / 2, 0, 0))
    add_light("SUN", energy=3, angle=0.02).rotation_euler = Euler((1.3, 0, 1.2))
    bpy.context.scene.cycles.max_bounces = 0
    assert_same_picture(tmp_path, 256)


def test_shadow_terminator_of_a_triangle(room, tmp_path):
    """That bends away from one corner, before a sun that is behind it."""
    for obj in room:
        bpy.data.objects.remove(obj)
    triangle = add_mesh("Triangle", ([(-0.9, 0, 0), (0.9, -0.9, 0), (0.9, 0.9, 0)], [(0, 1, 2)]))
    triangle.data.shade_smooth()
    triangle.data.normals_split_custom_set([(0, 0, 1), (0.86, 0, 0.5), (0.86, 0, 0.5)])
    add_shader(add_material("Gray", triangle), "ShaderNodeBsdfDiffuse")
    add_light("SUN", energy=3, angle=0.01).rotation_euler = Euler((0, np.pi / 2 + 0.1, 0))
    camera = bpy.context.scene.camera
    camera.data.type, camera.data.ortho_scale = "ORTHO", 3.5
    camera.location, camera.rotation_euler = (0, 0, 5), Euler((0, 0, 0))
    assert_same_picture(tmp_path, 256)


def test_transparent_film(room, tmp_path):
    scene = bpy.context.scene
    scene.render.film_transparent = True
    bpy.data.objects.remove(room[1])
    add_world((0.3, 0.4, 0.6), 1.0)
    add_ball()
    assert_same_picture(tmp_path, 256)
