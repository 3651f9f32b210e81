# SPDX-License-Identifier: Apache-2.0
"""Small scenes in plain numpy, for tests without Blender."""

from __future__ import annotations

import dataclasses

import numpy as np

from svgf.light_paths import LightPaths
from svgf.scene import (
    Aperture,
    Camera,
    Instances,
    Light,
    LightKind,
    Material,
    MaterialKind,
    Mesh,
    Projection,
    RayVisibility,
    RenderDefaults,
    Scene,
    Texture,
    TextureMap,
    World,
)

WHITE = Material("white", base_color=(0.8, 0.8, 0.8), specular_ior_level=0.0)
RED = Material("red", base_color=(0.7, 0.1, 0.1), specular_ior_level=0.0)
GREEN = Material("green", base_color=(0.1, 0.6, 0.1), specular_ior_level=0.0)
GLOSSY = Material("glossy", base_color=(0.2, 0.3, 0.7), roughness=0.25, ior=1.5)
METAL = Material("metal", base_color=(0.9, 0.7, 0.4), metallic=1.0, roughness=0.3)
MIRROR = Material("mirror", base_color=(0.9, 0.9, 0.9), metallic=1.0, roughness=0.0)
GLASS = Material("glass", base_color=(0.95, 1.0, 0.95), transmission=1.0, roughness=0.0, ior=1.45)
ROUGH_GLASS = Material("rough glass", base_color=(0.95, 0.9, 1.0), transmission=1.0, roughness=0.4, ior=1.45)
BLACK = Material("black", base_color=(0.0, 0.0, 0.0), specular_ior_level=0.0)


def rotation(axis: str, angle: float) -> np.ndarray:
    """[3, 3], right-handed, radians."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[j, i], matrix[i, j] = s, -s
    return matrix


def transform(location=(0.0, 0.0, 0.0), linear=None) -> np.ndarray:
    """[3, 4]."""
    return np.column_stack([np.eye(3) if linear is None else linear, np.asarray(location, dtype=np.float64)])


def look_at(eye, target, up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """Camera or lamp [3, 4] at eye with -Z towards target."""
    eye = np.asarray(eye, dtype=np.float64)
    z = eye - np.asarray(target, dtype=np.float64)
    z /= np.linalg.norm(z)
    x = np.cross(up, z)
    if np.linalg.norm(x) < 1e-6:
        x = np.array([1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z, eye])


def camera(eye, target, aspect: float = 16 / 9, half_width: float = 0.5, **changes) -> Camera:
    half_height = half_width / aspect
    return Camera(look_at(eye, target), (-half_width, half_width, -half_height, half_height), **changes)


def mesh(positions, triangles, smooth: bool = False, uvs=None, slots=None, name: str = "mesh", **changes) -> Mesh:
    """smooth: the vertex position, normalized, is the corner's normal."""
    positions = np.asarray(positions, dtype=np.float32)
    triangles = np.asarray(triangles, dtype=np.int32)
    normals = np.zeros((len(triangles), 3, 3), dtype=np.float32)
    if smooth:
        normals = positions[triangles] / np.linalg.norm(positions[triangles], axis=2, keepdims=True)
    slots = np.zeros(len(triangles)) if slots is None else slots
    uvs = None if uvs is None else np.asarray(uvs, dtype=np.float32)
    return Mesh(name, positions, triangles, normals, np.asarray(slots, dtype=np.int32), uvs, **changes)


