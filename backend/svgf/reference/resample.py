# SPDX-License-Identifier: Apache-2.0
"""Stage "resample": the history of one image size as that of another. As native/denoise/resample.h."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from .antialias import Resolved
from .guides import Guides, namespace
from .temporal import History
from .temporal_plus import HistoryPlus

# Of a pixel's old ones, along an axis.
MOST_SAMPLES = 4
# Of the resolved picture: denoised frames follow.
MOST_RESOLVED_FRAMES = 8.0


def resample(history: History | HistoryPlus | Resolved, object_id: Any, width: int, height: int) -> Any:
    """Each pixel is the nearest one's; what is larger than the old pixels has the mean colour of those of the nearest
    one's object. Frames become as many fewer as pixels become smaller; one is left of any. object_id [H, W]: of the old
    pixels."""
    resampled = {each.name: _nearest(getattr(history, each.name), width, height) for each in fields(history)}
    for name in ("color", "filtered"):
        if name in resampled:
            resampled[name] = _mean(getattr(history, name), object_id, width, height)
    counts = "length" if isinstance(history, History) else "frames"
    old = getattr(history, counts)
    old_height, old_width = (old[0] if isinstance(old, list) else old).shape
    share = min(1.0, old_width * old_height / (width * height))
    resampled[counts] = _fewer(resampled[counts], share)
    if isinstance(history, Resolved):
        resampled[counts] = namespace(old).minimum(resampled[counts], MOST_RESOLVED_FRAMES)
    return replace(history, **resampled)


def _nearest(images: Any, width: int, height: int) -> Any:
    if isinstance(images, list):
        return [_nearest(image, width, height) for image in images]
    if isinstance(images, Guides):
        return Guides(*(_nearest(getattr(images, each.name), width, height) for each in fields(images)))
    rows, columns = (_places(images, count, axis, 0, 1) for axis, count in enumerate((height, width)))
    return images[rows[:, None], columns]


def _places(images: Any, count: int, axis: int, sample: int, samples: int) -> Any:
    """Along an axis, the old pixel in which a sample of each of `count` pixels lies."""
    places = namespace(images).arange(count) * samples + sample
    return (2 * places + 1) * images.shape[axis] // (2 * count * samples)


def _mean(images: Any, object_id: Any, width: int, height: int) -> Any:
    if isinstance(images, list):
        return [_mean(image, object_id, width, height) for image in images]
    columns, rows = (
        min(max(old // new, 1), MOST_SAMPLES) for old, new in ((images.shape[1], width), (images.shape[0], height))
    )
    centre = [_places(images, height, 0, 0, 1)[:, None], _places(images, width, 1, 0, 1)]
    total, count = images[tuple(centre)], 1
    for j in range(rows):
        for i in range(columns):
            at = [_places(images, height, 0, j, rows)[:, None], _places(images, width, 1, i, columns)]
            counts = object_id[tuple(at)] == object_id[tuple(centre)]
            counts &= (at[0] != centre[0]) | (at[1] != centre[1])
            total = total + images[tuple(at)] * (counts[..., None] if images.ndim == 3 else counts)
            count = count + counts
    return total / (count[..., None] if images.ndim == 3 and not isinstance(count, int) else count)


def _fewer(frames: Any, share: float) -> Any:
    if isinstance(frames, list):
        return [_fewer(each, share) for each in frames]
    xp = namespace(frames)
    return xp.maximum(frames * share, xp.minimum(frames, 1.0))
