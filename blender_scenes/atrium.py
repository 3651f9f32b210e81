# SPDX-License-Identifier: Apache-2.0
"""Atrium: two storeys of arcades around a sunlit court, walked through in the shade of the ground floor.

220,000 triangles in 880 instances of 18 meshes. A steep sun and the sky light the court; most of the arcades sees
neither, so that five in six of its pixels get more light by bounces than directly. Stone, plaster, tiles, wood and
cloth carry image textures.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy
import geometry
import numpy as np
import studio
import textures
from geometry import box, cylinder, join, lathe, quad, rounded_box, sphere, tube

_BAY = 3.2  # distance of column axes, and depth of the arcade
_BAYS_X, _BAYS_Y = 4, 6  # bays of the court's sides
_COURT_X, _COURT_Y = _BAYS_X * _BAY / 2, _BAYS_Y * _BAY / 2  # column axes at +-x, +-y
_WALL_X, _WALL_Y = _COURT_X + _BAY, _COURT_Y + _BAY  # the outer walls
_SPRING = 3.0  # column height, where the arches begin
_STOREY = 5.2  # height of the upper floor
_UPPER_SCALE = 0.8  # upper columns are the lower ones, smaller
_UPPER_SPRING = _STOREY + _SPRING * _UPPER_SCALE
_EAVES = _UPPER_SPRING + _STOREY - _SPRING
_ARCH_RADIUS = 1.26
_WALL_DEPTH = 0.45
_KERB, _STEP = 0.5, 0.12  # the arcades' floor reaches this far into the court, and lies this much above it


def _column() -> geometry.Shape:
    """A Tuscan column with an Attic base, from plinth to abacus."""
    profile = [(0.305, 0.12), (0.325, 0.135), (0.332, 0.165), (0.325, 0.195), (0.300, 0.21), (0.265, 0.235),
               (0.275, 0.27), (0.296, 0.285), (0.290, 0.315), (0.262, 0.325),
               (0.250, 0.36), (0.248, 0.80), (0.243, 1.25), (0.230, 1.85), (0.210, 2.48),
               (0.222, 2.50), (0.232, 2.515), (0.222, 2.53), (0.208, 2.54), (0.208, 2.66), (0.222, 2.675),
               (0.230, 2.69), (0.232, 2.71), (0.275, 2.745), (0.305, 2.79), (0.312, 2.83)]
    plinth = rounded_box(0.68, 0.68, 0.12, 0.012, 1, tile=1.2)
    abacus = rounded_box(0.68, 0.68, 0.17, 0.015, 1, tile=1.2).moved(z=2.83)
    return join(lathe(profile, 24, tile=1.2), plinth, abacus)


def _pilaster() -> geometry.Shape:
    """The flat counterpart of a column, projecting from a wall behind it (-y)."""
    parts = [(0.66, 0.24, 0.12, 0.0), (0.60, 0.21, 0.18, 0.12), (0.50, 0.16, 2.24, 0.30), (0.54, 0.18, 0.06, 2.54),
             (0.50, 0.16, 0.13, 2.60), (0.58, 0.20, 0.10, 2.73), (0.68, 0.24, 0.17, 2.83)]
    blocks = [rounded_box(w, 2 * d, h, 0.012, 1, tile=1.2).moved(z=z) for w, d, h, z in parts]
    return join(*blocks)


def _arch() -> geometry.Shape:
    """The wall over a bay with its arch, mouldings on both sides (slot 1), springing at z = 0."""
    panel = geometry.arch_panel(_BAY, _STOREY - _SPRING, _ARCH_RADIUS, _WALL_DEPTH, 20, tile=2.4)
    y = _WALL_DEPTH / 2
    profile = [(0.0, y), (0.0, y + 0.03), (0.09, y + 0.03), (0.10, y + 0.055), (0.20, y + 0.055), (0.20, y)]
    front = geometry.arc_moulding(_ARCH_RADIUS, profile, 20, tile=1.2)
    return join(panel, front.with_slot(1), front.rotated("z", 180).with_slot(1))


def _cornice(depth: float) -> geometry.Shape:
    """A moulded string course one bay long that projects towards -y from the wall."""
    profile = np.array([(0.0, 0.0), (0.25, 0.0), (0.25, 0.05), (0.40, 0.09), (0.55, 0.16), (0.90, 0.19), (0.90, 0.26),
                        (1.0, 0.28), (1.0, 0.34), (0.0, 0.34)]) * (depth, 1.0)
    points = [[(x, -out, z) for x in (-_BAY / 2, _BAY / 2)] for out, z in profile]
    return geometry.surface(np.array(points), smooth=False).box_mapped(1.2)


def _baluster() -> geometry.Shape:
    profile = [(0.055, 0.0), (0.055, 0.05), (0.034, 0.08), (0.060, 0.17), (0.074, 0.25), (0.066, 0.33), (0.038, 0.47),
               (0.034, 0.57), (0.055, 0.60), (0.055, 0.66)]
    return lathe(profile, 10, tile=1.2)


def _door() -> geometry.Shape:
    """A panelled double door (slot 1) in a stone surround, in front of a wall behind it (-y)."""
    frame = [rounded_box(0.22, 0.24, 2.5, 0.015, 1, 1.2).moved(x=side * 0.86) for side in (-1, 1)]
    frame.append(rounded_box(2.14, 0.30, 0.24, 0.015, 1, 1.2).moved(z=2.5))
    leaves = []
    for side in (-1, 1):
        leaves.append(rounded_box(0.74, 0.10, 2.48, 0.01, 1, 0.8).moved(x=side * 0.375))
        for height, z in ((0.7, 0.2), (1.2, 1.06)):
            leaves.append(rounded_box(0.50, 0.15, height, 0.02, 1, 0.8).moved(x=side * 0.375, z=z))
    return join(*frame, *[leaf.with_slot(1) for leaf in leaves])


def _bench() -> geometry.Shape:
    seat = rounded_box(1.9, 0.46, 0.09, 0.02, 2, 1.2).moved(z=0.38)
    return join(seat, *[rounded_box(0.16, 0.36, 0.38, 0.015, 1, 1.2).moved(x=x) for x in (-0.7, 0.7)])


def _pot() -> geometry.Shape:
    """A terracotta pot with earth (slot 1)."""
    outside = [(0.0, 0.0), (0.20, 0.0), (0.205, 0.03), (0.27, 0.30), (0.31, 0.46), (0.345, 0.465), (0.355, 0.49),
               (0.355, 0.545), (0.345, 0.56), (0.305, 0.56), (0.300, 0.50)]
    return join(lathe(outside, 28, tile=0.8), lathe([(0.305, 0.50), (0.0, 0.515)], 28).with_slot(1))


def _tree() -> geometry.Shape:
    """An orange tree: trunk (slot 0), leaves (1) and fruit (2)."""
    rng = np.random.default_rng(21)
    path = np.array([(0, 0, 0), (0.02, 0.01, 0.3), (-0.01, 0.02, 0.6), (0.01, 0, 0.95)])
    trunk = tube(path, [0.045, 0.036, 0.032, 0.03], 8)
    leaves = join(geometry.foliage(0.52, 420, 0.18, rng), geometry.foliage(0.40, 140, 0.18, rng))
    inside = sphere(0.36, 12, 8)
    crown = join(leaves, inside).scaled(1.0, 1.0, 0.92).moved(z=1.28).with_slot(1)
    fruit = [sphere(0.042, 10, 6).moved(*(direction * (0.5, 0.5, 0.46))).moved(z=1.26).with_slot(2)
             for direction in geometry.fibonacci_sphere(30)[4:26]]
    return join(trunk, crown, *fruit)


def _banner() -> geometry.Shape:
    """A cloth hung over the rail, in soft folds, ending in a point; it hangs at y < 0 below z = 0."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(1, 0, 13))
    width, drop = 1.15, 1.75
    point = 0.34 * (1 - 2 * np.abs(u)) * (v > 0.99)
    fold = 0.045 * np.sin(2 * np.pi * (2.5 * u + 0.15 * np.sin(5 * v))) * v
    points = np.stack([u * width * (1 - 0.04 * v), fold - 0.05, -v * drop - point], axis=-1)
    return geometry.surface(points, tiles=(1, 3))


