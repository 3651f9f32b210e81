# SPDX-License-Identifier: Apache-2.0
"""Scene -> FlatScene, and the effects that are found on the way."""

import dataclasses
import pathlib
import re

import numpy as np
import pytest

from svgf.effects import Effects, find_effects
from svgf.flat_lights import TRIANGLE
from svgf.flatten import MATERIAL_COLUMNS, flatten, material_map_rows, material_rows
from svgf.scene import MATERIAL_INPUTS, Light, LightKind, Material, MaterialKind, TextureMap, World

from . import scenes

GLOW = Material("glow", emission=(3.0, 2.0, 1.0))
VIEW = scenes.camera((0.3, -4.0, 2.0), (0, 0, 0))


def world_corners(flat) -> np.ndarray:
    """Vertices of all instances, relative to the origin, from what a tracer in float32 would be given."""
    parts = []
    for index, matrix in zip(flat.instance_mesh, flat.object_to_world.astype(np.float32)):
        positions = flat.meshes[index].positions
        parts.append(positions @ matrix[:, :3].T + matrix[:, 3])
    return np.concatenate(parts)


@pytest.mark.parametrize("offset", [(1e6, -2e6, 3e5), (123456.789, 0.1, -98765.4321)])
def test_far_from_the_origin_keeps_its_precision(offset):
    near, far = (flatten(scene) for scene in (scenes.box_scene(), scenes.move(scenes.box_scene(), offset)))
    # The same shape to float32's accuracy, though float32 itself resolves 0.06 m to 0.25 m out there.
    difference = world_corners(far) + far.origin - (world_corners(near) + near.origin) - np.asarray(offset)
    assert np.abs(difference).max() < 1e-5
    assert np.abs(far.object_to_world[:, :, 3]).max() < 20 and np.abs(far.camera_to_world[:, 3]).max() < 1
    lamp = far.light_data[0, 0:3] + far.origin - offset
    np.testing.assert_allclose(lamp, near.light_data[0, 0:3] + near.origin, atol=1e-8)
    assert far.extent == pytest.approx(near.extent)


def test_origin_is_a_multiple_of_a_grid_near_the_camera():
    scene = scenes.box_scene()
    flat = flatten(scene)
    grid = 2.0 ** np.floor(np.log2(flat.extent)) / 64
    position = scene.camera.camera_to_world[:, 3]
    np.testing.assert_array_equal(flat.origin, np.round(position / grid) * grid)
    assert np.abs(flat.origin - position).max() <= grid / 2
    np.testing.assert_allclose(flat.camera_to_world[:, 3], position - flat.origin)


def test_origin_does_not_depend_on_the_frame_before():
    first, second = scenes.moving_scene(), scenes.move(scenes.moving_scene(), (10.3, 0, 0))
    np.testing.assert_array_equal(flatten(second, flatten(first)).origin, flatten(second).origin)


def test_extent_is_the_diagonal_of_the_box_around_everything():
    objects = [(scenes.cube(2.0), scenes.transform((0, 0, 1)), [scenes.WHITE] * 6)]
    assert flatten(scenes.build(objects, VIEW)).extent == pytest.approx(np.sqrt(12))
    objects.append((scenes.cube(2.0), scenes.transform((9, 0, 1), scenes.rotation("z", np.pi / 2)), [scenes.WHITE] * 6))
    assert flatten(scenes.build(objects, VIEW)).extent == pytest.approx(np.linalg.norm((11, 2, 2)))
    assert flatten(scenes.build([], VIEW)).extent == 1.0
    point = scenes.mesh(np.zeros((3, 3)), [(0, 1, 2)])
    assert flatten(scenes.build([(point, scenes.transform(), [scenes.WHITE])], VIEW)).extent == 1.0


def test_inverse_and_previous_transforms():
    scene = scenes.moving_scene()
    flat = flatten(scene)
    points = np.random.default_rng(0).normal(size=(10, 3))
    for to_world, to_object in zip(flat.object_to_world, flat.world_to_object):
        there = points @ to_world[:, :3].T + to_world[:, 3]
        np.testing.assert_allclose(there @ to_object[:, :3].T + to_object[:, 3], points, atol=1e-12)
    # Of the previous frame, but around the origin of this one.
    before = scene.instances.previous_object_to_world.copy()
    before[:, :, 3] -= flat.origin
    np.testing.assert_array_equal(flat.previous_object_to_world, before)
    np.testing.assert_array_equal(
        flat.previous_camera_to_world[:, 3], scene.previous_camera.camera_to_world[:, 3] - flat.origin
    )


