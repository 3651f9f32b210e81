# SPDX-License-Identifier: Apache-2.0
"""Random numbers and warps of the reference."""

import numpy as np
import pytest
from scipy.stats import qmc
from svgf.reference import sampling

from .statistical import assert_histogram, assert_mean

MASK = 0xFFFFFFFF


def mix_in_whole_numbers(x: int) -> int:
    x ^= x >> 16
    x = x * 0x7FEB352D & MASK
    x ^= x >> 15
    x = x * 0x846CA68B & MASK
    return x ^ x >> 16


def reverse_in_whole_numbers(x: int) -> int:
    return int(f"{x:032b}"[::-1], 2)


def owen_in_whole_numbers(x: int, seed: int) -> int:
    x = reverse_in_whole_numbers(x)
    x ^= x * 0x3D20ADEA & MASK
    x = x + seed & MASK
    x = x * (seed >> 16 | 1) & MASK
    x ^= x * 0x05526C56 & MASK
    x ^= x * 0x53A22864 & MASK
    return reverse_in_whole_numbers(x)


def pair_in_whole_numbers(x: int, y: int, width: int, seed: int, pair: int, sample: int) -> tuple[float, float]:
    """Python's own integers, one number at a time; the second Sobol dimension from its polynomial, z + 1."""
    pixel_key = mix_in_whole_numbers((y * width + x) ^ mix_in_whole_numbers(seed))
    key = mix_in_whole_numbers(pixel_key + 0x9E3779B9 * (pair + 1) & MASK)
    index = owen_in_whole_numbers(sample, key)
    second, direction = 0, 1  # direction numbers m_i = 2 m_(i-1) xor m_(i-1), as fractions m_i / 2^i
    for bit in range(32):
        if index >> bit & 1:
            second ^= direction << (31 - bit)
        direction = (2 * direction ^ direction) & MASK
    u = owen_in_whole_numbers(reverse_in_whole_numbers(index), mix_in_whole_numbers(key ^ 0xA511E9B3))
    v = owen_in_whole_numbers(second, mix_in_whole_numbers(key ^ 0x63D83595))
    return (u >> 8) / 2**24, (v >> 8) / 2**24


@pytest.mark.parametrize("seed", [0, 1, 0xDEADBEEF])
def test_pairs_are_those_of_plain_integer_arithmetic(seed):
    width, height = 7, 5
    keys = sampling.pixel_keys(width, height, seed)
    for pair in (0, 1, 6, 51):
        for sample in (0, 1, 2, 1023, 0xFFFFFFFF):
            numbers = sampling.random_pair(keys, pair, sample).reshape(height, width, 2)
            for x, y in ((0, 0), (6, 0), (3, 4)):
                assert tuple(numbers[y, x]) == pair_in_whole_numbers(x, y, width, seed, pair, sample)


def test_sobol_dimensions_are_those_of_scipy():
    index = np.arange(1 << 12, dtype=np.uint32)
    ours = np.stack(sampling.sobol(index ^ (index >> 1)), axis=1) / 2.0**32  # scipy counts in Gray code
    np.testing.assert_array_equal(ours, qmc.Sobol(2, scramble=False).random(len(index)))


@pytest.mark.parametrize("log_count", range(9))
def test_every_aligned_block_of_samples_is_stratified(log_count):
    """2^k samples hold one in each elementary interval of area 2^-k: a (0, k, 2)-net, whatever the scramble."""
    count = 1 << log_count
    keys = sampling.pixel_keys(4, 4, seed=9)
    for pair in (0, 3, 17):
        for block in (0, 1, 5, 1000):
            points = np.array([sampling.random_pair(keys, pair, block * count + i) for i in range(count)])
            for columns_log in range(log_count + 1):
                columns, rows = 1 << columns_log, 1 << (log_count - columns_log)
                cell = np.floor(points[..., 0] * columns) * rows + np.floor(points[..., 1] * rows)
                assert (np.sort(cell, axis=0) == np.arange(count)[:, None]).all()


def test_owen_scramble_keeps_elementary_intervals():
    rng = np.random.default_rng(1)
    x = rng.integers(0, 1 << 32, 1000, dtype=np.uint32)
    for bits in (1, 4, 9):
        neighbour = x ^ rng.integers(0, 1 << (32 - bits), 1000, dtype=np.uint32)
        a, b = sampling.owen(x, 12345), sampling.owen(neighbour, 12345)
        assert ((a >> (32 - bits)) == (b >> (32 - bits))).all()


def test_hash_is_one_to_one_and_uniform():
    keys = sampling.pixel_keys(512, 512, seed=4)
    assert len(np.unique(keys)) == len(keys)
    counts = np.bincount(keys >> np.uint32(22), minlength=1024)
    assert_histogram(counts, np.full(1024, len(keys) / 1024))


