# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as textures."""

from __future__ import annotations

from collections.abc import Set

import bpy
import numpy as np
from svgf.scene import Extension, Interpolation, Texture

from .findings import Findings
from .nodes import describe, source

_EXTENSIONS = {
    "REPEAT": Extension.REPEAT,
    "EXTEND": Extension.EXTEND,
    "CLIP": Extension.CLIP,
    "MIRROR": Extension.MIRROR,
}


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
    """Textures by image and how it is read. The same Texture object is returned as long as the image stays the same.

    Pixels are read once, until forgotten: a render job sees the images as they were at its start.
    """

    def __init__(self) -> None:
        self._textures: dict[tuple, Texture | None] = {}
        self._means: dict[tuple, np.ndarray | None] = {}

    def forget(self, names: Set[str]) -> None:
        """Images by full name, which are read again."""
        for cache in (self._textures, self._means):
            for key in [key for key in cache if key[0] in names]:
                del cache[key]

    def mean_radiance(self, image: bpy.types.Image) -> np.ndarray | None:
        """[3] mean over all directions of an equirectangular image; None where it is missing."""
        key = _identity(image)
        if key not in self._means:
            self._means[key] = _mean_radiance(image)
        return self._means[key]

    def get(self, node: bpy.types.Node, material: bpy.types.Material, findings: Findings) -> Texture | None:
        """The texture of an Image Texture node; None where its image is missing."""
        image = node.image
        if image is None:
            return None
        _find_unsupported(node, material, findings)
        # Cycles gives the colour times alpha, unless the node's Alpha is in use or alpha means something else.
        has_alpha = image.alpha_mode in {"STRAIGHT", "PREMUL"} and not image.colorspace_settings.is_data
        times_alpha = has_alpha and not node.outputs["Alpha"].is_linked
        interpolation = Interpolation.CLOSEST if node.interpolation == "Closest" else Interpolation.LINEAR
        key = (*_identity(image), has_alpha, times_alpha, interpolation, node.extension)
        if key not in self._textures:
            self._textures[key] = None
            pixels = read_pixels(image)
            if pixels is not None:
                pixels = _with_alpha(pixels, has_alpha, times_alpha)
                srgb = pixels.dtype == np.uint8 and not _is_data(image)
                self._textures[key] = Texture(image.name, pixels, srgb, interpolation, _EXTENSIONS[node.extension])
        if self._textures[key] is None:
            findings.add(image, "the image cannot be read; magenta is used instead, as Blender does.")
        elif not _is_data(image) and not image.is_float and image.colorspace_settings.name != "sRGB":
            name = image.colorspace_settings.name
            findings.add(image, f'colour space "{name}" is not supported yet; the image is read as sRGB.')
        return self._textures[key]


def _identity(image: bpy.types.Image) -> tuple:
    return image.name_full, image.filepath, tuple(image.size), image.is_float, image.colorspace_settings.name


def _mean_radiance(image: bpy.types.Image) -> np.ndarray | None:
    pixels = read_pixels(image)
    if pixels is None:
        return None
    weights = np.sin((np.arange(pixels.shape[0]) + 0.5) * np.pi / pixels.shape[0])
    color = pixels[..., :3]
    if color.dtype == np.uint8:
        color = color.astype(np.float32) / 255
        if not _is_data(image):
            color = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    rows = np.nan_to_num(color, posinf=0, neginf=0).mean(axis=1, dtype=np.float64)
    return np.average(rows, axis=0, weights=weights)


def _with_alpha(pixels: np.ndarray, has_alpha: bool, times_alpha: bool) -> np.ndarray:
    """Colour times alpha, or without it. Blender keeps bytes straight and floats multiplied."""
    if pixels.dtype == np.uint8:
        alpha = pixels[..., 3:]
        if times_alpha and alpha.min() < 255:
            # In the image's encoding, as Cycles does it.
            pixels[..., :3] = (pixels[..., :3] * alpha.astype(np.uint16) + 127) // 255
        return pixels
    np.nan_to_num(pixels, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    if has_alpha and not times_alpha:
        alpha = pixels[..., 3:]
        pixels[..., :3] /= np.where(alpha > 0, alpha, np.float32(1))
    return pixels


def _is_data(image: bpy.types.Image) -> bool:
    """Whether the stored numbers are linear as they are."""
    settings = image.colorspace_settings
    return settings.is_data or settings.name in {"Linear Rec.709", "Non-Color", "Raw"}


def _find_unsupported(node: bpy.types.Node, material: bpy.types.Material, findings: Findings) -> None:
    image = node.image
    if image.source in {"SEQUENCE", "MOVIE"}:
        findings.add(image, "image sequences and movies are not supported yet; one picture is used for all frames.")
    elif image.source == "TILED":
        findings.add(image, "UDIM tiles are not supported yet; the first one is used everywhere.")
    if node.projection != "FLAT":
        findings.add(material, f"{node.projection.lower()} projection of images is not supported yet; UVs are used.")
    if node.interpolation not in {"Linear", "Closest"}:
        findings.add(material, f"{node.interpolation.lower()} image interpolation is not supported yet; it is linear.")
    mapping = node.texture_mapping
    if any(mapping.translation) or any(mapping.rotation) or any(scale != 1 for scale in mapping.scale):
        findings.add(material, f"the texture mapping of {describe(node)} is not supported yet; it is left out.")
    driver = source(node.inputs["Vector"])
    if driver is None or (
        driver.node.type == "TEX_COORD" and driver.identifier == "UV" and not driver.node.from_instancer
    ):
        return
    if driver.node.type == "UVMAP":
        if driver.node.uv_map:
            findings.add(
                material, f'UV map "{driver.node.uv_map}" by name is not supported yet; the active one is used.'
            )
        return
    findings.add(material, f"{describe(driver.node)} for texture coordinates is not supported yet; UVs are used.")
