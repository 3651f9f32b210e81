# SPDX-License-Identifier: Apache-2.0
"""The frame's way: scene -> flat scene -> device -> gbuffer and path -> denoise -> Frame."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np

from .albedo import albedo_tables
from .devices import Device, open_device
from .diagnostics import DIAGNOSTICS
from .effects import Effects
from .errors import InputError, Interrupted
from .flatten import FlatScene, flatten
from .frame import Frame
from .scene import Mesh, Scene, Texture
from .scene_validation import SceneValidator
from .settings import Settings

# Above this many samples a frame is traced in several launches, so that progress shows and Esc is heard.
SAMPLES_PER_LAUNCH = 16


class SceneUploader:
    """Keeps a tracer's copy of the scene up to date, and uploads only what changed since the last call."""

    def __init__(self, device: Device, tracer: Any) -> None:
        self._device = device
        self._tracer = tracer
        # Keyed by identity; the value holds the source too, so that an id is never that of another, newer object.
        self._meshes: dict[int, tuple[Mesh, Any]] = {}
        self._textures: dict[int, tuple[Texture, Any]] = {}
        self.last: FlatScene | None = None
        tracer.set_albedo_tables(albedo_tables())

    def upload(self, flat: FlatScene) -> None:
        """flat: the frame to trace next. Raises OutOfMemory, DeviceError."""
        meshes = self._keep(self._meshes, flat.meshes, self._new_mesh)
        textures = self._keep(self._textures, flat.textures, self._new_texture)
        new_materials = textures is not None or self._changed(flat, MATERIAL_FIELDS)
        if new_materials:
            self._tracer.set_materials(
                *(np.asarray(getattr(flat, name), self._dtype) for name in MATERIAL_FIELDS),
                [self._textures[id(texture)][1] for texture in flat.textures],
            )
        # What the trees may do with an instance depends on its materials.
        if new_materials or meshes is not None or self._changed(flat, INSTANCE_FIELDS):
            self._tracer.set_instances(
                [self._meshes[id(mesh)][1] for mesh in flat.meshes],
                flat.instance_mesh,
                *(np.asarray(getattr(flat, name), self._dtype) for name in TRANSFORM_FIELDS),
                flat.object_id,
                flat.material_start,
                flat.material_table,
                flat.visibility,
                flat.emitter,
                self._rounded(flat.terminator_offset),
            )
        if self._changed(flat, LIGHT_FIELDS):
            self._tracer.set_lights(**{name: self._rounded(getattr(flat, name)) for name in LIGHT_FIELDS})
        if self._changed(flat, WORLD_FIELDS):
            self._tracer.set_world(
                self._rounded(flat.world_radiance),
                flat.world_visibility,
                flat.environment,
                flat.environment_light,
                self._rounded(flat.world_to_environment),
                flat.row_cdf,
                flat.column_cdf,
                self._rounded(flat.backdrop_radiance),
                flat.backdrop_environment,
            )
        self._tracer.set_camera(*(np.asarray(getattr(flat, name), self._dtype) for name in CAMERA_FIELDS))
        self.last = flat

    @property
    def _dtype(self) -> type:
        return np.float64 if self._device.name == "reference" else np.float32

    def _rounded(self, array: np.ndarray) -> np.ndarray:
        """What is float64 as the device holds it."""
        return np.asarray(array, self._dtype) if array.dtype == np.float64 else array

    def _changed(self, flat: FlatScene, names: tuple[str, ...]) -> bool:
        last = self.last
        return last is None or not all(_same(getattr(flat, name), getattr(last, name)) for name in names)

    def _keep(
        self, cache: dict[int, tuple[Any, Any]], wanted: tuple[Any, ...], make: Callable[[Any, list], Any]
    ) -> Any:
        """Brings the cache to exactly `wanted`. make(source, what is no longer wanted) makes what is new. Returns
        None if the cache held just that already."""
        keys = {id(source) for source in wanted}
        if keys == cache.keys():
            return None
        retired = [cache.pop(key) for key in cache.keys() - keys]
        for source in wanted:
            if id(source) not in cache:
                cache[id(source)] = (source, make(source, retired))
        return cache

    def _new_mesh(self, mesh: Mesh, retired: list[tuple[Mesh, Any]]) -> Any:
        for index, (last, native) in enumerate(retired):
            if _deforms_into(last, mesh):
                del retired[index]
                if self._device.refit(native, mesh.positions, mesh.normals, mesh.previous_positions, mesh.tangents):
                    return native
                break
        return self._device.mesh(
            mesh.positions,
            mesh.triangles,
            mesh.normals,
            mesh.uvs,
            mesh.material_slots,
            mesh.previous_positions,
            mesh.tangents,
            mesh.tangent_layer,
        )

    def _new_texture(self, texture: Texture, _: list[tuple[Texture, Any]]) -> Any:
        return self._device.texture(
            texture.pixels,
            texture.srgb,
            int(texture.interpolation),
            int(texture.extension),
            texture.associated_alpha,
        )


