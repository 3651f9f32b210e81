# SPDX-License-Identifier: Apache-2.0
"""The whole denoiser, on every device: what it must keep, what it must forget, and what may not harm it."""

from __future__ import annotations

import numpy as np
import pytest

from svgf.denoiser import Denoiser
from svgf.errors import InputError
from svgf.settings import DenoiseSettings

HEIGHT, WIDTH = 24, 40
METHODS = ("svgf", "eaw", "none")


def make_frame(height=HEIGHT, width=WIDTH, radiance=1.0, albedo=0.5):
    """A wall that faces the camera, ten metres away, evenly lit; nothing moves."""
    shape = (height, width)
    return {
        "diffuse": np.full((*shape, 3), radiance * albedo, np.float32),
        "diffuse_albedo": np.full((*shape, 3), albedo, np.float32),
        "emission": np.zeros((*shape, 3), np.float32),
        "normal": np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3)).copy(),
        "depth": np.full(shape, 10.0, np.float32),
        "depth_gradient": np.zeros((*shape, 2), np.float32),
        "motion": np.zeros((*shape, 3), np.float32),
        "object_id": np.ones(shape, np.int32),
    }


def add_noise(frame, rng, strength=1.0):
    """The same frame with radiance of the same mean, but as a path tracer sees it."""
    noise = rng.gamma(1.0 / strength**2, strength**2, (*frame["diffuse"].shape[:2], 1)).astype(np.float32)
    return {**frame, "diffuse": frame["diffuse"] * noise}


def put_square(frame, left, radiance=5.0):
    """A nearer square of another object, with its left edge at column `left`."""
    frame = {name: image.copy() for name, image in frame.items()}
    square = np.s_[8:16, left : left + 10]
    frame["diffuse"][square] = radiance * 0.5
    frame["depth"][square] = 5.0
    frame["object_id"][square] = 2
    return frame


# --- What it keeps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_constant_radiance_is_a_fixed_point(device, method):
    frame = make_frame(radiance=3.0)
    frame["specular"] = np.full_like(frame["diffuse"], 0.07)
    frame["specular_albedo"] = np.full_like(frame["diffuse"], 0.04)
    frame["emission"][:] = [0.0, 0.1, 0.2]
    denoiser = Denoiser(WIDTH, HEIGHT, device, method)
    for count in range(1, 9):
        result = denoiser.denoise(frame)
        expected = frame["diffuse"] + frame["specular"] + frame["emission"]
        np.testing.assert_allclose(result["color"], expected, rtol=1e-5)
        np.testing.assert_allclose(result["variance"], 0.0, atol=1e-8)
        np.testing.assert_array_equal(result["history_length"], count if method == "svgf" else 1)
        assert result["repaired"] == 0
        assert all(result[name].dtype == np.float32 for name in ("color", "variance", "history_length"))


@pytest.mark.parametrize(("alpha", "frames"), [(0.0, 12), (0.2, 5)])
def test_a_still_view_is_the_mean_of_its_frames(device, alpha, frames):
    rng = np.random.default_rng(1)
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf", settings=DenoiseSettings(alpha=alpha, levels=0))
    noisy = [add_noise(make_frame(), rng) for _ in range(frames)]
    for frame in noisy:
        result = denoiser.denoise(frame)
    np.testing.assert_allclose(result["color"], np.mean([frame["diffuse"] for frame in noisy], axis=0), rtol=1e-5)


def test_background_passes_through(device):
    rng = np.random.default_rng(2)
    for method in METHODS:
        frame = make_frame()
        sky = np.s_[:6]
        frame["object_id"][sky], frame["depth"][sky], frame["normal"][sky] = 0, 1e10, 0.0
        frame["diffuse"][sky], frame["diffuse_albedo"][sky] = 0.0, 0.0
        frame["emission"][sky] = rng.gamma(1.0, 1.0, frame["emission"][sky].shape)
        denoiser = Denoiser(WIDTH, HEIGHT, device, method)
        for _ in range(3):
            result = denoiser.denoise(frame)
            np.testing.assert_array_equal(result["color"][sky], frame["emission"][sky])
            np.testing.assert_allclose(result["color"][6:], 0.5, rtol=1e-5)
            assert not result["history_length"][sky].any()


