# SPDX-License-Identifier: Apache-2.0
"""The scene as plain data: what a frame needs to be traced, and nothing of who made it.

Conventions, used everywhere in svgf:

- World space is Blender's: right-handed, +Z up, metres. Camera space looks along -Z with +Y up.
- Transforms are row-major 3x4 float64 matrices [R | t] that map column vectors: ``p_world = R @ p_object + t``.
  They are float64 because scenes far from the origin lose their precision in float32; the renderer makes
  them relative to the camera before it rounds them.
- Colours are linear Rec.709. Radiance is W / (m^2 sr) per channel, power is W per channel.
- Angles are radians.
- ``previous_*`` is the state at the previous frame and equals the current state where nothing moves.
- Frames of one animation share the objects (``is``) that do not change between them; ``Renderer.update`` and
  ``save`` rely on that identity to upload and store them once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, IntFlag

import numpy as np

from .light_paths import LightPaths


class Interpolation(IntEnum):
    """How a texture is read between texels."""

    CLOSEST = 0
    LINEAR = 1
    CUBIC = 2


class Extension(IntEnum):
    """What a texture holds outside the unit square, as Blender's Image Texture node names it."""

    REPEAT = 0
    EXTEND = 1
    CLIP = 2
    MIRROR = 3


class MaterialKind(IntEnum):
    """Blender's shader nodes. An Emission node is a black DIFFUSE that emits."""

    PRINCIPLED = 0
    DIFFUSE = 1
    GLOSSY = 2
    GLASS = 3
    REFRACTION = 4
    TRANSLUCENT = 5
    TRANSPARENT = 6
    MIX = 7
    ADD = 8


class LightKind(IntEnum):
    POINT = 0
    SUN = 1
    SPOT = 2
    RECTANGLE = 3
    ELLIPSE = 4


class RayVisibility(IntFlag):
    """The rays that see something, as Blender's ray visibility names them: a ray is of the kind of the bounce that it
    leaves; transparent surfaces do not change it. SHADOW: rays between surfaces and lights."""

    NONE = 0
    CAMERA = 1
    DIFFUSE = 2
    GLOSSY = 4
    TRANSMISSION = 8
    SHADOW = 16
    ALL = 31