TRANSFORM_FIELDS = ("object_to_world", "world_to_object", "previous_object_to_world")
INSTANCE_FIELDS = (
    "instance_mesh", *TRANSFORM_FIELDS, "object_id", "material_start", "material_table", "visibility", "emitter",
    "terminator_offset",
)  # fmt: skip
MATERIAL_FIELDS = ("materials", "material_maps")
LIGHT_FIELDS = (
    "light_kind", "light_data", "light_visibility", "light_tree", "light_of_leaf", "emitters", "light_of_triangle",
    "emission_map", "emission_maps",
)  # fmt: skip
WORLD_FIELDS = (
    "world_radiance", "world_visibility", "environment", "environment_light", "world_to_environment", "row_cdf",
    "column_cdf", "backdrop_radiance", "backdrop_environment",
)  # fmt: skip
CAMERA_FIELDS = (
    "camera_to_world", "previous_camera_to_world", "window", "previous_window", "clip", "lens", "previous_lens",
)  # fmt: skip


def _deforms_into(last: Mesh, mesh: Mesh) -> bool:
    """Whether two meshes differ in nothing but where their vertices are, and move."""
    return (
        last.name == mesh.name
        and last.previous_positions is not None
        and mesh.previous_positions is not None
        and last.positions.shape == mesh.positions.shape
        and last.tangent_layer == mesh.tangent_layer
        and all(_same(getattr(last, name), getattr(mesh, name)) for name in ("triangles", "material_slots", "uvs"))
    )


def _same(a: Any, b: Any) -> bool:
    return a is b or np.array_equal(a, b)