SINGULAR = {
    "zero_scale": np.zeros((3, 3)),
    "flat": np.diag([1.0, 1.0, 0.0]),
    "sheared_flat": np.array([[1, 2, 3], [4, 5, 6], [5, 7, 9.0]]),
    "nan": np.full((3, 3), np.nan),
    "infinite": np.diag([np.inf, 1, 1]),
    "beyond_float32": np.eye(3) * 1e39,
    "inverse_beyond_float32": np.eye(3) * 1e-39,
}


@pytest.mark.parametrize("linear", SINGULAR.values(), ids=SINGULAR)
def test_instances_without_an_inverse_are_left_out(linear):
    cube = scenes.cube()
    objects = [(cube, scenes.transform(), [GLOW] * 6), (cube, scenes.transform((5, 0, 0), linear), [GLOW] * 6)]
    scene = dataclasses.replace(scenes.build(objects[::-1], VIEW), warnings=("from the exporter",))
    flat = flatten(scene)
    assert flat.object_id.tolist() == [2] and len(flat.light_kind) == 12
    for array in (flat.object_to_world, flat.world_to_object, flat.origin, flat.light_data):
        assert np.isfinite(array).all()
    assert flat.warnings[0] == "from the exporter" and len(flat.warnings) == 2 and "cube" in flat.warnings[1]
    assert flatten(scene, flat).warnings == flat.warnings


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1e5, (1e-6, 1.0, 1e6), (-1.0, 1.0, 1.0)])
def test_tiny_huge_stretched_and_mirrored_instances_are_kept(scale):
    linear = np.diag(np.broadcast_to(scale, 3)) @ scenes.rotation("y", 0.7)
    flat = flatten(scenes.build([(scenes.cube(), scenes.transform((0, 0, 0), linear), [scenes.WHITE] * 6)], VIEW))
    assert flat.object_id.tolist() == [1] and not flat.warnings
    identity = flat.world_to_object[0, :, :3] @ flat.object_to_world[0, :, :3]
    np.testing.assert_allclose(identity, np.eye(3), atol=1e-9)


def test_unknown_previous_transform_counts_as_standing_still():
    before = np.full((3, 4), np.nan)
    flat = flatten(scenes.build([(scenes.cube(), scenes.transform(), [scenes.WHITE] * 6, before)], VIEW))
    np.testing.assert_array_equal(flat.previous_object_to_world, flat.object_to_world)


def test_ids_and_materials_go_through():
    scene = scenes.box_scene()
    flat = flatten(scene)
    np.testing.assert_array_equal(flat.object_id, scene.instances.object_id)
    np.testing.assert_array_equal(flat.material_table, scene.instances.material_table)


def test_material_rows_hold_every_input_where_the_columns_say():
    """Every field gets a value of its own, so that none can stand in for another."""
    values = {}
    for number, field in enumerate(dataclasses.fields(Material)):
        if isinstance(field.default, tuple):
            values[field.name] = (number + 0.25, number + 0.5, number + 0.75)
        elif isinstance(field.default, (int, float)) and not isinstance(field.default, MaterialKind):
            values[field.name] = number
    maps = {"roughness": TextureMap(3, channel=2, uv_layer=1, uv_transform=(1, 2, 3, 4, 5, 6)), "normal": TextureMap(5)}
    material = Material("all", MaterialKind.PRINCIPLED, maps=maps, **values)
    before = Material("before", maps={"base_color": TextureMap(0)})
    rows, map_rows = material_rows((before, material)), material_map_rows((before, material))
    for name, value in values.items():
        if name != "subsurface_weight":
            column = MATERIAL_COLUMNS[name]
            np.testing.assert_array_equal(rows[1, column : column + np.size(value)], value, err_msg=name)
    assert rows[1, MATERIAL_COLUMNS["map_start"]] == 1 and rows[1, MATERIAL_COLUMNS["map_count"]] == 2
    assert rows[1, MATERIAL_COLUMNS["normal_uv_layer"]] == 0 and rows[0, MATERIAL_COLUMNS["normal_uv_layer"]] == -1
    np.testing.assert_array_equal(
        map_rows,
        [
            [MATERIAL_COLUMNS["base_color"], 0, -1, 0, 1, 0, 0, 0, 1, 0, 0, 0],
            [MATERIAL_COLUMNS["roughness"], 3, 2, 1, 1, 2, 3, 4, 5, 6, 0, 0],
            [MATERIAL_COLUMNS["normal"], 5, -1, 0, 1, 0, 0, 0, 1, 0, 0, 0],
        ],
    )


