# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees that depend on UVs alone, as textures. Those of equal content are made once for all exporters.

A tree whose images all lie on the surface in one way is evaluated at their texels and stays exact there. Any other is
evaluated over the part of the UV plane that the meshes use.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from svgf.scene import Extension, Interpolation, Texture

from .evaluation import arithmetic
from .evaluation.color import linear_to_srgb
from .evaluation.expression import Expression, evaluate, walk
from .evaluation.images import Image, sample_alpha, sample_color
from .node_values import UV

# Texels along a side. Noise and the like are read by pixels of the render, not by texels: 1024 of them a UV square.
_PROCEDURAL_SIDE = 1024
_LARGEST_SIDE = 4096
# Of all textures that are kept although no scene may use them any more.
_CACHE_BYTES = 512 << 20

Affine = tuple[float, ...]
IDENTITY: Affine = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True)
class Domain:
    """Where a texture lies: read at (a u + b v + c, d u + e v + f) of a UV map.

    size: (width, height) in texels.
    """

    uv_map: str
    transform: Affine
    size: tuple[int, int]
    extension: Extension = Extension.REPEAT
    interpolation: Interpolation = Interpolation.LINEAR

    def points(self, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """float32 [n, 3] UVs of the texels' centres, the bottom row first. shift: in texels."""
        width, height = self.size
        x = (np.arange(width) + 0.5 + shift[0]) / width
        y = (np.arange(height) + 0.5 + shift[1]) / height
        matrix = np.reshape(self.transform, (2, 3))
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2) - matrix[:, 2]
        uv = grid @ np.linalg.inv(matrix[:, :2]).T
        return np.concatenate([uv, np.zeros((len(uv), 1))], 1).astype(np.float32)

    def is_limited(self, bounds: np.ndarray) -> bool:
        """Whether it is as large as can be without reaching its full resolution over these UVs."""
        return self.extension is Extension.EXTEND and max(self.size) == _LARGEST_SIDE and bool(np.ptp(bounds) > 1)

    def gradient_scale(self) -> np.ndarray:
        """float64 [2, 2]: derivatives by texels, times this, are derivatives by UVs."""
        return np.diag(self.size) @ np.reshape(self.transform, (2, 3))[:, :2]


@dataclass(frozen=True)
class NormalMap:
    """color: of the node; a vector. strength: a number."""

    color: Expression
    strength: Expression


@dataclass(frozen=True)
class Bump:
    """height, strength, distance: numbers. sign: -1 where the node is inverted. below: the normal that it bends."""

    height: Expression
    strength: Expression
    distance: Expression
    sign: float
    below: Normal | None


Normal = NormalMap | Bump


def parts_of(normal: Normal) -> Iterator[Expression]:
    """All that a normal is made of."""
    if isinstance(normal, NormalMap):
        yield from (normal.color, normal.strength)
        return
    yield from (normal.height, normal.strength, normal.distance)
    if normal.below is not None:
        yield from parts_of(normal.below)


def uv_maps_of(expressions: list[Expression]) -> list[str]:
    """Names of the UV maps that they depend on."""
    return sorted({name.removeprefix(UV) for expression in expressions for name in expression.coordinates})


def affine_of(expression: Expression) -> tuple[str, Affine] | None:
    """The UV map and the transform of coordinates that are an affine function of it, else None."""
    if len(expression.coordinates) != 1 or not all(map(_is_affine, walk(expression))):
        return None
    (name,) = expression.coordinates
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    origin, along_u, along_v = evaluate(expression, {name: corners})[:, :2].astype(np.float64)
    rows = np.stack([along_u - origin, along_v - origin, origin], 1)
    return name.removeprefix(UV), tuple(float(part) for part in rows.ravel())


def _is_affine(member: Expression) -> bool:
    if member.value is not None or member.function is None:
        return True
    varying = [index for index, part in enumerate(member.inputs) if part.value is None]
    if member.function is arithmetic.mapping:
        return varying == [0] and member.settings["kind"] != "NORMAL"
    if member.function is not arithmetic.vector_math:
        return False
    operation = member.settings["operation"]
    if operation in {"ADD", "SUBTRACT"}:
        return set(varying) <= {0, 1}
    return operation in {"SCALE", "MULTIPLY", "MULTIPLY_ADD", "DIVIDE"} and varying == [0]


