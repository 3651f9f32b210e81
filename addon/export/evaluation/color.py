# SPDX-License-Identifier: GPL-3.0-or-later
"""The colour nodes: Mix, Hue/Saturation, Separate and Combine, ramps and curves, Blackbody, Wavelength.

Colours are linear Rec.709, [n, 3].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .arithmetic import safe_divide

_LUMINANCE = np.float32([0.2126390059, 0.7151686788, 0.0721923154])
_XYZ_TO_RGB = np.array(
    [[3.2409699, -1.5373832, -0.4986108], [-0.9692436, 1.8759675, 0.0415551], [0.0556301, -0.2039770, 1.0569715]]
)


def luminance(color: np.ndarray) -> np.ndarray:
    return color @ _LUMINANCE


def srgb_to_linear(color: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    low = color / np.float32(12.92)
    return np.where(color <= 0.04045, low, ((np.maximum(color, 0) + np.float32(0.055)) / np.float32(1.055)) ** 2.4)


def linear_to_srgb(color: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    high = np.float32(1.055) * np.maximum(color, 0) ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(color <= 0.0031308, color * np.float32(12.92), high)


def rgb_to_hsv(color: np.ndarray) -> np.ndarray:
    hue, value, delta = _hue(color)
    return np.stack([hue, safe_divide(delta, value), value], 1)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    hue, saturation, value = hsv.T
    return (1 + saturation[:, None] * (_pure(hue) - 1)) * value[:, None]


def rgb_to_hsl(color: np.ndarray) -> np.ndarray:
    hue, value, delta = _hue(color)
    lightness = np.minimum(1, value - delta / 2)
    span = np.where(lightness > 0.5, 2 - 2 * value + delta, 2 * value - delta)
    return np.stack([hue, safe_divide(delta, span), lightness], 1)


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    hue, saturation, lightness = hsl.T
    chroma = (1 - np.abs(2 * lightness - 1)) * saturation
    return (_pure(hue) - np.float32(0.5)) * chroma[:, None] + lightness[:, None]


def _hue(color: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hue in [0, 1), the largest channel, and its distance from the smallest."""
    r, g, b = color.T
    value = color.max(1)
    delta = value - color.min(1)
    sector = np.where(
        r == value,
        safe_divide(g - b, delta),
        np.where(g == value, 2 + safe_divide(b - r, delta), 4 + safe_divide(r - g, delta)),
    )
    hue = sector / 6
    return np.where(hue < 0, hue + 1, hue).astype(np.float32), value, delta


def _pure(hue: np.ndarray) -> np.ndarray:
    """[n, 3] the fully saturated colour."""
    h = hue[:, None] * 6
    bends = np.float32([3, 2, 4])
    return np.clip(np.float32([-1, 2, 2]) + np.float32([1, -1, -1]) * np.abs(h - bends), 0, 1)