def test_columns_are_those_of_the_native_source():
    header = (pathlib.Path(__file__).parents[1] / "backend/native/scene/flat_scene.h").read_text()
    inputs = re.search(r"enum class MaterialInput[^{]*{(.*?)}", header, re.DOTALL)[1]
    native = {name: int(column) for name, column in re.findall(r"(\w+) = (\d+)", inputs)}
    assert native == {name: MATERIAL_COLUMNS[name] for name in MATERIAL_INPUTS}
    # The record, float by float.
    record = re.search(r"struct alignas\(16\) Material {(.*?)};", header, re.DOTALL)[1]
    column, columns = 0, {}
    for kind, names in re.findall(r"^    ([\w:]+) ([\w, ]+);", record, re.MULTILINE):
        for name in names.split(", "):
            columns[name] = column
            column += 3 if kind == "Vec3" else 1
    # The last one's bits: the index of a map, and a flag.
    assert re.search(r"alpha_map : 31;.*coat_normal_mapped : 1;", record, re.DOTALL)
    assert column == 47 and {**columns, "coat_normal_mapped": 47} == MATERIAL_COLUMNS


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({}, (3, 2, 1)),
        ({"alpha": 0.5}, (1.5, 1, 0.5)),
        ({"kind": MaterialKind.DIFFUSE, "alpha": 0.5}, (3, 2, 1)),
        ({"coat_weight": 0.1}, (0, 0, 0)),
        ({"maps": {"emission": TextureMap(0)}}, (0, 0, 0)),
        ({"maps": {"alpha": TextureMap(0)}}, (0, 0, 0)),
        ({"kind": MaterialKind.GLASS}, (0, 0, 0)),
        ({"kind": MaterialKind.MIX, "first": 1, "second": 2, "factor": 0.25}, (6, 0.5, 0.25)),
        ({"kind": MaterialKind.MIX, "first": 1, "second": 2, "factor_fresnel_ior": 1.5}, (0, 0, 0)),
        ({"kind": MaterialKind.MIX, "first": 3, "second": 3, "factor_fresnel_ior": 1.5}, (0, 0, 0)),
        ({"kind": MaterialKind.ADD, "first": 1, "second": 2}, (8, 2, 1)),
        ({"kind": MaterialKind.ADD, "first": 1, "second": 4}, (0, 0, 0)),
    ],
)
def test_light_that_paths_aim_at(changes, expected):
    """A radiance that is the same everywhere and in all directions, or none."""
    parts = (
        Material(emission=(8.0, 0.0, 0.0)),
        Material(kind=MaterialKind.DIFFUSE, emission=(0.0, 2.0, 1.0)),
        Material(),
        Material(emission=(1.0, 1.0, 1.0), sheen_weight=1.0),
    )
    rows = material_rows((dataclasses.replace(GLOW, **changes), *parts))
    np.testing.assert_array_equal(rows[0, MATERIAL_COLUMNS["light_emission"] :][:3], expected)