def domain_of(expressions: list[Expression], bounds: np.ndarray, uv_map: str) -> Domain:
    """Where expressions of one UV map are evaluated.

    bounds: float [2, 2], the smallest and largest UVs in use.
    """
    members = [member for expression in expressions for member in walk(expression)]
    readers = [member for member in members if member.function in (sample_color, sample_alpha)]
    images = {member.settings["image"] for member in readers}
    places = {affine_of(member.inputs[0]) for member in readers}
    only_images = None not in places and _read_only_by(expressions, readers)
    extensions = {image.extension for image in images}
    if only_images and len(places) == 1 and len(extensions) == 1 and "CLIP" not in extensions:
        ((_, transform),) = places
        if abs(np.linalg.det(np.reshape(transform, (2, 3))[:, :2])) > 1e-12:
            return _image_domain(uv_map, transform, images)
    side = max(_finest(readers, places), 1 if only_images else _PROCEDURAL_SIDE)
    if only_images and extensions == {"REPEAT"} and all(_is_whole(place[1]) for place in places):
        side = min(side, _LARGEST_SIDE)
        return Domain(uv_map, IDENTITY, (side, side))
    return _square(uv_map, bounds, side)


def _image_domain(uv_map: str, transform: Affine, images: set[Image]) -> Domain:
    """The texels of images that all lie in the same place."""
    heights, widths = zip(*(image.pixels.shape[:2] for image in images), strict=True)
    is_sharp = {image.interpolation for image in images} == {"Closest"} and len(set(zip(heights, widths))) == 1
    (extension,) = {image.extension for image in images}
    return Domain(
        uv_map,
        transform,
        (min(max(widths), _LARGEST_SIDE), min(max(heights), _LARGEST_SIDE)),
        Extension[extension],
        Interpolation.CLOSEST if is_sharp else Interpolation.LINEAR,
    )


def _is_whole(transform: Affine) -> bool:
    """Whether a period of the image is one of the UVs, too."""
    linear = np.reshape(transform, (2, 3))[:, :2]
    return bool((np.abs(linear - np.rint(linear)) < 1e-6).all())


def _read_only_by(expressions: list[Expression], readers: list[Expression]) -> bool:
    """Whether all that depends on UVs does so through these image lookups."""
    waiting, seen = list(expressions), set()
    while waiting:
        member = waiting.pop()
        if id(member) in seen or member.value is not None or member in readers:
            continue
        if member.function is None:
            return False
        seen.add(id(member))
        waiting.extend(member.inputs)
    return True


def _finest(readers: list[Expression], places: set) -> int:
    """Texels of the finest image along a unit of UVs."""
    sides = [max(member.settings["image"].pixels.shape) for member in readers]
    scales = [np.abs(np.reshape(place[1], (2, 3))[:, :2]).max() for place in places if place is not None]
    return int(max(sides, default=0) * max(scales, default=1.0))


def _square(uv_map: str, bounds: np.ndarray, side: int) -> Domain:
    """The unit squares around the bounds, a texture of its own for each map that leaves the first of them."""
    low, high = np.floor(bounds[0] + 1e-6), np.ceil(bounds[1] - 1e-6)
    span = np.maximum(high - low, 1)
    width, height = (int(min(side * count, _LARGEST_SIDE)) for count in span)
    transform = (1 / span[0], 0.0, -low[0] / span[0], 0.0, 1 / span[1], -low[1] / span[1])
    # A texel beyond the border belongs to the neighbouring square, which may look quite different.
    return Domain(uv_map, tuple(map(float, transform)), (width, height), Extension.EXTEND)


class _BakeCache:
    """Textures by content, the one dropped first that was not asked for the longest. bakes: made so far."""

    def __init__(self) -> None:
        self.bakes = 0
        self._textures: OrderedDict[bytes, Texture] = OrderedDict()

    def get(self, key: bytes, make: Callable[[], Texture]) -> Texture:
        texture = self._textures.get(key)
        if texture is None:
            self.bakes += 1
            texture = self._textures[key] = make()
            while len(self._textures) > 1 and self._bytes() > _CACHE_BYTES:
                self._textures.popitem(last=False)
        self._textures.move_to_end(key)
        return texture

    def _bytes(self) -> int:
        return sum(texture.pixels.nbytes for texture in self._textures.values())


