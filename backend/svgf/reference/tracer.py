# SPDX-License-Identifier: Apache-2.0
"""The tracer: holds a scene and runs the stages "gbuffer" and "path"."""

from __future__ import annotations

import numpy as np

from ..effects import Effects
from .camera import Camera, pixel_centers
from .device import Device
from .gbuffer import trace_gbuffer
from .intersect import Hits
from .lights import Lights
from .path import Signals, trace_paths
from .sampling import PIXEL_PAIR, pixel_keys, random_pair, surface_pair
from .surface import Mesh, SceneView, Shapes
from .texture import Texture


class Tracer:
    """The arguments of the setters are the columns of FlatScene; each may be called again, in any order."""

    def __init__(self, device: Device | None = None) -> None:
        self._device = device or Device()
        self._shapes = Shapes([], *(np.zeros(0) for _ in range(7)))
        self._materials = np.zeros((0, 48))
        self._material_maps = np.zeros((0, 12))
        self._textures: list[Texture] = []
        self._lights = Lights([], [], [], [0.0], 0.0, np.zeros(3))
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
        )

    def set_materials(self, materials, material_maps, textures: list[Texture]) -> None:
        self._materials = np.asarray(materials, dtype=np.float64).reshape(-1, 48)
        self._material_maps = np.asarray(material_maps, dtype=np.float64).reshape(-1, 12)
        self._textures = list(textures)

    def set_albedo_tables(self, tables) -> None:
        """They are those of svgf.albedo in any case."""

    def set_lights(
        self, light_kind, light_data, light_probability, light_cdf, triangle_light_scale, world_radiance
    ) -> None:
        self._lights = Lights(
            light_kind, light_data, light_probability, light_cdf, triangle_light_scale, world_radiance
        )

    def set_camera(self, camera_to_world, previous_camera_to_world, window, previous_window, clip) -> None:
        rows = (camera_to_world, previous_camera_to_world, window, previous_window, clip)
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
    ) -> dict[str, np.ndarray]:
        """Images [height, width] or [height, width, channels] by name: those of the G-buffer, of the first sample, then
        "emission" and the signals, means over samples.

        sample: running number of the first one, >= 0. bounces: 0 is direct light only. effects: bits of Effects.
        pixel_filter: "box" or "center". signals: "diffuse_specular" (the second one only with SPECULAR) or
        "direct_indirect".
        """
        camera_to_world, previous_camera_to_world, window, previous_window, clip = self._camera_rows
        camera = Camera(camera_to_world, window, width, height)
        previous_camera = Camera(previous_camera_to_world, previous_window, width, height)
        scene = SceneView(self._shapes, self._materials, self._material_maps, self._textures, self._lights)
        keys = pixel_keys(width, height, seed)
        images: dict[str, np.ndarray] = {}
        radiance = Signals(width * height, signals, bool(Effects(effects) & Effects.SPECULAR))
        for number in range(sample, sample + samples):
            with self._device.stage("gbuffer"):
                point = pixel_centers(width, height)
                if pixel_filter == "box":
                    point = point - 0.5 + random_pair(keys, PIXEL_PAIR, number)
                direction = camera.direction(point)
                hits = self._primary_hits(camera, direction, clip)
                if not images:
                    choice = random_pair(keys, surface_pair(0), number)[:, 0]
                    images = trace_gbuffer(scene, camera, previous_camera, point, direction, hits, choice)
            with self._device.stage("path"):
                trace_paths(scene, radiance, keys, number, bounces, direction, hits)
        images.update({name: image / samples for name, image in radiance.images.items()})
        return {name: image.reshape(height, width, *image.shape[1:]) for name, image in images.items()}

    def _primary_hits(self, camera: Camera, direction: np.ndarray, clip: np.ndarray) -> Hits:
        # Directions have planar depth 1, so the planar clip distances are those along the ray.
        origin = np.broadcast_to(camera.to_world[:, 3], direction.shape)
        near, far = (np.full(len(direction), distance) for distance in clip)
        return self._shapes.closest(origin, direction, near, far)
