# SPDX-License-Identifier: Apache-2.0
"""Scene files: what goes in comes out, frames share what is equal, and nothing in a bad file does harm."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import svgf
from svgf import scene as scene_module
from svgf import scene_schema
from svgf.errors import InputError
from svgf.scene import (
    Camera,
    Extension,
    Instances,
    Interpolation,
    Light,
    LightKind,
    Material,
    MaterialKind,
    Mesh,
    RenderDefaults,
    Scene,
    Texture,
    TextureMap,
    World,
)
from svgf.scene_validation import SceneValidator

IDENTITY = np.eye(3, 4)


def make_scene(frame: int = 1, seed: int = 0) -> Scene:
    """Two meshes (one deforms), three instances, a texture and two lamps: every field differs from its default."""
    random = np.random.default_rng(seed)

    def mesh(name: str, vertices: int, triangles: int, **more: np.ndarray) -> Mesh:
        return Mesh(
            name=name,
            positions=random.normal(size=(vertices, 3)).astype(np.float32),
            triangles=random.integers(0, vertices, (triangles, 3), dtype=np.int32),
            normals=random.normal(size=(triangles, 3, 3)).astype(np.float32),
            material_slots=random.integers(0, 2, triangles, dtype=np.int32),
            **more,
        )

    transforms = np.concatenate([random.normal(size=(3, 3, 3)), random.normal(size=(3, 3, 1))], axis=2)
    return Scene(
        meshes=(
            mesh("Rock", 12, 20, uvs=random.random((20, 3, 2), np.float32)),
            mesh(
                "Fläche ✓",
                5,
                6,
                uvs=random.random((2, 6, 3, 2), np.float32),
                previous_positions=random.random((5, 3), np.float32),
                tangents=random.random((6, 3, 4), np.float32),
                tangent_layer=1,
            ),
        ),
        instances=Instances(
            mesh=np.array([0, 1, 0], np.int32),
            object_to_world=transforms,
            previous_object_to_world=transforms + 0.1,
            object_id=np.array([1, 2, 7], np.int32),
            material_start=np.array([0, 2, 1], np.int32),
            material_table=np.array([0, 1, 1, 0], np.int32),
            terminator_offset=np.array([0.1, 0.0, 2.5], np.float32),
        ),
        materials=(
            Material("Glass", transmission=1.0, roughness=0.0, ior=1.45),
            Material(
                "Painted",
                emission=(0.1, 1 / 3, 3e6),
                specular_tint=(1.0, 0.5, 0.25),
                maps={"base_color": TextureMap(0), "alpha": TextureMap(1, 3, 1, (2.0, 0.5, 0.1, -0.5, 3.0, 0.2))},
            ),
            Material("Both", kind=MaterialKind.MIX, first=0, second=1, factor_fresnel_ior=1.3),
            Material("Leaf", MaterialKind.TRANSLUCENT, (0.1, 0.5, 0.2), multiscatter=False, tangent_uv_layer=1),
        ),
        camera=Camera(IDENTITY.copy(), (-0.5, 0.5, -0.3, 0.2), (0.1, 1e4)),
        previous_camera=Camera(IDENTITY + [0, 0, 0, 0.25], (-0.5, 0.5, -0.3, 0.2), (0.1, 1e4)),
        textures=(
            Texture(
                "bark.png", random.integers(0, 256, (3, 5, 4), np.uint8), True, Interpolation.CLOSEST, Extension.CLIP
            ),
            Texture(
                "sky.exr",
                random.random((2, 2, 4), np.float32),
                False,
                Interpolation.CUBIC,
                Extension.MIRROR,
                associated_alpha=True,
            ),
        ),
        lights=(
            Light("Sun", LightKind.SUN, (3.0, 2.9, 2.8), IDENTITY.copy(), (0.01, 0.0)),
            Light("Spot", LightKind.SPOT, (100.0, 0.0, 0.0), IDENTITY + 0.0, (0.1, 0.0), 0.5, 0.9),
        ),
        world=World((0.05, 0.06, 0.07), backdrop_radiance=(0.1, 0.2, 0.3)),
        frame=frame,
        cut=True,
        name="toys",
        defaults=RenderDefaults(641, 359, 29.97, 4, 1.5),
        warnings=("Hair is not simulated.",),
    )


def assert_equal(a: object, b: object, path: str = "scene") -> None:
    assert type(a) is type(b), path
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes(), path
    elif is_dataclass(a):
        for field in fields(a):
            assert_equal(getattr(a, field.name), getattr(b, field.name), f"{path}.{field.name}")
    elif isinstance(a, dict):
        assert a.keys() == b.keys(), path
        for key in a:
            assert_equal(a[key], b[key], f"{path}[{key}]")
    elif isinstance(a, tuple):
        assert len(a) == len(b), path
        for index, (left, right) in enumerate(zip(a, b, strict=True)):
            assert_equal(left, right, f"{path}[{index}]")
    else:
        assert a == b, path


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "toys.svgf"
    svgf.save(path, make_scene())
    return path


def edit(path: Path, change: Callable[[dict], object]) -> Path:
    """Applies a change to the manifest, as somebody with a text editor would."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    manifest = json.loads(entries["manifest.json"])
    replaced = change(manifest)
    entries["manifest.json"] = replaced if isinstance(replaced, bytes) else json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


