# SPDX-License-Identifier: Apache-2.0
"""The toy robot: one skinned mesh on an armature that marches on the spot and waves.

It faces -Y, is 27 cm tall and has some 900 vertices, few enough to be stored for every frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import bpy
import geometry
import numpy as np
import studio
from geometry import join, lathe, sphere, torus, tube
from mathutils import Matrix, Quaternion, Vector

_HIP, _NECK = 0.088, 0.182  # heights, metres
# Head and tail of each bone at rest; those of _PAIRED are the left ones. Arms hang, slightly spread.
_JOINTS = {
    "hips": ((0.0, 0.0, _HIP), (0.0, 0.0, 0.118)),
    "chest": ((0.0, 0.0, 0.118), (0.0, 0.0, _NECK)),
    "head": ((0.0, 0.0, _NECK), (0.0, 0.0, 0.27)),
    "arm": ((0.056, 0.0, 0.166), (0.079, 0.0, 0.122)),
    "forearm": ((0.079, 0.0, 0.122), (0.092, -0.012, 0.076)),
    "thigh": ((0.026, 0.0, _HIP), (0.030, 0.0, 0.050)),
    "shin": ((0.030, 0.0, 0.050), (0.031, 0.0, 0.010)),
}
_PARENTS = {"chest": "hips", "head": "chest", "arm": "chest", "forearm": "arm", "thigh": "hips", "shin": "thigh"}
_PAIRED = ("arm", "forearm", "thigh", "shin")

_Weights = Callable[[np.ndarray], dict[str, np.ndarray]]


def _body() -> list[tuple[geometry.Shape, _Weights]]:
    """The parts with the bones that move them. Slots: body, limbs, trim, eyes."""
    trunk = lathe([(0.0, 0.080), (0.030, 0.081), (0.040, 0.088), (0.043, 0.100), (0.041, 0.112), (0.045, 0.122),
                   (0.052, 0.140), (0.055, 0.158), (0.052, 0.170), (0.040, 0.180), (0.020, 0.184), (0.0, 0.185)], 16)
    trunk = trunk.scaled(1.0, 0.78, 1.0)
    belt = torus(0.0425, 0.005, 16, 6).scaled(1.0, 0.78, 1.0).moved(z=0.112).with_slot(2)
    head = lathe([(0.0, 0.186), (0.030, 0.187), (0.037, 0.193), (0.039, 0.205), (0.039, 0.225), (0.035, 0.241),
                  (0.024, 0.252), (0.0, 0.257)], 16).with_slot(2)
    neck = geometry.cylinder(0.014, 0.012, 8).moved(z=0.179).with_slot(1)
    eyes = [sphere(0.0085, 8, 6).scaled(1, 0.6, 1).moved(side * 0.015, -0.036, 0.219).with_slot(3) for side in (-1, 1)]
    ears = [sphere(0.010, 8, 4).scaled(0.6, 1, 1).moved(side * 0.040, 0.0, 0.214).with_slot(0) for side in (-1, 1)]
    mouth = geometry.box(0.020, 0.006, 0.004).moved(0, -0.0375, 0.200).with_slot(3)
    antenna = geometry.cylinder(0.0018, 0.022, 6).moved(z=0.254).with_slot(1)
    knob = sphere(0.006, 8, 6).moved(z=0.279)
    parts: list[tuple[geometry.Shape, _Weights]] = [
        (trunk, _between("hips", "chest", 0.118, 0.018)),
        (belt, _rigid("hips")),
        (join(head, neck, *eyes, *ears, mouth, antenna, knob), _rigid("head")),
    ]
    for side, suffix in ((1, ".L"), (-1, ".R")):
        shoulder, elbow, wrist = _chain("arm", "forearm", side)
        arm = _limb([shoulder, elbow, wrist], 0.0125, 0.0105).with_slot(1)
        parts.append((arm, _between("forearm" + suffix, "arm" + suffix, elbow[2], 0.012)))
        parts.append((sphere(0.017, 8, 6).moved(*shoulder).with_slot(0), _rigid("arm" + suffix)))
        hand = sphere(0.0165, 8, 6).scaled(0.9, 0.9, 1.15).moved(*(wrist + (wrist - elbow) * 0.14))
        parts.append((hand.with_slot(2), _rigid("forearm" + suffix)))
        hip, knee, ankle = _chain("thigh", "shin", side)
        leg = _limb([hip, knee, ankle], 0.0155, 0.0135).with_slot(1)
        parts.append((leg, _between("shin" + suffix, "thigh" + suffix, knee[2], 0.010)))
        shoe = lathe([(0.0, 0.0), (0.020, 0.0), (0.0225, 0.004), (0.021, 0.013), (0.013, 0.021), (0.0, 0.024)], 12)
        shoe = shoe.scaled(1.0, 1.35, 1.0).moved(side * 0.031, -0.007, 0.0).with_slot(0)
        parts.append((shoe, _rigid("shin" + suffix)))
    return parts


def _chain(first: str, second: str, side: int) -> list[np.ndarray]:
    """The three joints of a limb; side is 1 for the left one, -1 for the right."""
    return [np.array(joint) * (side, 1, 1) for joint in (*_JOINTS[first], _JOINTS[second][1])]


def _limb(joints: Sequence[np.ndarray], first_radius: float, last_radius: float) -> geometry.Shape:
    """A tube through three joints with enough rings around the middle one to bend."""
    first, middle, last = joints
    path = [first + (middle - first) * t for t in (0, 0.3, 0.6, 0.8, 0.95)]
    path += [middle + (last - middle) * t for t in (0.1, 0.25, 0.5, 1)]
    return tube(np.array(path), np.linspace(first_radius, last_radius, len(path)), 8)


def _rigid(bone: str) -> _Weights:
    return lambda positions: {bone: np.ones(len(positions))}


def _between(lower: str, upper: str, height: float, blend: float) -> _Weights:
    """Two bones that meet at a height, blended smoothly over +-blend metres."""

    def weights(positions: np.ndarray) -> dict[str, np.ndarray]:
        t = np.clip((positions[:, 2] - height) / (2 * blend) + 0.5, 0, 1)
        share = t * t * (3 - 2 * t)
        return {upper: share, lower: 1 - share}

    return weights


def _armature() -> bpy.types.Object:
    rig = bpy.data.objects.new("Robot rig", bpy.data.armatures.new("Robot rig"))
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name, (head, tail) in _JOINTS.items():
        for side, suffix in ((1, ".L"), (-1, ".R")) if name in _PAIRED else ((1, ""),):
            bone = rig.data.edit_bones.new(name + suffix)
            bone.head, bone.tail = np.array(head) * (side, 1, 1), np.array(tail) * (side, 1, 1)
            parent = _PARENTS.get(name)
            if parent:
                bone.parent = rig.data.edit_bones[parent + (suffix if parent in _PAIRED else "")]
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def _pose(frame: int) -> dict[str, tuple[float, float, float]]:
    """Rotation of each bone, degrees around the world's X, Y, Z: a march of 24 frames for two steps, and a wave."""
    step = 2 * np.pi * (frame - 1) / 24
    wave = 2 * np.pi * (frame - 1) / 16
    pose = {"hips": (0, 3 * np.sin(step), 0), "chest": (0, -4 * np.sin(step), 5 * np.sin(step)),
            "head": (4, 7 * np.sin(step / 2 + 0.5), 6 * np.sin(step / 2))}
    for suffix, phase in ((".L", 0.0), (".R", np.pi)):
        lift = max(0.0, np.sin(step + phase)) ** 1.5
        pose["thigh" + suffix] = (-48 * lift, 0, 0)
        pose["shin" + suffix] = (58 * lift, 0, 0)
    pose["arm.R"] = (24 * np.sin(step), 4, 0)
    pose["forearm.R"] = (-20 + 10 * np.sin(step), 0, 0)
    pose["arm.L"] = (-12, -118 + 4 * np.sin(wave), 0)
    pose["forearm.L"] = (0, -24 + 26 * np.sin(wave), 0)
    return pose