def quad(size: float = 2.0) -> Mesh:
    """In the XY plane, facing +Z, UVs from (0, 0) to (1, 1)."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * (size / 2)
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    return mesh(corners, triangles, uvs=uv[triangles], name="quad")


def cube(size: float = 2.0, inwards: bool = False) -> Mesh:
    """Slots: 0 bottom, 1 top, 2 back (+Y), 3 front (-Y), 4 left (-X), 5 right (+X)."""
    corners = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * (size / 2)
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (2, 6, 7, 3), (0, 1, 5, 4), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    if inwards:
        triangles = triangles[:, ::-1]
    return mesh(corners, triangles, slots=np.repeat(np.arange(6), 2), name="cube")


def sphere(radius: float = 1.0, rows: int = 16, smooth: bool = True) -> Mesh:
    """Rows of quads from pole to pole, 2 * rows of them around; 4 * rows * (rows - 1) triangles."""
    columns = 2 * rows
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None]
    points = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], axis=-1
    ).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a, b = i * columns + j, i * columns + (j + 1) % columns
    c, d = a + columns, b + columns
    upper = np.stack([a, c, d], axis=-1)  # degenerate in no row: the first has its edge at the pole left out
    lower = np.stack([a, d, b], axis=-1)
    triangles = np.concatenate([upper[:-1].reshape(-1, 3), lower[1:].reshape(-1, 3)])
    return mesh(points * radius, triangles, smooth=smooth, name="sphere")


def build(objects, view: Camera, lights=(), previous_view: Camera | None = None, textures=(), **changes) -> Scene:
    """objects: of (mesh, transform [3, 4], materials of its slots) or with the previous transform as a fourth."""
    meshes: list[Mesh] = []
    materials: list[Material] = []
    rows = {"mesh": [], "object_to_world": [], "previous_object_to_world": [], "material_start": []}
    table: list[int] = []
    for entry in objects:
        shape, placement, slots = entry[:3]
        for items, wanted in ((meshes, [shape]), (materials, slots)):
            items.extend(item for item in wanted if not any(item is other for other in items))
        rows["mesh"].append(next(i for i, other in enumerate(meshes) if other is shape))
        rows["object_to_world"].append(placement)
        rows["previous_object_to_world"].append(entry[3] if len(entry) > 3 else placement)
        rows["material_start"].append(len(table))
        table.extend(next(i for i, other in enumerate(materials) if other is material) for material in slots)
    count = len(rows["mesh"])
    instances = Instances(
        mesh=np.array(rows["mesh"], dtype=np.int32),
        object_to_world=np.array(rows["object_to_world"], dtype=np.float64).reshape(-1, 3, 4),
        previous_object_to_world=np.array(rows["previous_object_to_world"], dtype=np.float64).reshape(-1, 3, 4),
        object_id=np.arange(1, count + 1, dtype=np.int32),
        material_start=np.array(rows["material_start"], dtype=np.int32),
        material_table=np.array(table, dtype=np.int32),
    )
    return Scene(
        meshes=tuple(meshes),
        instances=instances,
        materials=tuple(materials),
        camera=view,
        previous_camera=previous_view or view,
        textures=tuple(textures),
        lights=tuple(lights),
        **changes,
    )


def move(scene: Scene, offset) -> Scene:
    """The whole scene, elsewhere."""

    def moved(rows) -> np.ndarray:
        rows = np.array(rows)
        rows[..., 3] += offset
        return rows

    instances = dataclasses.replace(
        scene.instances,
        object_to_world=moved(scene.instances.object_to_world),
        previous_object_to_world=moved(scene.instances.previous_object_to_world),
    )
    return dataclasses.replace(
        scene,
        instances=instances,
        camera=dataclasses.replace(scene.camera, camera_to_world=moved(scene.camera.camera_to_world)),
        previous_camera=dataclasses.replace(
            scene.previous_camera, camera_to_world=moved(scene.previous_camera.camera_to_world)
        ),
        lights=tuple(dataclasses.replace(lamp, light_to_world=moved(lamp.light_to_world)) for lamp in scene.lights),
    )


def lamp(kind: LightKind, eye=(0.3, -0.4, 2.0), target=(0.0, 0.0, 0.0), power=(40.0, 30.0, 20.0), size=None) -> Light:
    """Over the origin, with a size."""
    sizes = {
        LightKind.POINT: (0.2, 0.0),
        LightKind.SUN: (0.2, 0.0),
        LightKind.SPOT: (0.1, 0.0),
        LightKind.RECTANGLE: (1.0, 0.5),
        LightKind.ELLIPSE: (1.0, 0.5),
    }
    if kind == LightKind.SUN:
        power = tuple(p / 10.0 for p in power)
    return Light(
        kind.name.lower(), kind, power, look_at(eye, target), size or sizes[kind], spot_angle=0.9, spot_blend=0.3
    )


def box_scene() -> Scene:
    """A room with red and green walls, open to the front, under an area lamp: a glossy, a metal, a glass and a rough
    glass sphere and a mirror cube. About 3400 triangles."""
    room, ball, block = cube(4.0, inwards=True), sphere(0.5, rows=16), cube(0.8)
    walls = [WHITE, WHITE, WHITE, WHITE, RED, GREEN]
    open_room = dataclasses.replace(
        room,
        triangles=room.triangles[room.material_slots != 3],
        normals=room.normals[room.material_slots != 3],
        material_slots=room.material_slots[room.material_slots != 3],
    )
    objects = [
        (open_room, transform((0, 0, 2)), walls),
        (ball, transform((-1.2, 0.5, 0.5)), [GLOSSY]),
        (ball, transform((0.0, 0.9, 0.75), 1.5 * rotation("x", 0.3)), [METAL]),
        (ball, transform((0.9, -0.6, 0.5)), [GLASS]),
        (ball, transform((-0.4, -0.9, 0.4), 0.8 * np.eye(3)), [ROUGH_GLASS]),
        (block, transform((1.2, 1.0, 0.4), rotation("z", 0.5)), [MIRROR] * 6),
    ]
    light = lamp(LightKind.RECTANGLE, eye=(0, 0, 3.9), target=(0, 0, 0), power=(60, 55, 50), size=(1.2, 0.8))
    return build(objects, camera((0.0, -7.0, 2.0), (0, 0, 1.8)), [light])


def checker_texture(size: int = 8) -> Texture:
    rng = np.random.default_rng(7)
    pixels = rng.integers(30, 226, (size, size, 4)).astype(np.uint8)
    pixels[(np.add.outer(np.arange(size), np.arange(size)) % 2) == 0] //= 4
    return Texture("checker", pixels, srgb=True)


def textured_scene() -> Scene:
    """A textured floor under a sun and a sky."""
    paper = Material("paper", maps={"base_color": TextureMap(0)}, specular_ior_level=0.0)
    return build(
        [(quad(4.0), transform(), [paper])],
        camera((0.5, -3.0, 2.5), (0, 0, 0)),
        [lamp(LightKind.SUN)],
        textures=[checker_texture()],
        world=World((0.3, 0.4, 0.5)),
    )


def moving_scene() -> Scene:
    """A camera that moves and turns, a sphere that moves and turns, a floor that stays, and a lit sky above it."""
    ball = sphere(0.7, rows=12)
    objects = [
        (quad(8.0), transform(), [WHITE]),
        (ball, transform((0.3, 0.1, 0.9), rotation("z", 0.2)), [GLOSSY], transform((0.0, 0.0, 0.8))),
    ]
    return build(
        objects,
        camera((0.4, -4.0, 1.6), (0, 0, 0.9)),
        [lamp(LightKind.POINT)],
        previous_view=camera((0.2, -4.2, 1.5), (0.1, 0, 0.8)),
        world=World((0.1, 0.1, 0.2)),
    )


def deforming_scene() -> Scene:
    """A quad of which each vertex moved by itself."""
    shape = quad(2.0)
    before = shape.positions + np.random.default_rng(3).normal(0, 0.1, shape.positions.shape).astype(np.float32)
    shape = dataclasses.replace(shape, previous_positions=before)
    return build([(shape, transform(), [WHITE])], camera((0.5, -2.0, 2.5), (0, 0, 0)), [lamp(LightKind.SUN)])


def lamp_scene(light: Light) -> Scene:
    """A floor with a glossy sphere on it, under one lamp."""
    objects = [(quad(4.0), transform(), [WHITE]), (sphere(0.3, rows=8), transform((0.5, 0.3, 0.3)), [GLOSSY])]
    return build(objects, camera((0.5, -3.0, 2.5), (0, 0, 0)), [light])


def mesh_light_scene() -> Scene:
    """A floor under two emissive triangles of different strength, which the camera sees."""
    glow = Material("glow", base_color=(0.5, 0.5, 0.5), emission=(6.0, 5.0, 4.0), specular_ior_level=0.0)
    dim = Material("dim", base_color=(0.5, 0.5, 0.5), emission=(0.5, 1.0, 2.0), specular_ior_level=0.0)
    panel = dataclasses.replace(quad(0.8), material_slots=np.array([0, 1], dtype=np.int32))
    objects = [
        (quad(4.0), transform(), [WHITE]),
        (panel, transform((0, 0, 1.2), rotation("x", 0.6)), [glow, dim]),
        (sphere(0.3, rows=8), transform((0.6, 0.2, 0.3)), [METAL]),
    ]
    return build(objects, camera((0.5, -3.0, 2.5), (0, 0, 0.3)))


def sky_texture(height: int = 24) -> Texture:
    """An equirectangular sky: a small bright sun, a glow around it, and a dark ground."""
    rng = np.random.default_rng(5)
    pixels = rng.uniform(0.1, 0.4, (height, 2 * height, 4)).astype(np.float32)
    pixels[: height // 2] *= 0.2
    pixels[2 * height // 3, height // 2, :3] = 400.0, 350.0, 250.0
    return Texture("sky", pixels, srgb=False)


def environment_scene() -> Scene:
    """A floor, a glossy and a mirror sphere under an image of a sky, turned about two axes."""
    objects = [
        (quad(4.0), transform(), [WHITE]),
        (sphere(0.4, rows=8), transform((0.5, 0.3, 0.4)), [GLOSSY]),
        (sphere(0.3, rows=8), transform((-0.6, 0.1, 0.3)), [MIRROR]),
    ]
    turn = tuple((rotation("x", 0.3) @ rotation("z", 1.0)).ravel())
    world = World((1.0, 0.9, 0.8), environment=0, world_to_environment=turn)
    return build(objects, camera((0.5, -3.0, 1.5), (0, 0, 0.2)), textures=[sky_texture()], world=world)


def many_lights_scene(count: int = 60) -> Scene:
    """Small lamps of every kind and two emissive balls all over a floor, and a sun."""
    rng = np.random.default_rng(11)
    glow = Material("glow", base_color=(0.2, 0.2, 0.2), emission=(3.0, 2.0, 1.0), specular_ior_level=0.0)
    ball = sphere(0.05, rows=4, smooth=False)
    objects = [
        (quad(6.0), transform(), [WHITE]),
        (sphere(0.3, rows=8), transform((0.5, 0.3, 0.3)), [GLOSSY]),
        *((ball, transform((x, 0.5, 0.4)), [glow]) for x in (-1.5, 1.2)),
    ]
    kinds = (LightKind.POINT, LightKind.SPOT, LightKind.RECTANGLE, LightKind.ELLIPSE)
    lights = [lamp(LightKind.SUN, power=(3, 3, 3))]
    for number in range(count):
        eye = rng.uniform((-2.5, -2.5, 0.2), (2.5, 2.5, 0.9))
        sizes = {0: (0.0, 0.0), 1: (0.03, 0.03)}[number % 3 > 0]
        kind = kinds[number % 4]
        sizes = (0.05, 0.08) if kind in (LightKind.RECTANGLE, LightKind.ELLIPSE) else sizes
        target = eye + rng.normal(size=3) * (1, 1, 0.3) - (0, 0, 1)
        lights.append(lamp(kind, eye, target, power=rng.uniform(0.1, 1.5, 3), size=sizes))
    return build(objects, camera((0.5, -3.0, 2.5), (0, 0, 0)), lights)


def textured_light_scene() -> Scene:
    """A floor under a screen: two triangles that shine as an image says."""
    screen = Material(
        "screen", base_color=(0.1, 0.1, 0.1), emission=(8.0, 6.0, 4.0), specular_ior_level=0.0,
        maps={"emission": TextureMap(0, uv_transform=(0.5, 0.0, 0.2, 0.1, 0.7, 0.0))},
    )  # fmt: skip
    objects = [
        (quad(4.0), transform(), [WHITE]),
        (quad(0.8), transform((0, 0, 1.2), rotation("x", 0.6)), [screen]),
        (sphere(0.3, rows=8), transform((0.6, 0.2, 0.3)), [METAL]),
    ]
    return build(objects, camera((0.5, -3.0, 2.5), (0, 0, 0.3)), textures=[checker_texture()])


def cutout_scene() -> Scene:
    """A floor with a lamp behind panes: tinted, half transparent, and one that an image cuts holes into; the camera
    looks through one of them too."""
    tinted = Material("tinted", kind=MaterialKind.TRANSPARENT, base_color=(0.9, 0.3, 0.2))
    half = Material("half", base_color=(0.2, 0.4, 0.8), alpha=0.4, specular_ior_level=0.0)
    holes = Material("holes", base_color=(0.3, 0.7, 0.3), specular_ior_level=0.0, maps={"alpha": TextureMap(0)})
    pane = quad(1.2)
    objects = [
        (quad(4.0), transform(), [WHITE]),
        *((pane, transform((x, 0, 0.9), rotation("y", 0.2)), [m]) for x, m in ((-1, tinted), (0, half), (1, holes))),
        (pane, transform((0.2, -1.2, 0.6), rotation("x", 1.3)), [half]),
        (sphere(0.3, rows=8), transform((0.3, 0.3, 0.3)), [GLOSSY]),
    ]
    light = lamp(LightKind.RECTANGLE, eye=(0.2, 0, 2.0), target=(0, 0, 0))
    view, world = camera((0.5, -3.0, 2.5), (0, 0, 0.3)), World((0.2, 0.3, 0.4))
    return build(objects, view, [light], textures=[checker_texture()], world=world)


def visibility_scene() -> Scene:
    """Every object and lamp is hidden from another kind of ray."""
    scene = box_scene()
    kinds = [RayVisibility.ALL & ~kind for kind in RayVisibility]
    visibility = np.array([RayVisibility.ALL, *kinds], dtype=np.uint8)
    lights = tuple(
        dataclasses.replace(scene.lights[0], name=f"lamp {number}", visibility=RayVisibility.ALL & ~kind)
        for number, kind in enumerate((RayVisibility.CAMERA, RayVisibility.DIFFUSE, RayVisibility.GLOSSY))
    )
    world = World((0.2, 0.3, 0.5), visibility=RayVisibility.ALL & ~RayVisibility.DIFFUSE)
    instances = dataclasses.replace(scene.instances, visibility=visibility)
    return dataclasses.replace(scene, instances=instances, lights=lights, world=world)


def with_terminator_offset(scene: Scene, offset: float) -> Scene:
    offsets = np.full(len(scene.instances.mesh), offset, np.float32)
    return dataclasses.replace(scene, instances=dataclasses.replace(scene.instances, terminator_offset=offsets))


def terminator_scene() -> Scene:
    """Coarse balls with smooth normals under a sun that grazes them and a lamp close to them: of all kinds of lobes,
    mirrored, stretched, and one from within."""
    ball = sphere(0.6, rows=4)
    screen = Material("screen", kind=MaterialKind.TRANSLUCENT, base_color=(0.6, 0.7, 0.3))
    opening = dataclasses.replace(
        ball, triangles=ball.triangles[:20], normals=ball.normals[:20], material_slots=ball.material_slots[:20]
    )
    objects = [
        (quad(6.0), transform((0, 0, -0.7)), [WHITE]),
        (ball, transform((-1.2, 0, 0)), [WHITE]),
        (ball, transform((0, 0, 0), np.diag([-1.0, 1.0, 1.0])), [GLOSSY]),
        (ball, transform((1.2, 0, 0), rotation("y", 0.5) @ np.diag([1.0, 0.8, 0.5])), [ROUGH_GLASS]),
        (opening, transform((0, -0.2, 1.0), rotation("x", 2.0)), [screen]),
    ]
    sun = Light("sun", LightKind.SUN, (3.0, 2.5, 2.0), look_at((3.0, -0.6, 0.7), (0, 0, 0)), (0.05, 0.0))
    point = lamp(LightKind.POINT, eye=(-0.6, -0.3, 0.5), size=(0.0, 0.0))
    return with_terminator_offset(build(objects, camera((0.3, -4.0, 1.5), (0, 0, 0.2)), [sun, point]), 0.4)


def limited_scene() -> Scene:
    """All that LightPaths can cut short, at once."""
    paths = LightPaths(1, 2, 3, 8, False, False, clamp_direct=0.7, clamp_indirect=0.2, filter_glossy=0.5)
    return dataclasses.replace(box_scene(), defaults=RenderDefaults(light_paths=paths, transparent_film=True))


def orthographic(scene: Scene, scale: float = 3.0) -> Scene:
    def change(view: Camera) -> Camera:
        window = tuple(scale * side for side in view.window)
        return dataclasses.replace(view, window=window, projection=Projection.ORTHOGRAPHIC)

    return dataclasses.replace(scene, camera=change(scene.camera), previous_camera=change(scene.previous_camera))


def out_of_focus(scene: Scene, **aperture) -> Scene:
    lens = Aperture(**{"radius": 0.1, "focus_distance": 3.0, **aperture})
    return dataclasses.replace(
        scene,
        camera=dataclasses.replace(scene.camera, aperture=lens),
        previous_camera=dataclasses.replace(scene.previous_camera, aperture=lens),
    )


def closed_box(material: Material) -> Scene:
    """The camera inside of a cube of one material."""
    view = camera((0.1, 0.2, -0.1), (1.0, 0.3, 0.2))
    return build([(cube(2.0, inwards=True), transform(), [material] * 6)], view)


def chains_scene() -> Scene:
    """Moving mirrors, a moving camera and glass: a mirror for a floor, a chrome and a glass ball, a glowing pane, a
    lamp and a sky."""
    glow = Material("glow", base_color=(0.5, 0.4, 0.3), emission=(2.0, 1.0, 0.5), specular_ior_level=0.0)
    objects = [
        (quad(4.0), transform((0, 0, 0), rotation("x", 0.04)), [MIRROR], transform((0, 0, -0.03))),
        (sphere(0.4, rows=16), transform((0.6, 0.2, 0.5)), [MIRROR], transform((0.5, 0.2, 0.5), rotation("z", 0.1))),
        (sphere(0.4, rows=16), transform((-0.5, -0.1, 0.45)), [GLASS]),
        (quad(0.8), transform((0, 1.0, 0.7), rotation("x", 1.2)), [glow], transform((0.1, 1.0, 0.7), rotation("x", 1))),
        (sphere(0.25, rows=8), transform((0.1, 0.0, 0.3)), [GLOSSY]),
    ]
    return build(
        objects,
        camera((0.4, -3.0, 1.6), (0, 0, 0.4)),
        [lamp(LightKind.POINT)],
        previous_view=camera((0.3, -3.1, 1.5), (0.05, 0, 0.4)),
        world=World((0.1, 0.1, 0.2)),
    )


def device_scenes() -> dict[str, Scene]:
    """What every device must trace alike."""
    scenes = {
        "box": box_scene(),
        "textured": textured_scene(),
        "moving": moving_scene(),
        "deforming": deforming_scene(),
        "mesh_light": mesh_light_scene(),
        "environment": environment_scene(),
        "many_lights": many_lights_scene(),
        "textured_light": textured_light_scene(),
        "cutouts": cutout_scene(),
        "visibility": visibility_scene(),
        "limited": limited_scene(),
        "shadow_terminator": terminator_scene(),
        "chains": chains_scene(),
        "orthographic": orthographic(moving_scene()),
        "out_of_focus": out_of_focus(moving_scene()),
        "polygon_aperture": out_of_focus(textured_scene(), blades=5, rotation=0.3, ratio=2.0),
        "spread": lamp_scene(dataclasses.replace(lamp(LightKind.RECTANGLE, eye=(0.6, -0.5, 1.0)), spread=1.0)),
        "empty": build([], camera((0, -1, 0), (0, 0, 0)), world=World((0.2, 0.3, 0.4))),
    }
    for kind in LightKind:
        scenes[f"{kind.name.lower()}_lamp"] = lamp_scene(lamp(kind))
    for kind in (LightKind.POINT, LightKind.SPOT):
        scenes[f"soft_{kind.name.lower()}"] = lamp_scene(dataclasses.replace(lamp(kind), soft_falloff=True))
    for kind in (LightKind.POINT, LightKind.SPOT, LightKind.SUN):
        scenes[f"delta_{kind.name.lower()}"] = lamp_scene(lamp(kind, size=(0.0, 0.0)))
    return scenes
