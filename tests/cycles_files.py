# SPDX-License-Identifier: Apache-2.0
"""EXR sequences as Cycles writes them, of a shot that needs no Cycles, and ``svgf denoise`` run on them.

A card slides over a wall below the sky. Everything but the noise is known exactly: albedo, depth, vectors, and the mean
of the light, 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import OpenEXR
from typer.testing import CliRunner, Result

from svgf.cli import app
from svgf.cycles.passes import LIGHT_PASSES, PASSES
from svgf.io import exr

WIDTH, HEIGHT = 64, 36
_SKY_ROWS = 6
_CARD = 14

Passes = dict[str, np.ndarray]


@dataclass(frozen=True)
class Shot:
    """speed: of the card, pixels per frame to the right and down. pan: of the camera to the right. noise: relative
    standard deviation of light. seed: None for a new one each frame. view: another number is another place."""

    speed: tuple[float, float] = (3.0, 2.0)
    pan: float = 0.0
    noise: float = 0.5
    seed: int | None = None
    view: int = 0

    def passes(self, frame: int) -> Passes:
        """[H, W, C] by the names of Blender 5, float32."""
        rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
        left, top = 8 + (self.speed[0] - self.pan) * frame, 10 + self.speed[1] * frame
        card = (columns >= left) & (columns < left + _CARD) & (rows >= top) & (rows < top + _CARD)
        sky = (rows < _SKY_ROWS) & ~card
        u, v = np.where(card, columns - left, columns + self.pan * frame), np.where(card, rows - top, rows)
        checker = (np.floor(u / 9) + np.floor(v / 8)) % 2
        stripes = 0.3 + 0.2 * checker + 0.3 * (np.floor(u / 13) % 2)
        albedo = np.stack([stripes, 0.9 - stripes, np.full_like(u, 0.2 + 0.5 * (self.view % 2))], axis=-1)
        albedo[sky] = 0
        gloss = np.where((card & ~sky)[..., None], 0.3, np.where(sky, 0.0, 0.04)[..., None]) * np.ones(3)

        noise = np.random.default_rng(frame if self.seed is None else self.seed)
        light = [
            1.0 + self.noise * noise.uniform(-np.sqrt(3), np.sqrt(3), (HEIGHT, WIDTH, 1)) * np.ones(3) for _ in range(4)
        ]
        passes = {name: np.zeros((HEIGHT, WIDTH, 3)) for name in LIGHT_PASSES}
        passes["Diffuse Color"], passes["Glossy Color"] = albedo, gloss
        for name, each in zip(
            ("Diffuse Direct", "Diffuse Indirect", "Glossy Direct", "Glossy Indirect"), light, strict=True
        ):
            passes[name] = np.where(sky[..., None], 0.0, 0.5 * each)
        passes["Emission"] = np.where((card & (u < 2))[..., None], 2.0, 0.0) * np.ones(3)
        passes["Environment"] = np.where(sky[..., None], np.array([0.2, 0.3, 0.4]), 0.0)
        combined = sum(
            passes[f"{lobe} Color"] * (passes[f"{lobe} Direct"] + passes[f"{lobe} Indirect"])
            for lobe in ("Diffuse", "Glossy", "Transmission")
        )
        combined = combined + passes["Emission"] + passes["Environment"]
        passes["Combined"] = np.concatenate([combined, np.where(sky, 0.25, 1.0)[..., None]], axis=-1)
        passes["Denoising Albedo"] = albedo + gloss
        depth = np.where(card, 3.0, 5.0 + self.view)
        passes["Depth"] = np.where(sky, 1e10, depth)[..., None]
        normal = np.where(card[..., None], (0.0, -0.8, 0.6), (0.0, -1.0, 0.0))
        passes["Normal"] = np.where(sky[..., None], 0.0, normal)
        passes["Denoising Normal"] = passes["Normal"][..., [0, 2, 1]]
        x = np.where(card, self.pan - self.speed[0], self.pan)
        y = np.where(card, self.speed[1], 0.0)  # up: what moves down was above
        passes["Vector"] = np.stack([x, y, x, y], axis=-1)
        passes["Object Index"] = np.where(card, 7.0, 0.0)[..., None]
        passes["Denoising Depth"] = np.where(sky, 0.0, depth)[..., None]
        return {name: pixels.astype(np.float32) for name, pixels in passes.items()}


@dataclass(frozen=True)
class Format:
    """A Blender version's file. dtype: of the color passes; Depth stays float."""

    version: str = "5.0"
    dtype: type = np.float32
    compression: str = "ZIP"
    layers: tuple[str, ...] = ("ViewLayer",)
    without: tuple[str, ...] = ()
    change: Callable[[int, Passes], None] = field(default=lambda frame, passes: None)

    def write(self, path: Path, frame: int, shot: Shot = Shot()) -> Path:
        header = {"type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{self.compression}_COMPRESSION")}
        parts: list[tuple[str, dict[str, np.ndarray]]] = []
        for layer in self.layers:
            passes = shot.passes(frame)
            self.change(frame, passes)
            if self.version == "5.2":
                passes["Denoising Specular Albedo"] = passes["Glossy Color"]
                passes["Denoising Roughness"] = passes["Depth"] * 0 + np.float32(0.5)
            for name in self.without:
                del passes[name]
            parts += [(f"{layer}.{name}", self._channels(layer, name, pixels)) for name, pixels in passes.items()]
        extra = {"Software": f"Blender {self.version}", "Frame": f"{frame:03d}", "cryptomatte/1234/name": "Object"}
        if self.version == "4.5":
            channels = {name: pixels for _, part in parts for name, pixels in part.items()}
            OpenEXR.File({**header, **extra}, channels).write(str(path))
        else:
            OpenEXR.File(
                [
                    OpenEXR.Part({**header, **(extra if index == 0 else {})}, channels, name)
                    for index, (name, channels) in enumerate(parts)
                ]
            ).write(str(path))
        return path

    def _channels(self, layer: str, name: str, pixels: np.ndarray) -> Mapping[str, np.ndarray]:
        written = PASSES[name].older or name if self.version == "4.5" and name in PASSES else name
        suffixes = {1: "X" if name == "Object Index" else "Z", 3: "XYZ" if "Normal" in name else "RGB"}.get(
            pixels.shape[-1], "XYZW" if name == "Vector" else "RGBA"
        )
        dtype = np.float32 if "Depth" in name else self.dtype
        return {f"{layer}.{written}.{c}": np.ascontiguousarray(pixels[..., i], dtype) for i, c in enumerate(suffixes)}


def write_shot(folder: Path, frames: range | tuple[int, ...], form: Format = Format(), shot: Shot = Shot()) -> Path:
    """frame_0001.exr and so on. Returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in frames:
        form.write(folder / f"frame_{frame:04d}.exr", frame, shot)
    return folder


def run(source: Path, output: Path, *arguments: object) -> Result:
    command = ["denoise", source, "-o", output, "--device", "reference", *arguments]
    return CliRunner().invoke(app, [str(argument) for argument in command])


def done(source: Path, output: Path, *arguments: object) -> str:
    """The messages."""
    result = run(source, output, *arguments)
    assert result.exit_code == 0, result.output
    return result.stderr


def refused(source: Path, output: Path, *arguments: object) -> str:
    """The error; nothing was written."""
    before = sorted(output.iterdir()) if output.is_dir() else None
    result = run(source, output, *arguments)
    assert result.exit_code == 2 and result.stdout == "", result.output
    assert (sorted(output.iterdir()) if output.is_dir() else None) == before
    error = result.stderr.splitlines()[-1]
    assert error.startswith("Error: ")
    return error


def combined(path: Path, layer: str = "ViewLayer") -> np.ndarray:
    return exr.read(path)[f"{layer}.Combined"]
