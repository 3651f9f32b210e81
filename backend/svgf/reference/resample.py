# SPDX-License-Identifier: Apache-2.0
"""Stage "resample": the history of one image size as that of another. As native/denoise/resample.h."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from .antialias import Resolved
from .guides import Guides, namespace
from .temporal import History
from .temporal_plus import HistoryPlus


def resample(history: History | HistoryPlus | Resolved, width: int, height: int) -> Any:
    """Each pixel is the nearest one's, whole. Frames become as many fewer as pixels become smaller; one is left of
    any."""
    resampled = {each.name: _nearest(getattr(history, each.name), width, height) for each in fields(history)}
    counts = "length" if isinstance(history, History) else "frames"
    old = getattr(history, counts)
    old_height, old_width = (old[0] if isinstance(old, list) else old).shape
    share = min(1.0, old_width * old_height / (width * height))
    resampled[counts] = _fewer(resampled[counts], share)
    return replace(history, **resampled)


def _nearest(images: Any, width: int, height: int) -> Any:
    if isinstance(images, list):
        return [_nearest(image, width, height) for image in images]
    if isinstance(images, Guides):
        return Guides(*(_nearest(getattr(images, each.name), width, height) for each in fields(images)))
    xp = namespace(images)
    rows, columns = (
        (2 * xp.arange(count) + 1) * old_count // (2 * count)
        for count, old_count in zip((height, width), images.shape[:2], strict=True)
    )
    return images[rows[:, None], columns]


def _fewer(frames: Any, share: float) -> Any:
    if isinstance(frames, list):
        return [_fewer(each, share) for each in frames]
    xp = namespace(frames)
    return xp.maximum(frames * share, xp.minimum(frames, 1.0))
