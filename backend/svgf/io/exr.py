# SPDX-License-Identifier: Apache-2.0
"""Multi-layer OpenEXR: frames out with Blender 5's channel names, and the files of Blender 4.5 to 5.2 in.

Everything is written as float32 with lossless ZIP compression. Half would save half of the disk, but it ends at 65504,
which radiance near a lamp passes, and rounds by up to 0.05 %, more than the difference between our devices.

Encoding and decoding go through memory, so that an operating system's error (a full disk) arrives as itself.
"""

from __future__ import annotations

import io
import mmap
import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..frame import Frame
from ..passes import DIAGNOSTIC_PASSES, PASSES
from .files import file_error, replacing

_MAGIC = b"\x76\x2f\x31\x01"
_MULTI_PART_FLAG = 0x1000
# A file may expand a thousandfold (ZIP's own limit), but a damaged header must not make us allocate a terabyte.
_FREE_BYTES = 4 << 30
_LARGEST_EXPANSION = 1100
# The order in which the channels of a pass are stacked; other suffixes follow, sorted.
_CHANNEL_ORDER = "RGBAXYZWV"


def write(
    frame: Frame,
    path: str | os.PathLike[str],
    layer: str = "ViewLayer",
    metadata: Mapping[str, str | int | float] | None = None,
) -> None:
    """Writes a frame, whole or not at all.

    metadata: attributes of the header, beside the units of each pass (``svgf.unit.PASS``) and the frame number.
    Raises InputError, naming the path, where it cannot be written.
    """
    import OpenEXR

    header: dict[str, object] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "colorInteropID": "lin_rec709_scene",
        "Software": "svgf",
        "Frame": f"{frame.frame:03d}",
    }
    channels = {}
    diagnosed = frame.reset_reason is not None
    for entry in [*PASSES.values(), *(DIAGNOSTIC_PASSES.values() if diagnosed else ())]:
        header[f"svgf.unit.{entry.name}"] = entry.unit
        planes = entry.image(frame).reshape(frame.height, frame.width, len(entry.channels))
        for index, channel in enumerate(entry.channels):
            channels[f"{layer}.{entry.name}.{channel}"] = np.ascontiguousarray(planes[..., index], np.float32)
    header.update(metadata or {})

    encoded = io.BytesIO()
    OpenEXR.File(header, channels).write(encoded)
    with replacing(path) as file:
        file.write(encoded.getbuffer())


