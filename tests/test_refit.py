# SPDX-License-Identifier: Apache-2.0
"""Trees of meshes that deform: refitted they find what a new tree finds, and where that does not pay there is a new
one."""

import dataclasses

import numpy as np
import pytest

from svgf.bench import generated
from svgf.flatten import flatten
from svgf.renderer import SceneUploader
from svgf.scene import Texture, TextureMap

SIZE = (48, 27)


@pytest.fixture(autouse=True)
def _native_only(device):
    if device.name == "reference":
        pytest.skip("the reference makes meshes anew")


def render(device, tracer, flat) -> dict[str, np.ndarray]:
    images = tracer.trace(
        *SIZE, sample=0, samples=1, seed=0, bounces=2, effects=int(flat.effects), pixel_filter="box", signals="diffuse_specular"
    )
    return {name: device.to_numpy(image) for name, image in images.items()}


class Animation:
    """Uploads scenes one after the other and says whether the first mesh was refitted."""

    def __init__(self, device) -> None:
        self.device, self.tracer = device, device.tracer()
        self.uploader = SceneUploader(device, self.tracer)
        self.flat = None

    def show(self, scene) -> tuple[bool, dict[str, np.ndarray]]:
        before = list(self.uploader._meshes.values())
        self.flat = flatten(scene, self.flat)
        self.uploader.upload(self.flat)
        native = self.uploader._meshes[id(scene.meshes[0])][1]
        return any(native is other for _, other in before), render(self.device, self.tracer, self.flat)


def fresh(device, scene) -> dict[str, np.ndarray]:
    return Animation(device).show(scene)[1]


def changed(scene, **changes):
    return dataclasses.replace(scene, meshes=(dataclasses.replace(scene.meshes[0], **changes), *scene.meshes[1:]))


def test_refitted_trees_find_the_same(device):
    animation = Animation(device)
    animation.show(generated.room(6, 1, SIZE))
    for frame in (2, 3, 4):
        scene = generated.room(6, frame, SIZE)
        refitted, images = animation.show(scene)
        assert refitted
        for name, image in fresh(device, scene).items():
            np.testing.assert_array_equal(images[name], image, err_msg=name)


def test_normals_follow(device):
    def with_normals(frame):
        scene = generated.room(6, frame, SIZE)
        normals = np.random.default_rng(frame).normal(size=scene.meshes[0].normals.shape).astype(np.float32)
        normals[:5] = np.nan
        return changed(scene, normals=normals)

    animation = Animation(device)
    animation.show(with_normals(1))
    refitted, images = animation.show(with_normals(2))
    assert refitted
    for name, image in fresh(device, with_normals(2)).items():
        np.testing.assert_array_equal(images[name], image, err_msg=name)


def test_tangents_follow(device):
    def with_tangents(frame):
        scene = generated.room(6, frame, SIZE)
        random, shape = np.random.default_rng(frame), scene.meshes[0].normals.shape[:2]
        uvs = np.random.default_rng(0).random((*shape, 2), np.float32)
        tangents = random.normal(size=(*shape, 4)).astype(np.float32)
        tangents[:5] = np.nan
        bumps = Texture("bumps", np.random.default_rng(1).random((4, 4, 4), np.float32), False)
        mapped = tuple(dataclasses.replace(each, maps={"normal": TextureMap(0)}) for each in scene.materials)
        scene = dataclasses.replace(scene, materials=mapped, textures=(bumps,))
        return changed(scene, uvs=uvs, tangents=tangents)

    animation = Animation(device)
    _, first = animation.show(with_tangents(1))
    refitted, images = animation.show(with_tangents(2))
    assert refitted
    for name, image in fresh(device, with_tangents(2)).items():
        np.testing.assert_array_equal(images[name], image, err_msg=name)
    without = changed(with_tangents(2), tangents=None)
    assert (fresh(device, without)["normal"] != images["normal"]).any()


def broken_vertex(scene):
    positions = scene.meshes[0].positions.copy()
    positions[7] = np.nan
    return changed(scene, positions=positions)


def scrambled(scene):
    positions = scene.meshes[0].positions
    return changed(scene, positions=np.random.default_rng(0).permutation(positions))


def far_away(scene):
    return changed(scene, positions=scene.meshes[0].positions + np.float32(1e4))


def other_triangles(scene):
    return changed(scene, triangles=np.ascontiguousarray(scene.meshes[0].triangles[::-1]))


def first_normals(scene):
    return changed(scene, normals=np.ones_like(scene.meshes[0].normals))


def first_tangents(scene):
    return changed(scene, tangents=np.ones((*scene.meshes[0].normals.shape[:2], 4), np.float32))


@pytest.mark.parametrize("change", [broken_vertex, scrambled, far_away, other_triangles, first_normals, first_tangents])
def test_where_refitting_does_not_do_there_is_a_new_tree(device, change):
    animation = Animation(device)
    animation.show(generated.room(6, 1, SIZE))
    scene = change(generated.room(6, 2, SIZE))
    refitted, images = animation.show(scene)
    assert not refitted
    for name, image in fresh(device, scene).items():
        np.testing.assert_array_equal(images[name], image, err_msg=name)
