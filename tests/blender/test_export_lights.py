# SPDX-License-Identifier: Apache-2.0
"""Lamps and the world."""

from __future__ import annotations

from collections import OrderedDict

import bpy
import numpy as np
import pytest
from blend import add_image, add_light, add_mesh, add_world, export, split_by_camera_ray, validate
from mathutils import Euler
from svgf.errors import Interrupted
from svgf.scene import LightKind, RayVisibility
from svgf_blender.export import sky


@pytest.fixture(autouse=True)
def something_to_render():
    add_mesh()


def only_light(**options):
    scene = export(**options)
    validate(scene)
    (light,) = scene.lights
    return light


@pytest.mark.parametrize("radius", [0.0, 0.25])
def test_point(radius):
    lamp = add_light("POINT", energy=100, color=(1, 0.5, 0.25), shadow_soft_size=radius)
    lamp.scale = (2, 2, 2)  # of no effect
    light = only_light()
    assert light.kind is LightKind.POINT and light.size == (radius, 0)
    assert np.allclose(light.power, (100, 50, 25))
    assert np.allclose(light.light_to_world, [(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 5)])


def test_sun():
    add_light("SUN", energy=3, angle=0.2)
    light = only_light()
    assert light.kind is LightKind.SUN and light.size == pytest.approx((0.2, 0)) and np.allclose(light.power, 3)


def test_spot():
    lamp = add_light("SPOT", energy=10, spot_size=1.0, spot_blend=0.3, shadow_soft_size=0)
    lamp.rotation_euler = (np.pi / 2, 0, 0)
    light = only_light()
    assert light.kind is LightKind.SPOT
    assert (light.spot_angle, light.spot_blend) == pytest.approx((1.0, 0.3))
    assert np.allclose(-light.light_to_world[:, 2], (0, 1, 0), atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "kind", "size"),
    [
        ("SQUARE", LightKind.RECTANGLE, (4, 6)),
        ("RECTANGLE", LightKind.RECTANGLE, (4, 1.5)),
        ("DISK", LightKind.ELLIPSE, (4, 6)),
        ("ELLIPSE", LightKind.ELLIPSE, (4, 1.5)),
    ],
)
def test_area(shape, kind, size):
    lamp = add_light("AREA", shape=shape, size=2, energy=10)
    lamp.data.size_y = 0.5
    lamp.scale = (2, 3, 1)
    light = only_light()
    assert light.kind is kind and light.size == pytest.approx(size) and np.allclose(light.power, 10)
    assert np.allclose(light.light_to_world[:, :3], np.eye(3))


def test_mirrored_area_shines_where_its_axis_points():
    lamp = add_light("AREA", shape="SQUARE", size=2)
    lamp.scale = (1, 1, -1)
    light = only_light()
    assert np.allclose(light.light_to_world[:, 2], (0, 0, -1))
    assert np.linalg.det(light.light_to_world[:, :3]) > 0


def test_exposure_and_temperature():
    lamp = add_light("POINT", energy=10, exposure=2, use_temperature=True, temperature=3000, shadow_soft_size=0)
    assert np.allclose(only_light().power, 40 * np.array(lamp.data.temperature_color))


@pytest.mark.parametrize(
    ("kind", "attributes", "factor"),
    [
        ("POINT", {"shadow_soft_size": 0.5}, 4 * np.pi * 0.25),
        ("SPOT", {"shadow_soft_size": 0.0}, 4),
        ("SUN", {"angle": 0.2}, np.pi * np.sin(0.1) ** 2),
        ("SUN", {"angle": 0.0}, 1),
        ("AREA", {"shape": "SQUARE", "size": 3.0}, 9),
        ("AREA", {"shape": "DISK", "size": 3.0}, 9 * np.pi / 4),
    ],
)
def test_power_that_is_not_normalized(kind, attributes, factor):
    add_light(kind, energy=2, normalize=False, **attributes)
    assert np.allclose(only_light().power, 2 * factor)


