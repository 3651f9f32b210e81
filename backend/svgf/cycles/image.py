# SPDX-License-Identifier: Apache-2.0
"""A multi-layer EXR file as layers and passes, of which some can be replaced while all else stays as it is."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..io import exr
from ..io.files import replacing
from .passes import PASSES, todays_name

_LARGEST_HALF = 65504.0
# Compressing again what they gave changes it again.
_LOSSY = ("B44_COMPRESSION", "B44A_COMPRESSION", "DWAA_COMPRESSION", "DWAB_COMPRESSION")


@dataclass(frozen=True)
class Layout:
    """What a file holds. layers: by name ("" where channels have no layer), then by pass (names of Blender 5), then by
    suffix, where the channel is: the number of its part and its full name."""

    width: int
    height: int
    layers: Mapping[str, Mapping[str, Mapping[str, tuple[int, str]]]]

    @property
    def size(self) -> tuple[int, int]:
        return self.width, self.height

    def has(self, layer: str, name: str) -> bool:
        """Whether the layer has the pass with all the channels that svgf reads."""
        return set(PASSES[name].channels) <= self.layers.get(layer, {}).get(name, {}).keys()


def read_layout(path: str | os.PathLike[str]) -> Layout:
    """Reads the header alone, and makes sure that the file is as long as it must be. Raises InputError."""
    return _layout(exr.decode(path, header_only=True).parts, path)


class MultilayerImage:
    """A file in memory. Raises InputError where it cannot be read."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._file = exr.decode(path)
        self.layout = _layout(self._file.parts, path)

    def read(self, layer: str, name: str) -> np.ndarray | None:
        """A pass, float32 [H, W] for one channel and [H, W, C] for more, row 0 on top; None where it is missing."""
        if not self.layout.has(layer, name):
            return None
        planes = [self._channel(layer, name, suffix).pixels for suffix in PASSES[name].channels]
        return np.ascontiguousarray(planes[0] if len(planes) == 1 else np.stack(planes, axis=-1), np.float32)

    def replace(self, layer: str, name: str, pixels: np.ndarray) -> int:
        """pixels [H, W, C] take the place of a pass, in the type that the file has. Returns how many of them a half
        cannot hold and were cut to its largest number."""
        cut = 0
        for index, suffix in enumerate(PASSES[name].channels):
            channel = self._channel(layer, name, suffix)
            plane = pixels[..., index]
            if channel.pixels.dtype == np.float16:
                cut += int((np.abs(plane) > _LARGEST_HALF).sum())
                plane = np.clip(plane, -_LARGEST_HALF, _LARGEST_HALF)
            channel.pixels = np.ascontiguousarray(plane, channel.pixels.dtype)
        return cut

    def add(self, layer: str, name: str, plane: np.ndarray) -> None:
        """A pass of one channel, V, float32 [H, W], beside the layer's Combined; takes the place of one of its name."""
        import OpenEXR

        part, beside = self.layout.layers[layer]["Combined"]["R"]
        prefix = beside.removesuffix("R").removesuffix("Combined.")
        full_name = f"{prefix}{name}.V"
        plane = np.ascontiguousarray(plane, np.float32)
        self._file.parts[part].channels[full_name] = OpenEXR.Channel(full_name, plane)

    def write(self, path: str | os.PathLike[str], attributes: Mapping[str, str | int | float]) -> None:
        """Writes the file, whole or not at all: the same parts, headers, channels and types, and attributes beside
        those of the first part. What was compressed with loss is written with ZIP: compressed with loss again, the
        channels that nobody replaced would change. Raises InputError where it cannot be written."""
        import OpenEXR

        for part in self._file.parts:
            if part.header["compression"] in [getattr(OpenEXR, name) for name in _LOSSY]:
                part.header["compression"] = OpenEXR.ZIP_COMPRESSION
        self._file.parts[0].header.update(attributes)
        encoded = io.BytesIO()
        self._file.write(encoded)
        with replacing(path) as file:
            file.write(encoded.getbuffer())

    def _channel(self, layer: str, name: str, suffix: str):
        part, channel = self.layout.layers[layer][name][suffix]
        return self._file.parts[part].channels[channel]


def _layout(parts: Sequence, path: str | os.PathLike[str]) -> Layout:
    layers: dict[str, dict[str, dict[str, tuple[int, str]]]] = {}
    sizes = set()
    for index, part in enumerate(parts):
        low, high = part.header["dataWindow"]
        sizes.add((int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1))
        for channel in part.header["channels"]:
            # Other writers of multi-part files put layer and pass into the name of the part alone.
            image, _, suffix = channel.name.rpartition(".")
            layer, _, name = (image or part.header.get("name") or "Combined").rpartition(".")
            found = layers.setdefault(layer, {}).setdefault(todays_name(name), {})
            if suffix in found:
                raise InputError(
                    f'{os.fspath(path)} holds the channel "{channel.name}" twice.',
                    "Write stereo views to files of their own (Output > Stereoscopy > Individual).",
                )
            if channel.xSampling != 1 or channel.ySampling != 1:
                raise InputError(
                    f'{os.fspath(path)}: channel "{channel.name}" is subsampled.',
                    "Save the image without chroma subsampling.",
                )
            found[suffix] = (index, channel.name)
    if len(sizes) > 1:
        raise InputError(f"The parts of {os.fspath(path)} differ in size.", "Write all passes in one size.")
    return Layout(*sizes.pop(), layers)
