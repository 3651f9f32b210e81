# SPDX-License-Identifier: Apache-2.0
"""Stage "path", on every device, against light that can be worked out on paper or by quadrature."""

import dataclasses

import numpy as np
import pytest

from svgf.effects import Effects
from svgf.environment import mean_radiance, sampling_map
from svgf.flat_lights import AREA_LAMP_RADIANCE
from svgf.light_paths import LightPaths
from svgf.reference.bsdf_evaluate import evaluate
from svgf.reference.environment import World as Sky
from svgf.reference.texture import Texture
from svgf.scene import Light, LightKind, Material, MaterialKind, RenderDefaults, World

from . import scenes
from .bsdf_cases import make, repeat, sphere_grid
from .statistical import assert_mean
from .tracing import hit_points, radiance, trace

GRAY = Material("gray", base_color=(0.5, 0.5, 0.5), specular_ior_level=0.0)
FLOOR = (scenes.quad(4.0), scenes.transform(), [scenes.WHITE])
VIEW = scenes.camera((0.5, -3.0, 2.5), (0, 0, 0))


def assert_ratio(images, expected: np.ndarray, chosen: np.ndarray, rounding: float = 1e-5) -> None:
    """z-test of light over expected light [height, width], over pixels, which are independent; then of each quarter of
    them."""
    ratio = (radiance(images)[..., 0] / np.where(chosen, expected, 1.0))[chosen]
    assert_mean(ratio, 1.0, rounding=rounding)
    for part in np.array_split(ratio, 4):
        assert_mean(part, 1.0, rounding=rounding)


@pytest.mark.parametrize("bounces", [0, 1, 4, 12])
def test_closed_furnace(device, bounces):
    """Walls that shine with radiance 1 and reflect half: 1 + 1/2 + 1/4 + ..., one term for each vertex. Light that is
    found at a wall is weighed against light that is sampled, and paths end at random; the mean does not know."""
    glow = dataclasses.replace(GRAY, emission=(1.0, 1.0, 1.0))
    images = trace(device, scenes.closed_box(glow), bounces=bounces, samples=8)
    assert_mean(radiance(images)[..., 1], 2.0 - 0.5 ** (bounces + 1), rounding=1e-5)
    np.testing.assert_array_equal(images["emission"], 1.0)


def test_furnace_converges_to_radiance_over_absorption(device):
    glow = dataclasses.replace(GRAY, base_color=(0.8, 0.5, 0.2), emission=(1.0, 2.0, 3.0))
    light = radiance(trace(device, scenes.closed_box(glow), bounces=60, samples=2))
    for channel, expected in enumerate((1 / 0.2, 2 / 0.5, 3 / 0.8)):
        assert_mean(light[..., channel], expected, rounding=1e-5)


def test_convex_object_in_a_bright_world(device):
    """Lambert under a uniform sky shows exactly its albedo, at every sample: no noise at all."""
    ball = scenes.sphere(1.0, rows=12, smooth=False)
    objects = [(ball, scenes.transform(), [dataclasses.replace(GRAY, base_color=(0.7, 0.5, 0.1))])]
    images = trace(
        device, scenes.build(objects, scenes.camera((0, -4, 0), (0, 0, 0)), world=World((1, 2, 3))), bounces=0
    )
    seen = images["object_id"] == 1
    assert 0.1 < seen.mean() < 0.9
    np.testing.assert_allclose(images["diffuse"][seen], np.tile((0.7, 1.0, 0.3), (seen.sum(), 1)), rtol=1e-5)
    np.testing.assert_allclose(images["emission"][~seen], np.tile((1, 2, 3), ((~seen).sum(), 1)), rtol=1e-6)
    assert not images["emission"][seen].any()


@pytest.mark.parametrize("ior", [1.0, 1.45])
def test_clear_glass_is_invisible_in_a_uniform_world(device, ior):
    """The world's light comes through whole, whether it is reflected or refracted, and however often. Along the larger
    part it comes by its mean; the smaller part, where both are there, is chosen with its probability."""
    glass = Material("clear", base_color=(1.0, 1.0, 1.0), transmission=1.0, roughness=0.0, ior=ior)
    objects = [(scenes.sphere(1.0, rows=12, smooth=False), scenes.transform(), [glass])]
    scene = scenes.build(objects, scenes.camera((0, -4, 0), (0, 0, 0)), world=World((1, 1, 1)))
    if ior == 1.0:
        np.testing.assert_allclose(radiance(trace(device, scene, bounces=40)), 1, rtol=1e-5)
        return
    samples = np.array([radiance(trace(device, scene, bounces=40, sample=i))[..., 0].mean() for i in range(24)])
    # A few paths are caught within by total reflection until their bounces are spent: they carry nothing.
    assert_mean(samples, 1.0, rounding=5e-4)


