# SPDX-License-Identifier: Apache-2.0
"""The render engine without a window: the same pixels as the Python API, passes, animations, errors."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from blend import add_cube, add_light, add_material, add_mesh, add_world, animate, save
from svgf import devices
from svgf.cli import app
from svgf.errors import DeviceError, Interrupted
from svgf.io import exr
from svgf.passes import PASSES
from svgf.renderer import Renderer
from svgf.settings import Settings
from svgf_blender import session
from svgf_blender.engine import SVGFRenderEngine
from svgf_blender.export import export_file
from svgf_blender.ui.passes import unsupported_passes
from typer.testing import CliRunner

WIDTH, HEIGHT = 24, 14
OBJECT_INDEX = "Object Index" if bpy.app.version >= (5, 0, 0) else "IndexOB"


@pytest.fixture(autouse=True)
def scene(registered, tmp_path, engine_device):
    """A cube that slides over a plane under a lamp, the camera close by."""
    floor = add_mesh("Floor", location=(0, 0, -1))
    floor.scale = (5, 5, 1)
    cube = add_cube("Moving")
    add_material("Paint", cube, Base_Color=(0.8, 0.2, 0.1))
    animate(cube, "location", (0, -1.0), (10, 1.0), index=0)
    add_light("AREA", location=(0, -2, 4), energy=200)
    add_world((0.5, 0.5, 0.5), 0.2)
    scene = bpy.context.scene
    scene.render.engine = "SVGF"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.svgf.device = engine_device
    if hasattr(scene, "cycles"):
        scene.cycles.max_bounces = 1
    settings = scene.render.image_settings
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    scene.render.filepath = str(tmp_path / "frame_")
    scene.frame_start, scene.frame_end = 1, 3
    return scene


@pytest.fixture(scope="module")
def engine_device() -> str:
    """The fastest device that every machine has."""
    from svgf.devices import available_devices

    usable = {info.name for info in available_devices() if info.available}
    return "cpu" if "cpu" in usable else "reference"


def rendered(tmp_path, name="frame_.exr") -> dict[str, np.ndarray]:
    return exr.read(tmp_path / name)


def from_python(path, frames, device, **settings) -> list:
    renderer = Renderer(Settings(**settings), device)
    return [renderer.render(scene) for scene in export_file(path, frames=frames)]


def test_still_is_what_python_renders(scene, tmp_path, engine_device):
    view_layer = scene.view_layers[0]
    view_layer.use_pass_z = view_layer.use_pass_normal = view_layer.use_pass_vector = True
    view_layer.use_pass_object_index = True
    scene.frame_set(2)
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    passes = rendered(tmp_path)
    (frame,) = from_python(save(tmp_path / "still.blend"), [2], engine_device)

    def found(name):
        return exr.find_pass(passes, name, "the render")

    assert found("Combined").shape == (HEIGHT, WIDTH, 4)
    assert np.array_equal(found("Combined")[..., :3], frame.color) and frame.color.std() > 0.01
    assert (found("Combined")[..., 3] == 1).all()
    assert np.array_equal(found("Depth"), frame.depth) and np.array_equal(found("Normal"), frame.normal)
    assert np.array_equal(found(OBJECT_INDEX), frame.object_id.astype(np.float32))
    vector = found("Vector")
    assert np.array_equal(vector[..., 0], frame.motion[..., 0]) and np.array_equal(
        vector[..., 1], -frame.motion[..., 1]
    )
    assert np.abs(vector[..., :2]).max() > 0.1 and not vector[..., 2:].any()


def ask_for_every_pass(view_layer) -> None:
    view_layer.use_pass_z = view_layer.use_pass_normal = view_layer.use_pass_vector = True
    view_layer.use_pass_object_index = True
    for item in view_layer.svgf.bl_rna.properties:
        if item.type == "BOOLEAN":
            setattr(view_layer.svgf, item.identifier, True)


def test_final_render_is_what_the_command_line_renders(scene, tmp_path, engine_device):
    """Every pass of an animation, to the bit: Blender's own files against `svgf render` of the exported scene."""
    ask_for_every_pass(scene.view_layers[0])
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    blend, exported = save(tmp_path / "shot.blend"), tmp_path / "shot.svgf"
    for arguments in (
        ["export", str(blend), "-o", str(exported), "--frames", "1-3"],
        ["render", str(exported), "-o", str(tmp_path / "cli"), "--device", engine_device],
    ):
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.stderr
    for frame in (1, 2, 3):
        ours = exr.read(tmp_path / f"frame_000{frame}.exr")
        theirs = exr.read(tmp_path / "cli" / f"shot_000{frame}.exr")
        assert len(theirs) == len(PASSES)
        for name in PASSES:
            shown = OBJECT_INDEX if name == "Object Index" else name
            assert np.array_equal(exr.find_pass(ours, shown, ""), exr.find_pass(theirs, name, "")), name
    assert exr.find_pass(theirs, "History Length", "").max() == 3


