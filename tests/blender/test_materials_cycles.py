# SPDX-License-Identifier: Apache-2.0
"""Materials against Cycles itself: a ball in a white world, ring by ring from its middle to its rim."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from blend import add_camera, add_material, add_shader, add_world, export

from svgf.devices import open_device
from svgf.flatten import flatten
from svgf.io import exr
from svgf.renderer import SceneUploader

SIDE, SAMPLES, BOUNCES = 32, 64, 8
PRINCIPLED, GLASS = "ShaderNodeBsdfPrincipled", "ShaderNodeBsdfGlass"
GLOSSY = "ShaderNodeBsdfAnisotropic"
ORANGE = (0.9, 0.6, 0.3)
CASES = {
    "rough diffuse": ("ShaderNodeBsdfDiffuse", {"Color": ORANGE, "Roughness": 0.8}),
    "plastic": (PRINCIPLED, {"Base Color": (0.3, 0.5, 0.8), "Roughness": 0.4, "Specular Tint": (1, 0.7, 0.4)}),
    "metal": (PRINCIPLED, {"Base Color": ORANGE, "Metallic": 1.0, "Roughness": 0.6, "Specular Tint": (0.3, 1, 0.5)}),
    "brushed": (PRINCIPLED, {"Base Color": ORANGE, "Metallic": 1.0, "Roughness": 0.4, "Anisotropic": 0.8}),
    "coat": (PRINCIPLED, {"Base Color": (0.6, 0.2, 0.2), "Coat Weight": 0.8, "Coat Tint": (1, 0.6, 0.2)}),
    "sheen": (PRINCIPLED, {"Base Color": (0.1, 0.1, 0.1), "Sheen Weight": 1.0, "Sheen Roughness": 0.4}),
    "lit coat": (PRINCIPLED, {"Emission Color": ORANGE, "Emission Strength": 0.7, "Coat Weight": 1.0}),
    "alpha": (PRINCIPLED, {"Base Color": (0.1, 0.1, 0.1), "Alpha": 0.6}),
    "glossy": (GLOSSY, {"Color": ORANGE, "Roughness": 0.5, "Anisotropy": 0.5}),
    "glass": (GLASS, {"Color": ORANGE, "Roughness": 0.0, "IOR": 1.4}),
    "translucent": ("ShaderNodeBsdfTranslucent", {"Color": (0.6, 0.8, 0.4)}),
}


def build(kind: str, inputs: dict) -> None:
    scene = bpy.context.scene
    bpy.data.objects.remove(scene.camera)
    add_camera((0, -6, 0)).data.angle = 0.36
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.context.object.data.shade_smooth()
    material = add_material(obj=bpy.context.object)
    material.node_tree.nodes.remove(next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"))
    add_shader(material, kind, **inputs)
    add_world((1, 1, 1), 1.0)
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x = render.resolution_y = SIDE
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = SAMPLES, False, False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.sample_clamp_indirect, cycles.blur_glossy = 0.0, 0.0
    for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
        setattr(cycles, f"{kind}_bounces", BOUNCES)


def cycles_image(path) -> np.ndarray:
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    (image,) = (image for image in exr.read(path).values() if image.ndim == 3)
    return image[..., :3].astype(np.float64)


def our_image() -> np.ndarray:
    scene = export()
    assert not scene.warnings
    device, flat = open_device("cpu"), flatten(scene)
    tracer = device.tracer()
    SceneUploader(device, tracer).upload(flat)
    images = tracer.trace(
        SIDE,
        SIDE,
        sample=0,
        samples=SAMPLES,
        seed=3,
        bounces=BOUNCES,
        effects=int(flat.effects),
        pixel_filter="box",
        signals="direct_indirect",
    )
    return sum(device.to_numpy(images[name]).astype(np.float64) for name in ("emission", "direct", "indirect"))


@pytest.mark.parametrize("name", CASES)
def test_material_looks_as_in_cycles(tmp_path, name):
    """Means of rings within 1 %, and what two times three standard errors of their pixels allow."""
    build(*CASES[name])
    theirs, ours = cycles_image(tmp_path / "cycles.exr"), our_image()
    y, x = (np.mgrid[0:SIDE, 0:SIDE] + 0.5) / SIDE * 2 - 1
    radius = np.hypot(x, y)
    for low, high in ((0.0, 0.35), (0.35, 0.6), (0.6, 0.8), (0.8, 0.9)):
        ring = (radius >= low) & (radius < high)
        expected, found = theirs[ring].mean(axis=0), ours[ring].mean(axis=0)
        noise = (ours - theirs)[ring].std(axis=0) / np.sqrt(ring.sum())
        assert (np.abs(found - expected) <= 0.01 * expected + 3 * noise + 1e-4).all(), (low, found / expected)