def _pose_quaternion(bone: bpy.types.PoseBone, degrees: Sequence[float]) -> Quaternion:
    """A rotation around the world's axes, expressed in the bone's own rest frame."""
    world = Matrix.Identity(3)
    for axis, angle in zip("XYZ", degrees):
        world = Matrix.Rotation(np.radians(angle), 3, axis) @ world
    rest = bone.bone.matrix_local.to_3x3()
    return (rest.inverted() @ world @ rest).to_quaternion()


def build(z: float, **materials: bpy.types.Material) -> bpy.types.Object:
    """The robot on the floor at height z. materials: body, limbs, trim, eyes."""
    rig = _armature()
    rig.location = Vector((0.0, 0.0, z))
    parts = _body()
    shape = join(*[part for part, _ in parts])
    robot = studio.place(studio.mesh("Robot", shape, [materials[slot] for slot in ("body", "limbs", "trim", "eyes")]))
    robot.parent = rig
    first = 0
    for part, weights_of in parts:
        for bone, weights in weights_of(part.positions).items():
            group = robot.vertex_groups.get(bone) or robot.vertex_groups.new(name=bone)
            for vertex, weight in enumerate(weights.tolist(), first):
                if weight > 0:
                    group.add([vertex], weight, "REPLACE")
        first += len(part.positions)
    modifier = robot.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig

    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
        poses = [_pose(frame) for frame in studio.animated_frames()]
        if bone.name in poses[0]:
            studio.animate(bone, "rotation_quaternion", [_pose_quaternion(bone, pose[bone.name]) for pose in poses])
    return robot
