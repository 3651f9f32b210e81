# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's images, as the evaluation of nodes reads them and as textures of a scene."""

from __future__ import annotations

from collections.abc import Callable, Set
from weakref import WeakKeyDictionary

import bpy
import numpy as np
from svgf.scene import Extension, Interpolation, Texture

from .evaluation.color import srgb_to_linear
from .evaluation.images import Image

_INTERPOLATIONS = {
    "Closest": Interpolation.CLOSEST,
    "Linear": Interpolation.LINEAR,
    "Cubic": Interpolation.CUBIC,
    "Smart": Interpolation.CUBIC,
}
# As measured: Cycles no longer multiplies bytes of premultiplied images, which Blender has divided when it read them.
_KEEPS_PREMULTIPLIED_BYTES = bpy.app.version >= (5, 2, 0)
# Larger images are reduced: beyond it a texture would be gigabytes.
LARGEST_SIDE = 16384

_FROM_REC2020 = ((1.660491, -0.587641, -0.072850), (-0.124550, 1.132900, -0.008349), (-0.018151, -0.100579, 1.118730))
_FROM_P3 = ((1.224940, -0.224940, 0.0), (-0.042057, 1.042057, 0.0), (-0.019638, -0.078636, 1.098274))
_FROM_ACESCG = ((1.705051, -0.621792, -0.083259), (-0.130257, 1.140804, -0.010548), (-0.024004, -0.128969, 1.152972))
_FROM_ACES = ((2.521686, -1.134131, -0.387555), (-0.276480, 1.372719, -0.096239), (-0.015378, -0.152975, 1.168353))
_FROM_XYZ = ((3.240970, -1.537383, -0.498611), (-0.969244, 1.875968, 0.041555), (0.055630, -0.203977, 1.056972))


def _linear(color: np.ndarray) -> np.ndarray:
    return color


def _rec1886(color: np.ndarray) -> np.ndarray:
    return np.maximum(color, 0) ** np.float32(2.4)


# How bytes become linear Rec.709, where that is not sRGB's way: a curve, then a matrix.
_COLOR_SPACES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], tuple | None]] = {
    "Rec.1886": (_rec1886, None),
    "Rec.2020": (_rec1886, _FROM_REC2020),
    "Display P3": (srgb_to_linear, _FROM_P3),
    "Linear Rec.2020": (_linear, _FROM_REC2020),
    "Linear DCI-P3 D65": (_linear, _FROM_P3),
    "Linear CIE-XYZ D65": (_linear, _FROM_XYZ),
    "ACEScg": (_linear, _FROM_ACESCG),
    "ACES2065-1": (_linear, _FROM_ACES),
}

Find = Callable[[str], None]
FindImage = Callable[[bpy.types.Image, str], None]


def read_pixels(image: bpy.types.Image) -> np.ndarray | None:
    """[H, W, 4], row 0 at the bottom: uint8 as stored, or float32 scene linear. None where the image has no data."""
    width, height = image.size
    count = len(image.pixels) if width and height else 0
    if not count:
        return None
    flat = np.empty(count, np.float32)
    image.pixels.foreach_get(flat)
    channels = count // (width * height)
    if not image.is_float:
        flat *= 255.0
        flat = np.rint(flat, out=flat).astype(np.uint8)
    pixels = flat.reshape(height, width, channels)
    if channels == 4:
        return pixels
    opaque = np.full((height, width, 4), 1.0 if image.is_float else 255, pixels.dtype)
    opaque[..., :3] = pixels[..., : min(channels, 3)]
    return opaque


class TextureCache:
    """Images by how they are read. The same object is returned as long as the image stays the same.

    Pixels are read once, until forgotten: a render job sees the images as they were at its start.
    """

    def __init__(self) -> None:
        self._images: dict[tuple, Image | None] = {}
        self._textures: WeakKeyDictionary[Image, Texture] = WeakKeyDictionary()

    def forget(self, names: Set[str]) -> None:
        """Images by full name, which are read again."""
        for key in [key for key in self._images if key[0] in names]:
            del self._images[key]

    def image(self, node: bpy.types.Node, find: Find, find_image: FindImage) -> Image | None:
        """What an Image or Environment Texture node reads; None where its image is missing."""
        source = node.image
        if source is None:
            return None
        _find_unsupported(node, find, find_image)
        # Cycles gives the colour times alpha, unless the node's Alpha is in use or alpha means something else.
        has_alpha = source.alpha_mode in {"STRAIGHT", "PREMUL"} and not source.colorspace_settings.is_data
        alpha = node.outputs.get("Alpha")
        divides = has_alpha and alpha is not None and alpha.is_linked
        extension = getattr(node, "extension", "REPEAT")
        key = (*_identity(source), has_alpha, divides, node.interpolation, extension)
        if key not in self._images:
            self._images[key] = _read(source, has_alpha, divides, node.interpolation, extension)
        image = self._images[key]
        if image is None:
            find_image(source, "the image cannot be read; magenta is used instead, as Blender does.")
        else:
            _find_limits(source, find_image)
        return image

    def texture(self, image: Image) -> Texture:
        """The texture that holds an image."""
        texture = self._textures.get(image)
        if texture is None:
            texture = Texture(
                image.name,
                image.pixels,
                image.srgb,
                _INTERPOLATIONS[image.interpolation],
                Extension[image.extension],
                image.associated_alpha,
            )
            self._textures[image] = texture
        return texture