# --- What goes in comes out ---


def test_round_trip_is_exact(saved: Path) -> None:
    assert_equal(svgf.load(saved), make_scene())


def test_scene_without_anything(tmp_path: Path) -> None:
    nothing = np.zeros(0, np.int32)
    empty = Instances(nothing, np.zeros((0, 3, 4)), np.zeros((0, 3, 4)), nothing, nothing, nothing)
    scene = replace(make_scene(), meshes=(), instances=empty, materials=(), textures=(), lights=(), warnings=())
    scene.save(tmp_path / "empty.svgf")
    assert_equal(svgf.load(tmp_path / "empty.svgf"), scene)


def test_schema_matches_the_dataclasses() -> None:
    kinds = {value for value in vars(scene_module).values() if isinstance(value, type) and is_dataclass(value)}
    assert scene_schema.SCHEMA.keys() == kinds
    for kind, decoders in scene_schema.SCHEMA.items():
        assert list(decoders) == [field.name for field in fields(kind)], kind


def test_same_scenes_give_same_bytes(tmp_path: Path) -> None:
    for name in ("a.svgf", "b.svgf"):
        svgf.save(tmp_path / name, (make_scene(frame) for frame in (1, 2)))
    assert (tmp_path / "a.svgf").read_bytes() == (tmp_path / "b.svgf").read_bytes()


def test_arrays_are_shared_and_cannot_be_written(saved: Path) -> None:
    with pytest.raises(ValueError, match="read-only"):
        svgf.load(saved).meshes[0].positions[0] = 0


# --- Animation ---


def animation(frames: int) -> list[Scene]:
    first = make_scene()
    moved = [replace(first.instances, object_to_world=first.instances.object_to_world + i) for i in range(frames)]
    return [replace(first, frame=10 + i, instances=moved[i]) for i in range(frames)]


def test_frames_share_what_does_not_change(tmp_path: Path) -> None:
    path = tmp_path / "walk.svgf"
    svgf.save(path, animation(8))
    with zipfile.ZipFile(path) as archive:
        arrays = [name for name in archive.namelist() if name.startswith("arrays/")]
    single = tmp_path / "still.svgf"
    svgf.save(single, animation(1))
    with zipfile.ZipFile(single) as archive:
        assert len(arrays) == len(archive.namelist()) - 1 + 7

    with svgf.SceneFile(path) as file:
        assert file.frames == tuple(range(10, 18)) and len(file) == 8
        scenes = list(file)
    for before, after in pairwise(scenes):
        assert all(a is b for a, b in zip(before.meshes, after.meshes, strict=True))
        assert all(a is b for a, b in zip(before.textures, after.textures, strict=True))
        assert before.camera is after.camera
        assert before.instances is not after.instances
        assert before.instances.material_table is after.instances.material_table


def test_consecutive_frames_share_even_if_nobody_keeps_them(tmp_path: Path) -> None:
    svgf.save(tmp_path / "walk.svgf", animation(3))
    with svgf.SceneFile(tmp_path / "walk.svgf") as file:
        identities = [id(scene.meshes[0]) for scene in file]
    assert len(set(identities)) == 1


