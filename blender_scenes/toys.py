# SPDX-License-Identifier: Apache-2.0
"""Toys: a thousand toys of a dozen kinds on a nursery floor, and a toy robot that marches and waves in their midst.

320,000 triangles in 1,000 instances of 21 meshes: every kind is one mesh, its objects differ in place and material
only. Wood, lacquer, steel, gold and glass under a window (area light), a reading lamp (spot) and a night light (point).
The camera orbits slowly; a steel ball rolls and a top spins.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import geometry
import numpy as np
import robot
import studio
import textures
from geometry import Scatter, Shape, cylinder, join, lathe, prism, rounded_box, sphere, torus

# Metres.
_ROOM = 5.0
_RUG_RADIUS, _RUG_HEIGHT = 0.80, 0.008
_PODIUM_RADIUS, _PODIUM_HEIGHT = 0.125, 0.045
_BLOCK = 0.04  # edge
_MARBLE, _GLOBE, _METAL_BALL, _ROLLER = 0.015, 0.034, 0.014, 0.035  # radii
_RING_TUBE = 0.0095
_TOP_PLACE = (0.455, -72.0)  # distance and direction (degrees) from the middle
_ROLLER_DISTANCE = 0.44  # radius of the circle on which the steel ball rolls


@dataclass
class _Toys:
    """What the arrangements share: one mesh of each kind, materials, and the places that are taken."""

    mesh: dict[str, bpy.types.Mesh]
    paints: list[bpy.types.Material]
    metals: list[bpy.types.Material]
    glasses: list[bpy.types.Material]
    wood: bpy.types.Material
    cream: bpy.types.Material
    black: bpy.types.Material
    taken: Scatter = field(default_factory=lambda: Scatter(seed=5))


def _shapes() -> dict[str, Shape]:
    return {
        "Block": rounded_box(_BLOCK, _BLOCK, _BLOCK, 0.003, 1, tile=0.06),
        "Plank": rounded_box(3 * _BLOCK, _BLOCK, _BLOCK / 2, 0.003, 1, tile=0.06),
        "Roof": _roof(),
        "Domino": rounded_box(0.008, 0.024, 0.048, 0.0015, 1),
        "Pawn": _pawn(),
        "Star": _star(),
        "Jack": _jack(),
        "Marble": sphere(_MARBLE, 24, 12),
        "Globe": sphere(_GLOBE, 36, 18),
        "Metal ball": sphere(_METAL_BALL, 24, 12),
        "Ring": torus(0.026, _RING_TUBE, 28, 12),
        "Peg": cylinder(0.011, 0.125, 16, 0.003),
        "Base": cylinder(0.045, 0.014, 32, 0.003),
        "Podium": cylinder(_PODIUM_RADIUS, _PODIUM_HEIGHT, 64, 0.004),
    }


def _roof() -> Shape:
    """A pyramid that tops a tower of blocks."""
    half, top = _BLOCK / 2, 0.036
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0), (0, 0, top)]
    return geometry.polygons(np.array(corners), [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)])


def _pawn() -> Shape:
    profile = [(0.0, 0.0), (0.014, 0.0), (0.015, 0.003), (0.013, 0.007), (0.008, 0.011), (0.006, 0.022), (0.005, 0.027),
               (0.009, 0.029), (0.009, 0.031), (0.006, 0.033), (0.009, 0.037), (0.0095, 0.041), (0.007, 0.046),
               (0.0, 0.049)]  # fmt: skip
    return lathe(profile, 18)


def _star() -> Shape:
    angle = np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2, 0.012, 0.026)
    return prism(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), 0.011, 0.0022)


def _jack() -> Shape:
    """A six-armed jack, resting on three arms."""
    length = 0.0155
    arm = lathe([(0.0018, 0.0), (0.0018, 0.0085), (0.0042, 0.0115), (0.0036, 0.0145), (0.0, length)], 8)
    arms = [arm, arm.rotated("x", 180)]
    arms += [arm.rotated("x", 90).rotated("z", quarter * 90) for quarter in range(4)]
    return join(*arms).rotated("z", 45).rotated("x", np.degrees(np.arctan(np.sqrt(2)))).moved(z=length / np.sqrt(3))


def _top() -> Shape:
    """A spinning top on its tip."""
    profile = [(0.0, 0.0), (0.004, 0.006), (0.012, 0.014), (0.034, 0.026), (0.044, 0.034), (0.044, 0.040),
               (0.03, 0.048), (0.012, 0.053), (0.007, 0.058), (0.006, 0.078), (0.007, 0.084), (0, 0.087)]  # fmt: skip
    return lathe(profile, 32, tile=0.1)


def _polar(distance: float, degrees: float) -> tuple[float, float]:
    """A point around the middle, on a grid of a millimetre: short numbers make the exported scene small."""
    angle = np.radians(degrees)
    return round(distance * np.cos(angle) * 1024) / 1024, round(distance * np.sin(angle) * 1024) / 1024


def _build_castle(toys: _Toys) -> None:
    """A wall of blocks in an arc behind the robot, with gates, battlements and towers."""
    radius = 0.60
    spread = 2 * np.degrees(np.arcsin(_BLOCK / 2 / radius)) + 0.25  # from block to block
    for i in range(-19, 20):
        degrees = 90 + i * spread
        x, y = _polar(radius, degrees)
        toys.taken.occupy(x, y, 0.034)
        is_tower, is_gate = i % 9 == 0, i % 9 in (4, 5)
        height = 7 if is_tower else 4 + i % 2
        for level in range(3 if is_gate else 0, height):
            is_painted = (i + level) % 3 == 0 or (is_tower and level == 6)
            paint = toys.paints[(i * 3 + level * 5) % len(toys.paints)] if is_painted else toys.wood
            turn = round(degrees) + (1 if level % 2 else -1)  # built by hand
            studio.place(toys.mesh["Block"], x, y, _RUG_HEIGHT + level * _BLOCK, turn, material=paint)
        if is_tower:
            top = _RUG_HEIGHT + height * _BLOCK
            studio.place(toys.mesh["Roof"], x, y, top, round(degrees), material=toys.paints[0])
    for i in (-14, -5, 4, 13):  # planks carry the wall over the gates
        degrees = 90 + (i + 0.5) * spread
        z = _RUG_HEIGHT + 2.5 * _BLOCK
        studio.place(toys.mesh["Plank"], *_polar(radius, degrees), z, round(degrees) + 90, material=toys.wood)


def _build_domino_spiral(toys: _Toys) -> None:
    """Two and a half turns of standing dominoes around the podium, their colours running through the paints."""
    degrees, count = 0.0, 0
    while degrees < 900:
        distance = 0.175 + 0.19 * degrees / 900
        x, y = _polar(distance, degrees - 60)
        paint = toys.paints[count // 12 % len(toys.paints)]
        studio.place(toys.mesh["Domino"], x, y, _RUG_HEIGHT, round(degrees - 60) + 92, material=paint)
        toys.taken.occupy(x, y, 0.020)
        degrees += np.degrees(0.0205 / distance)
        count += 1


def _build_pyramid(toys: _Toys, metal: bpy.types.Material, x: float, y: float, turn: float) -> None:
    """Balls stacked like oranges on a square of four by four."""
    side = 2 * _METAL_BALL
    rotation = geometry.rotation_matrix("z", turn)[:2, :2]
    for level in range(4):
        z = _RUG_HEIGHT + _METAL_BALL + level * side / np.sqrt(2)
        for i in range(4 - level):
            for j in range(4 - level):
                dx, dy = rotation @ (np.array([i, j]) - (3 - level) / 2) * side
                studio.place(toys.mesh["Metal ball"], x + dx, y + dy, z, material=metal)
    toys.taken.occupy(x, y, 0.073)


def _build_ring_tower(toys: _Toys, x: float, y: float, first_paint: int) -> None:
    """Rings of falling size on a peg."""
    studio.place(toys.mesh["Base"], x, y, _RUG_HEIGHT, material=toys.wood)
    studio.place(toys.mesh["Peg"], x, y, _RUG_HEIGHT + 0.014, material=toys.wood)
    z = _RUG_HEIGHT + 0.014
    for level in range(6):
        scale = 1.25 - 0.125 * level
        paint = toys.paints[(first_paint + level) % len(toys.paints)]
        studio.place(toys.mesh["Ring"], x, y, z + _RING_TUBE * scale, scale=scale, material=paint)
        z += 2 * _RING_TUBE * scale
    toys.taken.occupy(x, y, 0.05)


def _scatter(toys: _Toys) -> None:
    """Loose toys wherever there is room, the largest first."""
    # Kind, materials, radius of its place, height of its origin above the floor, whether it is turned, how many.
    loose = [
        ("Ring", toys.paints, 0.037, _RING_TUBE, False, 30),
        ("Globe", toys.glasses, _GLOBE, _GLOBE, False, 7),
        ("Block", [toys.wood, toys.wood, *toys.paints], 0.03, 0.0, True, 50),
        ("Star", [*toys.paints[:3], toys.cream, toys.metals[1]], 0.026, 0.0, True, 60),
        ("Pawn", [*toys.paints, toys.cream, toys.black], 0.016, 0.0, False, 80),
        ("Jack", toys.metals, 0.015, 0.0, True, 60),
        ("Marble", toys.glasses, _MARBLE, _MARBLE, False, 150),
        ("Metal ball", toys.metals, _METAL_BALL, _METAL_BALL, False, 70),
    ]
    for kind, materials, radius, height, is_turned, count in loose:
        for i in range(count):
            x, y = toys.taken.place(radius, 0.20, 1.15, keep_off=_RUG_RADIUS)
            ground = _RUG_HEIGHT if np.hypot(x, y) < _RUG_RADIUS else 0.0
            turn = 15.0 * int(toys.taken.rng.integers(24)) if is_turned else 0.0
            studio.place(toys.mesh[kind], x, y, ground + height, turn, material=materials[i % len(materials)])


def _build_room() -> None:
    oak = studio.material("Oak floor", studio.image("parquet", textures.parquet()), 0.35)
    wool = studio.material("Wool", studio.image("rug", textures.rug()), 0.9)
    paint = studio.material("Wall paint", (0.30, 0.42, 0.46), 0.8)
    white = studio.material("Skirting paint", (0.78, 0.75, 0.70), 0.5)
    studio.place(studio.mesh("Floor", geometry.quad(_ROOM, _ROOM, 0.8), [oak]))
    rug = cylinder(_RUG_RADIUS, _RUG_HEIGHT, 64).mapped_from_above(_RUG_RADIUS)
    studio.place(studio.mesh("Rug", rug, [wool]))
    wall = geometry.quad(_ROOM, 2.6).rotated("x", 90).moved(y=_ROOM / 2, z=1.3)
    studio.place(studio.mesh("Walls", join(*[wall.rotated("z", 90 * side) for side in range(4)]), [paint]))
    board = rounded_box(_ROOM, 0.03, 0.12, 0.008, 1).moved(y=_ROOM / 2 - 0.015)
    studio.place(studio.mesh("Skirting", join(*[board.rotated("z", 90 * side) for side in range(4)]), [white]))


def _roll(frame: int) -> tuple[float, float]:
    """Place of the rolling ball on its circle (degrees) and its roll (radians)."""
    travel = 0.55 * (frame - 1)
    return -130 + travel, np.radians(travel) * _ROLLER_DISTANCE / _ROLLER


def _build_moving_toys(toys: _Toys, steel: bpy.types.Material) -> None:
    """A steel ball that rolls, and a top that spins about its own axis while that axis circles."""
    stripes = textures.stripes([(0.80, 0.20, 0.16), (0.93, 0.88, 0.78), (0.12, 0.42, 0.48), (0.93, 0.88, 0.78),
                                (0.92, 0.66, 0.20), (0.93, 0.88, 0.78)])  # fmt: skip
    lacquer = studio.material("Striped lacquer", studio.image("stripes", stripes), 0.2)
    x, y = _polar(*_TOP_PLACE)
    top = studio.place(studio.mesh("Top", _top(), [lacquer]), x, y, _RUG_HEIGHT)
    toys.taken.occupy(x, y, 0.065)
    top.rotation_mode = "ZYX"
    lean = np.radians(9.0)
    studio.animate(top, "rotation_euler", [
        (lean * np.cos(0.16 * frame), lean * np.sin(0.16 * frame), 0.35 * frame) for frame in studio.animated_frames()
    ])  # fmt: skip

    ball = studio.place(studio.mesh("Roller", sphere(_ROLLER, 32, 16), [steel]))
    angles, rolls = np.transpose([_roll(frame) for frame in studio.animated_frames()])
    for degrees in np.arange(angles[0], angles[-1] + 3, 3):
        toys.taken.occupy(*_polar(_ROLLER_DISTANCE, degrees), _ROLLER + 0.004)
    angles = np.radians(angles)
    z = _RUG_HEIGHT + _ROLLER
    studio.animate(ball, "location", [(_ROLLER_DISTANCE * np.cos(a), _ROLLER_DISTANCE * np.sin(a), z) for a in angles])
    studio.animate(ball, "rotation_euler", [(roll, 0.0, a) for a, roll in zip(angles, rolls)])


def _orbit(frame: int) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """0.3 degrees a frame, at a child's eye height."""
    angle = np.radians(-96 + 0.3 * (frame - 1))
    return (1.30 * np.cos(angle), 1.30 * np.sin(angle), 0.56), (0.0, 0.03, 0.105)


