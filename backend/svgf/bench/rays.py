# SPDX-License-Identifier: Apache-2.0
"""How many rays a device traces per second, and what it costs to get a scene ready for them.

Three kinds of rays, one of each per pixel: "primary" from the camera through a random point of the pixel; "bounce"
from where it hit, cosine-distributed around the normal, for the closest hit; "shadow" from there to a random point
near the ceiling of the scene's bounding box, for any hit. Times are the device's own, medians over launches; rays are
made, uploaded and read by the kernel from memory, hits are written there.
"""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..devices import Device
from ..flatten import FlatScene, flatten
from ..renderer import SceneUploader
from ..scene import Scene
from . import generated

# Resolutions of generated.room.
ROOMS = {"room 19k": 18, "room 983k": 128}
# Those that are updated.
UPDATED_ROOMS = {"room 101k": 41, "room 983k": 128}
# Bounces at which the Cornell box is traced; Mitsuba's max_depth is two more.
CORNELL_BOUNCES = (0, 1, 4)
RAY_OFFSET = 1e-4  # of the extent, by which rays start off a surface


@dataclass(frozen=True)
class RayTime:
    """One measurement. what: the kind of ray, of frame or of update. rays: of each launch, 0 where not rays are
    counted.
    milliseconds: median; minimum: the best."""

    scene: str
    what: str
    triangles: int
    rays: int
    milliseconds: float
    minimum: float

    @property
    def gigarays(self) -> float:
        """1e9 rays per second; 0 where not rays are counted."""
        return self.rays / self.milliseconds / 1e6


def measure_rays(device: Device, scene: Scene, name: str, size: tuple[int, int], count: int) -> list[RayTime]:
    """All three kinds of rays in one scene; count: launches of each."""
    flat = flatten(scene)
    tracer = device.tracer()
    SceneUploader(device, tracer).upload(flat)
    triangles = int(sum(len(flat.meshes[mesh].triangles) for mesh in flat.instance_mesh))
    primary, bounce, shadow = _ray_sets(device, tracer, flat, size)
    rows = []
    for kind, rays, any_hit in (("primary", primary, False), ("bounce", bounce, False), ("shadow", shadow, True)):
        times = _stage_times(device, lambda rays=rays, any_hit=any_hit: tracer.cast(rays, any_hit=any_hit), count)
        rows.append(RayTime(name, kind, triangles, rays.shape[0] * rays.shape[1], *times))
    return rows


