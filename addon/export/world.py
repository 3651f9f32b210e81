# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: a colour, or an image of what its node tree shows in each direction; and another where the camera sees
something else than what lights the scene."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
from svgf.scene import Extension, Texture, World

from .evaluation import images
from .evaluation.expression import Expression, apply, constant, coordinate, evaluate, walk
from .findings import Findings
from .node_values import CAMERA_RAY, DIRECTION, ValueReader
from .nodes import Place, describe, find_input, has_nodes, trace
from .sky import sky_image
from .textures import TextureCache
from .unsupported import find_in_world
from .visibility import ray_visibility

# Width of the image of a tree without images, and of the largest; twice the height.
_PLAIN_WIDTH, _LARGEST_WIDTH = 1024, 4096
# Images are kept for as many worlds as a user may go back and forth between.
_KEPT = 4

_baked: OrderedDict[tuple[bytes, int, bytes], Texture] = OrderedDict()


def export_world(
    world: bpy.types.World | None,
    textures: TextureCache,
    findings: Findings,
    should_stop: Callable[[], bool] | None,
) -> tuple[World, tuple[Texture, ...]]:
    """The world and the images that it has the indices of. No world, or one without a surface, is black.

    should_stop: see ``sky_image``.
    """
    if world is None:
        return World(), ()
    find_in_world(world, findings)
    visibility = World.visibility
    if hasattr(world, "cycles_visibility"):
        visibility = ray_visibility(world.cycles_visibility, "")
    if not has_nodes(world):
        return World(_color(world.color), visibility=visibility), ()
    output = world.node_tree.get_output_node("CYCLES")
    if output and trace(Place(output.inputs["Volume"])).is_output:
        findings.add(world, "volumes are not supported yet; the air is clear.")
    start = output and find_input(output, "Surface")
    surface = start and trace(start)
    if surface is None or not surface.is_output:
        return World(), ()
    reader = ValueReader(
        textures,
        lambda text: findings.add(world, text),
        lambda image, text: findings.add(image, text),
        is_world=True,
        sky=partial(sky_image, should_stop=should_stop),
    )
    radiance = _radiance(surface, reader, world, findings)
    lighting = _for_rays(radiance, of_camera=False)
    backdrop = _for_rays(radiance, of_camera=True)
    rotation, _ = _without_rotation(backdrop if lighting.value is not None else lighting)
    color, image = _picture(world.name, lighting, rotation)
    pictures = [] if image is None else [image]
    found = World(color, len(pictures) - 1, tuple(rotation.ravel().tolist()), visibility)
    if backdrop is not lighting:
        color, image = _picture(f"{world.name} backdrop", backdrop, rotation)
        found = replace(found, backdrop_radiance=color, backdrop_environment=-1 if image is None else len(pictures))
        pictures += [] if image is None else [image]
    return found, tuple(pictures)


def _for_rays(radiance: Expression, of_camera: bool) -> Expression:
    if CAMERA_RAY not in radiance.coordinates:
        return radiance
    answer = constant((float(of_camera),) * 3)
    return _replaced(radiance, lambda member: member.settings.get("name") == CAMERA_RAY, answer)


def _picture(
    name: str, radiance: Expression, rotation: np.ndarray
) -> tuple[tuple[float, float, float], Texture | None]:
    """Colour and image of a world whose images are read at directions that are turned before."""
    if radiance.value is not None:
        return _color(radiance.vector()), None
    own, turned = _without_rotation(radiance)
    if np.allclose(own, rotation, atol=1e-6):
        return (1.0, 1.0, 1.0), _bake(name, turned, np.eye(3))
    return (1.0, 1.0, 1.0), _bake(name, radiance, rotation)


def _color(color) -> tuple[float, float, float]:
    return tuple(np.maximum(np.array(color, np.float64)[:3], 0).tolist())


def _radiance(shader: Place, reader: ValueReader, world: bpy.types.World, findings: Findings) -> Expression:
    """[n, 3] of what arrives at a shader's output."""
    node = shader.node

    def part(place: Place) -> Expression:
        found = trace(place)
        return _radiance(found, reader, world, findings) if found.is_output else constant((0.0,) * 3)

    if node.type in {"BACKGROUND", "EMISSION"}:
        return apply(_scaled, reader.read(shader.input("Color")), reader.read(shader.input("Strength")))
    if node.type == "ADD_SHADER":
        return apply(_sum, part(shader.input(0)), part(shader.input(1)))
    if node.type == "MIX_SHADER":
        return _mixed(reader.read(shader.input(0)), part(shader.input(1)), part(shader.input(2)))
    findings.add(world, f"{describe(node)} is not supported yet; it is black instead.")
    return constant((0.0,) * 3)