def test_transparent_film(scene, tmp_path, engine_device):
    """The plane hides half of the world, whose other half lets what is behind the image be seen."""
    bpy.data.objects["Floor"].location.z = -3
    scene.render.film_transparent = True
    bpy.ops.render.render(write_still=True)
    combined = exr.find_pass(rendered(tmp_path), "Combined", "")
    (frame,) = from_python(save(tmp_path / "film.blend"), [1], engine_device)
    assert np.array_equal(combined, np.dstack([frame.color, frame.alpha]))
    assert combined[..., 3].min() == 0 and combined[..., 3].max() == 1
    assert not combined[combined[..., 3] == 0].any()


def test_compositor_gets_the_passes(scene, tmp_path):
    if bpy.app.version < (5, 0, 0):
        pytest.skip("compositors of Blender 4 are another kind of node tree")
    scene.view_layers[0].use_pass_normal = True
    tree = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    layers, output = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("NodeGroupOutput")
    scene.compositing_node_group = tree
    tree.links.new(layers.outputs["Normal"], output.inputs[0])
    settings = scene.render.image_settings
    settings.media_type, settings.file_format, settings.color_depth = "IMAGE", "OPEN_EXR", "32"
    bpy.ops.render.render(write_still=True)
    composite = exr.find_pass(rendered(tmp_path), "Combined", "")
    scene.compositing_node_group = None
    settings.media_type = "MULTI_LAYER_IMAGE"
    bpy.ops.render.render(write_still=True)
    assert np.array_equal(composite[..., :3], exr.find_pass(rendered(tmp_path), "Normal", ""))


def test_passes_that_we_lack_are_named(scene):
    view_layer = scene.view_layers[0]
    assert unsupported_passes(view_layer) == ()
    view_layer.use_pass_mist = view_layer.use_pass_diffuse_color = True
    view_layer.aovs.add().name = "Mask"
    view_layer.lightgroups.add(name="Key")
    if hasattr(view_layer, "cycles"):
        view_layer.cycles.denoising_store_passes = True
    (sentence,) = unsupported_passes(view_layer)
    assert sentence.startswith('View layer "ViewLayer": passes are not supported yet and left out: ')
    assert all(name in sentence for name in ("Mist", "Diffuse Color", "Mask (AOV)", "Key (light group)"))
    assert ("Denoising" in sentence) is hasattr(view_layer, "cycles")


def test_passes_that_nobody_asks_for_are_not_there(scene, tmp_path):
    scene.view_layers[0].use_pass_z = False
    bpy.ops.render.render(write_still=True)
    assert [name.rpartition(".")[2] for name in rendered(tmp_path)] == ["Combined"]


def test_settings_reach_the_renderer(scene, tmp_path, engine_device):
    scene.svgf.method, scene.svgf.samples, scene.svgf.seed = "none", 3, 7
    scene.svgf.denoise.alpha = 0.1
    assert scene.svgf.to_settings() == Settings(
        method="none", samples=3, seed=7, denoise=type(Settings().denoise)(alpha=0.1)
    )
    scene.frame_set(1)
    bpy.ops.render.render(write_still=True)
    (frame,) = from_python(save(tmp_path / "settings.blend"), [1], engine_device, method="none", samples=3, seed=7)
    assert np.array_equal(exr.find_pass(rendered(tmp_path), "Combined", "")[..., :3], frame.color)


def test_a_view_layer_may_have_samples_of_its_own(scene, tmp_path):
    images = []
    scene.svgf.method = "none"
    for scene.svgf.samples, scene.view_layers[0].samples in ((3, 0), (1, 3)):
        bpy.ops.render.render(write_still=True)
        images.append(exr.find_pass(rendered(tmp_path), "Combined", ""))
    assert np.array_equal(*images)