def cosine_to(light: Light, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit direction to a lamp's centre, distance, and cosine with +Z."""
    towards = light.light_to_world[:, 3] - points
    distance = np.linalg.norm(towards, axis=-1)
    return towards / distance[..., None], distance, towards[..., 2] / distance


def quadrature(light: Light, points: np.ndarray, cells: int = 24) -> np.ndarray:
    """Irradiance over radiance of a rectangle or ellipse on points of the floor, by the midpoint rule over the lamp."""
    x, y, z, centre = light.light_to_world.T
    centres = (np.arange(cells) + 0.5) / cells - 0.5
    total = np.zeros(points.shape[:-1])
    count = 0
    for a in centres:
        for b in centres:
            if light.kind == LightKind.ELLIPSE and a * a + b * b > 0.25:
                continue
            count += 1
            towards = centre + a * light.size[0] * x + b * light.size[1] * y - points
            squared = (towards**2).sum(axis=-1)
            total += np.maximum(towards @ z, 0) * np.maximum(towards[..., 2], 0) / squared**2
    area = light.size[0] * light.size[1] * (np.pi / 4 if light.kind == LightKind.ELLIPSE else 1)
    return total / count * area


def floor_points(device, scene) -> tuple[np.ndarray, np.ndarray]:
    images = trace(device, scene, bounces=0)
    seen = images["object_id"] == 1
    return np.where(seen[..., None], hit_points(scene, images), 0.0), seen


@pytest.mark.parametrize("kind", [LightKind.RECTANGLE, LightKind.ELLIPSE])
@pytest.mark.parametrize("eye", [(0.3, -0.4, 2.0), (0.3, -0.4, 0.2)])
def test_area_lamp_over_a_floor(device, kind, eye):
    """Both ways of finding the lamp take part; close to the floor the BSDF's finds much of it."""
    lamp = scenes.lamp(kind, eye=eye, target=(0, 0, 0))
    scene = scenes.build([FLOOR], VIEW, [lamp])
    points, seen = floor_points(device, scene)
    area = lamp.size[0] * lamp.size[1] * (np.pi / 4 if kind == LightKind.ELLIPSE else 1)
    expected = lamp.power[0] * AREA_LAMP_RADIANCE / area * quadrature(lamp, points, 80) * 0.8 / np.pi
    lit = seen & (expected > 1e-2 * expected.max())
    assert lit.mean() > 0.1
    # The midpoint rule knows the rim of an ellipse to half a percent, and a lamp that nearly touches to one.
    assert_ratio(trace(device, scene, bounces=0, samples=16), expected, lit, rounding=0.01)


@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.SPOT, LightKind.SUN])
@pytest.mark.parametrize("has_size", [True, False], ids=["sized", "delta"])
def test_point_spot_and_sun_over_a_floor(device, kind, has_size):
    lamp = scenes.lamp(kind, eye=(0.2, -0.3, 1.0), size=None if has_size else (0.0, 0.0))
    scene = scenes.build([FLOOR], VIEW, [lamp])
    points, seen = floor_points(device, scene)
    towards, distance, cosine = cosine_to(lamp, points)
    if kind == LightKind.SUN:
        irradiance = np.full(seen.shape, lamp.power[0] * lamp.light_to_world[2, 2])
    else:
        irradiance = lamp.power[0] / (4 * np.pi) * cosine / distance**2
    if kind == LightKind.SPOT:
        # Where the cone neither ends nor fades within the size of the lamp.
        seen = seen & (towards @ lamp.light_to_world[:, 2] > np.cos(lamp.spot_angle / 2 * 0.6))
    images = trace(device, scene, bounces=0, samples=16)
    expected = irradiance * 0.8 / np.pi
    if has_size:
        assert_ratio(images, expected, seen)
    else:
        np.testing.assert_allclose(images["diffuse"][..., 0][seen], expected[seen], rtol=2e-4)