def test_any_frame_by_number(tmp_path: Path) -> None:
    scenes = animation(3)
    svgf.save(tmp_path / "walk.svgf", scenes)
    assert_equal(svgf.load(tmp_path / "walk.svgf", 12), scenes[2])
    with pytest.raises(InputError, match=r"walk.svgf has no frame 13. It holds 10-12."):
        svgf.load(tmp_path / "walk.svgf", 13)


def test_saving_streams(tmp_path: Path) -> None:
    """Twenty frames of a deforming mesh of 0.6 MB never need the room of more than a few."""

    def frames():
        base = make_scene()
        for frame in range(20):
            positions = np.random.default_rng(frame).random((50_000, 3), np.float32)
            yield replace(base, frame=frame, meshes=(replace(base.meshes[0], positions=positions), base.meshes[1]))

    tracemalloc.start()
    try:
        svgf.save(tmp_path / "long.svgf", frames())
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 8 * 0.6e6


def test_failing_source_leaves_the_old_file(saved: Path) -> None:
    before = saved.read_bytes()

    def frames():
        yield make_scene(1)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        svgf.save(saved, frames())
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize(
    ("scenes", "message"),
    [([], "there is no frame to save"), ([make_scene(3), make_scene(3)], "frame 3 comes twice")],
)
def test_frames_that_make_no_animation(tmp_path: Path, scenes: list[Scene], message: str) -> None:
    with pytest.raises(InputError, match=message):
        svgf.save(tmp_path / "x.svgf", scenes)
    assert not list(tmp_path.iterdir())


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    material = Material(roughness=np.float32(0.5), emission=(np.float64(1), np.int32(2), 3))
    svgf.save(tmp_path / "a.svgf", replace(make_scene(), frame=np.int64(4), materials=(material,) * 4))
    loaded = svgf.load(tmp_path / "a.svgf")
    assert loaded.frame == 4 and loaded.materials[1] == Material(emission=(1.0, 2.0, 3.0))