def test_node_emission_multiplies():
    lamp = add_light("POINT", energy=10, shadow_soft_size=0)
    if bpy.app.version < (5, 2, 0):
        lamp.data.use_nodes = True
    emission = next(node for node in lamp.data.node_tree.nodes if node.type == "EMISSION")
    emission.inputs["Color"].default_value = (1, 0.5, 0, 1)
    emission.inputs["Strength"].default_value = 3
    assert np.allclose(only_light().power, (30, 15, 0))
    tree = lamp.data.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], emission.inputs["Color"])
    scene = export()
    assert np.allclose(scene.lights[0].power, 10)
    assert scene.warnings == (
        'Light "Lamp": node "Noise Texture" (Noise Texture) is not supported yet; '
        "the lamp's own colour and power are used instead.",
    )


@pytest.mark.parametrize("kind", ["POINT", "SPOT"])
@pytest.mark.parametrize("soft", [True, False])
def test_soft_falloff(kind, soft):
    add_light(kind, shadow_soft_size=0.5, use_soft_falloff=soft)
    scene = export()
    assert scene.lights[0].soft_falloff is soft
    assert not scene.warnings


def test_portals_are_no_lamps():
    lamp = add_light("AREA")
    if not hasattr(lamp.data, "cycles"):
        pytest.skip("The Cycles add-on is disabled.")
    lamp.data.cycles.is_portal = True
    scene = export()
    assert not scene.lights
    assert scene.warnings == ('Object "Lamp": a portal only guides Cycles\' sampling; it is not needed and left out.',)


def test_what_lamps_do_that_is_not_simulated():
    add_light("SUN", "Ghost", use_shadow=False, energy=-1)
    lamp = add_light("POINT", "Limited")
    if hasattr(lamp.data, "cycles"):
        lamp.data.cycles.max_bounces = 2
    warnings = export().warnings
    for name, feature in (("Ghost", "a lamp without shadows"), ("Ghost", "negative light"), ("Limited", "a limit on")):
        assert sum(warning.startswith(f'Light "{name}": {feature}') for warning in warnings) == 1
    assert len(warnings) == 3


@pytest.mark.parametrize("spread", [1.0, np.pi])
def test_spread(spread):
    add_light("AREA", spread=spread)
    assert only_light().spread == pytest.approx(spread)


def test_ray_visibility_of_lamps():
    lamp = add_light("POINT", shadow_soft_size=0.5)
    assert not only_light().visibility & RayVisibility.CAMERA  # Blender hides new lamps
    lamp.visible_camera, lamp.visible_glossy = True, False
    assert only_light().visibility == RayVisibility.ALL & ~RayVisibility.GLOSSY


def test_world_color():
    assert export().world.radiance == (0, 0, 0)
    add_world((0.2, 0.4, 0.6), 2.0)
    scene = export()
    assert np.allclose(scene.world.radiance, (0.4, 0.8, 1.2)) and not scene.warnings


def test_world_without_surface_is_black():
    world = add_world()
    world.node_tree.links.clear()
    assert export().world.radiance == (0, 0, 0)


def link_sky(world, pixels, color_space="Linear Rec.709", is_float=True):
    """An Environment Texture in place of the world's colour."""
    node = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = add_image("Sky", pixels, color_space, is_float)
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    world.node_tree.links.new(node.outputs[0], background.inputs["Color"])
    return node


def sky_pixels() -> np.ndarray:
    pixels = np.random.default_rng(1).uniform(0, 4, (8, 16, 4))
    pixels[..., 3] = 1
    return pixels