def test_mesh_light_over_a_floor(device):
    """Triangles of two strengths, of which the stronger is chosen more often; both sides shine."""
    scene = scenes.mesh_light_scene()
    scene = dataclasses.replace(scene, camera=scenes.camera((0.5, -1.2, 0.9), (0.2, 0, 0)))
    names = ("mesh", "object_to_world", "previous_object_to_world", "object_id", "material_start")
    floor_and_panel = {name: getattr(scene.instances, name)[:2] for name in names}
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, **floor_and_panel))
    points, seen = floor_points(device, scene)
    matrix = scene.instances.object_to_world[1]
    panel = scene.meshes[1]
    expected = np.zeros(seen.shape)
    cells = 60
    for triangle, material in zip(panel.triangles, scene.materials[1:3]):
        a, b, c = panel.positions[triangle].astype(float) @ matrix[:, :3].T + matrix[:, 3]
        normal = np.cross(b - a, c - a)
        for i in range(cells):
            for j in range(cells - i):
                for offset in ((1 / 3, 1 / 3), (2 / 3, 2 / 3))[: 2 if i + j < cells - 1 else 1]:
                    towards = a + (b - a) * (i + offset[0]) / cells + (c - a) * (j + offset[1]) / cells - points
                    squared = (towards**2).sum(axis=-1)
                    part = np.abs(towards @ normal) / 2 * np.maximum(towards[..., 2], 0) / squared**2
                    expected += material.emission[0] * part / cells**2
    assert_ratio(trace(device, scene, bounces=0, samples=16), expected * 0.8 / np.pi, seen, rounding=2e-3)


@pytest.mark.parametrize("roughness", [0.25, 0.6])
@pytest.mark.parametrize("material", [scenes.METAL, scenes.GLOSSY], ids=lambda m: m.name)
def test_highlight_of_an_area_lamp(device, material, roughness):
    """Direct light of all lobes by quadrature over the lamp, in the reference's BSDF, which its own tests hold."""
    material = dataclasses.replace(material, roughness=roughness)
    lamp = scenes.lamp(LightKind.RECTANGLE, eye=(0, 1.5, 1.2), target=(0, 0, 0), size=(1.0, 1.0))
    scene = scenes.build([(FLOOR[0], FLOOR[1], [material])], scenes.camera((0, -2.0, 1.5), (0, 0, 0)), [lamp])
    points, seen = floor_points(device, scene)
    rows = points[seen]
    view = scene.camera.camera_to_world[:, 3] - rows
    bsdf = make(material, view / np.linalg.norm(view, axis=1, keepdims=True))
    x, y, z, centre = lamp.light_to_world.T
    cells, total = 24, np.zeros((len(rows), 3))
    for a in (np.arange(cells) + 0.5) / cells - 0.5:
        for b in (np.arange(cells) + 0.5) / cells - 0.5:
            towards = centre + a * x + b * y - rows
            distance = np.linalg.norm(towards, axis=1, keepdims=True)
            diffuse, specular, _ = evaluate(bsdf, towards / distance)
            total += (diffuse + specular) * np.maximum(towards @ z, 0)[:, None] / distance**3
    expected = np.zeros(seen.shape)
    expected[seen] = (total / cells**2 * lamp.power[0] * AREA_LAMP_RADIANCE)[:, 0]
    bright = seen & (expected > 0.01 * expected.max())
    assert_ratio(trace(device, scene, bounces=0, samples=16), expected, bright, rounding=5e-3)


@pytest.mark.parametrize("outside", [True, False], ids=["outside", "inside"])
@pytest.mark.parametrize("roughness", [0.4, 1.0])
def test_rough_glass_passes_on_what_its_lobes_hold(device, outside, roughness):
    """In a uniform world, by quadrature of the reference's BSDF: light that microfacets send to the wrong side is lost,
    and must not be taken for light that another event sent there."""
    glass = dataclasses.replace(scenes.ROUGH_GLASS, roughness=roughness, base_color=(1.0, 1.0, 1.0))
    eye = np.array([0.0, -2.0, 2.0 if outside else -2.0])
    scene = scenes.build(
        [(FLOOR[0], FLOOR[1], [glass])], scenes.camera(eye, (0, 0, 0), half_width=1e-3), world=World((1, 1, 1))
    )
    bsdf = make(glass, eye[None] / np.linalg.norm(eye))
    directions, solid_angle = sphere_grid(800, 400)
    _, specular, _ = evaluate(repeat(bsdf, len(directions)), directions)
    assert_mean(
        radiance(trace(device, scene, bounces=0, samples=16))[..., 0], specular[:, 0] @ solid_angle, rounding=1e-3
    )


