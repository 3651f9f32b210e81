# SPDX-License-Identifier: Apache-2.0
"""The measurements of ``bench.rays`` with Mitsuba 3, where it is installed: on OptiX if there is a GPU, else with
Embree.

Its times are the clock's around an evaluation of results that Dr.Jit has compiled before, launch overhead included.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ..scene import Scene
from .rays import RayTime


def measure_mesh(
    scene: Scene, name: str, count: int, primary: np.ndarray, bounce: np.ndarray, shadow: np.ndarray
) -> list[RayTime]:
    """The given rays, [H, W, 8], against all meshes of a scene whose instances stand where their meshes are."""
    from ..flatten import flatten

    mi, dr = _mitsuba()
    origin = flatten(scene).origin
    shapes: dict[str, Any] = {"type": "scene"}
    for index, mesh in enumerate(scene.meshes):
        shape = mi.Mesh(mesh.name, len(mesh.positions), len(mesh.triangles))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = (mesh.positions - origin).astype(np.float32).ravel()
        parameters["faces"] = mesh.triangles.astype(np.uint32).ravel()
        parameters.update()
        shapes[f"mesh{index}"] = shape
    loaded = mi.load_dict(shapes)
    triangles = sum(len(mesh.triangles) for mesh in scene.meshes)
    rows = []
    for kind, rays in (("primary", primary), ("bounce", bounce), ("shadow", shadow)):
        flat = rays.reshape(-1, 8)
        ray = mi.Ray3f(o=mi.Point3f(flat[:, :3].T), d=mi.Vector3f(flat[:, 3:6].T))
        ray.maxt = mi.Float(np.minimum(flat[:, 7], np.finfo(np.float32).max))
        dr.eval(ray)

        def trace(ray: Any = ray, kind: str = kind) -> None:
            if kind == "shadow":
                dr.eval(loaded.ray_test(ray))
            else:
                found = loaded.ray_intersect_preliminary(ray, coherent=kind == "primary")
                dr.eval(found.t, found.prim_index)

        rows.append(RayTime(f"{name}, Mitsuba", kind, triangles, len(flat), *_clock(dr, trace, count)))
    return rows


def measure_box(size: tuple[int, int], bounces: tuple[int, ...], count: int) -> list[RayTime]:
    """Mitsuba's own Cornell box at one sample per pixel."""
    mi, dr = _mitsuba()
    box = mi.cornell_box()
    box["sensor"]["film"].update(width=size[0], height=size[1], rfilter={"type": "box"})
    loaded = mi.load_dict(box)
    rows = []
    for bounce in bounces:
        integrator = mi.load_dict({"type": "path", "max_depth": bounce + 2})
        seeds = iter(range(1 << 30))

        def render(integrator: Any = integrator, seeds: Any = seeds) -> None:
            dr.eval(mi.render(loaded, integrator=integrator, spp=1, seed=next(seeds)))

        rows.append(RayTime("cornell_box, Mitsuba", f"frame, {bounce} bounces", 36, 0, *_clock(dr, render, count)))
    return rows


def _clock(dr: Any, work: Callable[[], None], count: int) -> tuple[float, float]:
    """Median and minimum milliseconds."""
    times = []
    for index in range(count + 3):
        dr.sync_thread()
        start = time.perf_counter()
        work()
        dr.sync_thread()
        if index >= 3:
            times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times), min(times)


def _mitsuba() -> tuple[Any, Any]:
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise InputError("Mitsuba 3 is not installed.", "Run pip install mitsuba.") from error
    variants = mi.variants()
    mi.set_variant("cuda_ad_rgb" if "cuda_ad_rgb" in variants and dr.has_backend(dr.JitBackend.CUDA) else "llvm_ad_rgb")
    return mi, dr