class Renderer:
    """Renders scenes one after the other; temporal history carries over from each frame to the next.

    settings: what to render and how. device: a name for ``open_device``, or an opened Device. interactive: for a view
    that someone works in: while something changes, what stands still shows denoised frames alone.
    """

    def __init__(
        self, settings: Settings | None = None, device: str | Device = "auto", interactive: bool = False
    ) -> None:
        self.settings = settings or Settings()
        self._interactive = interactive
        self.device = open_device(device) if isinstance(device, str) else device
        self._tracer = self.device.tracer()
        self._uploader = SceneUploader(self.device, self._tracer)
        self._validator = SceneValidator()
        self._denoisers: list[Any] = []
        self._denoiser_size = (0, 0)
        self._last_frame: int | None = None
        self._last_scene: Scene | None = None
        self._resting: Scene | None = None  # the last scene without motion, while it is rendered again and again
        self._repeats = 0
        self._reset_reason = "first frame"

    def reset(self, reason: str) -> None:
        """The next frame starts without history; reason is kept in Frame.reset."""
        self._reset_reason = reason

    def interrupt(self) -> None:
        """From any thread: the frame that is being rendered raises Interrupted."""
        self.device.interrupt()

    def render(self, scene: Scene, progress: Callable[[float], None] | None = None) -> Frame:
        """Renders the next frame of an animation, or the same scene again with new samples.

        scene: history is kept where its frame number follows that of the last call, or where it is the very same scene,
        which then stands still; another image size does not end it. progress: called with the finished share of the
        samples, in (0, 1].
        Raises InputError (naming the field that is wrong), DeviceError, OutOfMemory, Interrupted; after any of them
        the next frame starts afresh, unless it was interrupted before the denoiser had begun.
        """
        return self.render_variants(scene, [self.settings], progress)[0]

    def render_variants(
        self, scene: Scene, variants: Sequence[Settings], progress: Callable[[float], None] | None = None
    ) -> list[Frame]:
        """As ``render``, but what was traced once is denoised in several ways, each with a history of its own.

        variants: the renderer's settings but for method and denoise, the same in each call; what they say about
        tracing is not read. Timings of tracing are in the first frame alone.
        """
        self._validator.check(scene)
        settings = self.settings
        width = settings.width or scene.defaults.width
        height = settings.height or scene.defaults.height
        bounces = scene.defaults.bounces if settings.bounces is None else settings.bounces
        exposure = scene.defaults.exposure if settings.exposure is None else settings.exposure
        if width < 1 or height < 1:
            raise InputError(f"The image size is {width}x{height}.", "Both sides must be at least 1 pixel.")

        reset = self._find_reset(scene)
        self.device.clear_interrupt()
        tracing = True
        try:
            start = time.perf_counter()
            if self._repeats == 1:
                self._resting = scene.at_rest()
            flat = flatten(self._resting if self._repeats else scene, self._uploader.last)
            self._uploader.upload(flat)
            update_ms = (time.perf_counter() - start) * 1e3
            images = self._trace(flat, width, height, scene.frame + self._repeats, bounces, progress)
            tracing = False
            frames, timings = [], {"update": update_ms}
            for denoiser in self._sized_denoisers(variants, width, height):
                denoised = self._denoise(denoiser, flat, images, reset)
                timings.update(self.device.take_timings())
                frames.append(self._finish(scene, images, denoised, exposure, timings, reset))
                timings = {}
        except BaseException as error:
            if not (isinstance(error, Interrupted) and tracing):
                self.reset("the last frame was not finished")
            self._last_scene = None
            raise
        self._last_scene, self._last_frame, self._reset_reason = scene, scene.frame, ""
        return frames

    def _find_reset(self, scene: Scene) -> str:
        """Why history cannot go on, or an empty string. Counts how often the same scene came in a row."""
        self._repeats = self._repeats + 1 if scene is self._last_scene else 0
        if self._reset_reason:
            return self._reset_reason
        if scene.cut:
            return "camera cut"
        if not self._repeats and scene.frame != self._last_frame + 1:
            return f"frame {scene.frame} does not follow frame {self._last_frame}"
        return ""

    def _trace(
        self,
        flat: FlatScene,
        width: int,
        height: int,
        frame: int,
        bounces: int,
        progress: Callable[[float], None] | None,
    ) -> dict[str, Any]:
        """The images of the tracer; the signals are means over all samples of the frame."""
        settings, defaults = self.settings, flat.scene.defaults
        light_paths = settings.light_paths(defaults.light_paths)
        effects = flat.effects & ~Effects.LIGHT_PATH_LIMITS
        if light_paths.changes(bounces):
            effects |= Effects.LIGHT_PATH_LIMITS
        film = defaults.transparent_film if settings.transparent_film is None else settings.transparent_film
        first = (frame * settings.samples) & 0xFFFFFFFF  # the same noise for a frame, wherever the animation starts
        images: dict[str, Any] = {}
        sums: dict[str, np.ndarray] = {}
        done = 0
        while done < settings.samples:
            count = min(SAMPLES_PER_LAUNCH, settings.samples - done)
            traced = self._tracer.trace(
                width,
                height,
                sample=(first + done) & 0xFFFFFFFF,
                samples=count,
                seed=settings.seed,
                bounces=bounces,
                effects=int(effects),
                pixel_filter=settings.resolved_pixel_filter,
                signals=settings.signals,
                light_paths=astuple(light_paths),
                transparent_film=film,
            )
            images = images or traced
            if settings.samples > SAMPLES_PER_LAUNCH:
                for name in MEAN_IMAGES & traced.keys():
                    # float64: a sum of many thousand samples keeps every one of them.
                    part = self.device.to_numpy(traced[name]).astype(np.float64) * (count / settings.samples)
                    sums[name] = sums[name] + part if name in sums else part
            done += count
            if progress:
                progress(done / settings.samples)
        if sums:
            images.update({name: total.astype(np.float32) for name, total in sums.items()})
        return images

    def _sized_denoisers(self, variants: Sequence[Settings], width: int, height: int) -> list[Any]:
        if not self._denoisers:
            self._denoisers = [
                self.device.denoiser(width, height, variant.method, variant.denoise.as_dict()) for variant in variants
            ]
        elif self._denoiser_size != (width, height):
            for denoiser in self._denoisers:
                denoiser.resize(width, height)
        self._denoiser_size = (width, height)
        return self._denoisers

    def _denoise(self, denoiser: Any, flat: FlatScene, images: dict[str, Any], reset: str) -> dict[str, Any]:
        return denoiser.denoise(
            {**images, "window": flat.window},
            reset=bool(reset),
            diagnostics=self.settings.diagnostics,
            unchanged=self._repeats > SETTLING_FRAMES,
            interactive=self._interactive,
        )

    def _finish(
        self,
        scene: Scene,
        images: dict[str, Any],
        denoised: dict[str, Any],
        exposure: float,
        timings: dict[str, float],
        reset: str,
    ) -> Frame:
        def host(image: Any) -> np.ndarray:
            array = image if isinstance(image, np.ndarray) else self.device.to_numpy(image)
            return array if array.dtype == np.int32 else array.astype(np.float32, copy=False)

        def lazy(image: Any, factor: float = 1.0) -> Callable[[], np.ndarray]:
            return lambda: host(image) if factor == 1.0 else host(image) * np.float32(factor)

        # What the camera's rays hit, not what mirrors show there.
        first = {name: images.get(f"first_{name}", images.get(name)) for name in FIRST_IMAGES}
        radiance = [images[name] for name in sorted(RADIANCE_IMAGES & images.keys())]
        albedo = [images[name] for name in ("diffuse_albedo", "specular_albedo") if name in images]
        width, height = self._denoiser_size
        return Frame(
            frame=scene.frame,
            color=lazy(denoised["color"], exposure),
            noisy=lambda: sum(map(host, radiance)) * np.float32(exposure),
            albedo=lambda: sum(map(host, albedo)),
            normal=lazy(first["normal"]),
            depth=lazy(first["depth"]),
            motion=lazy(first["motion"]) if "motion" in images else lambda: np.zeros((height, width, 3), np.float32),
            roughness=lazy(images["roughness"]),
            object_id=lazy(first["object_id"]),
            variance=lazy(denoised["variance"], exposure**2),
            history_length=lazy(denoised["history_length"]),
            alpha=lazy(images["alpha"]) if "alpha" in images else None,
            **{name: lazy(denoised[name]) for name in DIAGNOSTICS if name in denoised},
            timings=timings,
            reset=reset,
        )


# Frames of the same scene after which its light has settled in the history: what has changed before is found by then.
SETTLING_FRAMES = 16
FIRST_IMAGES = ("normal", "depth", "motion", "object_id")
RADIANCE_IMAGES = frozenset({"diffuse", "specular", "direct", "indirect", "emission"})
# Images that are means over all samples of a frame; the others are of its first sample.
MEAN_IMAGES = RADIANCE_IMAGES | {"alpha"}