def test_bounce_between_two_planes(device):
    """A floor under a ceiling that a sun from below lights evenly: one bounce later the floor shows what the form
    factor says."""
    ceiling = (scenes.quad(3.0), scenes.transform((0, 0, 1.0)), [scenes.WHITE])
    floor = (scenes.quad(0.02), scenes.transform(), [GRAY])
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, -5), target=(0, 0, 0), size=(0.0, 0.0))
    scene = scenes.build([floor, ceiling], scenes.camera((0, -0.5, 0.4), (0, 0, 0), half_width=0.005), [sun])
    images = trace(device, scene, bounces=1, samples=16)
    seen = images["object_id"] == 1
    assert seen.mean() > 0.5
    a = 1.5
    quarter = (a / np.hypot(1, a)) * np.arctan(a / np.hypot(1, a)) * 2 / (2 * np.pi)  # of a square above its corner
    radiance_above = sun.power[0] * 0.8 / np.pi
    # The floor itself keeps the sun off 0.02 m of the ceiling: 4e-5 of it.
    assert_mean(radiance(images)[..., 0][seen], radiance_above * 4 * quarter * 0.5, rounding=2e-4)
    assert not radiance(trace(device, scene, bounces=0))[..., 0][seen].any()


def test_shadow_of_a_lamp_without_size_is_black(device):
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, 5), size=(0.0, 0.0))
    roof = (scenes.quad(2.0), scenes.transform((0, 0, 1.5)), [scenes.BLACK])
    scene = scenes.build([FLOOR, roof], scenes.camera((0, -3, 1.0), (0, 0, 0)), [sun])
    points, seen = floor_points(device, scene)
    light = radiance(trace(device, scene, bounces=0))[..., 0]
    inside = np.abs(points[..., :2]).max(axis=-1)
    assert (seen & (inside < 0.99)).sum() > 100
    assert not light[seen & (inside < 0.99)].any()
    np.testing.assert_allclose(light[seen & (inside > 1.01)], sun.power[0] * 0.8 / np.pi, rtol=1e-5)


def test_camera_does_not_see_lamps_but_mirrors_do(device):
    lamp = scenes.lamp(LightKind.RECTANGLE, eye=(0, 0, 1.0), target=(0, 0, 0), size=(1.0, 1.0))
    objects = [(FLOOR[0], FLOOR[1], [scenes.MIRROR])]
    scene = scenes.build(objects, scenes.camera((0, 0.01, 3.0), (0, 0, 0), half_width=0.8), [lamp])
    images = trace(device, scene, bounces=0)
    assert not images["emission"].any()
    expected = lamp.power[0] * AREA_LAMP_RADIANCE * 0.9
    points, seen = floor_points(device, scene)
    # From 3 m above, the lamp 1 m above the mirror is seen within 3/8 m of the middle of the floor.
    from_middle = np.abs(points[..., :2]).max(axis=-1)
    inside, outside = seen & (from_middle < 0.36), seen & (from_middle > 0.39)
    assert inside.sum() > 50
    np.testing.assert_allclose(radiance(images)[..., 0][inside], expected, rtol=1e-4)
    assert not radiance(images)[outside].any()


def test_textured_light_over_a_floor(device):
    """A screen above the floor, by the midpoint rule over its image."""
    scene = scenes.textured_light_scene()
    names = ("mesh", "object_to_world", "previous_object_to_world", "object_id", "material_start")
    floor_and_screen = {name: getattr(scene.instances, name)[:2] for name in names}
    scene = dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, **floor_and_screen))
    points, seen = floor_points(device, scene)
    matrix, cells = scene.instances.object_to_world[1], 40
    texture = Texture(None, scene.textures[0].pixels, True, 1, 0, False)
    grid = (np.stack(np.meshgrid(*[np.arange(cells)] * 2), axis=-1).reshape(-1, 2) + 0.5) / cells
    m = np.reshape(scene.materials[1].maps["emission"].uv_transform, (2, 3))
    shine = 8.0 * texture.lookup(grid @ m[:, :2].T + m[:, 2])[:, 0]
    expected = np.zeros(seen.shape)
    for (u, v), strength in zip(grid, shine):
        towards = matrix[:, :3] @ [0.8 * (u - 0.5), 0.8 * (v - 0.5), 0.0] + matrix[:, 3] - points
        squared = (towards**2).sum(axis=-1)
        part = np.abs(towards @ matrix[:, 2]) * np.maximum(towards[..., 2], 0) / squared**2
        expected += strength * part * (0.8 / cells) ** 2
    assert_ratio(trace(device, scene, bounces=0, samples=64), expected * 0.8 / np.pi, seen, rounding=5e-3)