# --- Bad files ---


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda m: m.update(version=3),
            "format version 3; this svgf reads up to 2. Update it: pip install --upgrade svgf",
        ),
        (lambda m: m.update(version="1"), "version is '1'"),
        (lambda m: m.update(format="gltf"), "is not an svgf scene file"),
        (lambda m: m.update(frames=[]), "frames is empty"),
        (lambda m: m.update(frames={"1": {}}), "frames is empty"),
        (lambda m: m["frames"].append(m["frames"][0]), r"frames\[1\].frame is not a number of its own"),
        (lambda m: m["frames"][0].update(frame=None), r"frames\[0\].frame"),
        (lambda m: m["tables"].pop("lights"), "tables is incomplete"),
        (lambda m: m["frames"][0]["meshes"].append(2), r"frames\[0\].meshes\[2\] names meshes\[2\], but there are 2"),
        (lambda m: m["frames"][0]["meshes"].append(-1), r"names meshes\[-1\]"),
        (lambda m: m["frames"][0].update(meshes=0), r"frames\[0\].meshes is 0, not a list"),
        (lambda m: m["frames"][0].update(camera=None), r"frames\[0\].camera names cameras\[None\]"),
        (lambda m: m["frames"][0].pop("camera"), r"frames\[0\].camera is missing"),
        (lambda m: m["frames"][0].update(kamera=1), r"frames\[0\].kamera is not a known field"),
        (lambda m: m["frames"][0].update(world=[0, 0, 0]), r"frames\[0\].world is not a record"),
        (lambda m: m["frames"][0].update(cut=1), r"frames\[0\].cut is 1, not of type bool"),
        (lambda m: m["tables"]["meshes"][0].update(positions="../etc"), r"meshes\[0\].positions is not the digest"),
        (lambda m: m["tables"]["meshes"][0].update(positions="0" * 32), r"needs arrays/0{32}.npy, which is missing"),
        (lambda m: m["tables"]["lights"][0].update(kind="LASER"), r"lights\[0\].kind is 'LASER', not one of POINT"),
        (lambda m: m["tables"]["materials"][0].update(ior="1.5"), r"materials\[0\].ior is '1.5', not of type float"),
        (lambda m: m["tables"]["materials"][0].update(ior=10**400), r"materials\[0\].ior is not a finite number"),
        (lambda m: m["tables"]["materials"][0].update(ior=-1), r'materials\[0\] "Glass".ior is -1.0, outside of'),
        (lambda m: b'{"format": ', "manifest.json is not valid JSON"),
        (lambda m: b"[" * 100_000, "manifest.json is not valid JSON"),
        (lambda m: json.dumps(m).replace("1.45", "NaN").encode(), r"manifest.json is not valid JSON \(NaN is not a"),
        (lambda m: b"\xff\xfe\x00", "manifest.json is not valid JSON"),
        (lambda m: b"[]", "of another format"),
    ],
)
def test_hand_edited_manifest(saved: Path, change: Callable[[dict], object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        svgf.load(edit(saved, change))
    assert "toys.svgf" in str(caught.value) and "\n" not in str(caught.value)


def test_edited_value_is_found_under_its_name(saved: Path) -> None:
    edit(saved, lambda manifest: manifest["tables"]["materials"][0].update(roughness=0.125, name="Frosted"))
    assert svgf.load(saved).materials[0].name == "Frosted"


def test_file_of_version_1(saved: Path) -> None:
    """Fields that it did not have take their defaults; its texture becomes the map of the base colour."""
    old = ("name", "base_color", "metallic", "roughness", "ior", "transmission", "specular_ior_level", "specular_tint")

    def downgrade(manifest: dict) -> None:
        manifest["version"] = 1
        materials = manifest["tables"]["materials"]
        for index, record in enumerate(materials):
            kept = {name: record[name] for name in (*old, "emission")}
            materials[index] = {**kept, "base_color_texture": 0 if record["name"] == "Painted" else -1}
        for record in manifest["tables"]["textures"]:
            del record["associated_alpha"]

    expected = make_scene().materials
    glass, painted, both, leaf = svgf.load(edit(saved, downgrade)).materials
    assert glass == expected[0]
    assert painted == replace(expected[1], maps={"base_color": TextureMap(0)})
    assert both == Material("Both") and leaf == Material("Leaf", base_color=(0.1, 0.5, 0.2))


def rewrite_array(path: Path, data: bytes) -> None:
    """Puts other bytes in the place of the positions of the first mesh."""
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    digest = json.loads(entries["manifest.json"])["tables"]["meshes"][0]["positions"]
    entries[f"arrays/{digest}.npy"] = data
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)


def npy(header: str, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + data


def numpy_bytes(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b"\x93NUMPY", id="cut off"),
        pytest.param(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 3)}"), id="a terabyte"),
        pytest.param(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 3)}"), id="negative"),
        pytest.param(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (True, 3)}"), id="bool"),
        pytest.param(npy("{'descr': '<f4', 'fortran_order': False, 'shape': 3}", bytes(12)), id="no tuple"),
        pytest.param(
            npy("{'descr': '<f4', 'fortran_order': False, 'shape': (" + "1," * 99 + ")}", bytes(4)), id="99 axes"
        ),
        pytest.param(npy("{'descr': ['<f4'], 'fortran_order': False, 'shape': (1, 3)}"), id="unhashable"),
        pytest.param(npy("{'descr': '<f4'}"), id="keys"),
        pytest.param(npy("__import__('os').abort()"), id="code"),
        pytest.param(npy("(" * 9000), id="nested"),
        pytest.param(numpy_bytes(np.array([{"pickled": 1}], dtype=object)), id="pickle"),
        pytest.param(numpy_bytes(np.zeros((12, 3), ">f4")), id="big endian"),
        pytest.param(numpy_bytes(np.zeros((12, 3), np.float32, order="F")), id="columns first"),
        pytest.param(numpy_bytes(np.zeros((12, 3), np.float32))[:-1], id="one byte short"),
    ],
)
def test_hand_edited_array(saved: Path, data: bytes) -> None:
    rewrite_array(saved, data)
    with pytest.raises(InputError, match=r"toys.svgf: meshes\[0\].positions is "):
        svgf.load(saved)


def test_declared_size_is_not_allocated(saved: Path) -> None:
    """A central directory that claims 2 GiB for an entry of a few hundred bytes."""
    data = bytearray(saved.read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 24 : entry + 28] = struct.pack("<I", 2 << 30)
    saved.write_bytes(data)
    with pytest.raises(InputError, match="claims to hold more than it can"):
        svgf.load(saved)


