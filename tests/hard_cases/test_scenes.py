# SPDX-License-Identifier: Apache-2.0
"""Scenes that break renderers. On every device: finite, never negative, bounded in energy, and where the same scene can
be had without its difficulty, the same picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from svgf.renderer import Renderer
from svgf.scene import LightKind, Material, MaterialKind, World
from svgf.settings import Settings

from .. import scenes

SMALL = Settings(width=24, height=14, bounces=3, seed=5)
NATIVE_SIZE = Settings(width=48, height=27, bounces=3, seed=5)


def render(device, scene, settings=SMALL, frames=2):
    """The last of some frames, each checked."""
    renderer = Renderer(settings, device)
    for _ in range(frames):
        frame = renderer.render(scene)
        for name in ("color", "noisy", "albedo", "depth", "variance", "history_length", "roughness"):
            image = getattr(frame, name)
            assert np.isfinite(image).all(), name
            assert (image >= 0).all(), name
        assert np.isfinite(frame.motion).all()
        assert np.isfinite(frame.normal).all()
    return frame


def scaled(scene, factor):
    """The same picture, with every length times factor."""

    def placed(rows):
        rows = np.array(rows)
        rows[..., 3] *= factor
        return rows

    def grown(rows):
        return np.array(rows) * factor

    instances = dataclasses.replace(
        scene.instances,
        object_to_world=grown(scene.instances.object_to_world),
        previous_object_to_world=grown(scene.instances.previous_object_to_world),
    )
    camera = dataclasses.replace(
        scene.camera,
        camera_to_world=placed(scene.camera.camera_to_world),
        clip=(0.01 * factor, 1000 * factor),
    )
    lights = tuple(
        dataclasses.replace(
            light,
            light_to_world=placed(light.light_to_world),
            power=tuple(p * factor**2 for p in light.power),
            size=tuple(s * factor for s in light.size),
        )
        for light in scene.lights
    )
    return dataclasses.replace(scene, instances=instances, camera=camera, previous_camera=camera, lights=lights)


def share_alike(a, b, tolerance):
    """Share of pixels whose channels all agree."""
    return np.mean(np.all(np.abs(a - b) <= tolerance * (np.abs(b) + 1e-3), axis=-1))


@pytest.mark.parametrize("offset", [(1e6, 0, 0), (-1e6, 1e6, 1e6)])
def test_far_from_the_origin(device, offset):
    scene = scenes.lamp_scene(scenes.lamp(LightKind.RECTANGLE))
    near, far = render(device, scene), render(device, scenes.move(scene, offset))
    # The rows of a float64 transform at 1e6 m hold 1e-10 m: nothing but the rounding of paths that sit on an edge is
    # left.
    assert share_alike(far.noisy, near.noisy, 1e-3) >= 0.99
    np.testing.assert_allclose(far.depth, near.depth, rtol=1e-4)


@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_scale(device, factor):
    scene = scenes.lamp_scene(scenes.lamp(LightKind.RECTANGLE))
    plain, other = render(device, scene), render(device, scaled(scene, factor))
    assert share_alike(other.noisy, plain.noisy, 1e-2) >= 0.99
    assert share_alike(other.color, plain.color, 2e-2) >= 0.98


def hostile_mesh(kind):
    """A floor, and triangles that nothing can hit, or that all can hit at once."""
    rng = np.random.default_rng(11)
    base = scenes.quad(4.0)
    extra = rng.uniform(-1, 1, (60, 3)).astype(np.float32) + (0, 0, 0.5)
    if kind == "degenerate":
        extra[1::3] = extra[0::3]
    elif kind == "collinear":
        extra[2::3] = 0.5 * (extra[0::3] + extra[1::3])
    elif kind == "needle":
        extra[2::3] = extra[0::3] + 1e-6
    elif kind == "nan":
        extra[rng.integers(0, 60, 30)] = np.nan
    elif kind == "infinite":
        extra[::3] = np.inf
    elif kind == "huge":
        extra[::3] = 3e38
    elif kind == "duplicate":
        extra[:] = np.tile(extra[:3], (20, 1))
    elif kind == "coplanar":
        extra[:, 2] = 0.0
    positions = np.concatenate([base.positions, extra.astype(np.float32)])
    triangles = np.concatenate([base.triangles, np.arange(60).reshape(20, 3) + len(base.positions)])
    return scenes.mesh(positions, triangles, name=kind)


@pytest.mark.parametrize(
    "kind", ["degenerate", "collinear", "needle", "nan", "infinite", "huge", "duplicate", "coplanar"]
)
def test_hostile_triangles(device, kind):
    light = scenes.lamp(LightKind.RECTANGLE)
    view = scenes.camera((0.5, -3.0, 2.5), (0, 0, 0))
    scene = scenes.build([(hostile_mesh(kind), scenes.transform(), [scenes.WHITE])], view, [light])
    frame = render(device, scene)
    assert frame.noisy.mean() > 0
    if kind in ("degenerate", "collinear", "infinite"):
        plain = render(device, scenes.build([(scenes.quad(4.0), scenes.transform(), [scenes.WHITE])], view, [light]))
        np.testing.assert_allclose(frame.depth, plain.depth, rtol=1e-5)


@pytest.mark.parametrize("offset", [0.1, 1e-30, 1e18])
@pytest.mark.parametrize("kind", ["nan", "zero", "cancelling", "inverted", "random", "degenerate", "huge"])
def test_shadow_terminator_of_hostile_normals(device, kind, offset):
    ball = scenes.sphere(0.8, rows=4)
    normals, positions = np.array(ball.normals), np.array(ball.positions)
    some = np.arange(0, len(normals), 2)
    if kind in ("nan", "zero"):
        normals[some, 1] = {"nan": np.nan, "zero": 0.0}[kind]
    elif kind == "cancelling":
        normals[some, 1] = -normals[some, 0]
    elif kind == "inverted":
        normals[some] *= -1
    elif kind == "random":
        normals = np.random.default_rng(4).normal(size=normals.shape).astype(np.float32)
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    elif kind == "degenerate":
        positions[ball.triangles[some, 1]] = positions[ball.triangles[some, 0]]
    else:
        positions *= np.float32(1e30)
    hostile = dataclasses.replace(ball, normals=normals, positions=positions)
    lights = [scenes.lamp(LightKind.SUN, eye=(3, -0.5, 0.2)), scenes.lamp(LightKind.POINT, eye=(1.0, -0.5, 0.3))]
    scene = scenes.build(
        [(hostile, scenes.transform(), [scenes.WHITE])], scenes.camera((0, -3, 0.3), (0, 0, 0)), lights
    )
    frame = render(device, scenes.with_terminator_offset(scene, offset))
    assert kind == "huge" or frame.noisy.mean() > 0


@pytest.mark.parametrize(
    "material",
    [
        Material(roughness=0.0, metallic=1.0, base_color=(1, 1, 1)),
        Material(roughness=1e-4, metallic=1.0),
        Material(roughness=0.0),
        Material(roughness=0.0, transmission=1.0, ior=1.0),
        Material(roughness=0.3, transmission=1.0, ior=1.0),
        Material(roughness=0.0, transmission=1.0, ior=1.0 + 1e-7),
        Material(roughness=0.0, transmission=1.0, ior=1000.0),
        Material(roughness=0.04, transmission=1.0, ior=1.5),
        Material(roughness=1.0, transmission=0.5, metallic=0.5, ior=2.4),
        Material(base_color=(0, 0, 0), specular_ior_level=0.0),
        Material(base_color=(1, 1, 1), specular_ior_level=0.0),
        Material(ior=1000.0, specular_ior_level=1.0),
        Material(ior=0.0, transmission=0.5, roughness=0.2),
        Material(coat_weight=1.0, coat_roughness=0.0, coat_ior=1000.0, sheen_weight=1.0, sheen_roughness=0.0),
        Material(coat_weight=1.0, coat_ior=0.0, coat_tint=(0.0, 0.5, 1.0), sheen_weight=1.0, sheen_roughness=1.0),
        Material(metallic=1.0, roughness=1e-4, anisotropic=1.0),
        Material(metallic=1.0, roughness=1.0, specular_tint=(0.0, 0.0, 0.0)),
        Material(kind=MaterialKind.GLOSSY, roughness=0.1, anisotropic=-1.0),
        Material(kind=MaterialKind.GLASS, roughness=1e-4, base_color=(1, 1, 1)),
        Material(kind=MaterialKind.GLASS, roughness=1.0, base_color=(0, 0, 0)),
        Material(kind=MaterialKind.REFRACTION, roughness=0.5, ior=1000.0),
        Material(kind=MaterialKind.TRANSLUCENT, base_color=(1, 1, 1)),
        Material(kind=MaterialKind.DIFFUSE, diffuse_roughness=1.0, base_color=(1, 1, 1)),
    ],
    ids=lambda m: (
        f"{m.kind.name}_m{m.metallic:g}_r{m.roughness:g}_t{m.transmission:g}_ior{m.ior:g}_c{m.base_color[0]:g}"
    ),
)
def test_furnace(device, material):
    """A body in a uniform world of radiance 1 never gives back more than it got."""
    ball = scenes.sphere(0.8, rows=12)
    scene = scenes.build(
        [(ball, scenes.transform(), [material])], scenes.camera((0, -3, 0.3), (0, 0, 0)), world=World((1, 1, 1))
    )
    frame = render(device, scene, dataclasses.replace(SMALL, samples=8, method="none", pixel_filter="center"))
    body = frame.object_id > 0
    assert body.any()
    # A sample may exceed 1 (its weight is value over probability); the mean of 8 over the body may not by much.
    assert frame.noisy[body].mean() <= 1.02
    np.testing.assert_allclose(frame.noisy[~body], 1.0, rtol=1e-5)


def test_glass_within_glass(device):
    """Balls of clear and of rough glass within each other, a diamond in the middle: no light is made."""
    glasses = [
        Material(kind=MaterialKind.GLASS, roughness=0.0, base_color=(1, 1, 1), ior=1.33),
        Material(kind=MaterialKind.GLASS, roughness=0.5, base_color=(1, 1, 1), ior=1.5),
        Material(kind=MaterialKind.GLASS, roughness=0.0, base_color=(1, 1, 1), ior=2.4),
    ]
    balls = [
        (scenes.sphere(radius, rows=12), scenes.transform(), [glass])
        for radius, glass in zip((0.9, 0.6, 0.3), glasses, strict=True)
    ]
    scene = scenes.build(balls, scenes.camera((0, -3, 0.3), (0, 0, 0)), world=World((1, 1, 1)))
    frame = render(device, scene, dataclasses.replace(SMALL, bounces=48, samples=8, method="none"))
    body = frame.object_id > 0
    # Some paths are caught between the surfaces until their bounces are used up.
    assert 0.8 < frame.noisy[body].mean() <= 1.02


@pytest.mark.parametrize("power", [1e6, 1e12])
@pytest.mark.parametrize("kind", list(LightKind), ids=lambda kind: kind.name.lower())
def test_strong_lamps(device, kind, power):
    frame = render(device, scenes.lamp_scene(scenes.lamp(kind, power=(power, power, power))))
    assert frame.noisy.max() > 0


@pytest.mark.parametrize("size", [(0.0, 0.0), (1e-6, 1e-6), (1e4, 1e4)])
@pytest.mark.parametrize("kind", [LightKind.POINT, LightKind.SPOT, LightKind.RECTANGLE, LightKind.ELLIPSE])
def test_lamp_sizes(device, kind, size):
    """From a point to one that the whole scene lies in."""
    render(device, scenes.lamp_scene(scenes.lamp(kind, size=size)))


def test_light_inside_geometry(device):
    light = scenes.lamp(LightKind.POINT, eye=(0.5, 0.3, 0.3), size=(0.1, 0.0))
    dark = render(device, dataclasses.replace(scenes.lamp_scene(light), world=World()))
    assert dark.noisy.max() == 0


def test_camera_inside_glass(device):
    ball = scenes.sphere(2.0, rows=12)
    scene = scenes.build(
        [(ball, scenes.transform(), [scenes.GLASS])], scenes.camera((0, -0.5, 0), (0, 1, 0)), world=World((1, 1, 1))
    )
    # Total internal reflection keeps some paths inside until their bounces are used up; none may gain energy.
    frame = render(device, scene, dataclasses.replace(SMALL, bounces=16, samples=4))
    assert 0 < frame.noisy.mean() <= 1.01


def test_nested_glass(device):
    objects = [(scenes.sphere(radius, rows=10), scenes.transform(), [scenes.GLASS]) for radius in (0.9, 0.6, 0.3)]
    scene = scenes.build(objects, scenes.camera((0, -3, 0.3), (0, 0, 0)), world=World((1, 1, 1)))
    render(device, scene, dataclasses.replace(SMALL, bounces=16))


def test_grazing_view(device):
    floor = scenes.quad(1000.0)
    scene = scenes.build(
        [(floor, scenes.transform(), [scenes.GLOSSY])],
        scenes.camera((0, -1, 1e-3), (0, 100, 0)),
        [scenes.lamp(LightKind.SUN)],
        world=World((0.5, 0.5, 0.5)),
    )
    render(device, scene)


@pytest.mark.parametrize("half_width", [1e-4, 50.0])
def test_extreme_focal_lengths(device, half_width):
    scene = scenes.box_scene()
    view = dataclasses.replace(
        scene.camera, window=(-half_width, half_width, -half_width * 9 / 16, half_width * 9 / 16)
    )
    render(device, dataclasses.replace(scene, camera=view, previous_camera=view))


def test_camera_that_turns_around(device):
    """The previous view saw nothing of this one."""
    scene = scenes.box_scene()
    behind = dataclasses.replace(
        scene.camera, camera_to_world=scenes.look_at((0.0, -7.0, 2.0), (0.0, -14.0, 1.8))
    )
    render(device, dataclasses.replace(scene, previous_camera=behind), frames=1)


def test_empty_scene(device):
    scene = scenes.build([], scenes.camera((0, -1, 0), (0, 0, 0)), world=World((0.2, 0.3, 0.4)))
    frame = render(device, scene)
    np.testing.assert_allclose(frame.color, np.broadcast_to((0.2, 0.3, 0.4), frame.color.shape), rtol=2.0**-13)  # packed
    assert (frame.object_id == 0).all()


def test_mirrored_and_flat_instances(device):
    """Negative scale renders; a scale of zero is left out, and said so."""
    ball = scenes.sphere(0.5, rows=8)
    view = scenes.camera((0, -4, 1), (0, 0, 0))
    objects = [
        (ball, scenes.transform((-1, 0, 0), np.diag([-1.0, 1.0, 1.0])), [scenes.GLOSSY]),
        (ball, scenes.transform((1, 0, 0), np.diag([1.0, 1.0, 0.0])), [scenes.GLOSSY]),
        (ball, scenes.transform((0, 0, 1), -np.eye(3)), [scenes.GLASS]),
    ]
    frame = render(device, scenes.build(objects, view, world=World((0.5, 0.5, 0.5))))
    assert set(np.unique(frame.object_id)) >= {0, 1}
    assert 2 not in frame.object_id


def test_a_million_instances(device):
    if device.name == "reference":
        pytest.skip("the reference tests every triangle")
    triangle = scenes.mesh([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)], [(0, 1, 2)])
    count = 1_000_000
    rng = np.random.default_rng(2)
    placements = np.tile(np.eye(3, 4), (count, 1, 1))
    placements[:, :, 3] = rng.uniform(-1, 1, (count, 3))
    scene = scenes.build([(triangle, scenes.transform(), [scenes.WHITE])], scenes.camera((0, -4, 0), (0, 0, 0)))
    scene = dataclasses.replace(
        scene,
        instances=dataclasses.replace(
            scene.instances,
            mesh=np.zeros(count, np.int32),
            object_to_world=placements,
            previous_object_to_world=placements,
            object_id=np.arange(1, count + 1, dtype=np.int32),
            material_start=np.zeros(count, np.int32),
        ),
        world=World((1, 1, 1)),
    )
    frame = render(device, scene, dataclasses.replace(NATIVE_SIZE, bounces=1))
    assert (frame.object_id > 0).mean() > 0.2


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 1), (33, 19)])
@pytest.mark.parametrize("method", ["none", "svgf+", "svgf", "eaw"])
def test_odd_sizes(device, size, method):
    settings = Settings(width=size[0], height=size[1], bounces=1, method=method)
    frame = render(device, scenes.textured_scene(), settings, frames=3)
    assert frame.color.shape == (size[1], size[0], 3)
