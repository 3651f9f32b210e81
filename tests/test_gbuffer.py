# SPDX-License-Identifier: Apache-2.0
"""Stage "gbuffer", on every device, against projections and derivatives worked out here."""

import dataclasses

import numpy as np
import pytest
from scipy import interpolate

from svgf.effects import Effects, find_effects
from svgf.scene import Extension, Interpolation, LightKind, Material, Texture, TextureMap, World

from . import scenes
from .tracing import HEIGHT, WIDTH, hit_points, pixels, project, rays, trace


def test_depth_and_normal_of_a_plane(device):
    scene = scenes.textured_scene()
    images = trace(device, scene)
    seen = images["object_id"] == 1
    points = hit_points(scene, images)[seen]
    assert 0.3 < seen.mean() < 0.95
    np.testing.assert_allclose(points[:, 2], 0, atol=2e-6)
    assert np.abs(points[:, :2]).max() < 2 + 1e-5
    np.testing.assert_allclose(images["normal"][seen], np.broadcast_to((0, 0, 1), points.shape), atol=1e-6)


def test_depth_and_normal_of_a_sphere(device):
    """A fine mesh with smooth normals is a sphere to a few parts in a thousand."""
    ball = scenes.sphere(1.0, rows=40)
    scene = scenes.build(
        [(ball, scenes.transform((0.2, 0, 0), 0.8 * np.eye(3)), [scenes.WHITE])], scenes.camera((0, -4, 0.5), (0, 0, 0))
    )
    images = trace(device, scene)
    seen = images["object_id"] == 1
    radial = hit_points(scene, images)[seen] - (0.2, 0, 0)
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 0.8, rtol=4e-3)
    cosine = np.einsum("ni,ni->n", images["normal"][seen], radial / np.linalg.norm(radial, axis=1, keepdims=True))
    facing = -np.einsum("ni,ni->n", radial, rays(scene.camera, *pixels())[seen]) > 0.3
    assert cosine[facing].min() > 0.9999
    np.testing.assert_allclose(np.linalg.norm(images["normal"][seen], axis=1), 1, atol=1e-6)


def test_normals_turn_to_the_viewer_and_survive_stretching_and_mirroring(device):
    """A normal is no vector: under a stretch it turns the other way than the surface's points do."""
    for linear in (np.diag([1.0, 1.0, -1.0]), np.diag([3.0, 0.5, 1.0]) @ scenes.rotation("y", 0.5), -np.eye(3)):
        scene = scenes.build(
            [(scenes.quad(4.0), scenes.transform((0, 0, 0), linear), [scenes.WHITE])],
            scenes.camera((0.3, -2, 3), (0, 0, 0)),
        )
        images = trace(device, scene)
        seen = images["object_id"] == 1
        expected = np.linalg.inv(linear).T @ (0, 0, 1)
        expected *= np.sign(expected[2]) / np.linalg.norm(expected)
        np.testing.assert_allclose(images["normal"][seen], np.broadcast_to(expected, (seen.sum(), 3)), atol=1e-6)


@pytest.mark.parametrize("name", ["box", "moving"])
def test_depth_gradient_is_the_slope_of_the_hit_plane(device, name):
    """1 / depth is linear over the image of a plane: 1 / z(p + s) = 1 / z(p) - s dz / z(p)^2, for a finite step s. The
    window moves by the step, so that the same pixel sees its neighbourhood."""
    scene = scenes.device_scenes()[name]
    step = 0.05
    images = trace(device, scene)
    left, right, bottom, top = scene.camera.window
    for axis, shift in ((0, ((right - left) / WIDTH, 0)), (1, (0, (bottom - top) / HEIGHT))):
        moved_window = (
            left + step * shift[0],
            right + step * shift[0],
            bottom + step * shift[1],
            top + step * shift[1],
        )
        moved = trace(device, dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, window=moved_window)))
        depth, gradient = images["depth"], images["depth_gradient"][..., axis]
        # The same triangle, told by its gradient; curved meshes have many.
        same = (images["object_id"] == moved["object_id"]) & (images["object_id"] > 0)
        expected = 1 / (1 / depth - step * gradient / depth**2)
        relative = np.abs(moved["depth"] - expected) / depth
        assert np.quantile(relative[same], 0.9) < 2e-6
        flat = same & (images["object_id"] == 1)
        assert np.quantile(relative[flat], 0.98) < 2e-6
        # And the gradient is no small thing that the test would not miss.
        assert np.abs(gradient[same]).mean() * step / depth[same].mean() > 1e-5