@pytest.mark.parametrize("count", [1, 3])
def test_panes_let_their_share_through(device, count):
    """A sun straight above panes of alpha 0.4 over a floor: 0.6 of its light passes each; the panes are black."""
    pane = Material("pane", base_color=(0.0, 0.0, 0.0), alpha=0.4, specular_ior_level=0.0)
    panes = [(scenes.quad(8.0), scenes.transform((0, 0, 1.0 + i)), [pane]) for i in range(count)]
    sun = scenes.lamp(LightKind.SUN, eye=(0, 0, 5), target=(0, 0, 0), size=(0.0, 0.0))
    scene = scenes.build([FLOOR, *panes], scenes.camera((0, -0.9, 0.5), (0, 0, 0)), [sun])
    images = trace(device, scene, bounces=0)
    seen = images["object_id"] == 1
    assert seen.mean() > 0.5
    np.testing.assert_allclose(radiance(images)[..., 0][seen], sun.power[0] * 0.8 / np.pi * 0.6**count, rtol=1e-4)
    # As seen through them, on the mean over samples: 0.6 of the rays pass each.
    above = dataclasses.replace(scene, camera=scenes.camera((0, 0.01, 5.0), (0, 0, 0), half_width=0.2))
    mean = radiance(trace(device, above, bounces=0, samples=64))[..., 0]
    assert_mean(mean, sun.power[0] * 0.8 / np.pi * 0.6 ** (2 * count), rounding=1e-4)


def test_transparent_bounces_end_at_their_limit(device):
    """Of 64 panes on top of each other, clear but for their number."""
    pane = Material("pane", kind=MaterialKind.TRANSPARENT, base_color=(1.0, 1.0, 1.0))
    panes = [(scenes.quad(8.0), scenes.transform((0, 0, 0.5 + 0.01 * i)), [pane]) for i in range(64)]
    view = scenes.camera((0, 0.01, 5.0), (0, 0, 0), half_width=0.2)
    # A limit of n lets a ray pass n surfaces; the next one ends it.
    for limit, expected in ((64, 1.0), (63, 0.0)):
        scene = scenes.build(panes, view, world=World((1, 1, 1)))
        paths = LightPaths(transparent_bounces=limit)
        scene = dataclasses.replace(scene, defaults=RenderDefaults(light_paths=paths, transparent_film=True))
        images = trace(device, scene)
        np.testing.assert_allclose(1.0 - images["alpha"], expected)


def test_furnace_of_the_environment(device):
    """Under an image of one colour white stays white: nothing of it is sampled, all of it is found."""
    sky = dataclasses.replace(scenes.sky_texture(), pixels=np.ones((8, 16, 4), np.float32))
    white = Material("white", base_color=(1.0, 1.0, 1.0), specular_ior_level=0.0)
    scene = scenes.build(
        [(scenes.sphere(1.0, smooth=False), scenes.transform(), [white])], scenes.camera((0, -3, 0), (0, 0, 0)),
        textures=[sky], world=World((1, 1, 1), environment=0),
    )  # fmt: skip
    images = trace(device, scene, bounces=4, samples=16)
    seen = images["object_id"] == 1
    np.testing.assert_allclose(radiance(images)[..., 0][seen], 1.0, atol=2e-5)


def test_floor_under_an_image(device):
    """Irradiance by quadrature, of a sky with a bright sun."""
    scene = scenes.build(
        [FLOOR], scenes.camera((0, -0.5, 3.0), (0, 0, 0), half_width=0.1), textures=[scenes.sky_texture()],
        world=World((1, 1, 1), environment=0),
    )  # fmt: skip
    sky = Sky((1, 1, 1), image=Texture(None, scene.textures[0].pixels, False, 1, 0, False))
    directions, solid_angle = sphere_grid(800, 400)
    expected = (sky.radiance(directions)[:, 0] * np.maximum(directions[:, 2], 0.0)) @ solid_angle * 0.8 / np.pi
    assert_mean(radiance(trace(device, scene, bounces=0, samples=64))[..., 0], expected, rounding=5e-3)