def read(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The passes of a file, whatever number of parts it has.

    Keys are layer and pass, as in ``ViewLayer.Combined``; an image without layers is ``Combined``. Values are float32
    (uint32 where the file says so), [H, W] for one channel and [H, W, C] for more, in the order RGBA or XYZW, row 0 on
    top, covering the data window. Raises InputError for anything that is not such a file.
    """
    planes: dict[str, dict[str, np.ndarray]] = {}
    for part in decode(path).parts:
        for name, channel in part.channels.items():
            if channel.xSampling != 1 or channel.ySampling != 1:
                raise InputError(
                    f'{os.fspath(path)}: channel "{name}" is subsampled.', "Save the image without chroma subsampling."
                )
            image, _, suffix = name.rpartition(".")
            pixels = channel.pixels
            planes.setdefault(image or _part_layer(part), {})[suffix] = (
                pixels if pixels.dtype == np.uint32 else pixels.astype(np.float32)
            )
    return {image: _stack(parts) for image, parts in planes.items()}


def find_pass(passes: Mapping[str, np.ndarray], name: str, path: str | os.PathLike[str]) -> np.ndarray:
    """The pass of that name in the first layer that has it. Raises InputError that lists what there is."""
    for key, pixels in passes.items():
        if key == name or key.endswith(f".{name}"):
            return pixels
    raise InputError(f'{os.fspath(path)} has no pass "{name}".', f"It has: {', '.join(sorted(passes))}.")


def is_complete(path: str | os.PathLike[str]) -> bool:
    """Whether a file can be read to its end: what ``--resume`` asks before it skips a frame."""
    try:
        decode(path)
    except InputError:
        return False
    return True


def decode(path: str | os.PathLike[str], header_only: bool = False):
    """The file as the OpenEXR package holds it, one channel apiece; header_only: without pixels, which takes a moment
    whatever the size, and still finds a file that was cut off. Raises InputError for anything that is not such a file.
    """
    import OpenEXR

    try:
        # A map of the file: of a long sequence of headers nothing else is read.
        data = _map(path) if header_only else Path(path).read_bytes()
    except OSError as error:
        raise file_error("read", path, error) from error
    if data[: len(_MAGIC)] != _MAGIC:
        raise InputError(f"{os.fspath(path)} is not an OpenEXR file.", "svgf reads .exr files.")
    try:
        headers = OpenEXR.File(data if header_only else io.BytesIO(data), separate_channels=True, header_only=True)
        parts = headers.parts
        if any(part.header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile) for part in parts):
            raise InputError(f"{os.fspath(path)} is a deep image.", "svgf reads flat images.")
        needed = sum(map(_expanded_bytes, parts))
        if needed > max(_FREE_BYTES, _LARGEST_EXPANSION * len(data)):
            raise InputError(
                f"{os.fspath(path)} is damaged: its header asks for {needed >> 30} GiB.", "Render it again."
            )
        if header_only:
            _check_length(data, [part.header["type"] == OpenEXR.tiledimage for part in parts])
            return headers
        image = OpenEXR.File(io.BytesIO(data), separate_channels=True)
        # Parts whose pixels cannot be decoded are left out without an exception.
        if len(image.parts) != len(parts):
            raise ValueError("a part cannot be decoded")
        return image
    # The binding turns the library's exceptions into these.
    except (
        RuntimeError,
        ValueError,
        TypeError,
        IndexError,
        OverflowError,
        MemoryError,
        OSError,
        struct.error,
    ) as error:
        raise InputError(f"{os.fspath(path)} is truncated or damaged.", "Render it again.") from error


def _map(path: str | os.PathLike[str]) -> mmap.mmap | bytes:
    with open(path, "rb") as file:
        if os.fstat(file.fileno()).st_size == 0:
            return b""
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _check_length(data: mmap.mmap, tiled: Sequence[bool]) -> None:
    """Raises ValueError where the last chunk that the file's offset tables name does not end within the file.

    tiled: of each part. The tables of all parts follow the headers, and the first chunk follows them: so their length
    need not be known.
    """
    is_multi_part = bool(struct.unpack_from("<I", data, 4)[0] & _MULTI_PART_FLAG)
    position = 8
    for _ in tiled:
        while data[position] != 0:
            for _ in ("name", "type"):
                position = data.find(b"\0", position) + 1
            position += 4 + struct.unpack_from("<i", data, position)[0]
        position += 1
    position += is_multi_part  # an empty header ends their list
    first, last = len(data), 0
    while position < first:
        offset = struct.unpack_from("<Q", data, position)[0]
        first, last = min(first, offset), max(last, offset)
        position += 8
    if position != first:
        raise ValueError("the offset table is incomplete")
    # A chunk: (the number of its part,) its coordinates, the size of its data, the data.
    part = struct.unpack_from("<i", data, last)[0] if is_multi_part else 0
    size_at = last + 4 * is_multi_part + (16 if tiled[part] else 4)
    if size_at + 4 + struct.unpack_from("<i", data, size_at)[0] > len(data):
        raise ValueError("the last chunk is incomplete")


def _expanded_bytes(part) -> int:
    low, high = part.header["dataWindow"]
    width, height = (int(high[axis]) - int(low[axis]) + 1 for axis in (0, 1))
    return width * height * 4 * len(part.header["channels"])


def _part_layer(part) -> str:
    """The pass of unqualified channels: the part's name, as other writers of multi-part files use it."""
    return part.header.get("name") or "Combined"


def _stack(planes: Mapping[str, np.ndarray]) -> np.ndarray:
    def rank(suffix: str) -> tuple[int, str]:
        return (_CHANNEL_ORDER.find(suffix) if suffix in _CHANNEL_ORDER else len(_CHANNEL_ORDER), suffix)

    ordered = [planes[suffix] for suffix in sorted(planes, key=rank)]
    return ordered[0] if len(ordered) == 1 else np.stack(ordered, axis=-1)
