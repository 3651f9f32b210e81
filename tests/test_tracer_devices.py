# SPDX-License-Identifier: Apache-2.0
"""Every device traces the same paths as the float64 reference: one sample, compared pixel by pixel.

A rounding error can move a ray over an edge, and then that pixel's path is another one. Those pixels are counted, not
excused.
"""

import dataclasses

import numpy as np
import pytest

from svgf.devices import open_device
from svgf.scene import Material

from . import material_cases, scenes
from .tracing import trace

SCENES = scenes.device_scenes()
RELATIVE = 1e-3
SHARE = 0.997

# Absolute differences that mean nothing, for what can be zero: radiance, pixels, metres.
ABSOLUTE = {"motion": 2e-3, "depth_gradient": 1e-4, "normal": 1e-4, "diffuse_albedo": 1e-4, "specular_albedo": 1e-4}


@pytest.fixture(autouse=True)
def _native_only(device):
    if device.name == "reference":
        pytest.skip("the reference is what the others are compared with")


def same_share(images, reference, name: str) -> float:
    """Share of pixels whose channels all agree."""
    mine, other = images[name], reference[name]
    assert mine.shape == other.shape
    if mine.dtype == np.int32:
        return float((mine == other).mean())
    absolute = ABSOLUTE.get(name, 1e-4 * max(np.abs(other).mean(), 1e-6))
    same = np.abs(mine - other) <= RELATIVE * np.abs(other) + absolute
    return float(same.reshape(*same.shape[:2], -1).all(axis=2).mean())


def assert_same(device, scene, **settings) -> None:
    images = trace(device, scene, **settings)
    reference = trace(open_device("reference"), scene, **settings)
    assert images.keys() == reference.keys()
    shares = {name: same_share(images, reference, name) for name in reference}
    assert min(shares.values()) >= SHARE, {name: round(share, 4) for name, share in shares.items() if share < SHARE}


@pytest.mark.parametrize("name", SCENES)
def test_same_paths(device, name):
    assert_same(device, SCENES[name])


@pytest.mark.parametrize("name", ["box", "moving", "textured", "mesh_light"])
def test_same_paths_with_jitter_other_samples_and_the_other_split(device, name):
    assert_same(
        device, SCENES[name], pixel_filter="box", sample=123456789, samples=2, seed=77, signals="direct_indirect"
    )


@pytest.mark.parametrize("roughness", [0.0, 0.03, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("kind", ["plastic", "metal", "glass", "all"])
def test_same_paths_for_every_lobe(device, kind, roughness):
    lobes = {
        "plastic": {"specular_tint": (1.0, 0.5, 0.2), "specular_ior_level": 0.9},
        "metal": {"metallic": 1.0},
        "glass": {"transmission": 1.0, "ior": 1.3},
        "all": {"metallic": 0.3, "transmission": 0.5, "ior": 1.7},
    }
    material = Material(kind, base_color=(0.7, 0.6, 0.5), roughness=roughness, **lobes[kind])
    scene = SCENES["rectangle_lamp"]
    assert_same(device, dataclasses.replace(scene, materials=(scene.materials[0], material)))


@pytest.mark.parametrize("is_smooth", [False, True], ids=["rough", "smooth"])
@pytest.mark.parametrize("material", material_cases.SINGLE, ids=material_cases.names(material_cases.SINGLE))
def test_same_paths_for_every_kind_of_material(device, material, is_smooth):
    scene = material_cases.material_scene(material_cases.smooth(material) if is_smooth else material)
    assert_same(device, scene)


VARIED = material_cases.varied_scenes()


@pytest.mark.parametrize("name", VARIED)
def test_same_paths_for_maps_and_mixes(device, name):
    assert_same(device, VARIED[name])


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (1e6, -1e6, 1e5)])
def test_same_paths_far_from_the_origin(device, offset):
    assert_same(device, scenes.move(SCENES["box"], offset))


@pytest.mark.parametrize("size", [(1, 1), (17, 5), (5, 31)])
def test_same_paths_at_odd_sizes(device, size):
    """All pixels must agree: there are too few to leave any out."""
    scene = SCENES["rectangle_lamp"]
    images = trace(device, scene, *size)
    reference = trace(open_device("reference"), scene, *size)
    for name in reference:
        assert same_share(images, reference, name) >= (0.97 if size[0] * size[1] > 1 else 1)