def _fountain() -> geometry.Shape:
    """An octagonal basin with a bowl on a baluster (slot 0) and water (slot 1)."""
    wall = lathe([(1.75, 0.0), (1.75, 0.10), (1.66, 0.12), (1.64, 0.38), (1.72, 0.42), (1.72, 0.50), (1.42, 0.50),
                  (1.42, 0.2)], 8, tile=1.2)
    stem = lathe([(0.34, 0.2), (0.34, 0.42), (0.20, 0.50), (0.15, 0.62), (0.20, 0.78), (0.24, 0.86), (0.15, 1.02),
                  (0.13, 1.08), (0.22, 1.12), (0.50, 1.22), (0.72, 1.34), (0.78, 1.40), (0.76, 1.43), (0.70, 1.38),
                  (0.0, 1.26)], 28, tile=1.2)
    finial = lathe([(0.11, 1.25), (0.09, 1.45), (0.06, 1.52), (0.10, 1.6), (0.13, 1.7), (0.08, 1.8), (0.0, 1.86)], 20)
    water = [lathe([(radius, z), (0.0, z)], 24).with_slot(1) for radius, z in ((1.5, 0.36), (0.71, 1.37))]
    return join(wall, stem, finial, *water)


def _lantern() -> geometry.Shape:
    """A bronze lantern that hangs from z = 0 on a rod."""
    rod = cylinder(0.012, 1.3, 6).moved(z=-1.3)
    cap = lathe([(0.0, -1.42), (0.16, -1.42), (0.17, -1.40), (0.05, -1.30), (0.02, -1.26), (0.0, -1.26)], 12)
    foot = lathe([(0.0, -1.86), (0.05, -1.84), (0.11, -1.79), (0.11, -1.77), (0.0, -1.77)], 12)
    bars = [cylinder(0.010, 0.36, 5).moved(0.11 * np.cos(turn), 0.11 * np.sin(turn), -1.78)
            for turn in np.arange(6) * np.pi / 3]
    return join(rod, cap, foot, *bars)