def test_lamps_come_first_then_triangles_in_instance_order():
    quad, ball = scenes.quad(), scenes.sphere(0.5, rows=4)
    dim = Material("dim", emission=(0.1, 0.1, 0.1))
    objects = [
        (ball, scenes.transform((3, 0, 0)), [dim]),
        (quad, scenes.transform((1, 0, 0)), [GLOW]),
        (scenes.quad(), scenes.transform(), [scenes.WHITE]),
        (quad, scenes.transform((2, 0, 0), 2 * np.eye(3)), [dim]),
        (ball, scenes.transform((4, 0, 0)), [GLOW]),
    ]
    lamps = [
        scenes.lamp(LightKind.SPOT),
        scenes.lamp(LightKind.SUN, power=(0.0, 0.0, 0.0)),
        scenes.lamp(LightKind.POINT),
    ]
    flat = flatten(scenes.build(objects, VIEW, lamps))
    faces = len(ball.triangles)
    assert flat.light_kind.tolist() == [LightKind.SPOT, LightKind.POINT] + [TRIANGLE] * (faces + 2 + 2 + faces)
    rows = flat.light_data[2:]
    for start, placed in ((0, 0), (faces, 1), (faces + 2, 3), (faces + 4, 4)):
        shape, matrix, slots = objects[placed]
        corners = shape.positions[shape.triangles].astype(float) @ matrix[:, :3].T + matrix[:, 3] - flat.origin
        part = rows[start : start + len(corners)]
        np.testing.assert_allclose(part[:, 0:3], corners[:, 0], atol=1e-12)
        np.testing.assert_allclose(part[:, 3:6], corners[:, 1] - corners[:, 0], atol=1e-12)
        np.testing.assert_allclose(part[:, 6:9], corners[:, 2] - corners[:, 0], atol=1e-12)
        normal = np.cross(part[:, 3:6], part[:, 6:9])
        np.testing.assert_allclose(part[:, 17], np.linalg.norm(normal, axis=1) / 2)
        np.testing.assert_allclose(part[:, 9:12] * 2 * part[:, 17:18], normal, atol=1e-12)
        np.testing.assert_array_equal(part[:, 12:15], np.tile(slots[0].emission, (len(corners), 1)))


def test_only_the_emissive_slots_of_an_instance_are_lights():
    cube = scenes.cube()
    objects = [
        (cube, scenes.transform(), [scenes.WHITE, GLOW, scenes.WHITE, scenes.WHITE, scenes.WHITE, scenes.WHITE]),
        (cube, scenes.transform((3, 0, 0)), [scenes.WHITE] * 5 + [GLOW]),
    ]
    flat = flatten(scenes.build(objects, VIEW))
    np.testing.assert_allclose(flat.light_data[:, 9:12], [(0, 0, 1)] * 2 + [(1, 0, 0)] * 2, atol=1e-12)


def test_degenerate_triangles_are_no_lights():
    shape = scenes.mesh(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (np.nan, 0, 0), (np.inf, 0, 0)],
        [(0, 1, 2), (0, 1, 3), (0, 0, 1), (0, 1, 4), (0, 5, 2)],
    )
    flat = flatten(scenes.build([(shape, scenes.transform(), [GLOW])], VIEW))
    assert len(flat.light_kind) == 1 and flat.light_data[0, 17] == pytest.approx(0.5)
    assert np.isfinite(flat.extent) and np.isfinite(flat.light_data).all()


SUN = 20.0


def test_intensities_are_in_one_unit():
    """W / sr along the axis of lamps and triangles, W / m^2 of a sun; of these only the ratios are kept."""
    objects = [(scenes.quad(2.0), scenes.transform(), [GLOW])]
    lamps = [
        scenes.lamp(LightKind.POINT, power=(3.0, 6.0, 9.0)),
        scenes.lamp(LightKind.SUN, power=(5.0 * SUN, 10.0 * SUN, 15.0 * SUN), size=(0.0, 0.0)),
        scenes.lamp(LightKind.RECTANGLE, power=(1.0, 1.0, 4.0)),
        scenes.lamp(LightKind.POINT, power=(0.0, 0.0, 0.0)),
    ]
    flat = flatten(scenes.build(objects, VIEW, lamps))
    np.testing.assert_allclose(flat.light_data[0, [21, 22]], [0.02, 1.0])
    leaves = flat.light_tree[len(flat.light_of_leaf) - 1 :, 11][flat.light_of_leaf >= 0]
    of_light = dict(zip(flat.light_of_leaf[flat.light_of_leaf >= 0], np.abs(leaves), strict=True))
    expected = np.array([6.0 / (4.0 * np.pi), 2.0 / np.pi, 2.0 * 4.0]) / SUN  # two triangles are one leaf
    np.testing.assert_allclose([of_light[light] for light in (1, 2, 3)], expected, rtol=1e-6)
    np.testing.assert_allclose(flat.light_data[1:, 22], [1.0, 1.0, 0.5, 0.5])
    # Suns come first.
    assert flat.light_kind.tolist() == [LightKind.SUN, LightKind.POINT, LightKind.RECTANGLE, TRIANGLE, TRIANGLE]