def ray_sets(device: Device, scene: Scene, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Primary, bounce and shadow rays, [H, W, 8] each as ``Tracer.cast`` takes them, relative to the flat scene's
    origin."""
    flat = flatten(scene)
    tracer = device.tracer()
    SceneUploader(device, tracer).upload(flat)
    return _ray_sets(device, tracer, flat, size)


def measure_cornell(device: Device, size: tuple[int, int], count: int) -> list[RayTime]:
    """Mitsuba's Cornell box at one sample per pixel, stages gbuffer and path."""
    flat = flatten(generated.cornell_box(size))
    tracer = device.tracer()
    SceneUploader(device, tracer).upload(flat)
    rows = []
    for bounces in CORNELL_BOUNCES:
        sample = iter(range(1 << 30))
        times = _stage_times(
            device,
            lambda bounces=bounces, sample=sample: tracer.trace(
                *size,
                sample=next(sample),
                samples=1,
                seed=0,
                bounces=bounces,
                effects=int(flat.effects),
                pixel_filter="box",
                signals="diffuse_specular",
            ),
            count,
        )
        rows.append(RayTime("cornell_box", f"frame, {bounces} bounces", 36, 0, *times))
    return rows


def measure_updates(device: Device, scene: Scene, deformed: Scene, name: str, count: int) -> list[RayTime]:
    """What it costs on the clock, until the device is done: to build the scene's trees, to move the camera or an
    instance, and to deform its meshes into those of ``deformed``."""
    triangles = int(sum(len(mesh.triangles) for mesh in scene.meshes))
    tracer = device.tracer()

    def clock(work: Callable[[int], None]) -> list[float]:
        times = []
        for index in range(count + 1):
            device.synchronize()
            start = time.perf_counter()
            work(index)
            device.synchronize()
            times.append((time.perf_counter() - start) * 1e3)
        return times[1:]

    flat = flatten(scene)
    uploader = SceneUploader(device, tracer)
    uploader.upload(flat)
    moves = [_moved(scene, 1e-3 * index) for index in range(count + 1)]
    views = [_viewed(scene, 1e-3 * index) for index in range(count + 1)]
    shapes = [flatten(shape, flat) for shape in (deformed, scene)]
    flat_moves, flat_views = ([flatten(s, flat) for s in scenes] for scenes in (moves, views))
    measured = {
        "build": clock(lambda _: SceneUploader(device, tracer).upload(flat)),
        "deform": clock(lambda index: uploader.upload(shapes[index % 2])),
        "move an object": clock(lambda index: uploader.upload(flat_moves[index])),
        "move the camera": clock(lambda index: uploader.upload(flat_views[index])),
        "no change": clock(lambda _: uploader.upload(flat_views[-1])),
    }
    return [RayTime(name, what, triangles, 0, statistics.median(t), min(t)) for what, t in measured.items()]


def _ray_sets(
    device: Device, tracer: Any, flat: FlatScene, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    primary = _primary_rays(flat, size, rng)
    hits = {key: device.to_numpy(image) for key, image in tracer.cast(primary, any_hit=False).items()}
    return primary, *_secondary_rays(flat, primary, hits, rng)


def _stage_times(device: Device, launch: Callable[[], object], count: int) -> tuple[float, float]:
    """Median and minimum of the device's milliseconds of all stages together."""
    times = []
    for index in range(count + 2):
        launch()
        spent = sum(device.take_timings().values())
        if index >= 2:
            times.append(spent)
    return statistics.median(times), min(times)


def _primary_rays(flat: FlatScene, size: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    width, height = size
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    left, right, bottom, top = flat.window
    u = left + (right - left) * (x + rng.random(x.shape)) / width
    v = top + (bottom - top) * (y + rng.random(x.shape)) / height
    direction = np.stack([u, v, -np.ones_like(u)], axis=-1) @ flat.camera_to_world[:, :3].T
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return _rays(np.broadcast_to(flat.camera_to_world[:, 3], direction.shape), direction, np.inf)


def _rays(origin: np.ndarray, direction: np.ndarray, t_max) -> np.ndarray:
    rays = np.zeros((*origin.shape[:2], 8), dtype=np.float32)
    rays[..., :3], rays[..., 3:6], rays[..., 7] = origin, direction, t_max
    return rays


def _secondary_rays(
    flat: FlatScene, primary: np.ndarray, hits: dict[str, np.ndarray], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Bounce and shadow rays. Where the primary ray hit nothing they start at its origin, in its direction."""
    found = hits["instance"] >= 0
    origin, direction = primary[..., :3].astype(np.float64), primary[..., 3:6].astype(np.float64)
    normal = -direction
    normal[found] = _normals(flat, hits["instance"][found], hits["triangle"][found])
    normal *= np.where((normal * direction).sum(axis=-1, keepdims=True) > 0.0, -1.0, 1.0)
    distance = np.where(found, hits["distance"], 0.0)
    start = origin + direction * distance[..., None] + normal * RAY_OFFSET * flat.extent
    # A point on the unit sphere around the tip of the normal: cosine-distributed.
    z = rng.uniform(-1.0, 1.0, found.shape)
    angle = rng.uniform(0.0, 2.0 * np.pi, found.shape)
    ring = np.sqrt(1.0 - z * z)
    bounce = normal + np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)
    bounce /= np.maximum(np.linalg.norm(bounce, axis=-1, keepdims=True), 1e-9)
    bounce[~found] = direction[~found]
    low, high = start[found].min(axis=0), start[found].max(axis=0)
    target = low + (high - low) * (0.4 + 0.2 * rng.random((*found.shape, 3)))
    target[..., 2] = low[2] + (high - low)[2] * 0.85
    return _rays(start, bounce, np.inf), _rays(start, target - start, 1.0)


def _normals(flat: FlatScene, instance: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Unit face normals in the world."""
    normals = np.empty((len(instance), 3))
    order = np.argsort(instance, kind="stable")
    ends = np.cumsum(np.bincount(instance, minlength=len(flat.instance_mesh)))
    for index in np.unique(instance):
        members = order[(ends[index - 1] if index else 0) : ends[index]]
        mesh = flat.meshes[flat.instance_mesh[index]]
        corners = mesh.positions[mesh.triangles[triangle[members]]].astype(np.float64)
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        world = face @ flat.world_to_object[index][:, :3]
        normals[members] = world / np.maximum(np.linalg.norm(world, axis=1, keepdims=True), 1e-300)
    return normals


def _moved(scene: Scene, distance: float) -> Scene:
    to_world = np.array(scene.instances.object_to_world)
    to_world[-1, :, 3] += distance
    instances = dataclasses.replace(
        scene.instances, object_to_world=to_world, previous_object_to_world=scene.instances.object_to_world
    )
    return dataclasses.replace(scene, instances=instances)


def _viewed(scene: Scene, distance: float) -> Scene:
    to_world = np.array(scene.camera.camera_to_world)
    to_world[:, 3] += distance
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, camera_to_world=to_world))


def measure(
    device: Device, scenes: Sequence[tuple[str, Scene]], size: tuple[int, int], count: int, mitsuba: bool = False
) -> list[RayTime]:
    """Everything: the generated rooms, ``scenes`` (name, scene), the Cornell box, and updates of the rooms. mitsuba:
    Mitsuba 3 on the same rays and box beside it; raises InputError where it is not installed."""
    if mitsuba:
        from .mitsuba import measure_box, measure_mesh
    rows = []
    rooms = {name: generated.room(resolution, None, size) for name, resolution in ROOMS.items()}
    for name, scene in (*rooms.items(), *scenes):
        rows += measure_rays(device, scene, name, size, count)
        if mitsuba and name in rooms:
            rows += measure_mesh(scene, name, count, *ray_sets(device, scene, size))
    rows += measure_cornell(device, size, count)
    if mitsuba:
        rows += measure_box(size, CORNELL_BOUNCES, count)
    for name, resolution in UPDATED_ROOMS.items():
        frames = [generated.room(resolution, frame, size) for frame in (1, 2)]
        rows += measure_updates(device, *frames, name, min(count, 8))
    return rows


def plot(rows: Sequence[RayTime], title: str) -> bytes:
    """A PNG: 1e9 rays per second of each kind, by scene."""
    import io

    from matplotlib.figure import Figure

    rows = [row for row in rows if row.rays]
    scenes = list(dict.fromkeys(row.scene for row in rows))
    kinds = list(dict.fromkeys(row.what for row in rows))
    figure = Figure(figsize=(2 + 2 * len(scenes), 4), layout="constrained")
    figure.suptitle(title)
    axes = figure.add_subplot()
    for index, kind in enumerate(kinds):
        mine = {row.scene: row.gigarays for row in rows if row.what == kind}
        places = np.array([scenes.index(scene) for scene in mine]) + (index - (len(kinds) - 1) / 2) * 0.8 / len(kinds)
        bars = axes.bar(places, list(mine.values()), 0.75 / len(kinds), label=kind)
        axes.bar_label(bars, fmt="%.2f", fontsize="small")
    axes.set_xticks(range(len(scenes)), scenes)
    axes.set_ylabel("1e9 rays per second")
    axes.legend()
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110)
    return data.getvalue()
