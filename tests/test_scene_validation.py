# SPDX-License-Identifier: Apache-2.0
"""Every promise of scene.py is checked, before saving and after loading, and what is broken is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import svgf
from svgf import scene_writer
from svgf.errors import InputError
from svgf.scene import DEEPEST_MIX, Material, MaterialKind, Scene, TextureMap, World
from svgf.scene_validation import SceneValidator

from .test_scene_file import IDENTITY, make_scene


def change_mesh(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, meshes=(replace(scene.meshes[0], **values), scene.meshes[1]))


def change_instances(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, instances=replace(scene.instances, **values))


def change_material(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(
        scene, materials=(scene.materials[0], replace(scene.materials[1], **values), *scene.materials[2:])
    )


def change_light(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, lights=(replace(scene.lights[0], **values),))


def change_camera(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, camera=replace(scene.camera, **values))


def change_texture(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, textures=(scene.textures[0], replace(scene.textures[1], **values)))


def change_defaults(**values: object) -> Callable[[Scene], Scene]:
    return lambda scene: replace(scene, defaults=replace(scene.defaults, **values))


NAN, INF = float("nan"), float("inf")
INVALID = [
    (change_mesh(positions=np.zeros((12, 2), np.float32)), r'meshes\[0\] "Rock".positions is float32 \[12, 2\], not'),
    (change_mesh(positions=np.zeros((12, 3))), r"positions is float64 \[12, 3\], not float32"),
    (change_mesh(positions=[[0.0, 0.0, 0.0]]), r"positions is .* not of type ndarray"),
    (change_mesh(triangles=np.full((20, 3), 12, np.int32)), r"triangles holds 12, but there are 12 vertices"),
    (change_mesh(triangles=np.full((20, 3), -1, np.int32)), r"triangles holds -1"),
    (
        change_mesh(normals=np.zeros((19, 3, 3), np.float32)),
        r"normals is float32 \[19, 3, 3\], not float32 \[20, 3, 3\]",
    ),
    (change_mesh(uvs=np.full((20, 3, 2), NAN, np.float32)), r"uvs holds 120 numbers that are not finite"),
    (change_mesh(uvs=np.zeros((2, 19, 3, 2), np.float32)), r"uvs is float32 \[2, 19, 3, 2\], not float32 \[\*, 20, 3, 2\]"),
    (change_mesh(uvs=np.zeros((0, 20, 3, 2), np.float32)), r"uvs has 0 layers, not 1 to 64"),
    (change_mesh(material_slots=np.full(20, -1, np.int32)), r"material_slots holds -1"),
    (change_mesh(previous_positions=np.zeros((11, 3), np.float32)), r"previous_positions is float32 \[11, 3\]"),
    (change_mesh(name=b"Rock"), r"meshes\[0\].name is b'Rock', not of type str"),
    (change_instances(mesh=np.array([0, 2, 0], np.int32)), r"instances.mesh holds 2, but there are 2 meshes"),
    (change_instances(object_to_world=np.full((3, 3, 4), NAN)), r"instances.object_to_world holds 36 numbers"),
    (change_instances(previous_object_to_world=np.full((3, 3, 4), INF)), r"instances.previous_object_to_world"),
    (change_instances(object_id=np.array([0, 1, 2], np.int32)), r"instances.object_id holds 0"),
    (change_instances(object_id=np.array([1, 2], np.int32)), r"instances.object_id is int32 \[2\], not int32 \[3\]"),
    (change_instances(material_start=np.array([0, 2, 3], np.int32)), r"instances.material_start\[2\] is 3"),
    (change_instances(material_start=np.array([0, 2**31 - 1, 0], np.int32)), r"instances.material_start\[1\]"),
    (change_instances(material_start=np.array([-1, 0, 0], np.int32)), r"instances.material_start\[0\] is -1"),
    (change_instances(terminator_offset=np.float32([0, -0.1, 0])), r"instances.terminator_offset holds -0.1;"),
    (change_instances(terminator_offset=np.float32([0, NAN, 0])), r"instances.terminator_offset holds 1 numbers"),
    (change_instances(terminator_offset=np.zeros(2, np.float32)), r"instances.terminator_offset is float32 \[2\]"),
    (change_instances(material_table=np.array([0, 1, 4, 0], np.int32)), r"material_table holds 4, but there are 4 mat"),
    (
        change_material(base_color=(0.1, NAN, 0.1)),
        r'materials\[1\] "Painted".base_color\[1\] is nan, outside of \[0, 1\]',
    ),
    (change_material(base_color=(0.1, 0.1)), r"base_color has 2 numbers, not 3"),
    (change_material(kind=1), r"kind is 1, not one of PRINCIPLED, DIFFUSE"),
    (change_material(maps={"base_color": TextureMap(2)}), r"maps\[base_color\].texture is 2, outside of \[0, 1\]"),
    (change_material(maps={"alpha": TextureMap(0, channel=4)}), r"maps\[alpha\].channel is 4"),
    (change_material(maps={"alpha": TextureMap(0, uv_layer=-1)}), r"maps\[alpha\].uv_layer is -1"),
    (change_material(maps={"alpha": TextureMap(0, uv_transform=(1.0, 0.0))}), r"uv_transform has 2 numbers, not 6"),
    (change_material(maps={"alpha": 0}), r"maps\[alpha\] is 0, not of type TextureMap"),
    (change_material(maps={"colour": TextureMap(0)}), r"maps has 'colour', which is not an input that a texture can"),
    (change_material(maps=()), r"maps is \(\), not of type dict"),
    (change_material(coat_weight=2.0), r"coat_weight is 2.0, outside of \[0, 1\]"),
    (change_material(anisotropic=-1.5), r"anisotropic is -1.5, outside of \[-1, 1\]"),
    (change_material(kind=MaterialKind.MIX), r'"Painted".first is -1, outside of \[0, 3\]'),
    (change_material(kind=MaterialKind.ADD, first=0, second=4), r'"Painted".second is 4, outside of \[0, 3\]'),
    (change_material(kind=MaterialKind.ADD, first=0, second=1), r'materials\[1\] "Painted" mixes itself'),
    (change_material(kind=MaterialKind.ADD, first=2, second=0), r'"(Painted|Both)" mixes itself'),
    (
        lambda scene: replace(
            scene,
            materials=(
                *(Material(kind=MaterialKind.ADD, first=i + 1, second=i + 2) for i in range(DEEPEST_MIX + 1)),
                *scene.materials,
            ),
        ),
        rf"lies within more than {DEEPEST_MIX} mixes",
    ),
    (change_texture(associated_alpha=1), r"associated_alpha is 1, not of type bool"),
    (change_material(roughness=1.5), r"roughness is 1.5, outside of \[0, 1\]"),
    (change_material(roughness="0.5"), r"roughness is '0.5', not a number"),
    (change_material(ior=-0.5), r"ior is -0.5, outside of"),
    (change_material(emission=(-1.0, 0.0, 0.0)), r"emission\[0\] is -1.0"),
    (change_material(emission=(INF, 0.0, 0.0)), r"emission\[0\] is inf"),
    (change_light(power=(NAN, 0.0, 0.0)), r'lights\[0\] "Sun".power\[0\] is nan'),
    (change_light(light_to_world=2 * IDENTITY), r"light_to_world scales or shears"),
    (change_light(kind=1), r"kind is 1, not one of POINT, SUN"),
    (change_light(size=(4.0, 0.0)), r"size\[0\] is 4.0"),
    (change_light(spot_angle=0.0 - 1e-9), r"spot_angle"),
    (change_camera(camera_to_world=np.full((3, 4), NAN)), r"camera.camera_to_world holds 12 numbers"),
    (change_camera(window=(0.5, -0.5, -0.5, 0.5)), r"camera.window is empty"),
    (change_camera(window=(-0.5, 0.5, -0.5, NAN)), r"camera.window\[3\] is nan"),
    (change_camera(clip=(1.0, 0.5)), r"camera.clip ends at 0.5"),
    (change_camera(projection="perspective"), r"camera.projection is 'perspective', not one of PERSPECTIVE"),
    (change_texture(pixels=np.zeros((0, 4, 4), np.float32)), r'textures\[1\] "sky.exr".pixels is 4x0'),
    (change_texture(pixels=np.zeros((4, 4, 3), np.uint8)), r"pixels is uint8 \[4, 4, 3\]"),
    (change_texture(pixels=np.full((1, 1, 4), NAN, np.float32)), r"pixels holds 4 numbers that are not finite"),
    (change_texture(srgb=True), r"srgb is set, but float32 pixels are linear"),
    (change_defaults(width=0), r"defaults.width is 0, outside of \[1, 65536\]"),
    (change_defaults(height=-5), r"defaults.height is -5"),
    (change_defaults(bounces=2.5), r"defaults.bounces is 2.5, not an integer"),
    (change_defaults(exposure=NAN), r"defaults.exposure is nan"),
    (lambda scene: replace(scene, world=World((0.0, INF, 0.0))), r"world.radiance\[1\] is inf"),
    (lambda scene: replace(scene, frame=True), r"frame is True, not an integer"),
    (lambda scene: replace(scene, meshes=list(scene.meshes)), r"meshes is .*not of type tuple"),
    (lambda scene: replace(scene, lights=("lamp",)), r"lights\[0\] is 'lamp', not of type Light"),
]


@pytest.mark.parametrize(("change", "message"), INVALID)
def test_invalid_scene_is_refused_by_name(tmp_path: Path, change: Callable[[Scene], Scene], message: str) -> None:
    scene = change(make_scene())
    with pytest.raises(InputError, match=message):
        SceneValidator().check(scene)
    with pytest.raises(InputError, match=rf"bad\.svgf: .*{message}"):
        svgf.save(tmp_path / "bad.svgf", scene)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("change", "message"), INVALID)
def test_invalid_file_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[Scene], Scene], message: str
) -> None:
    """The same, when somebody else's program wrote the file without checking."""
    path = tmp_path / "bad.svgf"
    with monkeypatch.context() as context:
        context.setattr(SceneValidator, "check", lambda self, scene: ())
        context.setattr(scene_writer, "_json", json.dumps)
        try:
            svgf.save(path, change(make_scene()))
        except (TypeError, ValueError, AttributeError):
            return  # a file cannot say this
    with pytest.raises(InputError, match=r"bad\.svgf"):
        svgf.load(path)


def test_vertices_that_are_not_finite_are_a_warning(tmp_path: Path) -> None:
    scene = make_scene()
    positions, normals = scene.meshes[0].positions.copy(), scene.meshes[0].normals.copy()
    triangles = np.zeros((20, 3), np.int32)
    triangles[:5] = [1, 2, 3]
    positions[3] = NAN
    positions[4, 1] = INF
    normals[7, 0] = NAN
    scene = change_mesh(positions=positions, normals=normals, triangles=triangles)(scene)
    path = tmp_path / "nan.svgf"
    svgf.save(path, scene)
    loaded = svgf.load(path)
    assert loaded.warnings == (
        "Hair is not simulated.",
        'Mesh "Rock": 2 of 12 vertices are not finite; 5 triangles are left out.',
        'Mesh "Rock": 1 corner normals are not finite; the face normal is used there.',
    )
    svgf.save(path, loaded)
    assert svgf.load(path).warnings == loaded.warnings