def _read(
    source: bpy.types.Image, has_alpha: bool, divides: bool, interpolation: str, extension: str
) -> Image | None:
    pixels = read_pixels(source)
    if pixels is None:
        return None
    factor = _reduction(source)
    if factor > 1:
        pixels = _reduced(pixels, factor)
    if pixels.dtype != np.uint8:
        np.nan_to_num(pixels, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    elif has_alpha and not (source.alpha_mode == "PREMUL" and _KEEPS_PREMULTIPLIED_BYTES):
        _multiply_alpha(pixels)
    if source.alpha_mode == "NONE":
        pixels[..., 3] = 255 if pixels.dtype == np.uint8 else 1
    conversion = None if source.is_float else _COLOR_SPACES.get(source.colorspace_settings.name)
    if conversion is not None:
        pixels = _converted(pixels, *conversion)
    srgb = pixels.dtype == np.uint8 and not _is_data(source)
    return Image(source.name, pixels, srgb, interpolation, extension, divides)


def _identity(image: bpy.types.Image) -> tuple:
    return (
        image.name_full,
        image.filepath,
        tuple(image.size),
        image.is_float,
        image.colorspace_settings.name,
        image.alpha_mode,
    )


def _multiply_alpha(pixels: np.ndarray) -> None:
    """Bytes by their alpha, in the image's encoding as Cycles does it. Blender keeps bytes without it, floats with."""
    alpha = pixels[..., 3:]
    if alpha.min() < 255:
        pixels[..., :3] = pixels[..., :3] * alpha.astype(np.uint16) // 255


def _reduction(image: bpy.types.Image) -> int:
    """By how much an image is too large."""
    return -(-max(image.size) // LARGEST_SIDE)


def _reduced(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Means of blocks, and single texels along a side that is shorter than a block."""
    height, width = (max(side // factor, 1) for side in pixels.shape[:2])
    tall, wide = min(factor, pixels.shape[0]), min(factor, pixels.shape[1])
    blocks = pixels[: height * tall, : width * wide].reshape(height, tall, width, wide, 4)
    means = blocks.mean(axis=(1, 3), dtype=np.float32)
    return np.rint(means).astype(np.uint8) if pixels.dtype == np.uint8 else means


def _converted(pixels: np.ndarray, curve: Callable[[np.ndarray], np.ndarray], matrix: tuple | None) -> np.ndarray:
    pixels = pixels.astype(np.float32) / np.float32(255)
    color = curve(pixels[..., :3])
    pixels[..., :3] = color if matrix is None else color @ np.array(matrix, np.float32).T
    return pixels


def _is_data(image: bpy.types.Image) -> bool:
    """Whether the stored numbers are linear Rec.709, or no colours at all."""
    settings = image.colorspace_settings
    return settings.is_data or settings.name in {"Linear Rec.709", "Non-Color", "Raw", "Working Space"}


def _find_limits(image: bpy.types.Image, find_image: FindImage) -> None:
    name = image.colorspace_settings.name
    if not image.is_float and not _is_data(image) and name != "sRGB" and name not in _COLOR_SPACES:
        find_image(image, f'colour space "{name}" is not supported yet; the image is read as sRGB.')
    if _reduction(image) > 1:
        width, height = image.size
        find_image(
            image, f"{width} x {height} pixels are more than {LARGEST_SIDE} on a side; the image is reduced to fit."
        )


def _find_unsupported(node: bpy.types.Node, find: Find, find_image: FindImage) -> None:
    image = node.image
    if image.source in {"SEQUENCE", "MOVIE"}:
        find_image(image, "image sequences and movies are not supported yet; one picture is used for all frames.")
    elif image.source == "TILED":
        find_image(image, "UDIM tiles are not supported yet; the first one is used everywhere.")
    if node.type == "TEX_IMAGE" and node.projection != "FLAT":
        find(f"{node.projection.lower()} projection of images is not supported yet; UVs are used.")