def test_depth_gradient_is_bounded(device):
    images = trace(
        device,
        scenes.build([(scenes.quad(1e4), scenes.transform(), [scenes.WHITE])], scenes.camera((0, -3, 1e-3), (0, 0, 0))),
    )
    assert np.isfinite(images["depth_gradient"]).all() and np.abs(images["depth_gradient"]).max() <= 1e10


def expected_motion(scene, images, points_before) -> np.ndarray:
    x, y, depth = project(scene.previous_camera, points_before)
    now_x, now_y = pixels()
    return np.stack([x - now_x, y - now_y, depth - images["depth"]], axis=-1)


def test_motion_of_camera_and_objects(device):
    scene = scenes.moving_scene()
    images = trace(device, scene)
    points = hit_points(scene, images)
    before = points.copy()
    instances = scene.instances
    for index, object_id in enumerate(instances.object_id):
        seen = images["object_id"] == object_id
        now, then = instances.object_to_world[index], instances.previous_object_to_world[index]
        local = (points[seen] - now[:, 3]) @ np.linalg.inv(now[:, :3]).T
        before[seen] = local @ then[:, :3].T + then[:, 3]
        assert seen.mean() > 0.05
    seen = images["object_id"] > 0
    expected = expected_motion(scene, images, before)
    assert np.abs(expected[seen]).max() > 1
    np.testing.assert_allclose(images["motion"][seen], expected[seen], atol=2e-4)


def test_motion_of_the_background_is_the_camera_s_rotation(device):
    scene = scenes.moving_scene()
    images = trace(device, scene)
    sky = images["object_id"] == 0
    directions = rays(scene.camera, *pixels())[sky]
    x, y, _ = project(scene.previous_camera, scene.previous_camera.camera_to_world[:, 3] + directions)
    now_x, now_y = pixels()
    assert sky.mean() > 0.1
    np.testing.assert_allclose(images["motion"][sky, 0], x - now_x[sky], atol=2e-4)
    np.testing.assert_allclose(images["motion"][sky, 1], y - now_y[sky], atol=2e-4)
    assert not images["motion"][sky, 2].any()


def test_motion_of_deforming_meshes(device):
    scene = scenes.deforming_scene()
    images = trace(device, scene)
    seen = images["object_id"] == 1
    points = hit_points(scene, images)
    shape = scene.meshes[0]
    before = np.full_like(points, np.nan)
    for triangle in shape.triangles:
        now, then = shape.positions[triangle].astype(float), shape.previous_positions[triangle].astype(float)
        weights = np.linalg.solve(
            np.vstack([now[:, :2].T, np.ones(3)]), np.concatenate([points[seen][:, :2].T, np.ones((1, seen.sum()))])
        )
        inside = (weights >= -1e-9).all(axis=0)
        rows = before[seen]
        rows[inside] = weights[:, inside].T @ then
        before[seen] = rows
    expected = expected_motion(scene, images, before)[seen]
    known = np.isfinite(expected).all(axis=1)
    assert known.mean() > 0.98 and np.abs(expected[known]).max() > 1
    np.testing.assert_allclose(images["motion"][seen][known], expected[known], atol=5e-4)


def test_nothing_moves_where_nothing_moved(device):
    images = trace(device, scenes.box_scene())
    np.testing.assert_allclose(images["motion"][images["object_id"] > 0], 0, atol=1e-3)