def _overlay(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(a < 0.5, a * (1 - t + 2 * t * b), 1 - (1 - t + 2 * t * (1 - b)) * (1 - a))


def _dodge(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    rest = 1 - t * b
    return np.where(a == 0, 0, np.where(rest <= 0, 1, np.minimum(safe_divide(a, rest), 1)))


def _burn(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0, np.clip(1 - safe_divide(1 - a, rest), 0, 1))


def _hue_blend(t: np.ndarray, a: np.ndarray, b: np.ndarray, channels: tuple[int, ...]) -> np.ndarray:
    target = rgb_to_hsv(b)
    hsv = rgb_to_hsv(a)
    hsv = np.broadcast_to(hsv, np.broadcast_shapes(hsv.shape, target.shape)).copy()
    hsv[:, channels] = target[:, channels]
    return np.where(target[:, 1:2] != 0, a + t * (hsv_to_rgb(hsv) - a), a)


def _channel_blend(t: np.ndarray, a: np.ndarray, b: np.ndarray, channel: int) -> np.ndarray:
    first, second = rgb_to_hsv(a), rgb_to_hsv(b)
    shape = np.broadcast_shapes(first.shape, second.shape, t.shape)
    hsv = np.broadcast_to(first, shape).copy()
    hsv[:, channel] = (1 - t[:, 0]) * first[:, channel] + t[:, 0] * second[:, channel]
    mixed = hsv_to_rgb(hsv)
    return mixed if channel == 2 else np.where(first[:, 1:2] != 0, mixed, a)


def _soft(t: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    screen = 1 - (1 - b) * (1 - a)
    return (1 - t) * a + t * ((1 - a) * b * a + a * screen)


# Factor [n, 1], colours [n, 3].
_BLENDS: dict[str, Callable] = {
    "MIX": lambda t, a, b: a + t * (b - a),
    "ADD": lambda t, a, b: a + t * b,
    "SUBTRACT": lambda t, a, b: a - t * b,
    "MULTIPLY": lambda t, a, b: a + t * (a * b - a),
    "SCREEN": lambda t, a, b: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "DIVIDE": lambda t, a, b: np.where(b != 0, (1 - t) * a + t * safe_divide(a, b), a),
    "DIFFERENCE": lambda t, a, b: a + t * (np.abs(a - b) - a),
    "EXCLUSION": lambda t, a, b: np.maximum(a + t * (b - 2 * a * b), 0),
    "DARKEN": lambda t, a, b: a + t * (np.minimum(a, b) - a),
    "LIGHTEN": lambda t, a, b: a + t * (np.maximum(a, b) - a),
    "OVERLAY": _overlay,
    "DODGE": _dodge,
    "BURN": _burn,
    "SOFT_LIGHT": _soft,
    "LINEAR_LIGHT": lambda t, a, b: a + t * (2 * b - 1),
    "HUE": lambda t, a, b: _hue_blend(t, a, b, (0,)),
    "COLOR": lambda t, a, b: _hue_blend(t, a, b, (0, 1)),
    "SATURATION": lambda t, a, b: _channel_blend(t, a, b, 1),
    "VALUE": lambda t, a, b: _channel_blend(t, a, b, 2),
}


def mix_color(
    factor: np.ndarray, a: np.ndarray, b: np.ndarray, *, blend: str, clamp_factor: bool, clamp_result: bool
) -> np.ndarray:
    factor = np.clip(factor, 0, 1) if clamp_factor else factor
    result = _BLENDS[blend](factor[:, None], a, b)
    return np.clip(result, 0, 1) if clamp_result else result


def mix(factor: np.ndarray, a: np.ndarray, b: np.ndarray, *, clamp_factor: bool) -> np.ndarray:
    """Numbers or vectors, with a factor for all components or one for each."""
    factor = np.clip(factor, 0, 1) if clamp_factor else factor
    factor = factor[:, None] if factor.ndim < a.ndim else factor
    return a * (1 - factor) + b * factor


def hue_saturation(
    hue: np.ndarray, saturation: np.ndarray, value: np.ndarray, factor: np.ndarray, color: np.ndarray
) -> np.ndarray:
    h, s, v = rgb_to_hsv(color).T
    h = h + hue + np.float32(0.5)
    parts = np.broadcast_arrays(h - np.floor(h), np.clip(s * saturation, 0, 1), v * value)
    changed = hsv_to_rgb(np.stack(parts, 1))
    return np.maximum(color + factor[:, None] * (changed - color), 0)


def invert(factor: np.ndarray, color: np.ndarray) -> np.ndarray:
    return color + factor[:, None] * (1 - 2 * color)


def gamma(color: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    exponent = exponent[:, None]
    raised = np.where(color > 0, np.power(np.maximum(color, 1e-30), exponent), color)
    return np.where(exponent == 0, 1, raised)


def brightness_contrast(color: np.ndarray, brightness: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    return np.maximum((1 + contrast)[:, None] * color + (brightness - contrast / 2)[:, None], 0)


def separate(color: np.ndarray, *, mode: str) -> np.ndarray:
    """[n, 3] in the colour model of the mode: HSV or HSL."""
    return {"HSV": rgb_to_hsv, "HSL": rgb_to_hsl}[mode](color)


def combine(first: np.ndarray, second: np.ndarray, third: np.ndarray, *, mode: str) -> np.ndarray:
    parts = np.stack(np.broadcast_arrays(first, second, third), 1)
    return {"RGB": lambda c: c, "HSV": hsv_to_rgb, "HSL": hsl_to_rgb}[mode](parts)


def ramp(factor: np.ndarray, *, table: np.ndarray, interpolate: bool) -> np.ndarray:
    """table: [k, c] over [0, 1]; c = 3 gives a colour, c = 1 a number."""
    position = np.clip(np.nan_to_num(factor), 0, 1) * (len(table) - 1)
    index = np.minimum(position.astype(np.int64), len(table) - 1)
    result = table[index]
    if interpolate:
        share = (position - index)[:, None].astype(np.float32)
        result = result + share * (table[np.minimum(index + 1, len(table) - 1)] - result)
    return result[:, 0] if table.shape[1] == 1 else result


def curves(
    factor: np.ndarray, value: np.ndarray, *, table: np.ndarray, low: float, high: float, extrapolate: bool
) -> np.ndarray:
    """Each channel through its column of the table [k, c], which spans [low, high]."""
    columns = value[:, None] if value.ndim == 1 else value
    places = (columns - np.float32(low)) / np.float32(max(high - low, 1e-8))
    span, last = np.float32(len(table) - 1), len(table) - 1
    result = []
    for channel, place in enumerate(places.T):
        entries = table[:, channel : channel + 1]
        curve = ramp(place, table=entries, interpolate=True)
        if extrapolate:
            below, above = entries[0, 0] - entries[1, 0], entries[last, 0] - entries[last - 1, 0]
            curve = curve + np.maximum(-place, 0) * span * below + np.maximum(place - 1, 0) * span * above
        result.append(curve)
    curve = result[0] if value.ndim == 1 else np.stack(result, 1)
    share = factor if value.ndim == 1 else factor[:, None]
    return value + share * (curve - value)


# CIE 1931 colour matching functions, X Y Z from 380 to 780 nm in steps of 10 nm [CIE15].
_MATCHING = np.array(
    """
    .0014 .0000 .0065  .0042 .0001 .0201  .0143 .0004 .0679  .0435 .0012 .2074  .1344 .0040 .6456  .2839 .0116 1.3856
    .3483 .0230 1.7471 .3362 .0380 1.7721 .2908 .0600 1.6692 .1954 .0910 1.2876 .0956 .1390 .8130  .0320 .2080 .4652
    .0049 .3230 .2720  .0093 .5030 .1582  .0633 .7100 .0782  .1655 .8620 .0422  .2904 .9540 .0203  .4334 .9950 .0087
    .5945 .9950 .0039  .7621 .9520 .0021  .9163 .8700 .0017 1.0263 .7570 .0011 1.0622 .6310 .0008 1.0026 .5030 .0003
    .8544 .3810 .0002  .6424 .2650 .0000  .4479 .1750 .0000  .2835 .1070 .0000  .1649 .0610 .0000  .0874 .0320 .0000
    .0468 .0170 .0000  .0227 .0082 .0000  .0114 .0041 .0000  .0058 .0021 .0000  .0029 .0010 .0000  .0014 .0005 .0000
    .0007 .0002 .0000  .0003 .0001 .0000  .0002 .0001 .0000  .0001 .0000 .0000  .0000 .0000 .0000
    """.split(),
    np.float64,
).reshape(-1, 3)


def _color_matching(wavelength: np.ndarray) -> np.ndarray:
    """[n, 3] of wavelengths in nm."""
    nanometres = 380 + 10 * np.arange(len(_MATCHING))
    return np.stack([np.interp(wavelength, nanometres, column) for column in _MATCHING.T], -1)


def wavelength(value: np.ndarray) -> np.ndarray:
    visible = (value >= 380) & (value < 780)
    color = np.maximum(_color_matching(value) @ _XYZ_TO_RGB.T / 2.52, 0)
    return np.where(visible[:, None], color, 0).astype(np.float32)


def blackbody(temperature: np.ndarray) -> np.ndarray:
    """Planck's spectrum at luminance 1; Blender's range is 800 to 12000 K."""
    kelvin = np.clip(np.asarray(temperature, np.float64), 800, 12000)[:, None]
    nanometres = np.arange(380, 781, 5.0)
    radiance = nanometres**-5 / np.expm1(1.438777e7 / (nanometres * kelvin))
    xyz = radiance @ _color_matching(nanometres)
    rgb = (xyz / xyz[:, 1:2]) @ _XYZ_TO_RGB.T
    return np.maximum(rgb, 0).astype(np.float32)
