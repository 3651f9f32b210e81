# SPDX-License-Identifier: Apache-2.0
"""Stage "antialias" of svgf+: resolves over time what lies within a pixel. The reasons stand in
native/denoise/antialias.h."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..settings import PlusStep
from .cubic import catmull_rom, cubic_taps, linear
from .guides import namespace

# Box in standard deviations of the 3x3 pixels: of the moving, and of the still picture, with a margin in brightness.
MOVING_BOX = 1.0
# Of the geometric mean of brightness, where something moves: where the average begins to compress.
MOVING_WHITE = 12.0
# Of that, where history is read between pixels.
INTERPOLATION_WHITE = 0.25
STILL_BOX = 4.0
STILL_MARGIN = 0.02
STILL_FRAMES = 24.0
# Where nothing changes: noise of the mean up to which it is that of the noisy frames, and the most that one moves it.
VISIBLE_NOISE = 0.1
LARGEST_STEP = 0.05
# Contrast of the 3x3 pixels that hides noise, and the frames that the mean takes there.
MASKING_CONTRAST = 0.05
BLEND_FRAMES = 56.0
STILL_RATE, BLEND_RATE, FORGETTING_FRAMES = 1.25, 2.0, 256.0
# Of the brightest of the 3x3 pixels: what darker ones count for in their geometric mean.
BLACK = 2.0**-10


@dataclass(frozen=True, eq=False)
class Resolved:
    """color [H, W, 3] and the frames [H, W] that are in it."""

    color: Any
    frames: Any


def antialias(
    color: Any, noisy: Any, noise: Any, changed: Any, depth: Any, motion: Any, history: Resolved | None, settings: Any,
    unchanged: bool = False, interactive: bool = False,
) -> Resolved:  # fmt: skip
    """color [H, W, 3]: the denoised frame. noisy [H, W, 3]: what it was made from, repaired; noise [H, W]: the variance
    of its luminance. changed bool [H, W]: light has just changed. depth [H, W]. motion [H, W, 2 or 3], None: nothing
    moved. unchanged: nor did the light change. interactive: what stands still waits with noisy frames until then."""
    xp = namespace(color)
    height, width = depth.shape
    rows, columns = xp.meshgrid(xp.arange(height), xp.arange(width), indexing="ij")
    motion = xp.zeros((height, width, 2)) if motion is None else motion[..., :2].astype(xp.float64)
    motion = xp.where(xp.isfinite(motion).all(axis=-1)[..., None], motion, -xp.inf)

    # Outside the frame, the pixels of its border.
    taps = [
        (xp.clip(rows + dy, 0, height - 1), xp.clip(columns + dx, 0, width - 1))
        for dy in (-1, 0, 1)
        for dx in (-1, 0, 1)
    ]
    # What stands in front leads: its own pixel where no other is nearer.
    front, nearest = motion, depth
    for at in taps:
        nearer = depth[at] < nearest
        front = xp.where(nearer[..., None], motion[at], front)
        nearest = xp.where(nearer, depth[at], nearest)
    still = (front == 0.0).all(axis=-1) & (motion == 0.0).all(axis=-1)
    colors = xp.stack([color[at] for at in taps])
    white = _white(colors) * xp.where(still, 1.0, MOVING_WHITE)

    def map_(c: Any) -> Any:
        return _compress(c, white)

    def unmap(c: Any) -> Any:
        return _expand(c, white)

    mapped = xp.stack([map_(c) for c in colors])
    mean, deviation = mapped.mean(axis=0), mapped.std(axis=0)

    x, y = columns + front[..., 0], rows + front[..., 1]
    reachable = (x >= 0.0) & (y >= 0.0) & (x <= width - 1) & (y <= height - 1)
    x, y = xp.where(reachable, x, 0.0), xp.where(reachable, y, 0.0)
    past_linear, past, frames = xp.zeros(color.shape), xp.zeros(color.shape), xp.zeros(depth.shape)
    if history is not None:
        left, top = xp.floor(x).astype(int), xp.floor(y).astype(int)
        past_linear = xp.where(reachable[..., None], history.color[top, left], 0.0)  # where nothing moves
        between, frames = _between(history, x, y, INTERPOLATION_WHITE * white, settings.has(PlusStep.CATMULL_ROM))
        exact = (x == left) & (y == top)
        past = map_(xp.where(exact[..., None], past_linear, between))
        past, frames = xp.where(reachable[..., None], past, 0.0), xp.where(reachable, frames, 0.0)

    known = frames > 0.5
    still &= known
    settled = still & (frames > STILL_FRAMES - 0.5) & settings.has(PlusStep.HAND_OVER)
    uncertain = STILL_BOX * xp.sqrt(noise / xp.maximum(frames, 1.0)) / (white + color.max(axis=-1) + 1e-30)
    margin = xp.where(settled, STILL_MARGIN + uncertain, 0.0)[..., None]
    moving = xp.maximum(MOVING_BOX * deviation, xp.abs(map_(color) - mean))
    extent = xp.where(still[..., None], STILL_BOX * deviation + margin, moving)
    excess = (xp.abs(past - mean) / xp.maximum(extent, 1e-30)).max(axis=-1)
    if unchanged:
        excess, changed = xp.where(still, 0.0, excess), changed & ~still
    goes_on = settled & (excess <= 1.0) & ~changed
    kept = xp.where((settled & ~goes_on) | (still & changed), 0.0, frames)
    clipped = xp.where((excess > 1.0)[..., None], mean + (past - mean) / xp.maximum(excess, 1.0)[..., None], past)
    clipped = xp.where((excess > 1e12)[..., None], mean, clipped)
    n = xp.where(still, kept + 1.0, xp.minimum(kept + 1.0, settings.antialias_frames))
    n = xp.where(known, n, 1.0)
    resolved = unmap(clipped + (map_(color) - clipped) / n[..., None])
    before = xp.where((excess > 1.0)[..., None], unmap(clipped), past_linear)
    resolved = xp.where(still[..., None], before + (color - before) / n[..., None], resolved)
    resolved = xp.where(known[..., None], resolved, color)
    left = xp.sqrt(noise / xp.maximum(frames, 1.0)) / white
    unseen = xp.clip(2.0 - left / VISIBLE_NOISE, 0.0, 1.0)
    masked = xp.clip(deviation.max(axis=-1) / MASKING_CONTRAST - 1.0, 0.0, 1.0)
    masked = masked * xp.clip((frames - STILL_FRAMES) / BLEND_FRAMES, 0.0, 1.0)
    waits = interactive and not unchanged
    share = xp.maximum(unseen, masked)[..., None] if unchanged else 0.0 if waits else 1.0
    sample = color + (noisy - color) * share
    least_rate = xp.where(unchanged | (frames < FORGETTING_FRAMES), STILL_RATE, 1.0)[..., None]
    rate = (BLEND_RATE + (least_rate - BLEND_RATE) * share)[..., 0]
    n = xp.where(goes_on, frames, n) if waits else n
    step = (sample - past_linear) * (rate / n)[..., None]
    if unchanged:
        most = LARGEST_STEP * xp.maximum(white, color.max(axis=-1) + 1e-30)
        step = step * (most / xp.maximum(step.max(axis=-1), most))[..., None]
    resolved = xp.where(goes_on[..., None], past_linear + step, resolved)
    return Resolved(resolved, n)


def _between(history: Resolved, x: Any, y: Any, white: Any, is_catmull_rom: bool) -> tuple[Any, Any]:
    """The history's color [H, W, 3] at places inside the frame, averaged after ``_compress``: Catmull-Rom, never beyond
    the inner four pixels, or bilinear; and the frames [H, W] in it, bilinear."""
    xp = namespace(x)
    least, most = xp.full(history.color.shape, xp.inf), xp.full(history.color.shape, -xp.inf)
    total, color = xp.zeros(x.shape), xp.zeros(history.color.shape)
    for at, share, is_inner in cubic_taps(x, y, catmull_rom if is_catmull_rom else linear):
        compressed = _compress(history.color[at], white)
        total, color = total + share, color + share[..., None] * compressed
        if is_inner:
            least, most = xp.minimum(least, compressed), xp.maximum(most, compressed)
    frames = sum(share * history.frames[at] for at, share, is_inner in cubic_taps(x, y, linear) if is_inner)
    return _expand(xp.clip(color / total[..., None], least, most), white), frames


def _compress(color: Any, white: Any) -> Any:
    """color [H, W, 3] to [0, 1): half of it where it is as bright as white [H, W]."""
    return color / (white[..., None] + color.max(axis=-1, keepdims=True) + 1e-30)


def _expand(color: Any, white: Any) -> Any:
    xp = namespace(color)
    return xp.maximum(color, 0.0) * white[..., None] / xp.maximum(1.0 - color.max(axis=-1, keepdims=True), 1e-4)


def _white(colors: Any) -> Any:
    """The geometric mean of the 3x3 pixels' brightness, [H, W]."""
    xp = namespace(colors)
    brightness = colors.max(axis=-1) + 1e-30
    return xp.exp(xp.log(xp.maximum(brightness, BLACK * brightness.max(axis=0))).mean(axis=0))