def test_motion_from_behind_the_previous_camera(device):
    scene = scenes.textured_scene()
    away = scenes.camera((0.5, -3.0, 2.5), (0.5, -6.0, 5.0))
    images = trace(device, dataclasses.replace(scene, previous_camera=away))
    np.testing.assert_array_equal(images["motion"][..., :2], 1e6)
    assert not images["motion"][..., 2].any()


def test_background(device):
    images = trace(device, scenes.build([], scenes.camera((0, -1, 0), (0, 0, 0)), world=World((1, 2, 3))))
    assert (images["depth"] == np.float32(1e10)).all()
    for name in (
        "normal",
        "depth_gradient",
        "object_id",
        "material_id",
        "roughness",
        "diffuse_albedo",
        "specular_albedo",
        "motion",
    ):
        assert not images[name].any(), name
    np.testing.assert_allclose(images["emission"], np.broadcast_to((1, 2, 3), (HEIGHT, WIDTH, 3)))


def trace_first_hits(device, scene):
    """With mirrors and glass as themselves; what they show: test_specular_chain."""
    return trace(device, scene, effects=int(find_effects(scene) & ~Effects.PERFECT_SPECULAR))


def test_ids_and_roughness(device):
    scene = scenes.box_scene()
    images = trace_first_hits(device, scene)
    table, start = scene.instances.material_table, scene.instances.material_start
    for material_id in np.unique(images["material_id"][images["material_id"] > 0]):
        seen = images["material_id"] == material_id
        material = scene.materials[material_id - 1]
        np.testing.assert_allclose(images["roughness"][seen], material.roughness, rtol=1e-6)
        for object_id in np.unique(images["object_id"][seen]):
            first = start[object_id - 1]
            assert material_id - 1 in table[first : first + (6 if object_id in (1, 6) else 1)]
    assert set(np.unique(images["object_id"])) == {0, 1, 2, 3, 4, 5, 6}


def test_albedos(device):
    """Exact for Lambert and for mirrors; both together never above 1."""
    scene = scenes.box_scene()
    images = trace_first_hits(device, scene)
    for index, material in enumerate(scene.materials):
        seen = images["material_id"] == index + 1
        if material in (scenes.WHITE, scenes.RED, scenes.GREEN):
            np.testing.assert_allclose(
                images["diffuse_albedo"][seen], np.tile(material.base_color, (seen.sum(), 1)), rtol=1e-6
            )
            assert not images["specular_albedo"][seen].any()
        elif material.metallic == 1 or material.transmission == 1:
            assert not images["diffuse_albedo"][seen].any() and (images["specular_albedo"][seen] > 0.1).all()
    total = images["diffuse_albedo"] + images["specular_albedo"]
    assert total.min() >= 0 and total.max() <= 1 + 1e-6


def read_texture(texture: Texture, u: float, v: float) -> np.ndarray:
    """RGBA of one lookup, one texel after the other."""
    height, width = texture.pixels.shape[:2]

    def wrap(i: int, size: int) -> int | None:
        if texture.extension == Extension.REPEAT:
            return i % size
        if texture.extension == Extension.MIRROR:
            i = i % (2 * size)
            return i if i < size else 2 * size - 1 - i
        if texture.extension == Extension.EXTEND:
            return min(max(i, 0), size - 1)
        return i if 0 <= i < size else None

    def texel(i: int, j: int) -> np.ndarray:
        i, j = wrap(i, width), wrap(j, height)
        if i is None or j is None:
            return np.zeros(4)
        scale = 255 if texture.pixels.dtype == np.uint8 else 1
        return texture.pixels[j, i].astype(float) / scale

    x, y = u * width, v * height
    if texture.interpolation == Interpolation.CLOSEST:
        value = texel(int(np.floor(x)), int(np.floor(y)))
    else:
        # Texels are the coefficients of a B-spline of degree 1 or 3.
        spline = SPLINES[texture.interpolation]
        i, j = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
        across = [spline(x - 0.5 - column) for column in range(i - 1, i + 3)]
        value = sum(
            spline(y - 0.5 - row) * weight * texel(column, row)
            for row in range(j - 1, j + 3)
            for column, weight in zip(range(i - 1, i + 3), across)
        )
    color = value[:3] / (value[3] if texture.associated_alpha and value[3] > 0 else 1)
    if texture.srgb:
        color = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return np.append(np.minimum(color, 1), value[3])


