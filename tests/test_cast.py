# SPDX-License-Identifier: Apache-2.0
"""Rays that the caller brings, against brute force in float64; and the generated scenes that benchmarks cast them
at."""

import numpy as np
import pytest

from svgf.bench import generated
from svgf.bench.rays import ray_sets
from svgf.devices import open_device
from svgf.flatten import flatten
from svgf.reference.intersect import intersect_triangles
from svgf.renderer import SceneUploader

from . import scenes

SIZE = (32, 18)


def tracer_of(device, scene):
    tracer = device.tracer()
    flat = flatten(scene)
    SceneUploader(device, tracer).upload(flat)
    return tracer, flat


def cast(device, tracer, rays, any_hit):
    return {name: device.to_numpy(image) for name, image in tracer.cast(rays, any_hit=any_hit).items()}


def brute_force(flat, rays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance, instance and triangle of every ray, against every triangle."""
    rays = rays.reshape(-1, 8).astype(np.float64)
    best = np.full(len(rays), np.inf), np.full(len(rays), -1), np.full(len(rays), -1)
    for instance, index in enumerate(flat.instance_mesh):
        mesh, to_world = flat.meshes[index], flat.object_to_world[instance]
        corners = mesh.positions[mesh.triangles].astype(np.float64) @ to_world[:, :3].T + to_world[:, 3]
        for triangle, corner in enumerate(corners):
            t = intersect_triangles(rays[:, :3], rays[:, 3:6], np.broadcast_to(corner, (len(rays), 3, 3)))[0]
            closer = (t > rays[:, 6]) & (t < rays[:, 7]) & (t < best[0])
            for values, value in zip(best, (t, instance, triangle)):
                values[closer] = np.broadcast_to(value, len(rays))[closer]
    return best


@pytest.mark.parametrize("kind", ["primary", "bounce", "shadow"])
def test_rays_find_what_brute_force_finds(device, kind):
    """A room of 540 triangles and its lamp. Rays along edges may go to either side: at most 1 in 200."""
    scene = generated.room(3, None, SIZE)
    tracer, flat = tracer_of(device, scene)
    rays = dict(zip(("primary", "bounce", "shadow"), ray_sets(open_device("reference"), scene, SIZE)))[kind]
    distance, instance, triangle = (image.reshape(SIZE[::-1]) for image in brute_force(flat, rays))
    found = np.isfinite(distance)
    if kind == "shadow":
        assert 0.1 < found.mean() < 0.9
        assert (cast(device, tracer, rays, True)["occluded"] == found).mean() > 0.995
        return
    images = cast(device, tracer, rays, False)
    same = (images["instance"] == instance) & (images["triangle"] == triangle)
    assert same.mean() > 0.995
    np.testing.assert_allclose(images["distance"][same & found], distance[same & found], rtol=1e-4)
    np.testing.assert_array_equal(images["distance"][~found], np.inf)


def test_meshes_that_share_their_space(device):
    """Heaps of small triangles, turned and stretched, that fill the same ball, one of them in two places, and a large
    square through all of them: the trees of such are mixed in the scene's own."""
    rng = np.random.default_rng(8)

    def heap(count):
        centres = rng.normal(size=(count, 1, 3))
        corners = centres + 0.12 * rng.normal(size=(count, 3, 3))
        return scenes.mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))

    def somewhere():
        turn = scenes.rotation("x", rng.uniform(0, 6)) @ scenes.rotation("z", rng.uniform(0, 6))
        return scenes.transform(0.1 * rng.normal(size=3), turn @ np.diag(rng.uniform(0.8, 1.2, 3)))

    heaps = [heap(count) for count in (7, 40, 150, 150)]
    heaps.append(heaps[-1])
    objects = [(shape, somewhere(), [scenes.WHITE]) for shape in heaps]
    objects.append((scenes.quad(4.0), somewhere(), [scenes.WHITE]))
    scene = scenes.build(objects, scenes.camera((0, 0, 5), (0, 0, 0)))
    tracer, flat = tracer_of(device, scene)
    rays = np.zeros((*SIZE[::-1], 8), dtype=np.float32)
    rays[..., :3] = 2 * rng.normal(size=(*SIZE[::-1], 3))
    rays[..., 3:6] = 0.6 * rng.normal(size=(*SIZE[::-1], 3)) - rays[..., :3]
    rays[..., :3] -= flat.origin
    rays[..., 7] = np.inf
    distance, instance, triangle = (image.reshape(SIZE[::-1]) for image in brute_force(flat, rays))
    images = cast(device, tracer, rays, False)
    assert 0.2 < np.isfinite(distance).mean() < 0.95
    np.testing.assert_allclose(images["distance"], distance, rtol=1e-4)
    np.testing.assert_array_equal(images["instance"], instance)
    np.testing.assert_array_equal(images["triangle"], triangle)
    np.testing.assert_array_equal(cast(device, tracer, rays, True)["occluded"], np.isfinite(distance))


def test_distances_count_in_lengths_of_the_direction(device):
    tracer, flat = tracer_of(
        device, scenes.build([(scenes.quad(2.0), scenes.transform(), [scenes.WHITE])], scenes.camera((0, 0, 5), (0, 0, 0)))
    )
    above = np.array([0.1, 0.2, 3.0]) - flat.origin
    rays = np.array(
        [[(*above, 0, 0, -2, low, high) for low, high in ((0, np.inf), (0, 1.4), (1.6, 9), (1.4, 1.6), (0, -1))]],
        np.float32
    )
    hit = [True, False, False, True, False]
    images = cast(device, tracer, rays, False)
    np.testing.assert_allclose(images["distance"][0], np.where(hit, 1.5, np.inf), rtol=1e-5)
    np.testing.assert_array_equal(images["instance"][0], np.where(hit, 0, -1))
    np.testing.assert_array_equal(cast(device, tracer, rays, True)["occluded"][0], hit)


def test_generated_scenes_are_as_large_and_as_closed_as_they_say(device):
    scene = generated.room(18, None, SIZE)
    assert len(scene.meshes[0].triangles) == 60 * 18**2
    if device.name == "reference":
        return
    tracer, _ = tracer_of(device, scene)
    for rays in ray_sets(device, scene, SIZE)[:2]:
        assert (cast(device, tracer, rays, False)["instance"] >= 0).all()
    assert sum(len(mesh.triangles) for mesh in generated.cornell_box(SIZE).meshes) == 36
