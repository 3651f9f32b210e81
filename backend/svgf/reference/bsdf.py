# SPDX-License-Identifier: Apache-2.0
"""The materials as Cycles defines them, as a sum of five lobes.

D, diffuse: Lambert or Oren-Nayar, in reflection, or in transmission for TRANSLUCENT. H, sheen: a linearly transformed
cosine. S, specular: GGX reflection, of the interface of plastic and of metal. C, coat: GGX reflection of its own
roughness. G, glass: GGX reflection and refraction.

Sheen, coat and interface lie on each other in this order; each takes its albedo away from what lies below. Of light that
GGX loses between microfacets, each lobe is given back what Fresnel's term leaves of it, as a factor [Kulla17].

All arrays have one row per ray. V is the direction to the viewer, L the sampled one; both point away from the surface.
Local directions are in a frame whose Z is the shading normal N and whose X is the tangent. What lies on the wrong side
of the geometric normal Ng is black.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..flatten import MATERIAL_COLUMNS
from ..scene import MaterialKind
from .albedo import ior_coordinate, lookup
from .sampling import cosine_hemisphere, frame
from .vec import dot, flip_towards, luminance, normalize

# GGX alpha below which a lobe is a mirror.
SMOOTH_ALPHA = 1e-3
# Shading normals are bent so that the viewer stays above the horizon.
SMALLEST_COSINE = 0.01
LARGEST_F0 = 0.99
# Diffuse roughness below which a surface is Lambert's.
SMALLEST_DIFFUSE_ROUGHNESS = 1e-5

# Events of BsdfSample.
NONE, DIFFUSE, GLOSSY, TRANSMISSION = range(4)


@dataclass
class Layers:
    """What lies on the base of a Principled BSDF. below [n, 3]: share of light that reaches the base and comes back,
    which is also the base's share of what it emits. sheen, coat: [n, 3] and [n], weights of these lobes with all their
    factors; coat_albedo: [n], of the coat towards V."""

    below: np.ndarray
    sheen: np.ndarray
    sheen_a: np.ndarray
    sheen_b: np.ndarray
    coat: np.ndarray
    coat_alpha: np.ndarray
    coat_eta: np.ndarray
    coat_albedo: np.ndarray


@dataclass
class Bsdf:
    """One material at each hit. Colours [n, 3], the rest [n], alpha [n, 2].

    x, y, z: axes of the local frame; z is N. smooth_normal: N before the normal map.
    diffuse, plastic, metal, glass: weights of the lobes, with all factors but those below. oren_nayar_*: see
    oren_nayar. transmits_diffuse: D is in transmission. plastic_f0, plastic_eta, metal_f0, metal_f90, metal_dip: of
    Fresnel's terms. glass_eta: IOR beyond the surface over that on the viewer's side. refracts_only: G without Fresnel's
    term and reflection.
    *_albedo: of the lobes towards V, D and H, and the others. probability: [n, 5], of choosing D, H, S, C, G.
    """

    view: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    geometric_normal: np.ndarray
    smooth_normal: np.ndarray
    roughness: np.ndarray
    diffuse: np.ndarray
    transmits_diffuse: np.ndarray
    oren_nayar_a: np.ndarray
    oren_nayar_b: np.ndarray
    oren_nayar_multiple: np.ndarray
    alpha: np.ndarray
    plastic: np.ndarray
    plastic_f0: np.ndarray
    plastic_eta: np.ndarray
    metal: np.ndarray
    metal_f0: np.ndarray
    metal_f90: np.ndarray
    metal_dip: np.ndarray
    glass: np.ndarray
    glass_alpha: np.ndarray
    glass_f0: np.ndarray
    glass_eta: np.ndarray
    reflection_tint: np.ndarray
    transmission_tint: np.ndarray
    refracts_only: np.ndarray
    sheen: np.ndarray
    sheen_a: np.ndarray
    sheen_b: np.ndarray
    coat: np.ndarray
    coat_alpha: np.ndarray
    coat_eta: np.ndarray
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    probability: np.ndarray

    @property
    def normal(self) -> np.ndarray:
        return self.z

    @property
    def smooth(self) -> np.ndarray:
        """bool [n]: lobe S is a mirror."""
        return self.alpha.max(axis=1) < SMOOTH_ALPHA

    @property
    def smooth_coat(self) -> np.ndarray:
        return self.coat_alpha < SMOOTH_ALPHA

    @property
    def smooth_glass(self) -> np.ndarray:
        """bool [n]: lobe G is a mirror, or there is no interface and it goes straight on."""
        return (self.glass_alpha < SMOOTH_ALPHA) | (self.glass_eta == 1.0)

    def to_local(self, vector: np.ndarray) -> np.ndarray:
        return np.stack([dot(vector, axis) for axis in (self.x, self.y, self.z)], axis=1)

    def to_world(self, local: np.ndarray) -> np.ndarray:
        return local[:, 0:1] * self.x + local[:, 1:2] * self.y + local[:, 2:3] * self.z

    def rows(self, chosen: np.ndarray) -> Bsdf:
        return Bsdf(**{field.name: getattr(self, field.name)[chosen] for field in fields(self)})


def column(rows: np.ndarray, name: str) -> np.ndarray:
    """[n], or [n, 3] of a colour."""
    start = MATERIAL_COLUMNS[name]
    colors = ("base_color", "specular_tint", "coat_tint", "sheen_tint", "emission", "light_emission", "normal")
    return rows[:, start : start + 3] if name in colors else rows[:, start]


def make_layers(rows: np.ndarray, cos_view: np.ndarray) -> Layers:
    """rows: [n, 48] of materials, maps applied. cos_view: [n], N.V."""
    principled = column(rows, "kind") == MaterialKind.PRINCIPLED
    below = np.ones((len(rows), 3))

    weight = np.where(principled, column(rows, "sheen_weight"), 0.0)[:, None] * column(rows, "sheen_tint")
    sheen_a, sheen_b, sheen_albedo = sheen_lobe(np.clip(cos_view, 0.0, 1.0), column(rows, "sheen_roughness"))
    sheen = weight * sheen_albedo[:, None]
    below = below * np.clip(1.0 - sheen.max(axis=1), 0.0, 1.0)[:, None]

    coat_weight = np.where(principled, column(rows, "coat_weight"), 0.0)
    coat_eta = np.maximum(column(rows, "coat_ior"), 1.0)
    roughness = column(rows, "coat_roughness")
    f0 = normal_reflectance(coat_eta)
    energy, factor = multiscatter_factor(roughness, cos_view, dielectric_mean(coat_eta))
    single = f0 + (1.0 - f0) * lookup("dielectric", roughness, cos_view, ior_coordinate(coat_eta))
    coat = coat_weight * below[:, 0] * factor
    coat_albedo = coat * energy * single
    below = below * np.clip(1.0 - coat_weight * factor * energy * single, 0.0, 1.0)[:, None]
    # Beer's law along the refracted ray; the tint is that of a ray along the normal.
    inside = np.sqrt(1.0 - (1.0 - np.clip(cos_view, 0.0, 1.0) ** 2) / coat_eta**2)
    absorbed = column(rows, "coat_tint") ** (1.0 / np.maximum(inside, 1e-6))[:, None]
    below = below * (1.0 + coat_weight[:, None] * (absorbed - 1.0))
    return Layers(below, sheen, sheen_a, sheen_b, coat, roughness**2, coat_eta, coat_albedo)


def make_bsdf(
    view: np.ndarray,
    normal: np.ndarray,
    geometric_normal: np.ndarray,
    rows: np.ndarray,
    smooth_normal: np.ndarray | None = None,
    tangent: np.ndarray | None = None,
    weight: np.ndarray | float = 1.0,
) -> Bsdf:
    """rows: [n, 48] of FlatScene.materials with the values of their maps, none of them a mix. normal: [n, 3], with the
    normal map; smooth_normal: without it. tangent: [n, 3], of anisotropy. weight: [n], of all lobes."""
    kind = column(rows, "kind")
    is_principled, is_glossy = kind == MaterialKind.PRINCIPLED, kind == MaterialKind.GLOSSY
    is_glass, is_refraction = kind == MaterialKind.GLASS, kind == MaterialKind.REFRACTION
    is_translucent = kind == MaterialKind.TRANSLUCENT
    base, roughness, ior = column(rows, "base_color"), column(rows, "roughness"), column(rows, "ior")
    tint = column(rows, "specular_tint")
    multiscatter = column(rows, "multiscatter")

    metallic = np.where(is_principled, column(rows, "metallic"), is_glossy)
    transmission = np.where(is_principled, column(rows, "transmission"), is_glass | is_refraction)
    interface_f0, plastic_eta = interface(ior, column(rows, "specular_ior_level"))
    has_interface = is_principled & (plastic_eta != 1.0) & (interface_f0 > 0.0)
    glass_share = (1.0 - metallic) * transmission
    plastic_share = np.where(has_interface, (1.0 - metallic) * (1.0 - transmission), 0.0)
    is_layered = is_principled & ((column(rows, "sheen_weight") > 0.0) | (column(rows, "coat_weight") > 0.0))
    has_specular = is_layered | (metallic > 0.0) | (transmission > 0.0) | has_interface

    entering = dot(geometric_normal, view) > 0.0
    geometric_normal = flip_towards(geometric_normal, view)
    flipped = flip_towards(normal, geometric_normal)
    smooth_normal = flipped if smooth_normal is None else flip_towards(smooth_normal, geometric_normal)
    reflecting = raise_viewer(valid_reflection(flipped, geometric_normal, view), view)
    normal = np.where(has_specular[:, None], reflecting, flipped)
    anisotropic = np.where(is_principled | is_glossy, column(rows, "anisotropic"), 0.0)
    x, y = _tangent_frame(normal, tangent, column(rows, "anisotropic_rotation"), anisotropic != 0.0)
    cos_view = dot(normal, view)

    layers = make_layers(rows, cos_view)
    below = layers.below * np.broadcast_to(weight, kind.shape)[:, None]
    n = len(rows)
    ones = np.ones((n, 3))

    # Metal, and GLOSSY, whose Fresnel term is its colour from all directions.
    metal_f0 = base
    metal_f90 = np.where(is_glossy[:, None], base, 1.0)
    schlick = (6.0 / 7.0) ** 5
    dip = (base + (1.0 - base) * schlick) * (7.0 / (schlick * 6.0 / 7.0)) * (1.0 - tint)
    metal_dip = np.where(is_glossy[:, None], 0.0, dip)
    mean = metal_f0 + (metal_f90 - metal_f0) / 21.0 - metal_dip / 126.0
    energy, factor = multiscatter_factor(roughness, cos_view, mean, multiscatter)
    # Of an anisotropic lobe Cycles' roughness is the fourth root of both alphas' product, clamped as they are.
    alpha = _alphas(roughness, anisotropic, is_glossy)
    mean_roughness = alpha.prod(axis=1) ** 0.25
    energy, factor = multiscatter_factor(mean_roughness, cos_view, mean, multiscatter)
    metal = below * metallic[:, None] * factor
    s = lookup("schlick", mean_roughness, cos_view)[:, None]
    c = np.clip(cos_view, 0.0, 1.0)[:, None]
    metal_albedo = np.clip(metal_f0 + (metal_f90 - metal_f0) * s - metal_dip * c * (1.0 - c) ** 6, 0.0, 1.0)
    specular_albedo = metal * energy[:, None] * metal_albedo

    # Glass.
    glass_eta = np.where(entering, ior, 1.0 / ior)
    glass_f0 = normal_reflectance(ior)[:, None] * np.where(is_principled[:, None], tint, 1.0)
    transmission_tint = np.where(is_principled[:, None], np.sqrt(base), base)
    reflection_tint = np.where(is_glass[:, None], base, 1.0)
    glass_factor = glass_multiscatter_factor(roughness, cos_view, glass_eta, transmission_tint, multiscatter)
    glass_factor = np.where(is_refraction[:, None], 1.0, glass_factor)
    glass = below * glass_share[:, None] * glass_factor
    inside_out = fresnel_dielectric(cos_view, glass_eta)
    z = ior_coordinate(ior)
    outside_in = glass_f0 + (1.0 - glass_f0) * lookup("dielectric", roughness, cos_view, z)[:, None]
    reflected = np.where(entering[:, None], outside_in, inside_out[:, None])
    reflected = np.where((glass_eta == 1.0)[:, None], 0.0, reflected)
    passed = np.where(is_refraction[:, None], transmission_tint, (1.0 - reflected) * transmission_tint)
    both = np.where(is_refraction[:, None], 0.0, reflected * reflection_tint) + passed
    glass_albedo = below * glass_share[:, None] * both
    specular_albedo = specular_albedo + glass_albedo

    # The interface of plastic, and the diffuse base below it.
    plastic_f0 = np.clip(interface_f0[:, None] * tint, 0.0, 1.0)
    f0 = normal_reflectance(plastic_eta)
    share = np.clip((dielectric_mean(plastic_eta) - f0) / (1.0 - f0), 0.0, 1.0)[:, None]
    mean = plastic_f0 + (1.0 - plastic_f0) * share
    energy, factor = multiscatter_factor(mean_roughness, cos_view, mean, multiscatter)
    plastic = below * plastic_share[:, None] * factor
    s = lookup("dielectric", mean_roughness, cos_view, ior_coordinate(plastic_eta))[:, None]
    plastic_albedo = plastic * energy[:, None] * (plastic_f0 + (1.0 - plastic_f0) * s)
    # What multiscatter does not give back is not given to the base either.
    counted = np.where(multiscatter > 0.0, energy, 1.0)[:, None]
    taken = ((plastic_f0 + (1.0 - plastic_f0) * s) * factor * counted).max(axis=1)
    taken = np.where(has_interface, np.clip(taken, 0.0, 1.0), 0.0)
    has_diffuse = is_principled | is_translucent | (kind == MaterialKind.DIFFUSE)
    diffuse_share = np.where(has_diffuse, (1.0 - metallic) * (1.0 - transmission) * (1.0 - taken), 0.0)
    diffuse = below * diffuse_share[:, None] * base
    a, b, multiple, diffuse_scale = _oren_nayar_terms(np.where(is_translucent, 0.0, column(rows, "diffuse_roughness")),
                                                      cos_view, base)  # fmt: skip
    diffuse_albedo = diffuse * diffuse_scale
    sheen = layers.sheen * np.broadcast_to(weight, kind.shape)[:, None]
    coat = layers.coat * weight

    weights = np.stack(
        [
            luminance(diffuse_albedo),
            luminance(sheen),
            luminance(specular_albedo - glass_albedo + plastic_albedo),
            layers.coat_albedo * weight,
            luminance(glass_albedo),
        ],
        axis=1,
    )
    total = weights.sum(axis=1, keepdims=True)
    probability = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), 0.0)
    coat_albedo = (layers.coat_albedo * weight)[:, None]
    return Bsdf(
        view=view,
        x=x,
        y=y,
        z=normal,
        geometric_normal=geometric_normal,
        smooth_normal=smooth_normal,
        roughness=roughness,
        diffuse=diffuse,
        transmits_diffuse=is_translucent,
        oren_nayar_a=a,
        oren_nayar_b=b,
        oren_nayar_multiple=multiple,
        alpha=alpha,
        plastic=plastic,
        plastic_f0=plastic_f0,
        plastic_eta=plastic_eta,
        metal=metal,
        metal_f0=metal_f0,
        metal_f90=metal_f90 * ones,
        metal_dip=metal_dip,
        glass=glass,
        glass_alpha=roughness**2,
        glass_f0=glass_f0,
        glass_eta=glass_eta,
        reflection_tint=reflection_tint * ones,
        transmission_tint=transmission_tint,
        refracts_only=is_refraction,
        sheen=sheen,
        sheen_a=layers.sheen_a,
        sheen_b=layers.sheen_b,
        coat=coat,
        coat_alpha=layers.coat_alpha,
        coat_eta=layers.coat_eta,
        diffuse_albedo=diffuse_albedo + sheen,
        specular_albedo=specular_albedo + plastic_albedo + coat_albedo,
        probability=probability,
    )


def _alphas(roughness: np.ndarray, anisotropic: np.ndarray, is_glossy: np.ndarray) -> np.ndarray:
    """GGX alpha along X and Y, [n, 2]."""
    alpha = roughness**2
    aspect = np.sqrt(1.0 - np.clip(anisotropic, 0.0, 1.0) * 0.9)
    ratio = 1.0 - np.minimum(np.abs(anisotropic), 0.99)
    narrow, wide = alpha * ratio, alpha / ratio
    below_zero = anisotropic < 0.0
    along_x = np.where(is_glossy, np.where(below_zero, wide, narrow), alpha / aspect)
    along_y = np.where(is_glossy, np.where(below_zero, narrow, wide), alpha * aspect)
    return np.clip(np.stack([along_x, along_y], axis=1), 0.0, 1.0)


def _tangent_frame(
    normal: np.ndarray, tangent: np.ndarray | None, rotation: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """X and Y. rotation: turns of the tangent around the normal. Where there is no tangent: any."""
    x, y = frame(normal)
    if tangent is None:
        return x, y
    across = np.cross(normal, tangent)
    there = wanted & (np.linalg.norm(across, axis=1) > 1e-6 * np.linalg.norm(tangent, axis=1))
    side = normalize(across)
    along = np.cross(side, normal)
    angle = (2.0 * np.pi * rotation)[:, None]
    turned = np.cos(angle) * along + np.sin(angle) * side
    x = np.where(there[:, None], turned, x)
    return x, np.where(there[:, None], np.cross(normal, x), y)


def valid_reflection(normal: np.ndarray, geometric_normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    """The normal, turned towards the geometric one just as far as the mirror image of the view needs to be above the
    surface.

    With Ng as Z and N in the XZ plane, V = (Vx, ., Vz): 2 (N.V) Nz - Vz = t is quadratic in Nz^2.
    """
    height = dot(view, geometric_normal)
    threshold = np.minimum(0.9 * height, 0.01)
    mirrored = 2.0 * dot(normal, view)[:, None] * normal - view
    x = normal - dot(normal, geometric_normal)[:, None] * geometric_normal
    length = np.linalg.norm(x, axis=1)
    x = normalize(x)
    vx = dot(view, x)
    a = vx**2 + height**2
    b = 2.0 * (a + height * threshold)
    c = (threshold + height) ** 2
    root = np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
    z2 = np.clip(0.25 * (b + np.where(vx < 0.0, root, -root)) / np.maximum(a, 1e-30), 0.0, 1.0)
    bent = np.sqrt(1.0 - z2)[:, None] * x + np.sqrt(z2)[:, None] * geometric_normal
    invalid = (dot(geometric_normal, mirrored) < threshold) & (length > 1e-6)
    return np.where(invalid[:, None], bent, normal)


def raise_viewer(normal: np.ndarray, view: np.ndarray) -> np.ndarray:
    cosine = dot(normal, view)
    bent = normalize(normal + view * (SMALLEST_COSINE - cosine)[:, None])
    return np.where((cosine < SMALLEST_COSINE)[:, None], bent, normal)


def normal_reflectance(ior: np.ndarray) -> np.ndarray:
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def interface(ior: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance at normal incidence and IOR of plastic's interface: the level scales the former."""
    f0 = normal_reflectance(ior) * 2.0 * level
    root = np.sqrt(np.minimum(f0, LARGEST_F0))
    eta = (1.0 + root) / (1.0 - root)
    return f0, np.where(level == 0.5, ior, np.where(ior < 1.0, 1.0 / eta, eta))


