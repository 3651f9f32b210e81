# SPDX-License-Identifier: Apache-2.0
"""The trees that rays traverse, node by node: complete, tight enough for nothing to be missed, no deeper than the
stack of a ray allows, and cheaper for having been improved; whatever the boxes."""

import os
import subprocess
import sys
import zlib

import numpy as np
import pytest

MAX_LEVELS, MAX_LEAF_SIZE = 20, 3  # scene/wide_node.h


def build(boxes, high_quality=True) -> tuple[np.ndarray, np.ndarray]:
    native = pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    return native.build_tree(np.ascontiguousarray(boxes, np.float32).reshape(-1, 6), high_quality)


class Tree:
    """A tree as scene/wide_node.h describes it, in float64. parents, slots: of all children, in any order; low, high:
    their boxes [C, 3]; inner: the node that a child is, or -1; first, count: the primitives of a leaf. level [M]."""

    def __init__(self, nodes):
        origin = nodes[:, :3].view(np.float32).astype(np.float64)
        as_bytes = np.ascontiguousarray(nodes).view(np.uint8).reshape(len(nodes), 80)
        step = 2.0 ** (as_bytes[:, 12:15].astype(np.float64) - 127)
        slots, is_inner = as_bytes[:, 24:32], as_bytes[:, 15]
        sides = as_bytes[:, 32:].reshape(len(nodes), 3, 8, 2).transpose(0, 3, 1, 2).astype(np.float64)
        self.parents, self.slots = np.nonzero(slots)
        corner = origin[self.parents, None] + sides[self.parents, :, :, self.slots] * step[self.parents, None]
        self.low, self.high = corner[:, 0], corner[:, 1]
        slot = slots[self.parents, self.slots]
        inner = (slot & 31) >= 24
        np.testing.assert_array_equal(inner, (is_inner[self.parents] >> self.slots) & 1)
        np.testing.assert_array_equal(slot[inner], 32 | (24 + self.slots[inner]))
        assert np.isin(slot[~inner] >> 5, (1, 3, 7)).all()
        before = np.cumsum(inner) - inner  # inner children are in the order of nodes and slots
        start = np.searchsorted(self.parents, np.arange(len(nodes)))
        rank = before - before[start[self.parents]]
        self.inner = np.where(inner, nodes[self.parents, 4] + rank, -1)
        self.first = nodes[self.parents, 5] + (slot & 31)
        self.count = np.where(inner, 0, np.unpackbits((slot >> 5)[:, None], axis=1).sum(axis=1))
        self.level = np.zeros(len(nodes), int)
        self.level[0] = 1
        for parent, child in sorted(zip(self.parents[inner], self.inner[inner]), key=lambda pair: pair[1]):
            # Children lie behind their parents.
            assert child > parent and self.level[child] == 0
            self.level[child] = self.level[parent] + 1

    def cost(self) -> float:
        """Children whose boxes a ray meets that meets the tree: by the areas of their boxes."""
        size = self.high - self.low
        area = (size * np.roll(size, 1, axis=1)).sum(axis=1)
        whole = self.high.max(axis=0) - self.low.min(axis=0)
        return float(area.sum() / (whole * np.roll(whole, 1)).sum())


