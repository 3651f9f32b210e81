# SPDX-License-Identifier: Apache-2.0
"""The denoiser alone, for images from any renderer."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .devices import Device, open_device
from .diagnostics import DIAGNOSTICS
from .errors import InputError
from .reference.denoiser import MAX_SIGNALS, SIGNAL_ALBEDOS
from .settings import METHODS, DenoiseSettings, check_name


@dataclass(frozen=True)
class _Image:
    """channels: the numbers of channels that the image may have. meaning: for messages."""

    channels: tuple[int, ...]
    meaning: str
    whole: bool = False


_COLOR = (3,)
_IMAGES = {
    **{name: _Image(_COLOR, "noisy radiance") for name in SIGNAL_ALBEDOS},
    "diffuse_albedo": _Image(_COLOR, "albedo"),
    "specular_albedo": _Image(_COLOR, "albedo"),
    "albedo": _Image(_COLOR, "albedo of color"),
    "roughness": _Image((1,), "roughness of what the specular signal shows, 0 to 1"),
    "emission": _Image(_COLOR, "radiance that the surface itself sends out, and the background's"),
    "normal": _Image((3,), "world-space normal"),
    "depth": _Image((1,), "distance along the camera's axis, 1e10 on the background"),
    "depth_gradient": _Image((2,), "change of depth per pixel to the right and down"),
    "motion": _Image((2, 3), "previous pixel position minus this one; if known, expected previous depth minus depth"),
    "object_id": _Image((1,), "number of the object, 0 on the background", whole=True),
}
# A tracer's images that no method reads: a renderer can hand over all it has.
_IGNORED = frozenset({"material_id", "hit_distance"})

_DLPACK_HOST = (1, 3)  # kDLCPU, kDLCUDAHost
_LEGACY_STREAM = 1


class Denoiser:
    """Denoises the frames of one view, one after the other.

    width, height: of the images, pixels. device: a name for ``open_device``, or an opened Device. method: "svgf+",
    ours, "svgf" [Schied17], both of which reuse the frames before, "eaw" [Dammertz10] or "none". settings: see
    DenoiseSettings; may be set again between frames. diagnostics: also make the images that ``diagnostics`` returns.

    Raises InputError, DeviceError, OutOfMemory.
    """

    def __init__(
        self,
        width: int,
        height: int,
        device: str | Device = "auto",
        method: str = "svgf+",
        settings: DenoiseSettings | None = None,
        diagnostics: bool = False,
    ) -> None:
        for name, value in (("width", width), ("height", height)):
            if not isinstance(value, (int, np.integer)) or value < 1:
                raise InputError(f"Denoiser {name} is {value!r}.", "Give a whole number of at least 1.")
        check_name("Denoiser method", method, METHODS)
        self.width, self.height, self.method = int(width), int(height), method
        self.device = open_device(device) if isinstance(device, str) else device
        self._settings = settings or DenoiseSettings()
        self._native = self.device.denoiser(self.width, self.height, method, self._settings.as_dict())
        self._diagnoses = diagnostics
        self._diagnostics: dict[str, Any] = {}
        self._signals: list[str] = []
        self._next_reset = "first frame"
        self._last_reset = ""

    @property
    def settings(self) -> DenoiseSettings:
        return self._settings

    @settings.setter
    def settings(self, settings: DenoiseSettings) -> None:
        self._native.set_settings(settings.as_dict())
        self._settings = settings

    @property
    def last_reset(self) -> str:
        """Why the last frame started without history; empty if it went on."""
        return self._last_reset

    def reset(self, reason: str) -> None:
        """The next frame starts without history, as after a camera cut."""
        self._next_reset = reason

    @property
    def buffers(self) -> dict[str, int]:
        """Bytes of each piece of memory that is kept between frames. The results' are the caller's."""
        return dict(self._native.buffers())

    @property
    def repaired(self) -> int:
        """How many values of the last frame were NaN, infinite or out of range. Waits for the device."""
        return int(self._native.repaired())

    @property
    def fireflies(self) -> tuple[int, float]:
        """svgf+: how many samples of the last frame were scaled down to the firefly limit, and the light that was cut
        from them: luminance over albedo, summed over the pixels. Waits for the device."""
        samples, light = self._native.fireflies()
        return int(samples), float(light)

    @property
    def diagnostics(self) -> dict[str, Any]:
        """Of the last frame, images [H, W] of its library: "motion_error" in pixels, "reset_reason" (``ResetReason``),
        "repaired_values" and "suppressed_light"; see ``svgf.diagnostics``. Empty before the first frame. Raises
        InputError where the denoiser was not made with diagnostics."""
        if not self._diagnoses:
            raise InputError("This denoiser makes no diagnostics.", "Make it with diagnostics=True.")
        return dict(self._diagnostics)

    @property
    def history(self) -> dict[str, np.ndarray]:
        """svgf and svgf+: what the next frame starts from, numpy float32: per signal "color0" [H, W, 3], the temporal
        mean of radiance over albedo, and for svgf+ "frames0" [H, W] in it; "1" for the second signal. Empty without
        history. Waits for the device."""
        return {name: np.asarray(image, np.float32) for name, image in self._native.history_images().items()}

    def denoise(self, inputs: Mapping[str, Any], stream: Any = None) -> dict[str, Any]:
        """Denoises the next frame.

        inputs: images by name, float32 [H, W, C], row 0 on top; numpy arrays, or arrays of any library that knows
        DLPack (CuPy, PyTorch, JAX), on the host or, with device "cuda", on its GPU, where they are not copied.

        - one or two signals of linear radiance: "diffuse" and "specular", or "direct" and "indirect", or "color".
        - "diffuse_albedo", "specular_albedo", for "color" "albedo" (optional): [0, 1]; signals are divided by theirs,
          direct and indirect by the sum. "emission" (optional): radiance that is not filtered.
        - "roughness" (svgf+, optional) [H, W]: of the specular signal, [0, 1]; rough reflections are filtered as
          diffuse light is, without it all are taken for sharp.
        - "normal": unit, world space. "depth" [H, W]: along the camera's axis, 1e10 on the background.
        - "motion" (needed by svgf): [H, W, 2] previous pixel position minus this one, x right, y down; a third channel,
          expected previous depth minus this depth, lets history survive a camera that moves forward.
        - "depth_gradient" (optional) [H, W, 2]: change of depth per pixel in the surface's plane; else differences.
        - "object_id" (optional) int32 [H, W]: 0 on the background; else background is where depth is 1e10 or more.
        - "window" (eaw): left, right, bottom, top of the image one unit ahead of the camera; else that of Blender's
          default camera.

        Returns images of the same library, float32: "color" [H, W, 3]; "variance" [H, W] of luminance that the filter
        left (svgf; else 0); "history_length" [H, W] in frames, 0 on the background; and for arrays on the host
        "repaired", as the property of this name, which costs the wait that arrays on the GPU are spared. Bad values do
        no harm to pixels around them.

        stream (device "cuda"): the CUDA stream to work on, as a cupy.cuda.Stream, a torch.cuda.Stream, anything else
        with ``__cuda_stream__``, or the address as an int (1: the legacy default stream). The call returns once the
        frame is queued there; inputs may be results that the stream has yet to compute, and the results may be used on
        it at once. Memory of results that are dropped serves later frames on the same stream. Without it a stream of
        the device's own is used, which keeps order with the legacy default one, on which CuPy and PyTorch work unless
        told otherwise. Either way arrays of other streams are waited for as DLPack says. Frames on different streams
        come one after the other.

        Raises InputError naming the image and the remedy, DeviceError, Interrupted; after them history starts afresh.
        """
        arrays = self._check(inputs)
        on_stream = {}
        if stream is not None:
            on_stream = {"stream": _stream_address(stream, self.device.name)}
        for name, array in arrays.items():
            if self.device.name == "cuda" and _dlpack_device(array) not in _DLPACK_HOST:
                arrays[name] = array.__dlpack__(stream=on_stream.get("stream", _LEGACY_STREAM))
        signals = [name for name in SIGNAL_ALBEDOS if name in arrays]
        if not self._next_reset and signals != self._signals:
            self._next_reset = "the signals changed"
        try:
            result = self._native.denoise(
                arrays, reset=bool(self._next_reset), diagnostics=self._diagnoses, **on_stream
            )
            repaired = {"repaired": self.repaired} if _dlpack_device(inputs[signals[0]]) in _DLPACK_HOST else {}
        except BaseException:
            self._next_reset = "the last frame was not finished"
            raise
        self._signals = signals
        self._last_reset, self._next_reset = self._next_reset, ""
        from_native = self._converter(inputs[signals[0]])
        images = {name: from_native(image) for name, image in result.items()}
        self._diagnostics = {name: images.pop(name) for name in DIAGNOSTICS if name in images}
        return {**images, **repaired}

    def _check(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        for name in inputs:
            if name not in _IMAGES and name not in _IGNORED and name != "window":
                check_name("A denoiser image", name, tuple(_IMAGES))
        signals = [name for name in SIGNAL_ALBEDOS if inputs.get(name) is not None]
        if not signals or len(signals) > MAX_SIGNALS or len({_split(name) for name in signals}) > 1:
            raise InputError(
                f"The signals are {', '.join(signals) or 'missing'}.",
                'Give "diffuse", "specular" or both; "direct", "indirect" or both; or "color".',
            )
        needed = ["normal", "depth", *(["motion"] if self.method in ("svgf", "svgf+") else [])]
        needed += [name for signal in signals for name in SIGNAL_ALBEDOS[signal] if name != "albedo"]
        for name in needed:
            if inputs.get(name) is None:
                remedy = "Give zeros [H, W, 2] if nothing moves." if name == "motion" else "Every frame needs it."
                raise InputError(f'The image "{name}" ({_IMAGES[name].meaning}) is missing.', remedy)
        arrays = {
            name: self._check_image(name, inputs[name], image)
            for name, image in _IMAGES.items()
            if inputs.get(name) is not None
        }
        if inputs.get("window") is not None:
            window = np.asarray(inputs["window"], np.float64)
            if window.shape != (4,) or not np.isfinite(window).all():
                raise InputError('"window" is not four numbers.', "Give left, right, bottom, top.")
            arrays["window"] = window
        return arrays

    def _check_image(self, name: str, array: Any, image: _Image) -> Any:
        shape = getattr(array, "shape", None)
        if shape is None:
            raise InputError(f'The image "{name}" is a {type(array).__name__}.', "Give a numpy array or a GPU array.")
        size = (self.height, self.width)
        shape = tuple(shape)
        channels = shape[2] if len(shape) == 3 else 1
        if shape[:2] != size or len(shape) not in (2, 3) or channels not in image.channels:
            wanted = " or ".join(str([*size, *([c] if c > 1 else [])]) for c in image.channels)
            remedy = "Drop the alpha channel: image[..., :3]." if shape == (*size, 4) else f"It needs {wanted}."
            raise InputError(f'The image "{name}" has the shape {list(shape)}.', remedy)
        if not isinstance(array, np.ndarray) and _dlpack_device(array) not in _DLPACK_HOST:
            return self._check_gpu_image(name, array, image)
        # Also for a host array of another library; only what numpy cannot read is left over.
        array = np.asarray(array)
        if array.dtype.kind not in ("iu" if image.whole else "fiu"):
            kind = "whole numbers" if image.whole else "numbers"
            raise InputError(
                f'The image "{name}" holds {array.dtype}, not {kind}.',
                f"Convert it: image.astype({'np.int32' if image.whole else 'np.float32'}).",
            )
        dtype = np.int32 if image.whole else np.float64 if self.device.name == "reference" else np.float32
        with np.errstate(over="ignore"):  # to infinity, which the denoiser repairs and counts
            return np.ascontiguousarray(array.reshape(*size, channels) if channels > 1 else array.reshape(size), dtype)

    def _check_gpu_image(self, name: str, array: Any, image: _Image) -> Any:
        if self.device.name == "cpu":
            raise InputError(
                f'The image "{name}" is on a GPU, but this denoiser runs on the CPU.',
                'Make it with device="cuda", or give numpy arrays.',
            )
        dtype = str(array.dtype).rpartition(".")[2]
        wanted = "int32" if image.whole else "float32"
        if dtype != wanted:
            raise InputError(f'The image "{name}" holds {dtype}.', f"Convert it to {wanted} on the GPU.")
        if self.device.name == "reference" and type(array).__module__.partition(".")[0] != "cupy":
            raise InputError(
                f'The image "{name}" is on a GPU.', 'The reference reads CuPy and numpy arrays; else use device="cuda".'
            )
        return array

    def _converter(self, like: Any) -> Any:
        """Turns a native result into a float32 array of the library of `like`."""
        if isinstance(like, np.ndarray):
            return lambda image: np.asarray(self.device.to_numpy(image), np.float32)
        if self.device.name == "reference":
            return lambda image: image.astype(np.float32)
        if hasattr(like, "__array_namespace__"):
            library = like.__array_namespace__()
        else:
            library = sys.modules[type(like).__module__.partition(".")[0]]
        if _dlpack_device(like) in _DLPACK_HOST:
            return lambda image: library.from_dlpack(np.asarray(self.device.to_numpy(image)))
        return library.from_dlpack


def _split(signal: str) -> int:
    """Which way of splitting light a signal belongs to."""
    return ("diffuse", "specular", "direct", "indirect", "color").index(signal) // 2


def _stream_address(stream: Any, device: str) -> int:
    """The address of a CUDA stream of any library."""
    if device != "cuda":
        raise InputError(f'A stream was given, but this denoiser runs on "{device}".', 'Make it with device="cuda".')
    if hasattr(stream, "__cuda_stream__"):
        protocol = stream.__cuda_stream__
        address = (protocol() if callable(protocol) else protocol)[1]
    else:
        address = next((getattr(stream, name) for name in ("ptr", "cuda_stream") if hasattr(stream, name)), stream)
    if isinstance(address, bool) or not hasattr(address, "__index__"):
        raise InputError(
            f"The stream is a {type(stream).__name__}.",
            "Give a cupy.cuda.Stream, a torch.cuda.Stream or the address of a CUDA stream.",
        )
    return int(address) or _LEGACY_STREAM  # 0 is the legacy default stream's other name


def _dlpack_device(array: Any) -> int:
    """DLPack's number of the kind of device that an array is on; the host for what does not know DLPack."""
    known = getattr(array, "__dlpack_device__", None)
    return int(known()[0]) if known else _DLPACK_HOST[0]
