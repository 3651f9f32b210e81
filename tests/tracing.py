# SPDX-License-Identifier: Apache-2.0
"""One call from a scene to images."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np

from svgf.devices import Device
from svgf.flatten import flatten
from svgf.renderer import SceneUploader
from svgf.scene import Camera, Scene

WIDTH, HEIGHT = 64, 36


def trace(device: Device, scene: Scene, width: int = WIDTH, height: int = HEIGHT, **settings) -> dict[str, np.ndarray]:
    """What ``Tracer.trace`` returns, on the host, float64 but for ids; what it leaves out as it would be zero is zero.
    settings: see there; 1 sample, 3 bounces, centre
    of the pixel, diffuse and specular, unless said."""
    defaults = {
        "sample": 0,
        "samples": 1,
        "seed": 1,
        "bounces": 3,
        "pixel_filter": "center",
        "signals": "diffuse_specular",
    }
    tracer = device.tracer()
    flat = flatten(scene)
    SceneUploader(device, tracer).upload(flat)
    defaults["light_paths"] = astuple(scene.defaults.light_paths)
    defaults["transparent_film"] = scene.defaults.transparent_film
    images = tracer.trace(width, height, **{**defaults, "effects": int(flat.effects), **settings})
    images = {name: device.to_numpy(image) for name, image in images.items()}
    for name in ("specular_albedo", "motion"):
        images.setdefault(name, np.zeros((height, width, 3)))
    return {name: image if image.dtype == np.int32 else image.astype(np.float64) for name, image in images.items()}


def radiance(images: dict[str, np.ndarray]) -> np.ndarray:
    """All light, [height, width, 3]."""
    names = ("emission", "diffuse", "specular", "direct", "indirect")
    return sum(images[name] for name in names if name in images)


def pixels() -> tuple[np.ndarray, np.ndarray]:
    """x and y of pixel centres, [HEIGHT, WIDTH]."""
    return np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)


def rays(camera: Camera, x, y) -> np.ndarray:
    """World directions of planar depth 1 through image points, [..., 3]."""
    left, right, bottom, top = camera.window
    local = np.stack([left + (right - left) * x / WIDTH, top + (bottom - top) * y / HEIGHT, -np.ones_like(x)], axis=-1)
    return local @ camera.camera_to_world[:, :3].T


def project(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, planar depth."""
    local = (points - camera.camera_to_world[:, 3]) @ camera.camera_to_world[:, :3]
    left, right, bottom, top = camera.window
    x = (local[..., 0] / -local[..., 2] - left) / (right - left) * WIDTH
    y = (local[..., 1] / -local[..., 2] - top) / (bottom - top) * HEIGHT
    return x, y, -local[..., 2]


def hit_points(scene: Scene, images: dict[str, np.ndarray]) -> np.ndarray:
    """World positions from depth, for images of WIDTH by HEIGHT with the centre filter."""
    camera = scene.camera
    return camera.camera_to_world[:, 3] + images["depth"][..., None] * rays(camera, *pixels())