def test_textures_are_not_blurred(device):
    rng = np.random.default_rng(3)
    frame = make_frame()
    frame["diffuse_albedo"] = rng.uniform(0.05, 1.0, frame["diffuse"].shape).astype(np.float32)
    frame["diffuse"] = 2.0 * frame["diffuse_albedo"]
    for method in METHODS:
        result = Denoiser(WIDTH, HEIGHT, device, method).denoise(frame)
        np.testing.assert_allclose(result["color"], frame["diffuse"], rtol=1e-5)


def test_energy_is_kept_where_the_albedo_is_constant(device):
    rng = np.random.default_rng(4)
    for method, tolerance in (("svgf", 0.02), ("eaw", 0.06)):
        denoiser = Denoiser(WIDTH, HEIGHT, device, method)
        noisy, denoised = [], []
        for _ in range(8):
            frame = add_noise(make_frame(), rng, strength=0.3)
            noisy.append(frame["diffuse"].mean(dtype=float))
            denoised.append(denoiser.denoise(frame)["color"].mean(dtype=float))
        assert np.mean(denoised) == pytest.approx(np.mean(noisy), rel=tolerance)


def test_signals_are_filtered_apart(device):
    """A noise-free signal comes out as it is, whatever the other does."""
    rng = np.random.default_rng(5)
    frame = make_frame()
    frame["specular_albedo"] = np.ones_like(frame["diffuse"])
    frame["specular"] = np.zeros_like(frame["diffuse"])
    two = Denoiser(WIDTH, HEIGHT, device, "svgf")
    one = Denoiser(WIDTH, HEIGHT, device, "svgf")
    for _ in range(3):
        noisy = add_noise(frame, rng)
        both = two.denoise(noisy)
        alone = one.denoise({name: image for name, image in noisy.items() if not name.startswith("specular")})
        np.testing.assert_allclose(both["color"], alone["color"], rtol=1e-5)


def test_one_frame_after_the_other_is_the_reference_s(device):
    """All stages together, feedback included, on a scene with edges and motion."""
    from svgf.reference.denoiser import Denoiser as ReferenceDenoiser

    rng = np.random.default_rng(6)
    for method in METHODS:
        denoiser = Denoiser(WIDTH, HEIGHT, device, method)
        oracle = ReferenceDenoiser(None, WIDTH, HEIGHT, method, {})
        for step in range(6):
            frame = add_noise(put_square(make_frame(), 6 + 2 * step), rng)
            frame["motion"][frame["object_id"] == 2, 0] = -2.0
            actual, expected = denoiser.denoise(frame), oracle.denoise(frame)
            for name in ("color", "variance", "history_length"):
                np.testing.assert_allclose(actual[name], expected[name], rtol=1e-3, atol=1e-5, err_msg=name)


# --- What it does ----------------------------------------------------------------------------------------------------


def test_noise_is_reduced(device):
    rng = np.random.default_rng(7)
    truth = put_square(make_frame(), 15, radiance=2.0)
    for method, factor in (("svgf", 10.0), ("eaw", 2.0)):
        denoiser = Denoiser(WIDTH, HEIGHT, device, method)
        for _ in range(8):
            frame = add_noise(truth, rng, strength=0.5)
            result = denoiser.denoise(frame)
        noisy_error = np.sqrt(np.mean((frame["diffuse"] - truth["diffuse"]) ** 2))
        error = np.sqrt(np.mean((result["color"] - truth["diffuse"]) ** 2))
        assert error < noisy_error / factor, method


def test_history_follows_the_camera(device):
    """Everything moves by a fraction of a pixel and away from the camera; only what enters the frame is new."""
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    frame = make_frame()
    for step in range(5):
        frame["depth"][:] = 10.0 + step
        frame["motion"][:] = [-0.5, 0.0, -1.0]
        result = denoiser.denoise(frame)
    assert (result["history_length"][:, 5:] == 5.0).all()