def test_without_lights():
    flat = flatten(scenes.build([(scenes.quad(), scenes.transform(), [scenes.WHITE])], VIEW))
    assert flat.light_kind.shape == (0,) and flat.light_data.shape == (0, 24)
    assert not len(flat.light_tree) and not len(flat.light_of_leaf) and (flat.emitter == -1).all()


def test_lamp_units():
    power = (40.0, 20.0, 10.0)

    def row(kind, size, **changes) -> np.ndarray:
        light = Light("lamp", kind, power, scenes.look_at((1, 2, 3), (0, 0, 0)), size, **changes)
        flat = flatten(scenes.build([], VIEW, [light]))
        np.testing.assert_allclose(flat.light_data[0, 0:3] + flat.origin, (1, 2, 3))
        # What shines along -Z shines at the target.
        np.testing.assert_allclose(flat.light_data[0, 9:12], np.array([1, 2, 3]) / np.sqrt(14))
        return flat.light_data[0]

    delta = row(LightKind.POINT, (0.0, 0.0))
    np.testing.assert_allclose(delta[12:15], np.array(power) / (4 * np.pi))
    assert delta[20] == 1
    sphere = row(LightKind.SPOT, (0.5, 0.0), spot_angle=1.2, spot_blend=0.5)
    np.testing.assert_allclose(sphere[12:15] * np.pi * 0.25, np.array(power) / (4 * np.pi))
    np.testing.assert_allclose(sphere[[15, 18, 20]], [0.5, np.cos(0.6), 0])
    assert sphere[19] == pytest.approx(1 / ((1 - np.cos(0.6)) * 0.5))
    assert row(LightKind.SPOT, (0.5, 0.0), spot_blend=0.0)[19] == pytest.approx(1000)
    sun = row(LightKind.SUN, (0.4, 0.0))
    np.testing.assert_allclose(sun[12:15] * np.pi * np.sin(0.2) ** 2, power)
    np.testing.assert_allclose(sun[15:17], [np.sin(0.2), np.cos(0.2)])
    np.testing.assert_allclose(row(LightKind.SUN, (0.0, 0.0))[[12, 13, 14, 20]], [*power, 1])
    assert row(LightKind.RECTANGLE, (2.0, 3.0))[17] == pytest.approx(6)
    assert row(LightKind.ELLIPSE, (2.0, 3.0))[17] == pytest.approx(6 * np.pi / 4)
    flat = row(LightKind.RECTANGLE, (0.0, 1.0))
    assert np.isfinite(flat).all() and flat[17] > 0 and flat[20] == 0


def test_what_did_not_change_is_the_same_array():
    scene = scenes.mesh_light_scene()
    first = flatten(scene)
    turned = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, window=(-0.4, 0.4, -0.2, 0.2)))
    second = flatten(turned, first)
    for name in ("object_to_world", "materials", "light_data", "light_tree", "mesh_bounds"):
        assert getattr(second, name) is getattr(first, name)
    dimmed = dataclasses.replace(turned, materials=tuple(dataclasses.replace(m) for m in turned.materials))
    third = flatten(dimmed, second)
    assert third.object_to_world is first.object_to_world and third.light_data is not first.light_data
    fresh = flatten(scenes.move(scene, (500.0, 0, 0)), first)
    for name in ("object_to_world", "light_data", "origin"):
        np.testing.assert_array_equal(getattr(fresh, name), getattr(flatten(scenes.move(scene, (500.0, 0, 0))), name))


@pytest.mark.parametrize(
    "scene, expected",
    [
        (
            scenes.box_scene(),
            Effects.SPECULAR | Effects.TRANSMISSION | Effects.AREA_LIGHTS | Effects.PERFECT_SPECULAR,
        ),
        (scenes.textured_scene(), Effects.TEXTURES | Effects.AREA_LIGHTS | Effects.ENVIRONMENT),
        (
            scenes.moving_scene(),
            Effects.SPECULAR
            | Effects.AREA_LIGHTS
            | Effects.ENVIRONMENT
            | Effects.CAMERA_MOTION
            | Effects.OBJECT_MOTION,
        ),
        (scenes.deforming_scene(), Effects.DEFORMATION | Effects.AREA_LIGHTS),
        (scenes.mesh_light_scene(), Effects.MESH_LIGHTS | Effects.SPECULAR | Effects.MANY_LIGHTS),
        (scenes.lamp_scene(scenes.lamp(LightKind.SUN, size=(0.0, 0.0))), Effects.SPECULAR | Effects.DELTA_LIGHTS),
        (scenes.build([], VIEW), Effects.NONE),
        (scenes.build([], VIEW, [scenes.lamp(LightKind.POINT, power=(0, 0, 0))]), Effects.NONE),
        (scenes.build([], VIEW, world=World((0, 0, 1e-9))), Effects.ENVIRONMENT),
        (scenes.closed_box(Material(ior=1.0)), Effects.NONE),
        (scenes.closed_box(Material(metallic=0.01, specular_ior_level=0.0)), Effects.SPECULAR),
    ],
)
def test_effects_are_those_of_the_scene_and_no_others(scene, expected):
    assert find_effects(scene) == expected == flatten(scene).effects


