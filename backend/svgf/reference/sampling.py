# SPDX-License-Identifier: Apache-2.0
"""Random numbers and the shapes they are warped to.

Every pixel draws its own Owen-scrambled Sobol points [Burley20]. A vertex of a path takes several two-dimensional
points (pairs); the sample index of each pair is shuffled on its own, which decorrelates the pairs ("padding"). All of
it is integer arithmetic modulo 2^32 on counters, so that every device gets the same bits.
"""

from __future__ import annotations

import numpy as np

# Pairs of one sample: the point in the pixel, then PAIRS_PER_VERTEX for each vertex, the first hit being vertex 0.
PIXEL_PAIR = 0
LENS_PAIR = 1 << 17
PAIRS_PER_VERTEX = 4


def direction_pair(vertex: int) -> int:
    """Direction of the BSDF sample."""
    return 1 + PAIRS_PER_VERTEX * vertex


def lobe_pair(vertex: int) -> int:
    """Lobe of the BSDF; Russian roulette."""
    return 2 + PAIRS_PER_VERTEX * vertex


def light_point_pair(vertex: int) -> int:
    """Point on the light."""
    return 3 + PAIRS_PER_VERTEX * vertex


def light_choice_pair(vertex: int) -> int:
    """Which light."""
    return 4 + PAIRS_PER_VERTEX * vertex


def surface_pair(vertex: int) -> int:
    """Part of a mix, and whether the ray passes straight, at a triangle. Far from all others."""
    return (1 << 16) + PAIRS_PER_VERTEX * vertex


def shadow_pair(vertex: int) -> int:
    """Part of a mix at a triangle on a shadow ray from the vertex."""
    return (1 << 18) + PAIRS_PER_VERTEX * vertex


def _uint32(x) -> np.ndarray:
    return np.atleast_1d(np.asarray(x)).astype(np.uint32)


def mix(x: np.ndarray) -> np.ndarray:
    """A bijective hash of uint32."""
    x = _uint32(x)
    x = x ^ (x >> np.uint32(16))
    x = x * np.uint32(0x7FEB352D)
    x = x ^ (x >> np.uint32(15))
    x = x * np.uint32(0x846CA68B)
    return x ^ (x >> np.uint32(16))


def reverse_bits(x: np.ndarray) -> np.ndarray:
    x = _uint32(x)
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> np.uint32(shift)) & np.uint32(mask)) | ((x & np.uint32(mask)) << np.uint32(shift))
    return (x >> np.uint32(16)) | (x << np.uint32(16))


def laine_karras(x: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """A permutation in which every bit depends only on itself and on lower ones [Burley20, Listing 2]."""
    x, seed = _uint32(x), _uint32(seed)
    x = x ^ (x * np.uint32(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> np.uint32(16)) | np.uint32(1))
    x = x ^ (x * np.uint32(0x05526C56))
    return x ^ (x * np.uint32(0x53A22864))


def owen(x: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """Nested uniform scramble in base 2: each bit flips by a hash of the higher ones [Burley20, Section 3]."""
    return reverse_bits(laine_karras(reverse_bits(x), seed))


def sobol(index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first two Sobol dimensions as uint32 fractions."""
    index = _uint32(index)
    first = reverse_bits(index)
    second = np.zeros_like(index)
    column = 1 << 31
    for bit in range(32):
        second = second ^ np.where((index >> np.uint32(bit)) & np.uint32(1), np.uint32(column), np.uint32(0))
        column ^= column >> 1
    return first, second


def pixel_keys(width: int, height: int, seed: int) -> np.ndarray:
    """uint32 [height * width], row by row."""
    return mix(np.arange(width * height, dtype=np.uint32) ^ mix(seed & 0xFFFFFFFF))


def to_unit(bits: np.ndarray) -> np.ndarray:
    """The upper 24 bits as a number in [0, 1): a float32 holds them exactly."""
    return (bits >> np.uint32(8)) * 2.0**-24


def random_pair(pixel_key: np.ndarray, pair: int, sample: int) -> np.ndarray:
    """[n, 2] in [0, 1). sample: the running number of the pixel's sample."""
    key = mix(pixel_key + np.uint32((0x9E3779B9 * (pair + 1)) & 0xFFFFFFFF))
    first, second = sobol(owen(sample & 0xFFFFFFFF, key))
    first = owen(first, mix(key ^ np.uint32(0xA511E9B3)))
    second = owen(second, mix(key ^ np.uint32(0x63D83595)))
    return np.stack([to_unit(first), to_unit(second)], axis=-1)


def random_at_triangle(
    pixel_key: np.ndarray, pair: int, sample: int, instance: np.ndarray, triangle: np.ndarray
) -> np.ndarray:
    """[n] in [0, 1): the first number of a pair that each triangle of each instance has for itself."""
    surface = mix(mix(instance) + _uint32(triangle))
    key = mix(mix(pixel_key + np.uint32((0x9E3779B9 * (pair + 1)) & 0xFFFFFFFF)) ^ surface)
    first, _ = sobol(owen(sample & 0xFFFFFFFF, key))
    return to_unit(owen(first, mix(key ^ np.uint32(0xA511E9B3))))


def frame(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that complete unit normals to right-handed orthonormal bases [Duff17, Listing 3]."""
    x, y, z = np.moveaxis(normal, -1, 0)
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    bitangent = np.stack([b, sign + y * y * a, -y], axis=-1)
    return tangent, bitangent


def to_world(local: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Vectors given in the frame of normal."""
    tangent, bitangent = frame(normal)
    return local[..., 0:1] * tangent + local[..., 1:2] * bitangent + local[..., 2:3] * normal


def to_local(world: np.ndarray, normal: np.ndarray) -> np.ndarray:
    tangent, bitangent = frame(normal)
    return np.stack([np.einsum("...i,...i->...", world, axis) for axis in (tangent, bitangent, normal)], axis=-1)


def concentric_disk(uv: np.ndarray) -> np.ndarray:
    """Uniform points in the unit disk, [..., 2], of low distortion [Shirley97]."""
    x, y = np.moveaxis(2.0 * uv - 1.0, -1, 0)
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    ratio = np.where(wide, y, x) / np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, np.pi / 4.0 * ratio, np.pi / 2.0 - np.pi / 4.0 * ratio)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def cosine_hemisphere(uv: np.ndarray) -> np.ndarray:
    """Directions around +Z of density cosine / pi."""
    disk = concentric_disk(uv)
    z = np.sqrt(np.maximum(0.0, 1.0 - (disk**2).sum(axis=-1)))
    return np.concatenate([disk, z[..., None]], axis=-1)


def cone(uv: np.ndarray, one_minus_cos: np.ndarray) -> np.ndarray:
    """Uniform directions within a cone around +Z. one_minus_cos: 1 - cosine of half its angle, exact even for narrow
    ones."""
    height = uv[..., 0] * one_minus_cos  # 1 - cosine of the direction
    sine = np.sqrt(np.maximum(0.0, height * (2.0 - height)))
    phi = 2.0 * np.pi * uv[..., 1]
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), 1.0 - height], axis=-1)


def triangle_barycentrics(uv: np.ndarray) -> np.ndarray:
    """Uniform weights of vertices 1 and 2: the square-root warp."""
    root = np.sqrt(uv[..., 0])
    return np.stack([root * (1.0 - uv[..., 1]), root * uv[..., 1]], axis=-1)


def power_heuristic(pdf: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Weight of a sample of density pdf that the other strategy finds with density other [Veach97, Eq. 9.13], exponent
    2."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = other / pdf
        return np.where(pdf > 0.0, 1.0 / (1.0 + ratio * ratio), 0.0)