def test_a_still_does_not_depend_on_what_was_rendered_before(scene, tmp_path):
    images = []
    for frame in (2, 1, 2):
        scene.frame_set(frame)
        bpy.ops.render.render(write_still=True)
        images.append(exr.find_pass(rendered(tmp_path), "Combined", ""))
    assert np.array_equal(images[0], images[2]) and not np.array_equal(images[0], images[1])


def test_animation_is_what_python_renders(scene, tmp_path, engine_device):
    """Three files, with history that goes on from frame to frame."""
    bpy.ops.render.render(animation=True)
    files = sorted(tmp_path.glob("frame_*.exr"))
    assert [file.name for file in files] == ["frame_0001.exr", "frame_0002.exr", "frame_0003.exr"]
    frames = from_python(save(tmp_path / "animation.blend"), range(1, 4), engine_device)
    assert frames[2].history_length.max() == 3
    for file, frame in zip(files, frames, strict=True):
        assert np.array_equal(exr.find_pass(rendered(tmp_path, file.name), "Combined", "")[..., :3], frame.color)


def test_session_ends_with_the_job(scene):
    bpy.ops.render.render()
    assert not session._sessions


def test_every_view_layer_is_rendered(scene, tmp_path):
    scene.view_layers.new("Second")
    bpy.ops.render.render(write_still=True)
    assert {name.partition(".")[0] for name in rendered(tmp_path)} == {"ViewLayer", "Second"}


def test_render_region(scene, tmp_path):
    bpy.ops.render.render(write_still=True)
    whole = exr.find_pass(rendered(tmp_path), "Combined", "")
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1
    bpy.ops.render.render(write_still=True)
    assert np.array_equal(exr.find_pass(rendered(tmp_path), "Combined", ""), whole[:7, 6:18])
    render.use_crop_to_border = False
    bpy.ops.render.render(write_still=True)
    framed = exr.find_pass(rendered(tmp_path), "Combined", "")
    assert np.array_equal(framed[:7, 6:18], whole[:7, 6:18]) and not framed[7:].any()


@pytest.mark.parametrize("border", [(0.1, 0.7, 0.3, 0.9), (0.29, 0.58, 0.57, 0.86), (0.05, 0.95, 0.0, 0.35)])
def test_render_region_of_any_size(scene, tmp_path, border):
    """Blender rounds in float32, and refuses a result of another size in silence."""
    scene.render.resolution_x, scene.render.resolution_y = 50, 30
    bpy.ops.render.render(write_still=True)
    whole = exr.find_pass(rendered(tmp_path), "Combined", "")
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = border
    bpy.ops.render.render(write_still=True)
    part = exr.find_pass(rendered(tmp_path), "Combined", "")
    left, top = round(border[0] * 50), 30 - round(border[3] * 30)
    found = [
        (x, y)
        for x in range(max(left - 1, 0), left + 2)
        for y in range(max(top - 1, 0), top + 2)
        if np.array_equal(whole[y : y + part.shape[0], x : x + part.shape[1]], part)
    ]
    assert len(found) == 1


def test_stereo_is_refused(scene):
    scene.render.use_multiview = True
    with pytest.raises(RuntimeError, match="Stereo rendering is not supported. Turn"):
        bpy.ops.render.render()
    assert not session._sessions


def test_nothing_to_render_is_said(scene, tmp_path):
    """No file is written, and the animation ends."""
    for name in ("Floor", "Moving"):
        bpy.data.objects[name].hide_render = True
    for animation in (False, True):
        with pytest.raises(RuntimeError, match='Scene "Scene" has no mesh to render at frame 1'):
            bpy.ops.render.render(write_still=True, animation=animation)
    assert not list(tmp_path.glob("frame_*"))


def test_device_that_fails_is_said(scene, monkeypatch):
    monkeypatch.setattr(session, "open_device", Mock(side_effect=DeviceError("The device is lost.", "Restart.")))
    monkeypatch.setattr(session, "_devices", {})
    with pytest.raises(RuntimeError, match="The device is lost. Restart."):
        bpy.ops.render.render()
    monkeypatch.undo()
    assert bpy.ops.render.render() == {"FINISHED"}