def test_zip_bomb_is_refused(tmp_path: Path) -> None:
    """Twenty gigabytes of zeros: every entry is honest, the sum is not."""
    path = tmp_path / "bomb.svgf"
    zeros = bytes(1 << 20)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("manifest.json", "{}")
        archive.writestr("arrays/a.npy", zeros)
    data = path.read_bytes()
    end = data.index(b"PK\x05\x06")
    start = data.index(b"PK\x01\x02")
    second = data.index(b"PK\x01\x02", start + 4)
    directory = data[start:second] + data[second:end] * 20_000
    tail = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 20_001, 20_001, len(directory), start, 0)
    path.write_bytes(data[:start] + directory + tail)
    with pytest.raises(InputError, match=r"overlap|expand"):
        svgf.load(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not an svgf scene file"),
        (b"BLENDER-v405", "is not an svgf scene file"),
        (b"PK", "is truncated or damaged"),
        (b"PK\x05\x06" + bytes(18), "it has no manifest.json"),
    ],
)
def test_other_files(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.svgf"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        svgf.load(path)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"Cannot read .*none.svgf: there is no such file"):
        svgf.load(tmp_path / "none.svgf")
    with pytest.raises(InputError, match="it is a folder"):
        svgf.load(tmp_path)
    with pytest.raises(InputError, match=r"Cannot write .*x.svgf: there is no such file or folder"):
        svgf.save(tmp_path / "none" / "x.svgf", make_scene())
    with pytest.raises(InputError, match="it is a folder"):
        svgf.save(tmp_path, make_scene())
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_full_disk(tmp_path: Path) -> None:
    """The system refuses bytes in the middle of the file: the older file survives, and nothing is left beside it."""
    path = tmp_path / "full.svgf"
    path.write_bytes(b"older")
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
        "sys.path.insert(0, sys.argv[1]); import svgf; from test_scene_file import make_scene\n"
        "try: svgf.save(sys.argv[2], make_scene())\nexcept svgf.InputError as error: print(error)"
    )
    arguments = [sys.executable, "-c", script, str(Path(__file__).parent), str(path)]
    output = subprocess.run(arguments, capture_output=True, text=True, check=True).stdout
    assert output.startswith(f"Cannot write {path}: the file would be larger")
    assert path.read_bytes() == b"older" and list(tmp_path.iterdir()) == [path]


@pytest.fixture(scope="module")
def small_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("fuzz") / "small.svgf"
    svgf.save(path, (make_scene(frame, seed=frame) for frame in (1, 2)))
    return path.read_bytes()


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damage_never_does_worse_than_an_input_error(small_file: bytes, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(small_file)
    for _ in range(data.draw(st.integers(0, 4), "flips")):
        position = data.draw(st.integers(0, len(content) - 1), "position")
        content[position] ^= data.draw(st.integers(1, 255), "bits")
    if data.draw(st.booleans(), "truncate"):
        del content[data.draw(st.integers(0, len(content)), "length") :]
    path = tmp_path / "damaged.svgf"
    path.write_bytes(content)
    try:
        with svgf.SceneFile(path) as file:
            for scene in file:
                SceneValidator().check(scene)
    except InputError as error:
        assert "damaged.svgf" in str(error) and "\n" not in str(error)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_edited_values_never_do_worse_than_an_input_error(
    small_file: bytes, tmp_path: Path, data: st.DataObject
) -> None:
    """Any value of the manifest replaced by any other: valid zip, valid JSON, nonsense."""
    path = tmp_path / "edited.svgf"
    path.write_bytes(small_file)
    scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=40)
    replacement = data.draw(
        scalars | st.lists(scalars, max_size=4) | st.dictionaries(st.text(max_size=4), scalars, max_size=2)
    )

    def change(manifest: dict) -> None:
        node, key = manifest, data.draw(st.sampled_from(sorted(manifest)), "key")
        while isinstance(node[key], dict | list) and node[key] and data.draw(st.integers(0, 9), "deeper") > 0:
            node = node[key]
            keys = sorted(node) if isinstance(node, dict) else range(len(node))
            key = data.draw(st.sampled_from(keys), "key")
        node[key] = replacement

    edit(path, change)
    try:
        with svgf.SceneFile(path) as file:
            for scene in file:
                SceneValidator().check(scene)
    except InputError as error:
        assert "edited.svgf" in str(error) and "\n" not in str(error)