def _roof_tile() -> geometry.Shape:
    """A half-round tile along y, its lower end at -y."""
    angle = np.linspace(0, np.pi, 7)
    rows = [[(0.105 * np.cos(a), y, 0.105 * np.sin(a)) for a in angle[::-1]] for y in (-0.55, 0.55)]
    return geometry.surface(np.array(rows), tiles=(0.3, 0.8))


class _Bay(NamedTuple):
    """One bay of the court's perimeter, on the column axis; turned by `turn` degrees, -y points into the court."""

    x: float
    y: float
    turn: float

    def at(self, along: float = 0.0, outwards: float = 0.0) -> tuple[float, float]:
        """A place by its offset along the side and away from the court."""
        cos, sin = np.cos(np.radians(self.turn)), np.sin(np.radians(self.turn))
        return self.x + cos * along - sin * outwards, self.y + sin * along + cos * outwards


def _bays() -> Iterator[_Bay]:
    for i in range(_BAYS_X):
        x = (i + 0.5) * _BAY - _COURT_X
        yield _Bay(x, _COURT_Y, 0.0)
        yield _Bay(x, -_COURT_Y, 180.0)
    for i in range(_BAYS_Y):
        y = (i + 0.5) * _BAY - _COURT_Y
        yield _Bay(-_COURT_X, y, 90.0)
        yield _Bay(_COURT_X, y, -90.0)


def _columns() -> list[tuple[float, float]]:
    along_x = [(i * _BAY - _COURT_X, side * _COURT_Y) for i in range(_BAYS_X + 1) for side in (-1, 1)]
    along_y = [(side * _COURT_X, i * _BAY - _COURT_Y) for i in range(1, _BAYS_Y) for side in (-1, 1)]
    return along_x + along_y


def _building() -> geometry.Shape:
    """What occurs once: outer walls of plaster (slot 0) over a base of cut stone (1), the arcades' floors (2), the
    court (3), ceilings of boards (4) and the roof (5)."""
    parts = []
    long, short = 2 * _WALL_Y, 2 * _WALL_X
    for width, offset, turn in ((short, _WALL_Y, 0), (short, _WALL_Y, 180), (long, _WALL_X, 90), (long, _WALL_X, -90)):
        wall = quad(width, _EAVES).rotated("x", 90).moved(y=offset, z=_EAVES / 2).box_mapped(2.4)
        base = box(width, 0.10, 1.15, tile=1.9).moved(y=offset - 0.05).with_slot(1)
        ledge = box(width, 0.16, 0.08, tile=1.9).moved(y=offset - 0.08, z=1.15).with_slot(1)
        parts += [part.rotated("z", turn) for part in (wall, base, ledge)]

    def ring(overhang: float, z: float, tile: float, slot: int, faces_up: bool = True) -> geometry.Shape:
        """The arcades' plan as four strips, from `overhang` metres before the column axis to the outer wall."""
        depth = _BAY + overhang
        strips = [quad(depth, long).moved(x=side * (_WALL_X - depth / 2)) for side in (-1, 1)]
        strips += [quad(short - 2 * depth, depth).moved(y=side * (_WALL_Y - depth / 2)) for side in (-1, 1)]
        strip = join(*strips) if faces_up else join(*strips).rotated("x", 180)
        return strip.box_mapped(tile).moved(z=z).with_slot(slot)

    parts.append(ring(_KERB, 0.0, 1.6, 2))
    court_x, court_y = 2 * (_COURT_X - _KERB), 2 * (_COURT_Y - _KERB)
    parts.append(quad(court_x, court_y, 1.6).moved(z=-_STEP).with_slot(3))
    for side in (-1, 1):
        parts.append(box(court_x + 0.04, 0.04, _STEP, 1.2).moved(y=side * court_y / 2, z=-_STEP).with_slot(1))
        parts.append(box(0.04, court_y, _STEP, 1.2).moved(x=side * court_x / 2, z=-_STEP).with_slot(1))
    parts.append(ring(_WALL_DEPTH / 2, _STOREY, 1.6, 2))
    parts.append(ring(_WALL_DEPTH / 2, _EAVES, 1.2, 4, faces_up=False))
    parts.append(ring(0.75, _EAVES + 0.20, 1.2, 5))
    parts.append(ring(0.75, _EAVES + 0.08, 1.2, 4, faces_up=False))
    return join(*parts)