def test_depth_is_expected_where_motion_says(device):
    """The same step away without expected depth in the motion: the depth test must refuse, unless it is unknown."""
    lengths = {}
    for name, motion, step in (("known", [0, 0, -1], 1.0), ("wrong", [0, 0, 0], 1.0), ("unknown", [0, 0], 0.5)):
        denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
        frame = make_frame()
        denoiser.denoise(frame)
        frame["depth"][:] += step
        frame["motion"] = np.broadcast_to(np.float32(motion), (HEIGHT, WIDTH, len(motion)))
        lengths[name] = denoiser.denoise(frame)["history_length"].max()
    assert lengths == {"known": 2.0, "wrong": 1.0, "unknown": 2.0}


# --- What it forgets -------------------------------------------------------------------------------------------------


def test_a_camera_cut_leaves_no_ghost(device):
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    assert denoiser.last_reset == ""
    for _ in range(5):
        denoiser.denoise(put_square(make_frame(radiance=8.0), 15, 40.0))
    denoiser.reset("camera cut")
    result = denoiser.denoise(make_frame(radiance=1.0))
    assert denoiser.last_reset == "camera cut"
    np.testing.assert_allclose(result["color"], 0.5, rtol=1e-5)
    assert (result["history_length"] == 1.0).all()
    denoiser.denoise(make_frame())
    assert denoiser.last_reset == ""


def test_a_moved_object_leaves_no_ghost(device):
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    wall = make_frame()
    for _ in range(5):
        denoiser.denoise(put_square(wall, 8))
    frame = put_square(wall, 20)
    frame["motion"][frame["object_id"] == 2, 0] = -12.0
    result = denoiser.denoise(frame)
    uncovered = result["history_length"][8:16, 8:18]
    assert (uncovered[1:-1, 1:-1] == 1.0).all()
    np.testing.assert_allclose(result["color"][8:16, 8:18], 0.5, rtol=1e-4)
    np.testing.assert_allclose(result["color"][8:16, 20:30], 2.5, rtol=1e-4)
    assert (result["history_length"][8:16, 20:30] == 6.0).all()


def test_a_turned_surface_leaves_no_ghost(device):
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    for _ in range(3):
        denoiser.denoise(make_frame(radiance=8.0))
    frame = make_frame(radiance=1.0)
    frame["normal"][:] = [0.0, 1.0, 0.0]
    np.testing.assert_allclose(denoiser.denoise(frame)["color"], 0.5, rtol=1e-5)


def test_other_signals_mean_another_history(device):
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    frame = make_frame()
    denoiser.denoise(frame)
    frame["direct"] = frame.pop("diffuse")
    frame["specular_albedo"] = np.zeros_like(frame["diffuse_albedo"])
    assert (denoiser.denoise(frame)["history_length"] == 1.0).all()
    assert denoiser.last_reset == "the signals changed"


def test_settings_change_between_frames(device):
    denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
    denoiser.denoise(make_frame())
    denoiser.settings = DenoiseSettings(levels=2)
    assert (denoiser.denoise(make_frame())["history_length"] == 2.0).all()


# --- What may not harm it: also tests/hard_cases/test_denoiser.py -----------------------------------------------------


@pytest.mark.parametrize("scale", [1e-4, 1e5])
def test_the_scale_of_the_scene_does_not_matter(device, scale):
    rng = np.random.default_rng(10)
    frames = [add_noise(put_square(make_frame(), 15), rng) for _ in range(3)]
    results = []
    for factor in (1.0, scale):
        denoiser = Denoiser(WIDTH, HEIGHT, device, "svgf")
        for frame in frames:
            result = denoiser.denoise({**frame, "depth": frame["depth"] * np.float32(factor)})
        results.append(result)
    np.testing.assert_allclose(results[1]["color"], results[0]["color"], rtol=1e-3)


# --- What it says ----------------------------------------------------------------------------------------------------