def build() -> None:
    """Replace the open file by the scene."""
    studio.new_scene("toys", bounces=6, world=(0.17, 0.20, 0.26))
    steel = studio.material("Steel", (0.66, 0.67, 0.69), 0.18, metallic=1.0)
    gold = studio.material("Gold", (0.95, 0.68, 0.28), 0.22, metallic=1.0)
    copper = studio.material("Copper", (0.90, 0.46, 0.30), 0.25, metallic=1.0)
    grain = textures.wood(128, [(0.68, 0.50, 0.33), (0.80, 0.64, 0.45), (0.88, 0.75, 0.57)])
    paints = {"Red": (0.62, 0.05, 0.04), "Orange": (0.80, 0.26, 0.03), "Yellow": (0.84, 0.54, 0.06),
              "Green": (0.12, 0.38, 0.12), "Teal": (0.02, 0.28, 0.32), "Blue": (0.04, 0.13, 0.46)}  # fmt: skip
    glasses = {"Clear glass": (0.97, 0.99, 0.98), "Green glass": (0.45, 0.85, 0.55),
               "Blue glass": (0.40, 0.62, 0.95), "Amber glass": (0.98, 0.66, 0.25)}  # fmt: skip
    toys = _Toys(
        mesh={name: studio.mesh(name, shape) for name, shape in _shapes().items()},
        paints=[studio.material(name, color, 0.3) for name, color in paints.items()],
        metals=[steel, gold, copper],
        glasses=[studio.material(name, color, 0.0, transmission=1.0) for name, color in glasses.items()],
        wood=studio.material("Beech", studio.image("beech", grain), 0.45),
        cream=studio.material("Cream", (0.80, 0.72, 0.58), 0.35),
        black=studio.material("Black", (0.02, 0.02, 0.025), 0.25),
    )

    _build_room()
    studio.place(toys.mesh["Podium"], z=_RUG_HEIGHT, material=toys.paints[4])
    toys.taken.occupy(0, 0, _PODIUM_RADIUS + 0.01)
    robot.build(_RUG_HEIGHT + _PODIUM_HEIGHT, body=toys.paints[0], limbs=steel, trim=toys.cream, eyes=toys.black)
    _build_domino_spiral(toys)
    _build_castle(toys)
    for metal, distance, degrees, turn in ((gold, 0.47, -28, 10), (steel, 0.48, 205, 30), (copper, 0.43, 35, 55)):
        _build_pyramid(toys, metal, *_polar(distance, degrees), turn)
    for first_paint, place in enumerate(((0.46, 165), (0.47, 8), (0.74, -20), (0.74, 200))):
        _build_ring_tower(toys, *_polar(*place), first_paint)
    _build_moving_toys(toys, steel)
    _scatter(toys)

    studio.light("AREA", "Window", 62.0, (1.0, 0.95, 0.88), (-1.5, -0.5, 1.75), (0.0, 0.1, 0.0), shape="RECTANGLE",
                 size=1.1, size_y=1.4)  # fmt: skip
    studio.light("SPOT", "Reading lamp", 85.0, (1.0, 0.72, 0.42), (1.35, 0.75, 1.35), (0.05, 0.1, 0.05),
                 shadow_soft_size=0.14, spot_size=np.radians(50), spot_blend=0.5)  # fmt: skip
    studio.light("POINT", "Night light", 4.0, (0.45, 0.62, 1.0), (0.25, 1.10, 0.34), shadow_soft_size=0.12)
    studio.camera(40.0, _orbit)