def _walk(frame: int) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """A stroll along the west arcade at 1 m/s, the gaze drifting from the court towards the vaults."""
    seconds = (frame - 1) / 24
    y = -8.25 + 1.0 * seconds
    height = 1.62 + 0.012 * np.sin(2 * np.pi * 1.8 * seconds)
    x = -_COURT_X - 1.85 + 0.015 * np.sin(2 * np.pi * 0.9 * seconds)
    yaw, pitch = np.radians(24 - 3.5 * seconds), np.radians(4.5)
    return (x, y, height), (x + np.sin(yaw), y + np.cos(yaw), height + np.tan(pitch))


def build() -> None:
    """Replace the open file by the scene."""
    studio.new_scene("atrium", bounces=6, world=(0.56, 0.82, 1.25))
    image = {name: studio.image(name, getattr(textures, name)()) for name in
             ("plaster", "limestone", "ashlar", "checker_marble", "paving", "wood")}
    plaster = studio.material("Plaster", image["plaster"], 0.8)
    stone = studio.material("Limestone", image["limestone"], 0.65)
    ashlar = studio.material("Ashlar", image["ashlar"], 0.75)
    marble = studio.material("Marble floor", image["checker_marble"], 0.35)
    paving = studio.material("Court paving", image["paving"], 0.8)
    wood = studio.material("Walnut", image["wood"], 0.55)
    terracotta = studio.material("Terracotta", (0.55, 0.22, 0.11), 0.75)
    earth = studio.material("Earth", (0.07, 0.045, 0.03), 0.9)
    bark = studio.material("Bark", (0.16, 0.11, 0.07), 0.8)
    leaf = studio.material("Leaves", (0.06, 0.15, 0.03), 0.5)
    orange = studio.material("Oranges", (0.85, 0.27, 0.02), 0.45)
    bronze = studio.material("Bronze", (0.40, 0.27, 0.14), 0.4, metallic=1.0)
    water = studio.material("Water", (0.05, 0.13, 0.12), 0.3, ior=1.33)
    cloths = []
    for name, ground, stripe in (("Red cloth", (0.66, 0.13, 0.11), (0.86, 0.66, 0.34)),
                                 ("Blue cloth", (0.12, 0.25, 0.45), (0.88, 0.82, 0.68))):  # fmt: skip
        pattern = studio.image(name, textures.stripes([ground] * 5 + [stripe] + [ground] * 5))
        cloths.append(studio.material(name, pattern, 0.85))

    studio.place(studio.mesh("Building", _building(), [plaster, ashlar, marble, paving, wood, terracotta]))
    _place_arcades(plaster, stone, wood, terracotta, bronze)

    door = studio.mesh("Door", _door(), [stone, wood])
    bench = studio.mesh("Bench", _bench(), [stone])
    for i, bay in enumerate(_bays()):
        block, gap = (door, 0.06) if i % 4 < 2 else (bench, 0.40)
        studio.place(block, *bay.at(outwards=_BAY - gap), turn=bay.turn)

    pot = studio.mesh("Pot", _pot(), [terracotta, earth])
    tree = studio.mesh("Orange tree", _tree(), [bark, leaf, orange])
    for i, (x, y) in enumerate([(side * 4.6, y) for y in (-6.4, -2.2, 2.2, 6.4) for side in (-1, 1)]):
        studio.place(pot, x, y, -_STEP, turn=40 * i, scale=1.25)
        studio.place(tree, x, y, 0.50, turn=77 * i, scale=1.15)

    banner = studio.mesh("Banner", _banner())
    for i, bay in enumerate(_bays()):
        if bay.y > -_COURT_Y and bay.x > -_COURT_X:  # not on the two sides that the camera is close to
            cloth = cloths[i // 2 % 2]
            studio.place(banner, *bay.at(outwards=-_WALL_DEPTH / 2 - 0.22), _STOREY + 0.02, bay.turn, material=cloth)
    studio.place(studio.mesh("Fountain", _fountain(), [stone, water]), z=-_STEP, turn=22.5)

    studio.light("SUN", "Sun", 9.5, (1.0, 0.89, 0.72), (1.9, -6.0, 13.0), angle=np.radians(0.6))
    studio.camera(23.0, _walk)


def _place_arcades(
    plaster: bpy.types.Material,
    stone: bpy.types.Material,
    wood: bpy.types.Material,
    terracotta: bpy.types.Material,
    bronze: bpy.types.Material,
) -> None:
    """Everything that repeats from bay to bay, on both storeys, up to the edge of the roof."""
    column = studio.mesh("Column", _column(), [stone])
    for x, y in _columns():
        studio.place(column, x, y)
        studio.place(column, x, y, _STOREY, scale=_UPPER_SCALE)

    arch = studio.mesh("Arch", _arch(), [plaster, stone])
    vault = studio.mesh("Vault", geometry.groin_vault(_BAY, tile=2.4), [plaster])
    string_course = studio.mesh("String course", _cornice(0.22), [stone])
    baluster = studio.mesh("Baluster", _baluster(), [stone])
    rail = studio.mesh("Rail", rounded_box(_BAY, 0.22, 0.12, 0.02, 1, 1.2), [stone])
    bracket = studio.mesh("Bracket", box(0.14, 0.62, 0.16, 0.8), [wood])
    beam = studio.mesh("Beam", rounded_box(0.20, _BAY, 0.22, 0.015, 1, 0.8), [wood])
    lantern = studio.mesh("Lantern", _lantern(), [bronze])
    tile = studio.mesh("Roof tile", _roof_tile(), [terracotta])
    for bay in _bays():
        turn, middle = bay.turn, bay.at(outwards=_BAY / 2)
        studio.place(arch, bay.x, bay.y, _SPRING, turn)
        studio.place(arch, bay.x, bay.y, _UPPER_SPRING, turn)
        for height in (_STOREY - 0.34, _EAVES - 0.30):
            studio.place(string_course, *bay.at(outwards=-_WALL_DEPTH / 2), height, turn)
        studio.place(vault, *middle, _SPRING)
        studio.place(lantern, *middle, _SPRING + _BAY / 2)
        studio.place(rail, bay.x, bay.y, _STOREY, turn, scale=(1, 1, 0.9))
        studio.place(rail, bay.x, bay.y, _STOREY + 0.76, turn)
        for along in np.linspace(-1.12, 1.12, 9):
            studio.place(baluster, *bay.at(along), _STOREY + 0.10)
        for along in np.arange(8) * 0.4 - 1.4:
            studio.place(bracket, *bay.at(along, -0.42), _EAVES - 0.05, turn)
        for along in np.arange(10) * 0.32 - 1.44:
            studio.place(tile, *bay.at(along, -0.36), _EAVES + 0.27, turn, tilt=14)
        for along in (-0.8, 0.8):
            studio.place(beam, *bay.at(along, _BAY / 2), _EAVES - 0.22, turn)
    for x in (-1, 1):
        for y in (-1, 1):
            studio.place(vault, x * (_COURT_X + _BAY / 2), y * (_COURT_Y + _BAY / 2), _SPRING)

    # Ribs across the arcade, from each column to a pilaster on the outer wall.
    pilaster = studio.mesh("Pilaster", _pilaster(), [stone])
    for side in (-1, 1):
        for i in range(_BAYS_Y + 1):
            y = i * _BAY - _COURT_Y
            studio.place(arch, side * (_COURT_X + _BAY / 2), y, _SPRING)
            studio.place(pilaster, side * _WALL_X, y, turn=-90 * side)
        for i in range(_BAYS_X + 1):
            x = i * _BAY - _COURT_X
            studio.place(arch, x, side * (_COURT_Y + _BAY / 2), _SPRING, turn=90)
            studio.place(pilaster, x, side * _WALL_Y, turn=90 - 90 * side)