def dielectric_mean(eta: np.ndarray) -> np.ndarray:
    """Mean Fresnel reflectance over the hemisphere, 2 int c F(c) dc: the fit of [Kulla17]."""
    inner = 0.997118 + eta * (0.1014 - eta * (0.965241 + eta * 0.130607))
    return np.where(eta < 1.0, inner, (eta - 1.0) / (4.08567 + 1.00071 * eta))


def multiscatter_factor(
    roughness: np.ndarray, cosine: np.ndarray, mean: np.ndarray, wanted: np.ndarray | float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Energy [n] of a reflecting lobe, and the factor on it for light that comes out after several reflections. mean:
    [n] or [n, 3], mean Fresnel reflectance of each [Kulla17]."""
    energy = lookup("energy", roughness, cosine)
    factor = _given_back(energy, lookup("mean_energy", roughness), mean)
    return energy, np.where(_like(wanted, factor) > 0.0, factor, 1.0)


def _like(values: np.ndarray | float, array: np.ndarray) -> np.ndarray:
    return np.reshape(values, np.shape(values) + (1,) * (array.ndim - 1)) if np.ndim(values) else np.asarray(values)


def _given_back(energy: np.ndarray, mean_energy: np.ndarray, mean: np.ndarray) -> np.ndarray:
    energy, mean_energy = _like(energy, mean), _like(mean_energy, mean)
    multiple = mean * mean_energy / (1.0 - mean * (1.0 - mean_energy))
    return 1.0 + multiple * (1.0 - energy) / energy


def glass_multiscatter_factor(
    roughness: np.ndarray, cosine: np.ndarray, eta: np.ndarray, tint: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """As multiscatter_factor, [n, 3], of reflection and refraction together; tint: of what is refracted."""
    entering = eta >= 1.0
    z = ior_coordinate(eta)
    energy, mean_energy = (
        np.where(entering, lookup(f"{name}_entering", roughness, cosine, z), lookup(f"{name}_leaving", roughness, cosine, z))
        for name in ("glass", "mean_glass")
    )  # fmt: skip
    factor = _given_back(energy, mean_energy, tint)
    return np.where(((wanted > 0.0) & (eta != 1.0))[:, None], factor, 1.0)


def sheen_lobe(cosine: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inverse linear transform (x, y, z) -> (a x + b z, a y, z) that makes the lobe a cosine [Zeltner22], by the fits of
    [MaterialX], and its albedo, by a table: the fit of that is off by up to 10 %."""
    x, y = cosine, np.clip(roughness, SMALLEST_SHEEN_ROUGHNESS, 1.0)
    a = (2.58126 * x + 0.813703 * y) * y / (1.0 + 0.310327 * x * x + 2.60994 * x * y)
    b = np.sqrt(1.0 - x) * (y - 1.0) * y**3 / (0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y)
    return a, b, lookup("sheen", roughness, cosine)


# Below it the fits divide by almost 0.
SMALLEST_SHEEN_ROUGHNESS = 0.01


def oren_nayar_loss(cosine: np.ndarray) -> np.ndarray:
    """G of the improved Oren-Nayar model [Fujii12], with which the directional albedo is a pi + b G."""
    c = np.clip(cosine, 0.0, 1.0)
    s = np.sqrt(1.0 - c * c)
    with np.errstate(divide="ignore", invalid="ignore"):
        full = s * (np.arccos(c) - 2.0 / 3.0 - s * c) + 2.0 / 3.0 * (s / c) * (1.0 - s**3)
    return np.where(c < 1e-6, np.pi / 2.0 - 2.0 / 3.0 - c, full)


def _oren_nayar_terms(roughness: np.ndarray, cos_view: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, ...]:
    """a, b, the factor of multiple scattering without the term of L, and the lobe's albedo towards V over its weight.

    [Fujii12] with an energy-preserving term; its strength is that of Cycles, which holds one factor of the colour more
    than [Portsmouth25, Eq. 20]."""
    a = 1.0 / (np.pi + roughness * (np.pi / 2.0 - 2.0 / 3.0))
    b = roughness * a
    mean = a * np.pi + (2.0 * np.pi - 5.6) / 3.0 * b
    strength = color**2 * (mean / np.maximum(1.0 - mean, 1e-9))[:, None] / (1.0 - color * (1.0 - mean)[:, None]) / np.pi
    view = a * np.pi + b * oren_nayar_loss(cos_view)
    multiple = strength * (1.0 - view)[:, None]
    is_lambert = roughness < SMALLEST_DIFFUSE_ROUGHNESS
    b = np.where(is_lambert, 0.0, b)
    multiple = np.where(is_lambert[:, None], 0.0, multiple)
    albedo = np.where(is_lambert[:, None], 1.0, view[:, None] + np.pi * multiple * (1.0 - mean)[:, None])
    return np.where(is_lambert, 1.0 / np.pi, a), b, multiple, albedo


def oren_nayar(bsdf: Bsdf, cos_view: np.ndarray, light: np.ndarray, local_view: np.ndarray) -> np.ndarray:
    """Value of D over its weight, without the cosine, [n, 3]."""
    cos_light = np.abs(light[:, 2])
    t = dot(light, local_view) - cos_light * np.maximum(cos_view, 0.0)
    t = np.where(t > 0.0, t / np.maximum(np.maximum(cos_light, cos_view), 1e-30), t)
    single = bsdf.oren_nayar_a + bsdf.oren_nayar_b * np.where(bsdf.oren_nayar_b > 0.0, t, 0.0)
    loss = 1.0 - (bsdf.oren_nayar_a * np.pi + bsdf.oren_nayar_b * oren_nayar_loss(cos_light))
    return single[:, None] + bsdf.oren_nayar_multiple * loss[:, None]


def fresnel_dielectric(cos_incident: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Unpolarized reflectance [Walter07, Eq. 22]; 1 at total internal reflection. eta: IOR beyond over IOR before the
    surface."""
    c = np.abs(cos_incident)
    g_squared = eta * eta - 1.0 + c * c
    g = np.sqrt(np.maximum(g_squared, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
        reflectance = 0.5 * ((g - c) / (g + c)) ** 2 * (1.0 + ratio * ratio)
    reflectance = np.where(eta == 1.0, 0.0, reflectance)
    return np.where(g_squared > 0.0, np.clip(reflectance, 0.0, 1.0), np.where(eta == 1.0, 0.0, 1.0))


def fresnel_tinted(cos_incident: np.ndarray, eta: np.ndarray, f0: np.ndarray) -> np.ndarray:
    """A dielectric's reflectance with its range [F(1), 1] mapped to [f0, 1], [n, 3]."""
    real_f0 = normal_reflectance(eta)
    share = np.clip((fresnel_dielectric(cos_incident, eta) - real_f0) / (1.0 - real_f0), 0.0, 1.0)
    return f0 + (1.0 - f0) * share[:, None]


def fresnel_metal(f0: np.ndarray, f90: np.ndarray, dip: np.ndarray, cos_incident: np.ndarray) -> np.ndarray:
    """Schlick's approximation with the dip around 82 degrees of [Kutz21], [n, 3]."""
    c = np.clip(cos_incident, 0.0, 1.0)[:, None]
    return np.clip(f0 + (f90 - f0) * (1.0 - c) ** 5 - dip * c * (1.0 - c) ** 6, 0.0, 1.0)


def ggx_density(half: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Distribution of microfacet normals D(H), local [n, 3]; alpha [n, 2] [Heitz14, Eq. 85]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        stretched = (half[:, 0] / alpha[:, 0]) ** 2 + (half[:, 1] / alpha[:, 1]) ** 2 + half[:, 2] ** 2
        return np.where(half[:, 2] > 0.0, 1.0 / (np.pi * alpha.prod(axis=1) * stretched**2), 0.0)


def ggx_lambda(direction: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Smith's Lambda of GGX for local directions [Heitz14, Eq. 72]."""
    slope = (alpha[:, 0] * direction[:, 0]) ** 2 + (alpha[:, 1] * direction[:, 1]) ** 2
    return (np.sqrt(1.0 + slope / np.maximum(direction[:, 2] ** 2, 1e-30)) - 1.0) / 2.0


def sample_visible_normal(view: np.ndarray, alpha: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Microfacet normal in the local frame, of density D_V: a point on a spherical cap [Dupuy23, Listing 1]."""
    stretch = np.concatenate([alpha, np.ones((len(alpha), 1))], axis=1)
    standard = normalize(view * stretch)
    phi = 2.0 * np.pi * uv[:, 0]
    z = (1.0 - uv[:, 1]) * (1.0 + standard[:, 2]) - standard[:, 2]
    sine = np.sqrt(np.clip(1.0 - z * z, 0.0, 1.0))
    cap = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], axis=1)
    return normalize((cap + standard) * stretch)


def reflect(view: np.ndarray, half: np.ndarray) -> np.ndarray:
    return 2.0 * dot(view, half)[:, None] * half - view


def refract(view: np.ndarray, half: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Transmitted direction [Walter07, Eq. 40] for half on the viewer's side. Where all is reflected: in the surface,
    unused."""
    cosine = dot(view, half)
    inside = np.sqrt(np.maximum(0.0, 1.0 - (1.0 - cosine * cosine) / (eta * eta)))
    return (cosine / eta - inside)[:, None] * half - view / eta[:, None]


def glass_events(bsdf: Bsdf, cos_half_view: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of lobe G at a microfacet: tinted reflectance and transmittance, [n, 3], and the chance of choosing reflection."""
    reflectance = fresnel_tinted(cos_half_view, bsdf.glass_eta, bsdf.glass_f0)
    reflectance = np.where((bsdf.glass_eta == 1.0)[:, None], 0.0, reflectance)
    blocked = (fresnel_dielectric(cos_half_view, bsdf.glass_eta) == 1.0) & (bsdf.glass_eta != 1.0)
    only = bsdf.refracts_only[:, None]
    transmittance = np.where(only, ~blocked[:, None], 1.0 - reflectance) * bsdf.transmission_tint
    reflectance = np.where(only, 0.0, reflectance * bsdf.reflection_tint)
    total = (reflectance + transmittance).sum(axis=1)
    return reflectance, transmittance, np.where(total > 0.0, reflectance.sum(axis=1) / np.maximum(total, 1e-300), 1.0)


def specular_at(bsdf: Bsdf, cos_half_view: np.ndarray) -> np.ndarray:
    """Fresnel's terms of lobe S with their weights, [n, 3]."""
    plastic = fresnel_tinted(cos_half_view, bsdf.plastic_eta, bsdf.plastic_f0)
    metal = fresnel_metal(bsdf.metal_f0, bsdf.metal_f90, bsdf.metal_dip, cos_half_view)
    return bsdf.plastic * plastic + bsdf.metal * metal


def coat_at(bsdf: Bsdf, cos_half_view: np.ndarray) -> np.ndarray:
    return bsdf.coat * fresnel_dielectric(cos_half_view, bsdf.coat_eta)


def bump_shadowing(bsdf: Bsdf, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What a normal map hides: bool [n], directions on the wrong side of the unperturbed surface, and the factor [n]
    that darkens diffuse reflection towards its horizon [Chiang19]."""
    smooth, normal = bsdf.smooth_normal, bsdf.normal
    mapped = (np.abs(smooth - normal) > 1e-6).any(axis=1)
    cos_light, cos_normal = dot(smooth, light), dot(smooth, normal)
    hidden = mapped & (cos_light * cos_normal * dot(normal, light) < 0.0)
    c, d = np.abs(cos_light), np.maximum(np.abs(cos_normal), 1e-6)
    tangent2 = np.maximum(1.0 / (d * d) - 1.0, 0.0)
    alpha2 = np.clip(0.125 * tangent2, 0.0, 1.0)
    slope2 = np.maximum(1.0 / np.maximum(c * c, 1e-12) - 1.0, 0.0)
    factor = 2.0 / (1.0 + np.sqrt(1.0 + alpha2 * slope2))
    return hidden, np.where(mapped, factor, 1.0)


def _uniform(alpha: np.ndarray) -> np.ndarray:
    return np.repeat(alpha[:, None], 2, axis=1)


def evaluate(bsdf: Bsdf, light: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diffuse and other lobes, times |cosine|, [n, 3] each, and the density [n] with which ``sample`` finds light.

    Smooth lobes have no part in any of the three.
    """
    local, view = bsdf.to_local(light), bsdf.to_local(bsdf.view)
    cos_light = local[:, 2]
    side = dot(bsdf.geometric_normal, light)
    hidden, darkening = bump_shadowing(bsdf, light)
    above = (cos_light > 0.0) & (side > 0.0) & ~hidden
    below = (cos_light < 0.0) & (side < 0.0) & ~hidden
    of_diffuse, of_sheen, of_specular, of_coat, of_glass = bsdf.probability.T

    lit = np.where(bsdf.transmits_diffuse, below, above)
    cosine = np.where(lit, np.abs(cos_light), 0.0)
    darkening = np.where(bsdf.transmits_diffuse, 1.0, darkening)
    diffuse = bsdf.diffuse * oren_nayar(bsdf, view[:, 2], local, view) * (cosine * darkening)[:, None]
    pdf = of_diffuse * cosine / np.pi

    density = np.where(above, sheen_density(bsdf, local, view), 0.0)
    diffuse = diffuse + bsdf.sheen * (density * np.where(above, darkening, 1.0))[:, None]
    pdf = pdf + of_sheen * density

    # Reflection at microfacets: D G2 / (4 NV NL) times NL.
    half = normalize(view + local)
    cos_half_view = dot(view, half)
    specular = np.zeros_like(diffuse)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half_view)
    coat = np.repeat(coat_at(bsdf, cos_half_view)[:, None], 3, axis=1)
    for value, probability, alpha, smooth in (
        (specular_at(bsdf, cos_half_view), of_specular, bsdf.alpha, bsdf.smooth),
        (coat, of_coat, _uniform(bsdf.coat_alpha), bsdf.smooth_coat),
        (bsdf.glass * reflectance, of_glass * chance, _uniform(bsdf.glass_alpha), bsdf.smooth_glass),
    ):
        lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(local, alpha)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.where(above & ~smooth, ggx_density(half, alpha) / (4.0 * view[:, 2]), 0.0)
        specular = specular + value * (spread / (1.0 + lambda_view + lambda_light))[:, None]
        pdf = pdf + probability * spread / (1.0 + lambda_view)

    # Refraction at microfacets [Walter07, Eq. 21] with the Jacobian of the half vector, Eq. 17.
    eta = bsdf.glass_eta
    half = normalize(-(view + eta[:, None] * local))
    half = np.where((half[:, 2] < 0.0)[:, None], -half, half)
    cos_half_view, cos_half_light = dot(view, half), dot(local, half)
    rough = below & ~bsdf.smooth_glass & (cos_half_view > 0.0) & (cos_half_light < 0.0)
    alpha = _uniform(bsdf.glass_alpha)
    lambda_view, lambda_light = ggx_lambda(view, alpha), ggx_lambda(local, alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        jacobian = eta**2 * np.abs(cos_half_light) / (cos_half_view + eta * cos_half_light) ** 2
        spread = ggx_density(half, alpha) * cos_half_view / view[:, 2] * jacobian
    spread = np.where(rough, spread, 0.0)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half_view)
    specular = specular + bsdf.glass * transmittance * (spread / (1.0 + lambda_view + lambda_light))[:, None]
    pdf = pdf + of_glass * (1.0 - chance) * spread / (1.0 + lambda_view)
    return diffuse, specular, pdf


def _turned(vector: np.ndarray, view: np.ndarray, back: bool = False) -> np.ndarray:
    """Local vectors in the frame whose X is the view's azimuth, or back from there."""
    length = np.hypot(view[:, 0], view[:, 1])
    there = length > 1e-8
    cosine = np.where(there, view[:, 0] / np.where(there, length, 1.0), 1.0)
    sine = np.where(there, view[:, 1] / np.where(there, length, 1.0), 0.0) * (-1.0 if back else 1.0)
    x, y, z = vector.T
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def sheen_density(bsdf: Bsdf, local: np.ndarray, view: np.ndarray) -> np.ndarray:
    """Density of lobe H, which is also its value over its weight [Zeltner22, Eq. 3]."""
    x, y, z = _turned(local, view).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    squared = (a * x + b * z) ** 2 + (a * y) ** 2 + z**2
    return np.maximum(z, 0.0) / np.pi * (a / np.maximum(squared, 1e-30)) ** 2


def sample_sheen(bsdf: Bsdf, view: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Local direction: a cosine-distributed one through the inverse of the transform."""
    x, y, z = cosine_hemisphere(uv).T
    a, b = bsdf.sheen_a, bsdf.sheen_b
    return _turned(normalize(np.stack([x - b * z, y, a * z], axis=1)), view, back=True)


@dataclass
class BsdfSample:
    """direction: [n, 3] unit. diffuse, specular: [n, 3], lobe value times |cosine| over pdf. pdf: [n], 0 where delta.
    event: [n], NONE, DIFFUSE, GLOSSY or TRANSMISSION, as Cycles counts bounces.

    Both values are zero where the direction is on the wrong side of the surface, and where the material is black.
    """

    direction: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    pdf: np.ndarray
    delta: np.ndarray
    event: np.ndarray


def sample(bsdf: Bsdf, uv: np.ndarray, lobe: np.ndarray) -> BsdfSample:
    """uv: [n, 2] and lobe: [n], uniform in [0, 1). lobe chooses D, H, S, C or G in this order; what is left of it
    chooses reflection or refraction in G."""
    ends = np.cumsum(bsdf.probability, axis=1)
    begins = ends - bsdf.probability
    of_diffuse, of_sheen, of_specular, of_coat = (
        (lobe >= begins[:, i]) & (lobe < ends[:, i]) & (bsdf.probability[:, i] > 0.0) for i in range(4)
    )
    of_glass = (lobe >= ends[:, 3]) & (bsdf.probability[:, 4] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rest = (lobe - ends[:, 3]) / bsdf.probability[:, 4]

    view = bsdf.to_local(bsdf.view)
    alpha = np.where(of_coat[:, None], _uniform(bsdf.coat_alpha), bsdf.alpha)
    alpha = np.where(of_glass[:, None], _uniform(bsdf.glass_alpha), alpha)
    mirror = np.select([of_specular, of_coat, of_glass], [bsdf.smooth, bsdf.smooth_coat, bsdf.smooth_glass], False)
    half = np.where(mirror[:, None], [0.0, 0.0, 1.0], sample_visible_normal(view, alpha, uv))
    cos_half = dot(view, half)
    reflectance, transmittance, chance = glass_events(bsdf, cos_half)
    refracts = of_glass & ~(rest < chance)

    light = np.where(refracts[:, None], refract(view, half, bsdf.glass_eta), reflect(view, half))
    light = np.where((refracts & (bsdf.glass_eta == 1.0))[:, None], -view, light)
    cosine = cosine_hemisphere(uv)
    cosine[:, 2] *= np.where(bsdf.transmits_diffuse, -1.0, 1.0)
    light = np.where(of_diffuse[:, None], cosine, light)
    light = np.where(of_sheen[:, None], sample_sheen(bsdf, view, uv), light)
    cos_light = light[:, 2]
    light = normalize(bsdf.to_world(light))

    # A microfacet can reflect below the horizon or refract above it. Such a direction is lost: the densities of the
    # other kind of event, which do reach it, do not count this one.
    goes_below = refracts | (of_diffuse & bsdf.transmits_diffuse)
    side = dot(bsdf.geometric_normal, light)
    passes = np.where(goes_below, (cos_light < 0.0) & (side < 0.0), (cos_light > 0.0) & (side > 0.0))
    passes &= of_diffuse | of_sheen | of_specular | of_coat | of_glass

    diffuse, specular, pdf = evaluate(bsdf, light)
    found = passes & (pdf > 0.0) & ~mirror
    with np.errstate(divide="ignore", invalid="ignore"):
        diffuse = np.where(found[:, None], diffuse / pdf[:, None], 0.0)
        specular = np.where(found[:, None], specular / pdf[:, None], 0.0)

        # A mirror: the lobe's value over the probability of choosing it.
        chance = np.where(refracts, 1.0 - chance, chance)[:, None]
        glass = bsdf.glass * np.where(refracts[:, None], transmittance, reflectance) / chance
        weight = np.where(of_glass[:, None], glass / bsdf.probability[:, 4:5], 0.0)
        weight = np.where(of_specular[:, None], specular_at(bsdf, cos_half) / bsdf.probability[:, 2:3], weight)
        weight = np.where(of_coat[:, None], (coat_at(bsdf, cos_half) / bsdf.probability[:, 3])[:, None], weight)
    specular = np.where((passes & mirror)[:, None], weight, specular)
    event = np.select([goes_below, of_diffuse | of_sheen], [TRANSMISSION, DIFFUSE], GLOSSY)
    event = np.where(found | (passes & mirror), event, NONE)
    return BsdfSample(light, diffuse, specular, np.where(found, pdf, 0.0), mirror, event)