def change(frame, **images):
    return {name: image for name, image in {**frame, **images}.items() if image is not None}


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ({"diffuse": None}, "signals are missing.*Give"),
        ({"color": make_frame()["diffuse"]}, "signals are diffuse, color"),
        ({"normal": None}, '"normal".*is missing'),
        ({"motion": None}, '"motion".*is missing. Give zeros'),
        ({"diffuse_albedo": None}, '"diffuse_albedo".*is missing'),
        ({"difuse": make_frame()["diffuse"]}, 'Did you mean "diffuse"'),
        ({"depth": np.ones((4, 4), np.float32)}, r'"depth" has the shape \[4, 4\]. It needs \[24, 40\]'),
        ({"diffuse": np.ones((HEIGHT, WIDTH, 4), np.float32)}, "Drop the alpha channel"),
        ({"motion": np.ones((HEIGHT, WIDTH), np.float32)}, r"It needs \[24, 40, 2\] or \[24, 40, 3\]"),
        ({"object_id": np.ones((HEIGHT, WIDTH), np.float32)}, r"not whole numbers. Convert it: .*np.int32"),
        ({"normal": "up"}, '"normal" is a str'),
        ({"normal": np.full((HEIGHT, WIDTH, 3), "up")}, '"normal" holds <U2, not numbers'),
        ({"window": [0.0, 1.0]}, '"window" is not four numbers'),
    ],
)
def test_inputs_are_checked(device, images, message):
    with pytest.raises(InputError, match=message):
        Denoiser(WIDTH, HEIGHT, device, "svgf").denoise(change(make_frame(), **images))


def test_inputs_are_taken_as_they_come(device):
    """float64, transposed in memory, [H, W, 1], and without what is optional."""
    frame = make_frame()
    frame["diffuse"] = np.asfortranarray(frame["diffuse"].astype(np.float64))
    frame["depth"] = frame["depth"][..., None]
    frame["object_id"] = frame["object_id"].astype(np.int64)
    frame["roughness"] = np.ones((HEIGHT, WIDTH), np.float32)
    frame = change(frame, emission=None, depth_gradient=None)
    np.testing.assert_allclose(Denoiser(WIDTH, HEIGHT, device, "svgf").denoise(frame)["color"], 0.5, rtol=1e-5)
    frame = change(frame, object_id=None, diffuse=None, diffuse_albedo=None, color=frame["diffuse"])
    np.testing.assert_allclose(Denoiser(WIDTH, HEIGHT, device, "svgf").denoise(frame)["color"], 0.5, rtol=1e-5)


def test_inputs_are_not_changed(device):
    frame = add_noise(make_frame(), np.random.default_rng(11))
    before = {name: image.copy() for name, image in frame.items()}
    Denoiser(WIDTH, HEIGHT, device, "svgf").denoise(frame)
    for name, image in frame.items():
        np.testing.assert_array_equal(image, before[name])


@pytest.mark.parametrize(("width", "height"), [(0, 1), (1, -1), (1.5, 1)])
def test_sizes_are_checked(width, height):
    with pytest.raises(InputError, match="Give a whole number of at least 1"):
        Denoiser(width, height, "reference")


def test_methods_are_checked():
    with pytest.raises(InputError, match='Did you mean "svgf'):
        Denoiser(8, 8, "reference", method="svg")


@pytest.mark.gpu
def test_gpu_arrays_come_and_go_without_the_host():
    cupy = pytest.importorskip("cupy")
    rng = np.random.default_rng(12)
    on_host, on_gpu = Denoiser(WIDTH, HEIGHT, "cuda"), Denoiser(WIDTH, HEIGHT, "cuda")
    for _ in range(3):
        frame = add_noise(make_frame(), rng)
        expected = on_host.denoise(frame)
        actual = on_gpu.denoise({name: cupy.asarray(image) for name, image in frame.items()})
        for name in ("color", "variance", "history_length"):
            assert isinstance(actual[name], cupy.ndarray)
            np.testing.assert_array_equal(actual[name].get(), expected[name])


@pytest.mark.gpu
def test_gpu_arrays_are_refused_on_the_cpu():
    cupy = pytest.importorskip("cupy")
    with pytest.raises(InputError, match='device="cuda"'):
        Denoiser(WIDTH, HEIGHT, "cpu").denoise({name: cupy.asarray(image) for name, image in make_frame().items()})


