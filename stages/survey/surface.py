"""How bright two cameras see the same surface points, of the subject or of what stands around: features that both show, along the calibration's lines.

A matte surface sends the same light to every camera. Points that glint, are nearly black or touch what is clipped are left out;
what is left of gloss, wrong matches and blur are errors, whose spread `exposure.match` counts.
"""

from __future__ import annotations

import cv2
import numpy as np

from stages.frames.display import to_display, to_linear
from stages.geometry.epipolar import fundamental, signed_epipolar_distance
from stages.geometry.features import Features, features, matched
from stages.io import Inputs
from stages.pose.points import to_frames
from stages.survey.params import NONE
from storage.rig import points_to_integer_centres

FRAMES = 2
"""Sampled frames that are matched."""
LONGEST = 960
"""Longer side, px, to which pictures are reduced before they are matched."""
BESIDE = 0.004
"""Distance of a right match from the calibration's line, as a share of the longer side."""
POINTS = 64
"""Points kept of a pair of cameras."""
DARKEST = 32
"""sRGB value below which a step of 1/255, a reflection or a lens's haze is a tenth of a stop and more."""
CLIPPED = 250
"""sRGB value from which on a pixel may have been brighter: nothing near a point may be."""
GLINT = 2.0
"""Stops by which all channels of a pixel near a point exceed the point: a highlight, which is elsewhere for another camera."""
NEAR = 2.0
"""Radius, over the blur's, within which a point's surroundings count."""
TONES = 0.7
"""Stops between the medians of the darkest and the brightest third of a pair's points: what is brighter at a single tone may be gloss or haze."""


def surface_stops(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """[V, 64, 3] float32: stops by which a source view is brighter than each later one at surface points that both show.

    Of a few of the sampled source frames `numbers` [n]; 99 where there is no point. Points are in the order of tone, the darkest first;
    of more than 64 those are kept that lie evenly in it. A pair whose points hardly differ in tone has none.
    """
    out = np.full((len(inputs.rig), POINTS, 3), NONE, dtype=np.float32)
    later = [v for v in inputs.views.sources if v > view] if view in inputs.views.sources else []
    chosen = np.asarray(numbers)[np.unique(np.rint(np.linspace(0, len(numbers) - 1, FRAMES + 2)[1:-1]).astype(int))] if len(numbers) else ()
    found: dict[int, list[np.ndarray]] = {v: [] for v in later}
    for number in chosen if later else ():
        own = _seen(inputs, view, int(number))
        for v in later:
            other = _seen(inputs, v, int(number)) if own is not None else None
            if own is not None and other is not None:
                found[v].append(_shared_light(inputs, (view, v), own, other))
    for v, parts in found.items():
        light = np.concatenate(parts) if parts else np.zeros((0, 2, 3))
        tone = light.mean(axis=(1, 2))
        order = np.argsort(tone, kind="stable")
        if len(light) and np.median(tone[order[-(len(light) + 2) // 3 :]]) - np.median(tone[order[: (len(light) + 2) // 3]]) >= TONES:
            kept = order[np.unique(np.rint(np.linspace(0, len(light) - 1, POINTS)).astype(int))]
            out[v, : len(kept)] = light[kept, 0] - light[kept, 1]
    return out


def _seen(inputs: Inputs, view: int, number: int) -> tuple[np.ndarray, Features, float] | None:
    """A captured picture, reduced, its features in reduced px, and the factor; None where the view has no such frame."""
    pictures = inputs.source("pictures")
    if number not in pictures.numbers(view):
        return None
    (picture,) = pictures.read(view, [number])
    shown = to_display(picture)
    scale = min(1.0, LONGEST / max(shown.shape[:2]))
    small = cv2.resize(shown, (round(shown.shape[1] * scale), round(shown.shape[0] * scale)), interpolation=cv2.INTER_AREA) if scale < 1 else shown
    return small, features(small, np.full(small.shape[:2], 255, np.uint8)), small.shape[1] / shown.shape[1]


def _shared_light(inputs: Inputs, views: tuple[int, int], own: tuple[np.ndarray, Features, float], other: tuple[np.ndarray, Features, float]) -> np.ndarray:
    """[n, 2, 3] logarithm to base 2 of the light of two cameras at the features they share."""
    pairs = matched(own[1], other[1])
    points = [seen[1].points[pairs[:, i]] for i, seen in enumerate((own, other))]
    ideal, known = [], np.ones(len(pairs), bool)
    for v, at, (_, _, scale) in zip(views, points, (own, other), strict=True):
        pixels, mapped = to_frames(at / scale, inputs.captured_to_calibrated[v], inputs.source_rig, inputs.rig, v)
        ideal.append(pixels)
        known &= mapped
    off = np.abs(signed_epipolar_distance(fundamental(inputs.rig, *views), *ideal))
    right = known & (off <= BESIDE * inputs.rig.size[list(views)].max())
    light = [colors_at(seen[0], at[right]) for seen, at in zip((own, other), points, strict=True)]
    both = (light[0] > 0).all(axis=1) & (light[1] > 0).all(axis=1)
    return np.log2(np.stack([light[0][both], light[1][both]], axis=1))


def colors_at(picture: np.ndarray, points: np.ndarray, blur: float = 3.0) -> np.ndarray:
    """Colours [n, 3] in linear light around points [n, 2] px of [h, w, 3] uint8; 0 where nearly black, or beside what is clipped or glints."""
    at = np.rint(points_to_integer_centres(points)).astype(int)
    at = np.clip(at, 0, np.array(picture.shape[1::-1]) - 1)
    around = np.ones((2 * round(NEAR * blur) + 1,) * 2, np.uint8)
    sampled, brightest = (p[at[:, 1], at[:, 0]].astype(np.float64) for p in (cv2.GaussianBlur(picture, (0, 0), blur), cv2.dilate(picture, around)))
    exposed = ((sampled >= DARKEST) & (brightest < CLIPPED)).all(axis=1)
    light = to_linear(sampled)
    glints = (to_linear(brightest) > np.exp2(GLINT) * light).all(axis=1)
    return np.where((exposed & ~glints)[:, None], light, 0.0)