def test_environment_image_keeps_its_texels():
    pixels = sky_pixels()
    link_sky(add_world(strength=0.5), pixels)
    scene = export()
    validate(scene)
    assert not scene.warnings
    texture = scene.textures[scene.world.environment]
    np.testing.assert_allclose(texture.pixels[..., :3], pixels[..., :3] / 2, rtol=2e-4, atol=2e-4)
    assert scene.world.radiance == (1, 1, 1)
    assert export().textures[0] is not None


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE"])
def test_environment_is_turned_by_its_mapping(kind):
    pixels = sky_pixels()
    world = add_world(strength=1.0)
    image = link_sky(world, pixels)
    tree = world.node_tree
    mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.vector_type = kind
    mapping.inputs["Rotation"].default_value = (0.3, -0.2, 1.0)
    mapping.inputs["Scale"].default_value = (2, 2, 2)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], image.inputs["Vector"])
    scene = export()
    rotation = np.array(Euler((0.3, -0.2, 1.0)).to_matrix())
    expected = rotation if kind == "POINT" else rotation.T
    np.testing.assert_allclose(np.reshape(scene.world.world_to_environment, (3, 3)), expected, atol=1e-5)
    np.testing.assert_allclose(scene.textures[0].pixels[..., :3], pixels[..., :3], rtol=2e-4, atol=2e-4)


def test_any_tree_of_the_direction_is_baked():
    """A gradient from the horizon up, mixed with a colour."""
    world = add_world(color=(0.5, 0.5, 0.5), strength=1.0)
    tree = world.node_tree
    coordinates, separate = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(coordinates.outputs["Generated"], separate.inputs[0])
    first = next(node for node in tree.nodes if node.type == "BACKGROUND")
    second, mix = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeMixShader")
    second.inputs["Color"].default_value = (0, 0, 2, 1)
    tree.links.new(separate.outputs["Z"], mix.inputs[0])
    tree.links.new(first.outputs[0], mix.inputs[1])
    tree.links.new(second.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    scene = export()
    assert not scene.warnings
    pixels = scene.textures[scene.world.environment].pixels
    height = np.sin(((np.arange(len(pixels)) + 0.5) / len(pixels) - 0.5) * np.pi).clip(0)
    np.testing.assert_allclose(pixels[:, 3, 0], 0.5 * (1 - height), atol=1e-5)
    np.testing.assert_allclose(pixels[:, 7, 2], 0.5 * (1 - height) + 2 * height, atol=1e-5)


def test_ray_visibility_of_the_world():
    world = add_world()
    if not hasattr(world, "cycles_visibility"):
        pytest.skip("The Cycles add-on is disabled.")
    world.cycles_visibility.camera = False
    assert export().world.visibility == RayVisibility.ALL & ~RayVisibility.CAMERA


def test_camera_sees_another_color():
    split_by_camera_ray(add_world((0.2, 0.4, 0.6), 2.0), (0.9, 0.1, 0.3))
    scene = export()
    assert np.allclose(scene.world.radiance, (0.4, 0.8, 1.2)) and scene.world.environment == -1
    assert np.allclose(scene.world.backdrop_radiance, (0.9, 0.1, 0.3)) and scene.world.backdrop_environment == -1
    assert not scene.warnings


def test_camera_sees_a_color_and_an_image_lights():
    pixels = np.random.default_rng(0).random((4, 8, 4))
    world = add_world(strength=1.0)
    link_sky(world, pixels)
    split_by_camera_ray(world, (0.9, 0.1, 0.3))
    scene = export()
    assert scene.world.environment == 0 and scene.textures[0].pixels.shape == (4, 8, 4)
    assert scene.world.backdrop_environment == -1 and np.allclose(scene.world.backdrop_radiance, (0.9, 0.1, 0.3))


def test_camera_sees_another_image_in_another_place():
    """Its texels are moved to where the turned directions of the first look them up."""
    world = add_world(strength=1.0)
    tree = world.node_tree
    sky = link_sky(world, np.random.default_rng(0).random((16, 32, 4)))
    place, turn = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (0, 0, 0.7)
    tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], sky.inputs["Vector"])
    second = split_by_camera_ray(world, (0, 0, 0))
    tree.links.new(place.outputs["Generated"], second.inputs["Color"])
    scene = export()
    world = scene.world
    assert (world.environment, world.backdrop_environment) == (0, 1)
    rotation = np.reshape(world.world_to_environment, (3, 3))
    assert not np.allclose(rotation, np.eye(3))
    pixels = scene.textures[1].pixels
    height, width = pixels.shape[:2]
    for direction in np.random.default_rng(1).normal(size=(20, 3)):
        direction /= np.linalg.norm(direction)
        x, y, z = rotation @ direction
        u, v = 0.5 - np.arctan2(y, x) / (2 * np.pi), 0.5 + np.arcsin(z) / np.pi
        texel = pixels[min(int(v * height), height - 1), min(int(u * width), width - 1), :3]
        assert np.allclose(texel, np.maximum(direction, 0), atol=4 / height)