cache = _BakeCache()


def bake(name: str, expression: Expression, domain: Domain, is_color: bool) -> Texture:
    """The texture of a colour or a number. In bytes where all values are in [0, 1]."""

    def make() -> Texture:
        values = evaluate(expression, {UV + domain.uv_map: domain.points()})
        return _texture(name, values, domain, is_color)

    return cache.get(_key(expression.digest, domain, is_color), make)


def bake_normal(name: str, normal: Normal, domain: Domain, metres: tuple[float, float]) -> Texture:
    """The tangent-space normal map. metres: along a unit of U and of V."""

    def make() -> Texture:
        values = _normals(normal, domain, metres) * np.float32(0.5) + np.float32(0.5)
        return _float_texture(name, values, domain)

    digests = b"".join(part.digest for part in parts_of(normal))
    signs = repr((_signs(normal), metres))
    return cache.get(_key(digests + signs.encode(), domain, "normal"), make)


def _signs(normal: Normal | None) -> list:
    if normal is None:
        return []
    return ["map"] if isinstance(normal, NormalMap) else [normal.sign, *_signs(normal.below)]


def _key(digest: bytes, domain: Domain, kind: object) -> bytes:
    return hashlib.sha1(digest + repr((domain, kind)).encode(), usedforsecurity=False).digest()


def _texture(name: str, values: np.ndarray, domain: Domain, is_color: bool) -> Texture:
    if values.min() < 0 or values.max() > 1:
        return _float_texture(name, values, domain)
    encoded = linear_to_srgb(values) if is_color else values
    pixels = _rgba(np.rint(encoded * np.float32(255)).astype(np.uint8), domain, 255)
    return Texture(name, pixels, is_color, domain.interpolation, domain.extension)


def _float_texture(name: str, values: np.ndarray, domain: Domain) -> Texture:
    return Texture(name, _rgba(values, domain, 1), False, domain.interpolation, domain.extension)


def _rgba(values: np.ndarray, domain: Domain, opaque: float) -> np.ndarray:
    width, height = domain.size
    pixels = np.full((height, width, 4), opaque, values.dtype)
    pixels[..., :3] = values.reshape(height, width, -1)
    return pixels


def _normals(normal: Normal | None, domain: Domain, metres: tuple[float, float]) -> np.ndarray:
    """float32 [n, 3] unit normals in tangent space."""
    upright = np.float32([[0, 0, 1]])
    if normal is None:
        return upright
    points = {UV + domain.uv_map: domain.points()}
    if isinstance(normal, NormalMap):
        strength = np.maximum(evaluate(normal.strength, points), 0)[:, None]
        tilted = arithmetic.normalize(evaluate(normal.color, points) * 2 - 1)
        return arithmetic.normalize(upright + (tilted - upright) * strength)
    below = _normals(normal.below, domain, metres)
    gradient = _gradient(normal.height, domain) / np.array(metres)
    distance = evaluate(normal.distance, points)[:, None] * np.float32(normal.sign)
    slope = np.concatenate([gradient, np.zeros((len(gradient), 1))], 1).astype(np.float32)
    strength = np.maximum(evaluate(normal.strength, points), 0)[:, None]
    bent = arithmetic.normalize(below - distance * slope)
    return arithmetic.normalize(strength * bent + (1 - strength) * below)


def _gradient(height: Expression, domain: Domain) -> np.ndarray:
    """[n, 2] derivatives of a height by U and V, over one texel."""
    name = UV + domain.uv_map

    def at(x: float, y: float) -> np.ndarray:
        return evaluate(height, {name: domain.points((x, y))}).astype(np.float64)

    by_texel = np.stack([at(0.5, 0) - at(-0.5, 0), at(0, 0.5) - at(0, -0.5)], 1)
    return by_texel @ domain.gradient_scale()