def test_directions_of_an_image_have_their_density():
    texture = scenes.sky_texture()
    rows, columns, *_ = sampling_map(mean_radiance(texture))
    sky = Sky((1, 1, 1), image=Texture(None, texture.pixels, False, 1, 0, False), row_cdf=rows, column_cdf=columns,
              to_environment=scenes.rotation("x", 0.7))  # fmt: skip
    directions, density = sky.sample(np.random.default_rng(0).random((20_000, 2)))
    np.testing.assert_allclose(sky.density(directions), density, rtol=1e-6)
    grid, solid_angle = sphere_grid(800, 400)
    assert sky.density(grid) @ solid_angle == pytest.approx(1.0, rel=1e-2)
    # Where nothing is sampled the sky is no brighter than its mean.
    assert (sky.density(grid) > 0).mean() < 0.6


def test_splits_hold_the_same_light(device):
    """diffuse + specular = direct + indirect, path by path; what has no bounce has nothing indirect."""
    for scene in (scenes.box_scene(), scenes.mesh_light_scene()):
        by_lobe, by_bounce = (trace(device, scene, signals=s) for s in ("diffuse_specular", "direct_indirect"))
        scale = radiance(by_lobe).mean()
        np.testing.assert_allclose(radiance(by_lobe), radiance(by_bounce), rtol=1e-4, atol=1e-5 * scale)
        assert by_bounce["indirect"].any() and by_lobe["specular"].any()
        direct = trace(device, scene, signals="direct_indirect", bounces=0)
        assert not direct["indirect"].any()
        # Without bounces mirrors show nothing.
        seen = by_bounce["first_object_id"] == by_bounce["object_id"] if "first_object_id" in by_bounce else slice(None)
        np.testing.assert_allclose(
            direct["direct"][seen], by_bounce["direct"][seen], rtol=1e-5, atol=1e-6 * scale
        )


def test_scenes_without_specular_have_one_signal(device):
    images = trace(device, scenes.textured_scene())
    assert "specular" not in images and "diffuse" in images
    full = trace(device, scenes.textured_scene(), effects=int(~Effects.NONE))
    assert not full["specular"].any()
    np.testing.assert_allclose(full["diffuse"], images["diffuse"], rtol=1e-6, atol=1e-7)


def test_samples_are_averaged_and_numbered(device):
    scene = scenes.lamp_scene(scenes.lamp(LightKind.RECTANGLE))
    together = radiance(trace(device, scene, sample=6, samples=4, pixel_filter="box"))
    alone = [radiance(trace(device, scene, sample=6 + i, pixel_filter="box")) for i in range(4)]
    np.testing.assert_allclose(together, np.mean(alone, axis=0), rtol=1e-4, atol=1e-6)
    assert not np.array_equal(alone[0], alone[1])
    np.testing.assert_array_equal(alone[0], radiance(trace(device, scene, sample=6, pixel_filter="box")))
    assert not np.array_equal(alone[0], radiance(trace(device, scene, sample=6, seed=2, pixel_filter="box")))


def test_more_samples_less_noise(device):
    """Stratified samples do better than 1 / n: the variance of 64 is less than a 64th of that of one."""
    scene = scenes.build([FLOOR], VIEW, [scenes.lamp(LightKind.RECTANGLE)])
    points, seen = floor_points(device, scene)
    lamp = scene.lights[0]
    expected = lamp.power[0] * AREA_LAMP_RADIANCE / 0.5 * quadrature(lamp, points, 60) * 0.8 / np.pi
    one, many = (
        (
            (radiance(trace(device, scene, bounces=0, samples=n))[..., 0] / np.maximum(expected, 1e-9) - 1)[seen] ** 2
        ).mean()
        for n in (1, 64)
    )
    assert many < one / 64 / 2


def test_light_is_finite_and_not_negative(device):
    for scene in scenes.device_scenes().values():
        images = trace(device, scene, samples=2, bounces=8)
        for name in ("emission", "diffuse", "specular"):
            if name in images:
                assert np.isfinite(images[name]).all() and images[name].min() >= 0