def test_a_lost_gpu_gives_way_to_the_cpu(scene, tmp_path, monkeypatch, capfd):
    """When it is opened, and in the middle of an animation, which goes on to its end."""
    bpy.ops.render.render(write_still=True)
    expected = exr.find_pass(rendered(tmp_path), "Combined", "")
    scene.svgf.device = "cuda"

    def open_device(name: str):
        if name != "cpu":
            raise DeviceError("The GPU is lost.", "Restart.")
        return devices.open_device(name)

    monkeypatch.setattr(session, "open_device", open_device)
    monkeypatch.setattr(session, "_devices", {})
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    assert np.array_equal(exr.find_pass(rendered(tmp_path), "Combined", ""), expected)
    assert "The GPU is lost. Restart. The CPU goes on." in "".join(capfd.readouterr())

    class Failing(Renderer):
        def render(self, scene, *arguments):
            if self.device is gpu and scene.frame == 2:
                raise DeviceError("The GPU failed.", stage="path")
            return super().render(scene, *arguments)

    gpu = Mock(wraps=devices.open_device("cpu"))
    gpu.name, gpu.description = "cuda", "GPU"
    monkeypatch.setattr(session, "open_device", lambda name: gpu if name == "cuda" else devices.open_device(name))
    monkeypatch.setattr(session, "_devices", {})
    monkeypatch.setattr(session, "Renderer", Failing)
    assert bpy.ops.render.render(animation=True) == {"FINISHED"}
    assert len(list(tmp_path.glob("frame_0*.exr"))) == 3
    assert "The GPU failed. The CPU goes on." in "".join(capfd.readouterr())


def test_fault_of_ours_is_said(scene, monkeypatch):
    monkeypatch.setattr(Renderer, "render", Mock(side_effect=ZeroDivisionError("oops")))
    with pytest.raises(RuntimeError, match="svgf failed: ZeroDivisionError"):
        bpy.ops.render.render()


@pytest.fixture
def running(monkeypatch):
    """A session whose renderer works until `stopped` is set; the second is what sets it in place of an interrupt."""
    stopped = threading.Event()

    def endless(self, scene, progress):
        assert stopped.wait(10)
        raise Interrupted("Stopped.")

    monkeypatch.setattr(Renderer, "__init__", lambda self, settings, device: setattr(self, "settings", settings))
    monkeypatch.setattr(Renderer, "render", endless)
    monkeypatch.setattr(Renderer, "interrupt", lambda self: None)
    running = session.Session()
    future = running.start(None, Settings(), "reference")
    yield running, future, stopped
    stopped.set()
    running.close()
    running.join()


def engine_where_esc_is_pressed():
    presses = iter([False, False, True])
    return SimpleNamespace(test_break=lambda: next(presses), update_progress=lambda share: None)


def test_cancel(running, monkeypatch):
    """Esc while the renderer works: it is interrupted at once."""
    job, future, stopped = running
    monkeypatch.setattr(Renderer, "interrupt", lambda self: stopped.set())
    with pytest.raises(Interrupted):
        SVGFRenderEngine._wait(engine_where_esc_is_pressed(), job, future, 1)
    assert future.done() and not job.busy


def test_cancel_while_nothing_can_stop_the_renderer(running, monkeypatch):
    """A tree is built to its end. Blender goes on without it, and the next job gets a device of its own."""
    job, future, stopped = running
    device = session._device("reference")
    with pytest.raises(Interrupted):
        SVGFRenderEngine._wait(engine_where_esc_is_pressed(), job, future, 1)
    assert job.busy
    job.close()
    assert job.busy and session._device("reference") is not device
    stopped.set()
    job.join()
    assert not job.busy and job._renderer is None


def test_esc_before_the_renderer_has_begun(engine_device, monkeypatch):
    """Such an interrupt is forgotten by the frame that begins; the frame ends all the same."""
    job = session.Session()
    monkeypatch.setattr(Renderer, "render", lambda self, scene, progress: progress(0.5))
    job.stop()
    with pytest.raises(Interrupted):
        job.start(None, Settings(), engine_device).result()
    job.close()


def test_esc_while_a_scene_is_exported(scene, monkeypatch):
    """No mesh is read after it, and Blender's next job is as good as new."""
    exporter = session.Exporter()
    exporter.should_stop = lambda: True
    with pytest.raises(Interrupted):
        exporter.export(bpy.context.evaluated_depsgraph_get())
    assert exporter.counters.meshes == 0


def test_interrupted_frame_is_no_error(scene, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(Renderer, "render", Mock(side_effect=Interrupted("Stopped.")))
        bpy.ops.render.render()
    assert bpy.ops.render.render() == {"FINISHED"}
