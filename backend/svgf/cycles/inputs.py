# SPDX-License-Identifier: Apache-2.0
"""The passes of one layer of one frame as the denoiser's images, and the denoised Combined from its result.

Light passes: Combined = sum over diffuse, glossy and transmission of Color x (Direct + Indirect), + Emission +
Environment + what they do not explain (volumes, a denoised or composited Combined). Two signals can be filtered:
diffuse, and glossy and transmission as one, each divided by the sum of its colors: what is seen in mirrors and through
glass moves otherwise than the surface. With svgf+, two scenes at 1 sample per pixel, relMSE and FLIP over those of OIDN
2.5.1 in frames 5, 8, 12 and 16 (10):

    diffuse + transmission, glossy      3.10 0.845    1.30 0.779
    diffuse, glossy + transmission      3.07 0.839    1.28 0.766

Files do not say how rough a surface is, and what a mirror shows is structure, to be kept, as long as light is found
there. Where most of an object's specular samples are black, they say where light was found by chance, and are filtered
as those of a rough surface are. Two rooms at 1 sample per pixel, relMSE, FLIP and flicker over those of OIDN 2.5.1; the
gallery and the teapots of svgf's README are the same with both:

                                  zx_room, frames 24-29     Sponza, frames 34-39
    all sharp                     1.28 1.17 .633            0.87 1.03 .636
    by the share of black ones    0.95 0.95 .576            0.86 0.91 .635
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .image import MultilayerImage
from .passes import LOBES
from .reprojection import View

# Cycles' background is 1e10; files may have rounded it.
_BACKGROUND_DEPTH = 1e9
_DENOISER_BACKGROUND_DEPTH = 1e10
# Motion below this is none: some Blender versions round to 1e-4 px, and what stands still must not be resampled.
_LEAST_MOTION = 1 / 64
# Passes stored as half or further rounded explain Combined to about this; the difference is no light of its own.
_ROUNDING = 0.03
# Share of an object's specular samples that are black: up to the first they show what a mirror does, from the second on
# where light was found. And the roughness that stands for it: 0.1 is a mirror's to the denoiser, 0.4 a matte surface's.
_BLACK_SHARES, _ROUGHNESS = (0.4, 0.6), (0.1, 0.4)
# Denoising Albedo looks through mirrors and glass along one jittered ray: light over a dark texel times a neighbour's
# bright one is a firefly. Measured at 1 sample per pixel, 0.1 instead of 0 lowers FLIP by 14 to 21 %.
_LEAST_ALBEDO = 0.1


@dataclass(frozen=True)
class Reading:
    """How to read a layer. light_passes: two signals from the light passes, else one from Combined. motion: whether to
    read Vector. vector_signs: factors that turn its X and Y into previous pixel position minus this one, y down."""

    layer: str
    light_passes: bool
    motion: bool
    vector_signs: tuple[float, float] = (1.0, -1.0)


@dataclass(frozen=True)
class LayerInputs:
    """images: for ``svgf.Denoiser.denoise``. deficit [H, W, 3] <= 0: to add to its result, where Combined holds less
    than the light passes do. unexplained: the share of Combined's energy, in absolute value, that they miss. view: what
    tells the surfaces apart."""

    images: dict[str, np.ndarray]
    view: View
    deficit: np.ndarray
    unexplained: float


def layer_inputs(image: MultilayerImage, reading: Reading) -> LayerInputs:
    """The file must hold the passes that ``preflight`` asks for. Bad values stay in the images, for the denoiser to
    repair and count."""
    layer = reading.layer
    combined = image.read(layer, "Combined")
    emission = np.zeros_like(combined)
    for name in ("Emission", "Environment"):
        light = image.read(layer, name)
        if light is not None:
            emission += light
    images, deficit, unexplained = _surfaces(image, reading), np.zeros_like(combined), 0.0
    with np.errstate(invalid="ignore", over="ignore"):
        if reading.light_passes:
            diffuse, glossy, transmission = (_lobe(image, layer, lobe) for lobe in LOBES)
            images["diffuse_albedo"], images["specular_albedo"] = diffuse.color, glossy.color + transmission.color
            explained = diffuse.radiance + transmission.radiance + glossy.radiance
            difference = combined - emission - explained
            # Rounding is no light of its own: kept out of the filter it would stay as noise. It scales the signals.
            rounding = np.isfinite(explained) & (np.abs(difference) <= _ROUNDING * explained)
            scale = np.where(rounding, 1.0 + difference / np.where(explained > 0.0, explained, 1.0), 1.0)
            images["diffuse"] = diffuse.radiance * scale
            images["specular"] = (glossy.radiance + transmission.radiance) * scale
            images["roughness"] = _roughness(images["specular"], images["specular_albedo"], images["object_id"])
            residual = np.where(rounding | ~np.isfinite(difference), 0.0, difference)
            emission += np.maximum(residual, 0.0)
            deficit = np.minimum(residual, 0.0)
            total = float(np.abs(combined[np.isfinite(combined)]).sum(dtype=np.float64))
            unexplained = float(np.abs(residual).sum(dtype=np.float64)) / total if total > 0.0 else 0.0
        else:
            images["albedo"] = np.clip(image.read(layer, "Denoising Albedo"), _LEAST_ALBEDO, 1.0)
            # Rounding must not make emission more than there is.
            emission = np.where(emission > combined, np.maximum(combined, 0.0), emission)
            images["color"] = combined - emission
    images["emission"] = emission
    return LayerInputs(images, _view(images, _albedo(image, reading)), deficit, unexplained)


def _surfaces(image: MultilayerImage, reading: Reading) -> dict[str, np.ndarray]:
    """normal, depth, object_id and, where it is read, motion [H, W, 2], as the denoiser takes them."""
    layer = reading.layer
    depth = image.read(layer, "Depth")
    background = ~(depth < _BACKGROUND_DEPTH)
    normal = image.read(layer, "Normal")
    if normal is None:
        normal = image.read(layer, "Denoising Normal")
    index = image.read(layer, "Object Index")
    # Blender's objects have the index 0 unless someone sets another; 0 is the denoiser's background.
    object_id = np.ones(depth.shape, np.int32) if index is None else np.rint(np.nan_to_num(index)).astype(np.int32) + 1
    images = {
        "normal": normal,
        "depth": np.where(background, np.float32(_DENOISER_BACKGROUND_DEPTH), depth),
        "object_id": np.where(background, 0, object_id),
    }
    if reading.motion:
        motion = image.read(layer, "Vector") * np.float32(reading.vector_signs)
        still = (np.abs(motion) < _LEAST_MOTION).all(axis=-1)
        motion[still] = 0.0
        images["motion"] = motion
    return images


def _roughness(specular: np.ndarray, albedo: np.ndarray, object_id: np.ndarray) -> np.ndarray:
    """[H, W], the same all over an object: as rough as its specular samples look."""
    reflects = albedo.max(axis=-1) > 0.0
    black = reflects & ~(specular.max(axis=-1) > 0.0)
    objects, index = np.unique(object_id, return_inverse=True)
    index = index.reshape(object_id.shape)
    reflecting, dark = (np.bincount(index[mask], minlength=objects.size) for mask in (reflects, black))
    share = dark / np.maximum(reflecting, 1)
    return np.interp(share, _BLACK_SHARES, _ROUGHNESS).astype(np.float32)[index]


def view(image: MultilayerImage, reading: Reading) -> View:
    """What tells surfaces apart."""
    return _view(_surfaces(image, reading), _albedo(image, reading))


def _view(images: dict[str, np.ndarray], albedo: np.ndarray) -> View:
    motion = images.get("motion", np.zeros((*images["depth"].shape, 2), np.float32))
    return View(images["depth"], images["normal"], images["object_id"], albedo, motion)


def _albedo(image: MultilayerImage, reading: Reading) -> np.ndarray:
    if reading.light_passes:
        albedo = sum(image.read(reading.layer, f"{lobe} Color") for lobe in LOBES)
    else:
        albedo = image.read(reading.layer, "Denoising Albedo")
    return np.clip(albedo, 0.0, 1.0)


class _Lobe(NamedTuple):
    color: np.ndarray
    radiance: np.ndarray


def _lobe(image: MultilayerImage, layer: str, lobe: str) -> _Lobe:
    color, direct, indirect = (image.read(layer, f"{lobe} {part}") for part in ("Color", "Direct", "Indirect"))
    return _Lobe(color, color * (direct + indirect))