def check(boxes, nodes, order) -> Tree:
    tree = Tree(nodes)
    assert (tree.level > 0).all() and tree.level.max() <= MAX_LEVELS
    leaf = tree.inner < 0
    assert 1 <= tree.count[leaf].min() and tree.count.max() <= MAX_LEAF_SIZE
    # Each box is in one leaf.
    np.testing.assert_array_equal(np.sort(order), np.arange(len(boxes)))
    places = np.concatenate([first + np.arange(count) for first, count in zip(tree.first[leaf], tree.count[leaf])])
    np.testing.assert_array_equal(np.sort(places), np.arange(len(boxes)))
    # What lies below a child lies in its box: from the leaves up, the tight box of each node.
    low, high = np.full((len(nodes), 3), np.inf), np.full((len(nodes), 3), -np.inf)
    boxes = boxes.reshape(-1, 2, 3).astype(np.float32).astype(np.float64)[order]
    for child in np.argsort(-tree.parents, kind="stable"):
        if tree.inner[child] >= 0:
            inside = low[tree.inner[child]], high[tree.inner[child]]
        else:
            members = boxes[tree.first[child] : tree.first[child] + tree.count[child]]
            inside = members[:, 0].min(axis=0), members[:, 1].max(axis=0)
        # Rounded outwards, but for what a sum with the origin rounds.
        room = 1e-7 * np.maximum(np.abs(inside[0]), np.abs(inside[1]))
        assert (tree.low[child] <= inside[0] + room).all() and (tree.high[child] >= inside[1] - room).all()
        parent = tree.parents[child]
        low[parent], high[parent] = np.minimum(low[parent], inside[0]), np.maximum(high[parent], inside[1])
    return tree


def sticks(count: int, seed: int = 3) -> np.ndarray:
    """Boxes long and thin that cross each other."""
    rng = np.random.default_rng(seed)
    centre, size = rng.random((count, 3)), np.exp(rng.uniform(-6.0, -0.5, (count, 3)))
    return np.concatenate([centre - size / 2, centre + size / 2], axis=1)


def hostile(name: str) -> np.ndarray:
    count = np.arange(3000)[:, None]
    if name == "all the same":
        return np.broadcast_to([0.0, 0.0, 0.0, 1.0, 2.0, 3.0], (3000, 6))
    if name == "all one point":
        return np.ones((3000, 6))
    if name == "one in the other":
        size = np.exp2(-40.0 + 80.0 * count / 3000) * np.ones(3)
        return np.concatenate([-size, size], axis=1)
    if name == "ever farther":
        place = np.exp2(-60.0 + 120.0 * count / 3000) * [1.0, 0.0, 0.0]
        return np.concatenate([place, place * 1.0001], axis=1)
    if name == "in a line":
        return np.concatenate([count * [1.0, 0.0, 0.0], count * [1.0, 0.0, 0.0] + [1.0, 0.0, 0.0]], axis=1)
    boxes = sticks(3000)
    boxes[:300, :3], boxes[:300, 3:] = -1.0, 2.0
    return boxes


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 9, 25, 100, 3000])
@pytest.mark.parametrize("high_quality", [False, True])
def test_trees_are_whole(count, high_quality):
    boxes = sticks(count)
    check(boxes, *build(boxes, high_quality))


@pytest.mark.parametrize(
    "name", ["all the same", "all one point", "one in the other", "ever farther", "in a line", "some around all"]
)
def test_trees_of_hostile_boxes_are_whole_and_not_too_deep(name):
    boxes = hostile(name)
    check(boxes, *build(boxes))


def test_no_boxes_and_empty_boxes():
    nodes, order = build(np.zeros((0, 6)))
    assert len(nodes) == 1 and not nodes[0, 6:8].any() and not len(order)
    boxes = sticks(10)
    empty = np.concatenate([boxes, np.repeat([[np.inf] * 3 + [-np.inf] * 3], 5, axis=0)])
    np.testing.assert_array_equal(build(empty)[1], build(boxes)[1])


def test_improving_a_tree_makes_it_cheaper():
    boxes = sticks(6000)
    quick, high = (check(boxes, *build(boxes, quality)).cost() for quality in (False, True))
    assert high < 0.97 * quick


@pytest.mark.parametrize("threads", [1, 7])
def test_the_tree_does_not_depend_on_the_threads(threads):
    """Enough boxes for all that is done side by side."""
    pytest.importorskip("svgf._native.cpu", reason="the native modules are not built")
    program = (
        "import zlib; from tests.test_tree import build, sticks;"
        "print([zlib.crc32(array) for array in build(sticks(40_000))])"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "SVGF_THREADS": str(threads)},
        cwd=os.path.dirname(os.path.dirname(os.path.abspath(__file__))),
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert printed == f"{[zlib.crc32(array) for array in build(sticks(40_000))]}\n"