TENT = interpolate.BSpline.basis_element([-1, 0, 1], extrapolate=False)
CUBIC = interpolate.BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
SPLINES = {
    Interpolation.LINEAR: lambda x: np.nan_to_num(TENT(x)),
    Interpolation.CUBIC: lambda x: np.nan_to_num(CUBIC(x)),
}


@pytest.mark.parametrize("interpolation", Interpolation)
@pytest.mark.parametrize("extension", Extension)
@pytest.mark.parametrize("kind", ["srgb", "linear_bytes", "floats", "associated_alpha", "one_texel", "two_texels"])
def test_texture_lookups(device, interpolation, extension, kind):
    """A quad whose UVs run from -1.3 to 2.4 over an image of 3 by 5 texels: the colour, and alpha as roughness."""
    rng = np.random.default_rng(6)
    values = rng.random({"one_texel": (1, 1, 4), "two_texels": (2, 2, 4)}.get(kind, (5, 3, 4)))
    if kind == "associated_alpha":
        values[..., :3] *= values[..., 3:]
    pixels = values.astype(np.float32) if kind == "floats" else (values * 255).astype(np.uint8)
    texture = Texture("noise", pixels, kind == "srgb", interpolation, extension, kind == "associated_alpha")
    shape = scenes.quad(2.0)
    # Layer 1 is turned over, half as large and moved; its map makes up for that.
    layers = [shape.uvs * 3.7 - 1.3, shape.uvs[..., ::-1] / 2 + 0.1]
    shape = dataclasses.replace(shape, uvs=np.stack(layers).astype(np.float32))
    second = TextureMap(0, 3, 1, (0.0, 7.4, -0.74 - 1.3, 7.4, 0.0, -0.74 - 1.3))
    paper = Material("paper", maps={"base_color": TextureMap(0), "roughness": second}, specular_ior_level=0.0)
    scene = scenes.build(
        [(shape, scenes.transform(), [paper])], scenes.camera((0, 1e-3, 4), (0, 0, 0)), textures=[texture]
    )
    images = trace(device, scene)
    seen = images["object_id"] == 1
    uv = (hit_points(scene, images)[seen][:, :2] + 1) / 2 * 3.7 - 1.3
    expected = np.array([read_texture(texture, u, v) for u, v in uv[::5]])
    found = np.column_stack([images["diffuse_albedo"][seen], images["roughness"][seen]])[::5]
    wrong = np.abs(found - expected).max(axis=1) > 1e-4
    # A closest texel may change where rounding moves a lookup over its edge.
    assert wrong.mean() <= (0.01 if interpolation == Interpolation.CLOSEST else 0)


def test_box_filter_jitters_the_primary_ray_with_the_sample(device):
    scene = scenes.textured_scene()
    center, first, again, second = (
        trace(device, scene, pixel_filter=name, sample=sample)
        for name, sample in (("center", 0), ("box", 0), ("box", 0), ("box", 1))
    )
    np.testing.assert_array_equal(first["depth"], again["depth"])
    assert not np.array_equal(first["depth"], second["depth"])
    seen = (center["object_id"] == 1) & (first["object_id"] == 1)
    moved = (first["depth"] - center["depth"])[seen]
    slopes = np.abs(center["depth_gradient"][seen]).sum(axis=1) / 2
    assert 0.05 < np.abs(moved / slopes).mean() and np.abs(moved).max() <= slopes.max() * 1.2


def test_gbuffer_is_that_of_the_first_sample(device):
    scene = scenes.lamp_scene(scenes.lamp(LightKind.SUN))
    one, many = (trace(device, scene, samples=samples, pixel_filter="box", sample=5) for samples in (1, 3))
    for name in ("depth", "normal", "object_id", "motion", "diffuse_albedo"):
        np.testing.assert_array_equal(one[name], many[name])
