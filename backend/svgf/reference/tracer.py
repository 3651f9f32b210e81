# SPDX-License-Identifier: Apache-2.0
"""The tracer: holds a scene and runs the stages "gbuffer" and "path"."""

from __future__ import annotations

import numpy as np

from ..effects import MOTION_EFFECTS, Effects
from ..light_paths import LightPaths
from ..scene import RayVisibility
from .camera import Camera, pixel_centers
from .device import Device
from .environment import World
from .gbuffer import PrimaryRays, trace_gbuffer
from .lights import Lights
from .opacity import find_path_hits
from .path import Signals, trace_paths
from .sampling import LENS_PAIR, PIXEL_PAIR, pixel_keys, random_pair
from .specular_chain import replace_smooth_surfaces
from .surface import Mesh, SceneView, Shapes
from .texture import Texture


class Tracer:
    """The arguments of the setters are the columns of FlatScene; each may be called again, in any order."""

    def __init__(self, device: Device | None = None) -> None:
        self._device = device or Device()
        self._shapes = Shapes([], *(np.zeros(0) for _ in range(10)))
        self._materials = np.zeros((0, 48))
        self._material_maps = np.zeros((0, 12))
        self._textures: list[Texture] = []
        self._lights = Lights()
        self._world: tuple = ()
        self._camera_rows: tuple[np.ndarray, ...] = ()

    def set_instances(
        self,
        meshes: list[Mesh],
        instance_mesh,
        object_to_world,
        world_to_object,
        previous_object_to_world,
        object_id,
        material_start,
        material_table,
        visibility,
        emitter,
        terminator_offset,
    ) -> None:
        self._shapes = Shapes(
            meshes,
            instance_mesh,
            object_to_world,
            world_to_object,
            previous_object_to_world,
            object_id,
            material_start,
            material_table,
            visibility,
            emitter,
            terminator_offset,
        )

    def set_materials(self, materials, material_maps, textures: list[Texture]) -> None:
        self._materials = np.asarray(materials, dtype=np.float64).reshape(-1, 48)
        self._material_maps = np.asarray(material_maps, dtype=np.float64).reshape(-1, 12)
        self._textures = list(textures)

    def set_albedo_tables(self, tables) -> None:
        """They are those of svgf.albedo in any case."""

    def set_lights(self, **columns) -> None:
        self._lights = Lights(**columns)

    def set_world(
        self,
        radiance,
        visibility,
        texture: int,
        light: int,
        to_environment,
        row_cdf,
        column_cdf,
        backdrop_radiance,
        backdrop_texture: int,
    ) -> None:
        self._world = (radiance, visibility, texture, light, to_environment, row_cdf, column_cdf)
        self._backdrop = (backdrop_radiance, backdrop_texture)

    def set_camera(
        self, camera_to_world, previous_camera_to_world, window, previous_window, clip, lens, previous_lens
    ) -> None:
        rows = (camera_to_world, previous_camera_to_world, window, previous_window, clip, lens, previous_lens)
        self._camera_rows = tuple(np.asarray(row, dtype=np.float64) for row in rows)

    def trace(
        self,
        width: int,
        height: int,
        sample: int,
        samples: int,
        seed: int,
        bounces: int,
        effects: int,
        pixel_filter: str,
        signals: str,
        light_paths: tuple = (),
        transparent_film: bool = False,
        kernel: int = 0,
    ) -> dict[str, np.ndarray]:
        """Images [height, width] or [height, width, channels] by name: those of the G-buffer, of the first sample, then
        "emission" and the signals, means over samples.

        sample: running number of the first one, >= 0. bounces: 0 is direct light only. effects: bits of Effects.
        pixel_filter: "box" or "center". signals: "diffuse_specular" (the second one only with SPECULAR) or
        "direct_indirect". light_paths: the fields of svgf.scene.LightPaths, or none. transparent_film: the world is not
        seen by the camera, and there is an image "alpha". "hit_distance", of the first sample: in metres from the seen
        surface to what its specular lobes' ray hit next, 1e10 for the world, 0 where the path took no such ray. This
        and "specular_albedo" are there only with SPECULAR, "motion" only with an effect that moves something. With
        PERFECT_SPECULAR too the images are of what mirrors and clear glass show (specular_chain.py), but "material_id",
        and "first_normal", "first_depth", "first_object_id" and "first_motion" of what the camera's rays hit. kernel:
        of no account here, there is only one.
        """
        camera_to_world, previous_camera_to_world, window, previous_window, clip, lens, previous_lens = (
            self._camera_rows
        )
        camera = Camera(camera_to_world, window, lens, width, height)
        previous_camera = Camera(previous_camera_to_world, previous_window, previous_lens, width, height)
        scene = SceneView(
            self._shapes, self._materials, self._material_maps, self._textures, self._lights, self._make_world()
        )
        scene.lights.textures, scene.lights.world = scene.textures, scene.world
        limits = LightPaths(*light_paths)
        keys = pixel_keys(width, height, seed)
        images: dict[str, np.ndarray] = {}
        smooth = Effects.SPECULAR | Effects.PERFECT_SPECULAR
        has_chains = Effects(effects) & smooth == smooth
        radiance = Signals(width * height, signals, bool(Effects(effects) & Effects.SPECULAR), limits, transparent_film)
        for number in range(sample, sample + samples):
            with self._device.stage("gbuffer"):
                point = pixel_centers(width, height)
                if pixel_filter == "box":
                    point = point - 0.5 + random_pair(keys, PIXEL_PAIR, number)
                origin, direction = camera.rays(point, random_pair(keys, LENS_PAIR, number))
                # Directions have planar depth 1, so the planar clip distances are those along the ray. From here on
                # rays count in metres.
                length = np.sqrt((direction**2).sum(axis=1))
                direction, near, far = direction / length[:, None], clip[0] * length, clip[1] * length
                kind = np.full(len(far), int(RayVisibility.CAMERA))
                allowed = np.full(len(far), max(limits.transparent_bounces, 1))
                hits, passed = find_path_hits(scene, keys, number, 0, origin, direction, near, far, kind, allowed)
                chain_light = None
                if not images:
                    primary = PrimaryRays(point, origin, direction, far, keys, number)
                    images = trace_gbuffer(
                        scene, camera, previous_camera, primary, hits, passed, limits.transparent_bounces
                    )
                    if has_chains:
                        chain_light = replace_smooth_surfaces(
                            scene, camera, previous_camera, primary, hits, passed, bounces, limits, images
                        )
            with self._device.stage("path"):
                trace_paths(
                    scene, radiance, keys, number, bounces, limits, origin, direction, near, far, hits, passed,
                    has_chains, chain_light,
                )  # fmt: skip
                images.setdefault("hit_distance", radiance.hit_distance.copy())
        if not Effects(effects) & Effects.SPECULAR:
            del images["specular_albedo"], images["hit_distance"]
        if not Effects(effects) & MOTION_EFFECTS:
            for name in ("motion", "first_motion"):
                images.pop(name, None)
        images.update({name: image / samples for name, image in radiance.images.items()})
        return {name: image.reshape(height, width, *image.shape[1:]) for name, image in images.items()}

    def cast(self, rays: np.ndarray, any_hit: bool) -> dict[str, np.ndarray]:
        """rays [H, W, 8]: origin, direction, and the distances between which hits count, in lengths of the direction.

        Images "distance", infinity where nothing is hit, "instance" and "triangle", -1 there; with any_hit "occluded",
        0 or 1.
        """
        shape, rays = rays.shape[:2], np.asarray(rays, dtype=np.float64).reshape(-1, 8)
        everything = np.full(len(rays), int(RayVisibility.ALL))
        with self._device.stage("occluded" if any_hit else "closest"):
            hits = self._shapes.closest(rays[:, :3], rays[:, 3:6], rays[:, 6], rays[:, 7], everything)
        if any_hit:
            return {"occluded": hits.found.astype(np.int32).reshape(shape)}
        images = {
            "distance": np.where(hits.found, hits.t, np.inf),
            "instance": np.where(hits.found, hits.instance, -1).astype(np.int32),
            "triangle": np.where(hits.found, hits.triangle - self._shapes.start_of(hits.instance), -1).astype(np.int32),
        }
        return {name: image.reshape(shape) for name, image in images.items()}

    def _make_world(self) -> World:
        if not self._world:
            return World()
        radiance, visibility, texture, *rest = self._world
        backdrop_radiance, backdrop_texture = self._backdrop
        return World(
            radiance, visibility, self._image(texture), *rest, backdrop_radiance, self._image(backdrop_texture)
        )

    def _image(self, texture: int) -> Texture | None:
        return self._textures[texture] if texture >= 0 else None
