# SPDX-License-Identifier: Apache-2.0
"""Stage "temporal" of svgf+: firefly limit, reprojection, running means and the variance that is left in them. What is
done otherwise than in [Schied17], and why, stands in native/denoise/temporal_plus.h."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..settings import PlusStep
from .cubic import catmull_rom, cubic_taps
from .guides import Guides, luminance, namespace, tap
from .reprojection import LEAST_TAP_WEIGHT, Reprojection, reproject

# What the neighbours' mean, without the brightest, counts for beside history.
NEIGHBOUR_SHARE = 0.1
# Weight of a frame in the drift, and how far it counts one sample, in standard deviations.
DRIFT_RATE = 0.3
LARGEST_RESIDUAL = 4.0
# Spacing of the nine pixels whose drift is averaged.
DRIFT_SPACING = 3
# Rise of the threshold whenever history has doubled beyond these frames.
THRESHOLD_RISE = 0.05
THRESHOLD_FRAMES = 16.0
# Of the threshold, for light that is less than history says, and its rise.
FALL_SHARE, FALL_SHARE_RISE = 0.75, 0.0625
# Frames in the mean up to which the 3x3 samples' mean takes a sample's place.
YOUNG_FRAMES = 2.0
# Of a specular sample's variance, what the 3x3 samples say whatever their structure; and what makes the least of four
# second differences as large as the variance of noise.
STRUCTURE_SHARE = 0.06
SECOND_DIFFERENCE_SCALE = 2.5 / 6.0
# Of a diffuse sample's variance, what the 3x3 samples say whatever the pixel's own does, and from how many frames on.
NEIGHBOURS_VARIANCE_SHARE, OWN_VARIANCE_FRAMES = 0.3, 2.0
# Of how history differs around a place, what is taken off a specular sample's variance.
HISTORY_STRUCTURE_SHARE = 0.7
# Where nothing changes: frames beyond which the filter narrows faster than the noise falls.
NARROWING_FRAMES = 32.0
# How many times the specular mean is more uncertain after one frame than it seems.
YOUNG_SPECULAR = 3.0
# Deviations that no change reaches.
NEVER = 1e6
# Of the local brightness: history may be off by this much whatever the variance.
CLAMP_MARGIN = 1e-4


@dataclass(frozen=True, eq=False)
class HistoryPlus:
    """What a frame leaves to the next: per signal the mean color [H, W, 3], the frames [H, W] in it, the variance [H,
    W] of a sample's luminance, the drift [H, W] of samples from history in deviations, changed bool [H, W]
    where history gave way to a change of light, and the luminance [H, W] after the filter; the guides they belong
    to."""

    color: list[Any]
    frames: list[Any]
    variance: list[Any]
    drift: list[Any]
    changed: list[Any]
    filtered: list[Any]
    guides: Guides


@dataclass(frozen=True)
class Fireflies:
    """samples: that were brighter than the limit. light: luminance over albedo that was cut from them; image: the same
    [H, W]."""

    samples: int
    light: float
    image: Any = None


def temporal_plus(
    illumination: list[Any],
    is_specular: list[bool],
    guides: Guides,
    motion: Any,
    history: HistoryPlus | None,
    settings: Any,
    has_reflections: list[bool],
    unchanged: bool = False,
    black: list[Any] | None = None,
) -> tuple[HistoryPlus, list[Any], Fireflies, int]:
    """illumination [H, W, 3], is_specular, has_reflections (alone or with other light): per signal. motion: [H, W, 2
    or 3], None: nothing moved. unchanged: nor did the light change. black: per signal bool [H, W], the albedo is 0;
    None: nowhere.

    Returns what the next frame needs, but for the filtered luminance, which is yet to come; per signal the variance
    [H, W] of the mean, as the filter takes it; what the limit cut; and how many motions were no numbers. Where there
    is no surface, the illumination is the mean of 0 frames.
    """
    xp = namespace(guides.depth)
    shape = guides.depth.shape
    surface = guides.surface
    none = [xp.zeros(shape) for _ in illumination]
    old_color, old_frames, old_variance, expected = [xp.zeros((*shape, 3)) for _ in illumination], none, none, none
    drifts, structure = none, none
    found, moves, repaired = xp.zeros(shape, bool), xp.zeros(shape, bool), 0
    if history is not None and settings.has(PlusStep.HISTORY):
        point = replace(
            reproject(guides, history.guides, motion, settings),
            tests_taps=settings.has(PlusStep.TESTED_TAPS), interpolates=settings.has(PlusStep.INTERPOLATION),
        )  # fmt: skip
        repaired = point.repaired
        rows, columns = xp.meshgrid(xp.arange(shape[0]), xp.arange(shape[1]), indexing="ij")
        moves = point.reachable & ((point.x != columns) | (point.y != rows))
        found, (old_color, old_frames, old_variance, expected) = _read(point, history, settings.history_fix_radius)
        drifts = [xp.where(found, _around(point, image), 0.0) for image in history.drift]
        structure = list(none)
        is_sharp = found & moves & point.saw_all() & settings.has(PlusStep.CATMULL_ROM)
        for s in range(len(illumination)):
            if is_specular[s]:
                color, spread = _read_sharply(point, history.color[s])
                old_color[s] = xp.where(is_sharp[..., None], color, old_color[s])
                own_noise = old_variance[s] / xp.maximum(old_frames[s], 1.0)
                structure[s] = xp.where(is_sharp, xp.maximum(spread - own_noise, 0.0), 0.0)

    around = _neighbours(illumination, guides, settings.normal_tolerance)
    colors, frames, variances, new_drifts, changes, spreads = [], [], [], [], [], []
    fireflies, cut = 0, xp.zeros(shape)
    for s, new in enumerate(illumination):
        # Black says nothing about the light: the neighbours do, or history.
        near, count = around, sum(same for same, _ in around)
        if black is not None:
            unknown = black[s] & (luminance(new) <= 0.0)
            places = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0)]
            near = [
                (same & ~tap(*place, unknown)[1], color) for (same, color), place in zip(around, places, strict=True)
            ]
            count = sum(same for same, _ in near)
            known = sum(xp.where(same[..., None], color[s], 0.0) for same, color in near)
            known = known / xp.maximum(count, 1)[..., None]
            new = xp.where((unknown & surface)[..., None], xp.where((count > 0)[..., None], known, old_color[s]), new)
        # The limit, by what history and the neighbours say.
        lights = [xp.where(same, luminance(color[s]), 0.0) for same, color in near]
        several = count > 1
        local = (sum(lights) - xp.maximum.reduce(lights)) / xp.where(several, count - 1, 1)
        local = xp.where(several, xp.maximum(local, 0.0), luminance(new))
        known = xp.maximum(expected[s], xp.where(several, NEIGHBOUR_SHARE * local, 0.0))
        limit = settings.firefly_limit * xp.where(found, known, local)
        sample = _limited(new, limit)
        above = surface & (luminance(new) > limit)
        fireflies += int(above.sum())
        cut = cut + xp.where(above, luminance(new) - limit, 0.0)

        # Mean and variance of the 3x3 samples.
        taps = [xp.where(same[..., None], _limited(color[s], limit), 0.0) for same, color in near]
        mean = (sample + sum(taps)) / (count + 1)[..., None]
        mean_light = luminance(mean)
        squares = (luminance(sample) - mean_light) ** 2
        for (same, _), color in zip(near, taps, strict=True):
            squares = squares + xp.where(same, (luminance(color) - mean_light) ** 2, 0.0)
        spread = xp.where(count > 0, squares / xp.maximum(count, 1), luminance(sample) ** 2)
        if is_specular[s]:
            least = _least_second_difference(luminance(sample), [luminance(color) for color in taps], near)
            noise = xp.minimum(spread, SECOND_DIFFERENCE_SCALE * least)
            share = STRUCTURE_SHARE if settings.has(PlusStep.STRUCTURE) else 1.0
            spread = noise + share * (spread - noise)
            spread = xp.maximum(spread - HISTORY_STRUCTURE_SHARE * structure[s], share * spread)
        elif settings.has(PlusStep.STRUCTURE):
            own = (luminance(sample) - luminance(old_color[s])) ** 2 * (old_frames[s] / (old_frames[s] + 1.0))
            narrower = xp.minimum(spread, NEIGHBOURS_VARIANCE_SHARE * spread + own)
            spread = xp.where(moves & (old_frames[s] >= OWN_VARIANCE_FRAMES), narrower, spread)

        # Light that has changed.
        doublings = xp.maximum(xp.log2(xp.maximum(old_frames[s], 1.0) / THRESHOLD_FRAMES), 0.0)
        threshold = settings.specular_change_threshold if is_specular[s] else settings.change_threshold
        threshold = (NEVER if unchanged else threshold) + THRESHOLD_RISE * doublings
        fall_share = xp.minimum(FALL_SHARE + FALL_SHARE_RISE * doublings, 1.0)
        threshold = xp.where(drifts[s] < 0.0, fall_share, 1.0) * threshold
        kept_of_change = xp.clip(6.0 - 5.0 * xp.abs(drifts[s]) / threshold, 0.0, 1.0)
        changed = mean + (old_color[s] - mean) * kept_of_change[..., None]
        left = old_frames[s] * kept_of_change
        n = left + 1.0
        n = xp.where(moves, xp.minimum(n, settings.longest_history), n)
        variance = old_variance[s] + (spread - old_variance[s]) / n
        deviation = xp.sqrt(xp.maximum(variance, old_variance[s]))
        seen = mean_light if settings.has(PlusStep.MEAN_DRIFT) else luminance(sample)
        residual = (seen - luminance(changed)) / (deviation + 1e-3 * mean_light + 1e-30)
        residual = xp.clip(residual, -LARGEST_RESIDUAL, LARGEST_RESIDUAL)
        drift = drifts[s] + (residual - drifts[s]) * DRIFT_RATE
        # History that is too far from the samples is drawn to them, and counts as shorter.
        sharper = 1.0 / settings.specular_sharpness if is_specular[s] else 1.0
        distance = xp.abs(luminance(changed) - mean_light)
        clamp = settings.specular_history_clamp if is_specular[s] else settings.history_clamp
        clamp = NEVER if unchanged else clamp
        allowed = clamp * xp.sqrt(variance) + CLAMP_MARGIN * mean_light
        far = found & (distance > allowed)
        kept = xp.where(far, allowed / xp.where(far, distance, 1.0), 1.0)
        past = xp.where(far[..., None], mean + (changed - mean) * kept[..., None], changed)
        shorter = xp.maximum(left * kept, xp.minimum(old_frames[s], 1.0)) + 1.0
        n = xp.where(far, xp.where(moves, xp.minimum(shorter, settings.longest_history), shorter), n)

        uncertain = xp.minimum(NARROWING_FRAMES / n, 1.0) if unchanged else 1.0
        if is_specular[s]:
            uncertain = uncertain * (1.0 + YOUNG_SPECULAR / n)
        if not has_reflections[s] and settings.has(PlusStep.LOCAL_MEAN):
            sample = xp.where((n <= YOUNG_FRAMES)[..., None], mean, sample)

        colors.append(xp.where(surface[..., None], past + (sample - past) / n[..., None], new))
        frames.append(xp.where(surface, n, 0.0))
        new_drifts.append(xp.where(surface & found, drift, 0.0))
        changes.append(surface & found & (kept_of_change < 1.0))
        variances.append(xp.where(surface, variance, 0.0))
        spreads.append(xp.where(surface, sharper**2 * uncertain * variance / n, 0.0))
    new = HistoryPlus(colors, frames, variances, new_drifts, changes, none, guides)
    return new, spreads, Fireflies(fireflies, float(cut.sum()), cut), repaired


def _least_second_difference(light: Any, taps: list[Any], near: list[tuple[Any, list[Any]]]) -> Any:
    """The least of (2 light - a - b)^2 [H, W] over the four pairs (a, b) of opposite neighbours on the same surface;
    inf where there is none."""
    xp = namespace(light)
    least = xp.full(light.shape, xp.inf)
    for n in range(4):
        both = near[n][0] & near[7 - n][0]
        least = xp.where(both, xp.minimum(least, (2.0 * light - taps[n] - taps[7 - n]) ** 2), least)
    return least


def _limited(color: Any, limit: Any) -> Any:
    xp = namespace(color)
    light = luminance(color)
    return color * xp.where(light > limit, limit / xp.where(light > limit, light, 1.0), 1.0)[..., None]


def _neighbours(illumination: list[Any], guides: Guides, normal_tolerance: float) -> list[tuple[Any, list[Any]]]:
    """For each of the eight pixels around: bool [H, W], it shows the same surface; and its illumination per signal."""
    result = []
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if (dx, dy) == (0, 0):
                continue
            inside, normal, object_id, *colors = tap(dx, dy, guides.normal, guides.object_id, *illumination)
            same = inside & guides.surface & (object_id == guides.object_id)
            same &= (normal * guides.normal).sum(axis=-1) >= normal_tolerance
            result.append((same, colors))
    return result


def _around(point: Reprojection, image: Any) -> Any:
    """The mean drift of nine pixels around the nearest one, whatever they show."""
    xp = namespace(image)
    height, width = image.shape
    x, y = xp.floor(point.x + 0.5).astype(int), xp.floor(point.y + 0.5).astype(int)
    steps = (-DRIFT_SPACING, 0, DRIFT_SPACING)
    taps = [image[xp.clip(y + dy, 0, height - 1), xp.clip(x + dx, 0, width - 1)] for dy in steps for dx in steps]
    return sum(taps) / len(taps)


def _read_sharply(point: Reprojection, color: Any) -> tuple[Any, Any]:
    """color [H, W, 3] at the point by Catmull-Rom, never beyond the inner four pixels; the variance [H, W] of the
    luminance of the pixels that are read."""
    xp = namespace(color)
    least, most = xp.full(color.shape, xp.inf), xp.full(color.shape, -xp.inf)
    total, mean, lights = 0.0, 0.0, []
    for at, share, is_inner in cubic_taps(point.x, point.y, catmull_rom):
        total, mean = total + share, mean + share[..., None] * color[at]
        lights.append(luminance(color[at]))
        if is_inner:
            least, most = xp.minimum(least, color[at]), xp.maximum(most, color[at])
    return xp.clip(mean / total[..., None], least, most), xp.stack(lights).var(axis=0)


def _read(point: Reprojection, history: HistoryPlus, radius: int) -> tuple[Any, tuple[list[Any], ...]]:
    """bool [H, W]: there is history; and its weighted means, per signal. Where it is found only farther away than in
    the 3x3 pixels around, up to the radius, it counts for 0 frames."""
    xp = namespace(point.x)
    height, width = point.x.shape
    images = [history.color, history.frames, history.variance, history.filtered]

    def mean(taps: Any) -> tuple[Any, list[list[Any]]]:
        weight = xp.zeros((height, width))
        sums = [[xp.zeros(image.shape) for image in kind] for kind in images]
        for column, row, share in taps:
            row, column = xp.clip(row, 0, height - 1), xp.clip(column, 0, width - 1)
            weight = weight + share
            for kind, totals in zip(images, sums, strict=True):
                for s, image in enumerate(kind):
                    totals[s] = totals[s] + (share[..., None] if image.ndim == 3 else share) * image[row, column]
        safe = xp.where(weight > 0.0, weight, 1.0)
        return weight, [[t / (safe[..., None] if t.ndim == 3 else safe) for t in totals] for totals in sums]

    weight, means = mean(point.bilinear())
    found = weight >= LEAST_TAP_WEIGHT
    spacing = 1
    while spacing <= radius:
        weight, others = mean(point.neighbours(spacing))
        if spacing > 1:
            others[1] = [xp.zeros((height, width)) for _ in history.frames]
        means = [
            [
                xp.where(found[..., None] if a.ndim == 3 else found, a, b)
                for a, b in zip(first, second, strict=True)
            ]
            for first, second in zip(means, others, strict=True)
        ]
        found = found | (weight > 0.0)
        spacing *= 2
    return found, tuple(means)