def test_materials_that_nothing_uses_have_no_effect():
    scene = scenes.build([(scenes.quad(), scenes.transform(), [scenes.WHITE, scenes.GLASS, GLOW])], VIEW)
    assert find_effects(scene) == Effects.NONE
    assert find_effects(dataclasses.replace(scene, materials=(*scene.materials, scenes.METAL))) == Effects.NONE


@pytest.mark.parametrize(
    "material, expected",
    [
        (Material(alpha=0.5, specular_ior_level=0.0), Effects.ALPHA),
        (Material(maps={"alpha": TextureMap(0)}, ior=1.0), Effects.ALPHA | Effects.TEXTURES),
        (Material(maps={"ior": TextureMap(0)}, ior=1.0), Effects.SPECULAR | Effects.TEXTURES),
        (Material(diffuse_roughness=0.1, ior=1.0), Effects.SPECULAR),
        (Material(kind=MaterialKind.DIFFUSE, diffuse_roughness=0.1), Effects.SPECULAR),
        (Material(coat_weight=0.1, ior=1.0), Effects.SPECULAR | Effects.COAT),
        (Material(sheen_weight=0.1, ior=1.0), Effects.SPECULAR | Effects.SHEEN),
        (Material(anisotropic=0.1), Effects.SPECULAR | Effects.ANISOTROPY),
        (Material(anisotropic=0.1, ior=1.0), Effects.NONE),
        (
            Material(maps={"normal": TextureMap(0)}, ior=1.0),
            Effects.NORMAL_MAPS | Effects.TEXTURES,
        ),
        (Material(maps={"normal": TextureMap(0)}, normal_strength=0.0, ior=1.0), Effects.TEXTURES),
        (Material(kind=MaterialKind.DIFFUSE, coat_weight=1.0, alpha=0.5, transmission=1.0), Effects.NONE),
        (Material(kind=MaterialKind.GLOSSY, anisotropic=-0.5), Effects.SPECULAR | Effects.ANISOTROPY),
        (Material(kind=MaterialKind.GLASS), Effects.SPECULAR | Effects.TRANSMISSION),
        (Material(kind=MaterialKind.REFRACTION), Effects.SPECULAR | Effects.TRANSMISSION),
        (Material(kind=MaterialKind.TRANSLUCENT), Effects.TRANSMISSION),
        (Material(kind=MaterialKind.TRANSPARENT), Effects.ALPHA),
    ],
)
def test_effects_of_materials(material, expected):
    assert find_effects(scenes.closed_box(material)) == expected


def test_effects_of_mixes_are_those_of_their_parts():
    mix = Material("mix", kind=MaterialKind.MIX, first=1, second=2)
    add = Material("add", kind=MaterialKind.ADD, first=3, second=4)
    parts = (mix, Material(kind=MaterialKind.GLASS), add, Material(kind=MaterialKind.TRANSPARENT), scenes.WHITE)
    scene = dataclasses.replace(scenes.closed_box(mix), materials=(*parts, Material(coat_weight=1.0)))
    expected = Effects.MATERIAL_MIXES | Effects.SPECULAR | Effects.TRANSMISSION | Effects.ALPHA
    assert find_effects(scene) == expected


def test_bits_are_those_of_the_native_source():
    header = pathlib.Path(__file__).parents[1] / "backend/native/core/effects.h"
    native = dict(re.findall(r"(\w+) = 1u << (\d+)", header.read_text()))
    assert {effect.name.lower(): int(effect).bit_length() - 1 for effect in Effects} == {
        k: int(v) for k, v in native.items()
    }