# --- Streams ---------------------------------------------------------------------------------------------------------


class _Stream:
    """A stream of a library that follows the protocol."""

    def __init__(self, address):
        self.address = address

    def __cuda_stream__(self):
        return 0, self.address


@pytest.mark.gpu
def test_a_frame_runs_on_the_caller_s_stream():
    """The inputs are still being made on the stream when the frame is queued, and are overwritten right after it."""
    cupy = pytest.importorskip("cupy")
    rng = np.random.default_rng(13)
    height, width = 270, 480
    frames = [add_noise(make_frame(height, width), rng) for _ in range(6)]
    on_host = Denoiser(width, height, "cuda")
    expected = [on_host.denoise(frame)["color"] for frame in frames]
    stream = cupy.cuda.Stream(non_blocking=True)
    delay = cupy.RawKernel(
        'extern "C" __global__ void delay(long long n) { long long t = clock64(); while (clock64() - t < n); }', "delay"
    )
    for handle in (stream, stream.ptr, _Stream(stream.ptr)):
        denoiser = Denoiser(width, height, "cuda")
        with stream:
            source = [{name: cupy.asarray(image) for name, image in frame.items()} for frame in frames]
            inputs = {name: cupy.zeros_like(image) for name, image in source[0].items()}
            colors = []
            for frame in source:
                delay((1,), (1,), (2_000_000,))  # a millisecond
                for name, image in frame.items():
                    inputs[name][...] = image
                result = denoiser.denoise(inputs, stream=handle)
                for image in inputs.values():
                    image.fill(0)
                colors.append(result["color"] * 1.0)
        stream.synchronize()
        for color, right in zip(colors, expected, strict=True):
            np.testing.assert_array_equal(color.get(), right)
        assert denoiser.repaired == 0


@pytest.mark.gpu
def test_frames_on_several_streams_come_one_after_the_other():
    cupy = pytest.importorskip("cupy")
    rng = np.random.default_rng(14)
    frames = [add_noise(make_frame(), rng) for _ in range(8)]
    on_host, denoiser = Denoiser(WIDTH, HEIGHT, "cuda"), Denoiser(WIDTH, HEIGHT, "cuda")
    streams = [cupy.cuda.Stream(non_blocking=True) for _ in range(3)]
    for index, frame in enumerate(frames):
        stream = streams[index % 3] if index % 4 else None  # the device's own in between
        with stream or cupy.cuda.Stream.null:
            result = denoiser.denoise({name: cupy.asarray(image) for name, image in frame.items()}, stream=stream)
            actual = result["color"].get()
        np.testing.assert_array_equal(actual, on_host.denoise(frame)["color"])


@pytest.mark.gpu
def test_torch_streams_are_taken():
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(15)
    on_host, denoiser = Denoiser(WIDTH, HEIGHT, "cuda"), Denoiser(WIDTH, HEIGHT, "cuda")
    stream = torch.cuda.Stream()
    for _ in range(3):
        frame = add_noise(make_frame(), rng)
        with torch.cuda.stream(stream):
            inputs = {name: torch.from_numpy(image).cuda(non_blocking=True) for name, image in frame.items()}
            color = denoiser.denoise(inputs, stream=stream)["color"]
            assert isinstance(color, torch.Tensor)
            actual = (color + 0.0).cpu().numpy()
        np.testing.assert_array_equal(actual, on_host.denoise(frame)["color"])


@pytest.mark.parametrize("stream", [1, _Stream(7)])
def test_streams_are_for_the_gpu(stream):
    with pytest.raises(InputError, match='runs on "cpu".*device="cuda"'):
        Denoiser(WIDTH, HEIGHT, "cpu").denoise(make_frame(), stream=stream)


@pytest.mark.gpu
def test_streams_are_checked():
    pytest.importorskip("cupy")
    with pytest.raises(InputError, match="The stream is a str"):
        Denoiser(WIDTH, HEIGHT, "cuda").denoise(make_frame(), stream="fast")