@pytest.mark.parametrize("seed", [0, 1, 2**31])
@pytest.mark.parametrize("first, second", [((0, 0), (0, 1)), ((1, 0), (2, 0)), ((3, 1), (4, 1)), ((5, 0), (9, 1))])
def test_numbers_are_uniform_and_independent_over_pixels(seed, first, second):
    keys = sampling.pixel_keys(256, 256, seed)
    x = sampling.random_pair(keys, first[0], 3)[:, first[1]]
    y = sampling.random_pair(keys, second[0], 3)[:, second[1]]
    counts, _, _ = np.histogram2d(x, y, bins=32, range=[(0, 1), (0, 1)])
    assert_histogram(counts, np.full(1024, len(keys) / 1024), 1e-5)


def test_neighbours_in_the_image_are_independent():
    numbers = sampling.random_pair(sampling.pixel_keys(256, 256, 0), 1, 0)[:, 0].reshape(256, 256)
    for neighbour in (numbers[:, 1:], numbers[1:].reshape(-1, 256)):
        own = numbers[:, :-1] if neighbour.shape[1] == 255 else numbers[:-1]
        counts, _, _ = np.histogram2d(own.ravel(), neighbour.ravel(), bins=16, range=[(0, 1), (0, 1)])
        assert_histogram(counts, np.full(256, own.size / 256))


def test_numbers_stay_below_one():
    assert sampling.to_unit(np.array([MASK], dtype=np.uint32))[0] == np.float32(1) - np.float32(2**-24)


def grid(count: int = 256) -> np.ndarray:
    """Stratified points: the warps are smooth, so their integrals converge like 1 / count^2."""
    x, y = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_concentric_disk_is_uniform():
    points = sampling.concentric_disk(np.random.default_rng(2).random((200_000, 2)))
    radius, angle = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    assert radius.max() <= 1
    counts, _, _ = np.histogram2d(radius**2, angle, bins=(16, 32), range=[(0, 1), (-np.pi, np.pi)])
    assert_histogram(counts, np.full(512, len(points) / 512))


def test_concentric_disk_keeps_corners_and_centre():
    corners = sampling.concentric_disk(np.array([(0.5, 0.5), (1, 0.5), (0.5, 1), (0, 0.5), (0.5, 0), (1, 1), (0, 0)]))
    diagonal = np.sqrt(0.5)
    expected = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (diagonal, diagonal), (-diagonal, -diagonal)]
    np.testing.assert_allclose(corners, expected, atol=1e-15)


def test_cosine_hemisphere_moments():
    directions = sampling.cosine_hemisphere(grid())
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    # Of density cos / pi: E[z^n] = 2 / (n + 2), and E[x] = E[y] = 0.
    for power in (1, 2, 3):
        assert np.mean(directions[:, 2] ** power) == pytest.approx(2 / (power + 2), abs=2e-4)  # z has a kink at the rim
    np.testing.assert_allclose(directions[:, :2].mean(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize("one_minus_cos", [2.0, 1.0, 0.1, 1e-5, 1e-12])
def test_cone_is_uniform(one_minus_cos):
    directions = sampling.cone(grid(), np.array(one_minus_cos))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    # Height above the rim is uniform. The distance to the axis tells it for cones so narrow that 1 - z would not.
    height = (directions[:, :2] ** 2).sum(axis=1)
    expected = one_minus_cos - one_minus_cos**2 / 3  # mean of h (2 - h), h uniform in [0, one_minus_cos]
    assert height.mean() == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(directions[:, :2].mean(axis=0), 0, atol=1e-9)


def test_triangle_points_are_uniform():
    weights = sampling.triangle_barycentrics(np.random.default_rng(3).random((100_000, 2)))
    assert weights.min() >= 0 and weights.sum(axis=1).max() <= 1 + 1e-12
    for weight in (*weights.T, 1 - weights.sum(axis=1)):
        assert_mean(weight, 1 / 3)
        assert_mean(weight**2, 1 / 6)


def test_frames_are_orthonormal_and_right_handed():
    normals = np.random.default_rng(4).normal(size=(1000, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3), [(1e-9, 0, -1), (0, 1e-9, 1), (0, 0, -0.0 - 1)]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangent, bitangent = sampling.frame(normals)
    basis = np.stack([tangent, bitangent, normals], axis=1)
    np.testing.assert_allclose(basis @ basis.transpose(0, 2, 1), np.broadcast_to(np.eye(3), basis.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(basis), 1, atol=1e-12)
    local = np.random.default_rng(5).normal(size=normals.shape)
    np.testing.assert_allclose(sampling.to_local(sampling.to_world(local, normals), normals), local, atol=1e-12)


def test_power_heuristic_sums_to_one_without_overflow():
    a = np.array([1.0, 1e-200, 1e200, 3.0, np.inf])
    b = np.array([2.0, 1e200, 1e-200, 0.0, 1.0])
    np.testing.assert_allclose(sampling.power_heuristic(a, b)[:4] + sampling.power_heuristic(b, a)[:4], 1.0)
    assert sampling.power_heuristic(np.array(1.0), np.array(2.0)) == pytest.approx(0.2)
    assert sampling.power_heuristic(a, b)[4] == 1.0