def test_other_kinds_of_rays_are_named():
    world = add_world()
    tree = world.node_tree
    split_by_camera_ray(world, (1, 1, 1))
    path, mix = (next(node for node in tree.nodes if node.type == kind) for kind in ("LIGHT_PATH", "MIX_SHADER"))
    tree.links.new(path.outputs["Is Glossy Ray"], mix.inputs[0])
    scene = export()
    assert any("Light Path" in warning for warning in scene.warnings) and scene.world.backdrop_radiance is None


def link_color(world, kind: str):
    """A node in place of the world's colour."""
    node = world.node_tree.nodes.new(kind)
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    world.node_tree.links.new(node.outputs[0], background.inputs["Color"])
    return node


def test_other_world_nodes_are_named():
    link_color(add_world(), "ShaderNodeObjectInfo")
    (warning,) = export().warnings
    assert warning.startswith('World "World": node "Object Info" (Object Info)')


@pytest.fixture
def program(monkeypatch, tmp_path):
    """Writes the program that renders skies."""
    monkeypatch.setattr(sky, "_skies", OrderedDict())
    monkeypatch.setattr(sky, "_SCRIPT", tmp_path / "render_sky.py")
    yield (tmp_path / "render_sky.py").write_text
    if sky._job is not None:
        sky._job.process.kill()
        sky._job.process.wait()
        assert sky._finish()


def test_a_sky_that_cannot_be_rendered_is_named(program):
    program("raise SystemExit('No Cycles here.')")
    link_color(add_world(strength=2.0), "ShaderNodeTexSky")
    scene = export()
    assert scene.world.radiance == (1.0, 1.0, 1.0)
    assert scene.warnings == (
        'World "World": the sky of node "Sky Texture" (Sky Texture) could not be rendered (No Cycles here.); it is an '
        "even grey.",
    )


def test_an_export_can_be_stopped_while_a_sky_is_rendered(program):
    program("import time; time.sleep(60)")
    node = link_color(add_world(), "ShaderNodeTexSky")
    assert sky.sky_image(node, None) == "is still being rendered"
    with pytest.raises(Interrupted):
        sky.sky_image(node, lambda: True)


def test_all_settings_decide_on_a_sky():
    node = link_color(add_world(), "ShaderNodeTexSky")
    before = sky.sky_settings(node)
    assert sky.sky_settings(node) == before
    node.sun_elevation = 0.5
    assert sky.sky_settings(node) != before


def test_lamps_are_instanced_and_hidden_like_objects():
    collection = bpy.data.collections.new("Collection")
    lamp = add_light("POINT", shadow_soft_size=0)
    bpy.context.scene.collection.objects.unlink(lamp)
    collection.objects.link(lamp)
    for x in range(3):
        empty = bpy.data.objects.new("Empty", None)
        empty.location.x = x
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        bpy.context.scene.collection.objects.link(empty)
    assert [light.light_to_world[0, 3] for light in export().lights] == [0, 1, 2]