class Projection(Enum):
    PERSPECTIVE = "perspective"
    ORTHOGRAPHIC = "orthographic"


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in object space, shared by any number of instances.

    positions: float32 [V, 3], metres.
    triangles: int32 [T, 3], indices into positions, counter-clockwise seen from the front.
    normals: float32 [T, 3, 3], unit shading normal of each corner (zero vectors mean: use the face normal).
    uvs: float32 texture coordinates of each corner, (0, 0) at the image's bottom left: [T, 3, 2], or [L, T, 3, 2] with
    several layers; None without a UV map. A layer has the same meaning in all meshes of a scene, 0 being the active one
    of each mesh; a layer that a mesh does not have reads as (0, 0).
    material_slots: int32 [T], index into the material list of the instance.
    previous_positions: float32 [V, 3] at the previous frame where the mesh deforms, else None.
    tangents: float32 [T, 3, 4], MikkTSpace's unit tangent of each corner [Mikkelsen08] and 1, or -1 where V lies to its
    right, of the UV layer tangent_layer; zero vectors and None: those of the triangle. Normal maps and anisotropy of
    other layers have the triangle's, too.
    """

    name: str
    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    material_slots: np.ndarray
    uvs: np.ndarray | None = None
    previous_positions: np.ndarray | None = None
    tangents: np.ndarray | None = None
    tangent_layer: int = 0


@dataclass(frozen=True, eq=False)
class Instances:
    """All placements of meshes, one row each (N rows).

    mesh: int32 [N], index into Scene.meshes.
    object_to_world, previous_object_to_world: float64 [N, 3, 4].
    object_id: int32 [N], > 0, the same for the same object in every frame; 0 is the background.
    material_start: int32 [N]; material of a triangle = material_table[material_start[n] + material_slots[t]].
    material_table: int32 [M], indices into Scene.materials.
    visibility: uint8 [N], bits of RayVisibility; None: all rays see all instances.
    terminator_offset: float32 [N], >= 0, Blender's Shadow Terminator Geometry Offset: the cosine with light below which
    an instance with smooth normals is shadowed as the surface that they describe [Hanika21]; None: 0, as its triangles
    are, everywhere.
    """

    mesh: np.ndarray
    object_to_world: np.ndarray
    previous_object_to_world: np.ndarray
    object_id: np.ndarray
    material_start: np.ndarray
    material_table: np.ndarray
    visibility: np.ndarray | None = None
    terminator_offset: np.ndarray | None = None


@dataclass(frozen=True)
class TextureMap:
    """Where an input of a material reads its value.

    texture: index into Scene.textures. channel: what a scalar input reads, 0 to 3 for R, G, B, A; colours read RGB.
    uv_layer: of the mesh. uv_transform (a, b, c, d, e, f): the texture is read at (a u + b v + c, d u + e v + f).
    """

    texture: int
    channel: int = 0
    uv_layer: int = 0
    uv_transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


# Inputs of a material that a map can drive, and their channels.
MATERIAL_INPUTS: dict[str, int] = {
    "base_color": 3,
    "metallic": 1,
    "roughness": 1,
    "ior": 1,
    "transmission": 1,
    "specular_ior_level": 1,
    "specular_tint": 3,
    "emission": 3,
    "alpha": 1,
    "diffuse_roughness": 1,
    "anisotropic": 1,
    "anisotropic_rotation": 1,
    "normal_strength": 1,
    "coat_weight": 1,
    "coat_roughness": 1,
    "coat_ior": 1,
    "coat_tint": 3,
    "sheen_weight": 1,
    "sheen_roughness": 1,
    "sheen_tint": 3,
    "factor": 1,
    "normal": 3,
}
# Mixes of mixes that a material may be made of, one within the other.
DEEPEST_MIX = 16


@dataclass(frozen=True)
class Material:
    """A shader node of Blender with its inputs; names and defaults are those of the Principled BSDF.

    Colours are linear RGB in [0, 1]. metallic, roughness, transmission, alpha, coat_weight, coat_roughness,
    sheen_weight, sheen_roughness, diffuse_roughness, subsurface_weight: [0, 1]. specular_ior_level: >= 0, 0.5 leaves
    the IOR as it is. ior, coat_ior: >= 0 (1: no interface). emission: radiance per channel (colour times strength), >=
    0. anisotropic: [-1, 1], below 0 for GLOSSY alone. anisotropic_rotation: turns, [0, 1]. tangent_uv_layer: UV layer
    whose U axis anisotropy follows; -1: circles around the object's Z axis, as in Blender without a Tangent node.
    subsurface_weight is rendered as diffuse. normal_strength: >= 0, of the map "normal", which is in tangent space.
    multiscatter: light that is reflected between microfacets is not lost (Blender's distribution "Multiscatter GGX").
    coat_normal_mapped: whether the normal map bends the coat, too, which else is smooth.

    What the other kinds read:

    - DIFFUSE: base_color, diffuse_roughness, emission. TRANSLUCENT, TRANSPARENT: base_color.
    - GLOSSY: base_color, roughness, anisotropic, anisotropic_rotation. GLASS, REFRACTION: base_color, roughness, ior.
    - MIX: first and second are indices into Scene.materials, and factor in [0, 1] is the share of the second. Where
      factor_fresnel_ior > 0, the factor is instead what Blender's Fresnel node gives for this IOR; where
      factor_facing_blend >= 0, the output Facing of its Layer Weight node for this blend.
    - ADD: the sum of first and second.

    maps: by input (see MATERIAL_INPUTS), the texture that replaces its constant; that of "emission" multiplies it.
    """

    name: str = "Default"
    kind: MaterialKind = MaterialKind.PRINCIPLED
    base_color: tuple[float, float, float] = (0.8, 0.8, 0.8)
    metallic: float = 0.0
    roughness: float = 0.5
    ior: float = 1.5
    transmission: float = 0.0
    specular_ior_level: float = 0.5
    specular_tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    anisotropic: float = 0.0
    anisotropic_rotation: float = 0.0
    tangent_uv_layer: int = -1
    coat_weight: float = 0.0
    coat_roughness: float = 0.03
    coat_ior: float = 1.5
    coat_tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    coat_normal_mapped: bool = False
    sheen_weight: float = 0.0
    sheen_roughness: float = 0.5
    sheen_tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    diffuse_roughness: float = 0.0
    subsurface_weight: float = 0.0
    normal_strength: float = 1.0
    multiscatter: bool = True
    maps: dict[str, TextureMap] = field(default_factory=dict)
    first: int = -1
    second: int = -1
    factor: float = 0.5
    factor_fresnel_ior: float = 0.0
    factor_facing_blend: float = -1.0

    @property
    def is_mix(self) -> bool:
        return self.kind in (MaterialKind.MIX, MaterialKind.ADD)

    def may_have(self, weight: str) -> bool:
        """Whether a scalar input is anywhere above 0, as far as constants tell."""
        return weight in self.maps or getattr(self, weight) > 0.0


@dataclass(frozen=True, eq=False)
class Texture:
    """pixels: [H, W, 4], row 0 at the bottom as Blender stores it; uint8 (sRGB if srgb is set, else linear) or
    float32 (linear, srgb must be False). uint8 sRGB texels are interpolated first and decoded after, as Cycles does.
    associated_alpha: colours are stored times alpha, in the pixels' encoding, and a lookup divides by the interpolated
    alpha; where it is not set, colours are read as they are. Alpha itself is never decoded."""

    name: str
    pixels: np.ndarray
    srgb: bool
    interpolation: Interpolation = Interpolation.LINEAR
    extension: Extension = Extension.REPEAT
    associated_alpha: bool = False


@dataclass(frozen=True, eq=False)
class Light:
    """One lamp, with Blender's units.

    power: W per channel (colour times power); a sun's is irradiance, W / m^2 on a surface that faces it.
    light_to_world: float64 [3, 4], no scale; a sun, spot or area light shines along its -Z.
    size: POINT, SPOT: radius (m) in size[0]; SUN: angular diameter (rad) in size[0]; RECTANGLE, ELLIPSE: full widths
    (m) along X, Y. spot_angle: full cone angle (rad). spot_blend: [0, 1], share of the cone that fades.
    soft_falloff: a POINT or SPOT is a disk that faces whatever it lights, Blender's default, instead of a sphere: light
    then does not grow without bound close to it.
    spread: full angle (rad) into which an area lamp shines, as through a grid of slats; pi: its whole front side.
    visibility: the rays that find it. Without SHADOW nothing is different: no ray is shadowed by a lamp.
    """

    name: str
    kind: LightKind
    power: tuple[float, float, float]
    light_to_world: np.ndarray
    size: tuple[float, float] = (0.0, 0.0)
    spot_angle: float = np.pi / 4
    spot_blend: float = 0.15
    soft_falloff: bool = False
    spread: float = np.pi
    visibility: RayVisibility = RayVisibility.ALL & ~RayVisibility.CAMERA


@dataclass(frozen=True)
class World:
    """What rays see that hit nothing.

    radiance: per channel, >= 0, the same from every direction; times the environment image where there is one.
    environment: index into Scene.textures of an equirectangular image, -1 for none. Direction (x, y, z) of its space is
    read at u = 1/2 - atan2(y, x) / 2 pi, v = 1/2 + asin(z) / pi, as Blender does.
    world_to_environment: rotation, 3x3 by rows, of world directions before the image is looked up.
    visibility: the rays that see it; SHADOW is of no effect.
    backdrop_radiance, backdrop_environment: what the camera's rays see in place of radiance and environment; None: the
    same.
    """

    radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    environment: int = -1
    world_to_environment: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    visibility: RayVisibility = RayVisibility.ALL
    backdrop_radiance: tuple[float, float, float] | None = None
    backdrop_environment: int = -1

    @property
    def backdrop(self) -> tuple[tuple[float, float, float], int]:
        """Radiance and environment as the camera's rays see them."""
        if self.backdrop_radiance is None:
            return self.radiance, self.environment
        return self.backdrop_radiance, self.backdrop_environment


@dataclass(frozen=True)
class Aperture:
    """The opening of a thin lens; what is off the focal plane gets blurred.

    radius: metres, 0: everything is in focus. focus_distance: planar, metres, > 0. blades: corners of the opening, a
    circle if less than 3. rotation: of the polygon, radians. ratio: height over width, > 0 (anamorphic lenses).
    """

    radius: float = 0.0
    focus_distance: float = 10.0
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0


@dataclass(frozen=True, eq=False)
class Camera:
    """camera_to_world: float64 [3, 4], rotation and translation only.

    window: (left, right, bottom, top) of the image in camera space, on the plane one unit in front of the camera where
    rays part from a point, in metres where they are parallel (ORTHOGRAPHIC); it holds focal length, sensor fit, shift
    and pixel aspect all at once. clip: (near, far) planar distances in metres.
    """

    camera_to_world: np.ndarray
    window: tuple[float, float, float, float]
    clip: tuple[float, float] = (0.01, 1000.0)
    projection: Projection = Projection.PERSPECTIVE
    aperture: Aperture = Aperture()


@dataclass(frozen=True)
class RenderDefaults:
    """What the file says about the render; command line and Settings override it.

    bounces: Cycles' total light bounces (0: direct light only). exposure: film exposure, a factor on radiance.
    light_paths: see there. transparent_film: the world is not seen behind the scene, alpha is.
    """

    width: int = 960
    height: int = 540
    frames_per_second: float = 24.0
    bounces: int = 12
    exposure: float = 1.0
    light_paths: LightPaths = LightPaths()
    transparent_film: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """One frame of a scene.

    cut: the camera or the scene jumped since the previous frame, so nothing of that frame can be reused.
    warnings: one sentence for each thing of the source that svgf does not simulate.
    """

    meshes: tuple[Mesh, ...]
    instances: Instances
    materials: tuple[Material, ...]
    camera: Camera
    previous_camera: Camera
    textures: tuple[Texture, ...] = ()
    lights: tuple[Light, ...] = ()
    world: World = World()
    frame: int = 1
    cut: bool = False
    name: str = "scene"
    defaults: RenderDefaults = RenderDefaults()
    warnings: tuple[str, ...] = field(default=())

    def at_rest(self) -> Scene:
        """The same instant with everything standing still: each previous state is the current one."""
        return replace(
            self,
            meshes=tuple(
                mesh if mesh.previous_positions is None else replace(mesh, previous_positions=None)
                for mesh in self.meshes
            ),
            instances=replace(self.instances, previous_object_to_world=self.instances.object_to_world),
            previous_camera=self.camera,
            cut=False,
        )

    def save(self, path) -> None:
        """Writes this frame to an .svgf file; see ``svgf.save``."""
        from .scene_file import save

        save(path, [self])