def _scaled(color: np.ndarray, strength: np.ndarray) -> np.ndarray:
    return color * strength[:, None]


def _sum(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first + second


def _mixed(factor: Expression, first: Expression, second: Expression) -> Expression:
    """Without what has no share in it."""
    if factor.value is not None and factor.number() in (0.0, 1.0):
        return second if factor.number() else first
    return apply(_mix, factor, first, second)


def _mix(factor: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    share = np.clip(factor, 0, 1)[:, None]
    return first * (1 - share) + second * share


def _without_rotation(radiance: Expression) -> tuple[np.ndarray, Expression]:
    """[3, 3] and the radiance by directions that this matrix has turned: an image then keeps its texels, and turning it
    makes no new one."""
    identity = np.eye(3)
    places = [member.inputs[0] for member in walk(radiance) if member.function is images.equirectangular]
    users = {id(place) for place in places}
    if len(users) != 1 or places[0].function is None:
        return identity, radiance
    turned = places[0]
    # Nothing else may depend on the direction.
    replaced = _replaced(radiance, lambda member: member is turned, coordinate(_TURNED))
    if DIRECTION in replaced.coordinates:
        return identity, radiance
    points = np.random.default_rng(0).normal(size=(8, 3)).astype(np.float32)
    points[:3] = identity
    images_of_points = evaluate(turned, {DIRECTION: points}).astype(np.float64)
    matrix = images_of_points[:3].T
    scale = np.cbrt(max(np.linalg.det(matrix), 0))
    is_rotation = scale > 0 and np.allclose(matrix @ matrix.T, identity * scale**2, atol=1e-4 * scale**2)
    if not is_rotation or not np.allclose(images_of_points, points @ matrix.T, atol=1e-4 * scale):
        return identity, radiance
    return matrix / scale, _replaced(radiance, lambda member: member is turned, coordinate(DIRECTION))


_TURNED = "turned direction"


def _replaced(
    member: Expression,
    is_old: Callable[[Expression], bool],
    new: Expression,
    known: dict[int, Expression] | None = None,
) -> Expression:
    """The same graph with another member in place of some."""
    known = {} if known is None else known
    if is_old(member):
        return new
    if member.value is not None or not member.inputs:
        return member
    if id(member) not in known:
        inputs = (_replaced(part, is_old, new, known) for part in member.inputs)
        build = _mixed if member.function is _mix else partial(apply, member.function)
        known[id(member)] = build(*inputs, **member.settings)
    return known[id(member)]


def _bake(name: str, radiance: Expression, rotation: np.ndarray) -> Texture:
    """An equirectangular image, float32, of the size of the images that it is made from. rotation: [3, 3], of
    directions before they are looked up in it."""
    widths = [
        member.settings["image"].pixels.shape[1] for member in walk(radiance) if "image" in member.settings
    ]
    width = min(max(widths, default=_PLAIN_WIDTH), _LARGEST_WIDTH)
    width += width % 2
    key = radiance.digest, width, rotation.tobytes()
    if key in _baked:
        _baked.move_to_end(key)
        return _baked[key]
    height = width // 2
    elevation = ((np.arange(height) + 0.5) / height - 0.5) * np.pi
    azimuth = (0.5 - (np.arange(width) + 0.5) / width) * 2 * np.pi
    cosine = np.cos(elevation)[:, None]
    direction = np.stack(
        [cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.repeat(np.sin(elevation)[:, None], width, axis=1)], -1
    )
    direction = direction.reshape(-1, 3) @ rotation  # back into the world
    color = evaluate(radiance, {DIRECTION: direction.astype(np.float32)})
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = np.maximum(color, 0).reshape(height, width, 3)
    _baked[key] = Texture(name, pixels, srgb=False, extension=Extension.REPEAT)
    while len(_baked) > _KEPT:
        _baked.popitem(last=False)
    return _baked[key]
