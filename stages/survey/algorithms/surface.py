"""How bright two cameras see the same surface points, of the subject or of what stands around: features that both show,
along the calibration's lines; where there are too few, points of the visual hull of given masks that both see.

A matte surface sends the same light to every camera. Points that glint, are nearly black or touch what is clipped are
left out; what is left of gloss, wrong matches and blur are errors, whose spread `exposure.match` counts.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import cv2
import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.features import Features, features, matched
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.color import to_display, to_linear
from posegaussian.stages.imaging.exposure import FEWEST_POINTS, NONE
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.shared_points import shared_points
from posegaussian.stages.survey.algorithms.look import KEPT_PICTURES, Look
from posegaussian.stages.survey.algorithms.sample import compared_numbers
from posegaussian.stages.survey.algorithms.silhouettes import masks_of
from posegaussian.storage.model.cameras import points_to_integer_centres

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
"""Stops by which all channels of a pixel near a point exceed the point: a highlight, which is elsewhere for another
camera."""
NEAR = 2.0
"""Radius, over the blur's, within which a point's surroundings count."""
ANGLE = 75.0
"""Degrees between two cameras, seen from the subject, up to which they are compared by points of the hull."""
BLUR = 0.008
"""Blur, as a share of the longer side, under which points of the hull are compared: it lies outside the surface."""
BRIGHT = 1.5
"""Stops below the brightest of such points down to which they count: what is dark beside them is mostly gloss."""
TONES = 0.7
"""Stops between the medians of the darkest and the brightest third of a pair's points: what is brighter at a single
tone may be gloss or haze."""
TONES_OF_HULL = 0.25
"""The same of points of the hull, of which there are only bright ones."""


class Seen(NamedTuple):
    """What is compared of a captured picture."""

    light: np.ndarray
    """[n, 3] linear light around the features; 0 where nearly black or clipped."""
    features: Features
    """In px of the reduced picture."""
    scale: float
    """Reduced px per captured px."""


class Shared(NamedTuple):
    """Features that two pictures share."""

    pairs: np.ndarray
    """[n, 2] indices of the features."""
    pixels: tuple[np.ndarray, np.ndarray]
    """[n, 2] px of the rig, of each picture."""
    mapped: np.ndarray
    """[n] bool: whether the lens could be undone at both."""


_KEPT: OrderedDict[str, Seen] = OrderedDict()
_MATCHED: OrderedDict[tuple[str, str], np.ndarray] = OrderedDict()
KEPT_MATCHES = 256
"""Pairs of pictures whose matches a process keeps for the other measures of a view."""


class SurfaceLook(Look):
    """survey/surface [V, 64, 3] of one view: `surface_stops`, its own pictures taken from the view's pass."""

    def __init__(self, inputs: Inputs, view: int, sample: np.ndarray) -> None:
        """sample: the view's sampled source frames, those with somebody."""
        self._inputs, self._view, self._sample = inputs, view, sample
        self._own: dict[int, Seen] = {}
        self.numbers = compared_numbers(sample) if later(inputs, view) else np.zeros(0, np.int64)

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Features of one frame."""
        found = seen(self._inputs, self._view, number, shown)
        if found is not None:
            self._own[number] = found

    def blocks(self) -> Iterator[Block]:
        """Compared with the later views."""
        yield Block("survey/surface", surface_stops(self._inputs, self._view, self._sample, self._own), self._view)


def later(inputs: Inputs, view: int) -> list[int]:
    """Source views behind a source view: each pair is compared once."""
    return [v for v in inputs.views.sources if v > view] if view in inputs.views.sources else []


def surface_stops(
    inputs: Inputs, view: int, numbers: np.ndarray, known: Mapping[int, Seen] | None = None
) -> np.ndarray:
    """[V, 64, 3] float32: stops by which a source view is brighter than each later one at surface points that both
    show.

    Of a few of the sampled source frames `numbers` [n]; 99 where there is no point. Points are in the order of tone,
    the darkest first; of more than 64 those are kept that lie evenly in it. A pair whose points hardly differ in tone
    has none.
    `known`: what is known of the view's own pictures, by frame; what is not is looked at.
    """
    out = np.full((len(inputs.rig), POINTS, 3), NONE, dtype=np.float32)
    others, chosen = later(inputs, view), compared_numbers(numbers)
    found: dict[int, list[np.ndarray]] = {v: [] for v in others}
    for number in chosen if others else ():
        own = (known or {}).get(int(number)) or seen(inputs, view, int(number))
        for v in others:
            other = seen(inputs, v, int(number)) if own is not None else None
            if own is not None and other is not None:
                found[v].append(_shared_light(inputs, (view, v), int(number), own, other))
    stops = {v: _even_in_tone(np.concatenate([np.zeros((0, 2, 3)), *parts])) for v, parts in found.items()}
    without = [v for v in others if len(stops[v]) < FEWEST_POINTS]
    if without and MASKS in inputs.facts:
        light_of_hull = _hull_light(inputs, view, without, chosen)
        of_hull = {v: _even_in_tone(light, TONES_OF_HULL) for v, light in light_of_hull.items()}
        stops |= {v: told for v, told in of_hull.items() if len(told) > len(stops[v])}
    for v, known_stops in stops.items():
        out[v, : len(known_stops)] = known_stops
    return out


def _even_in_tone(light: np.ndarray, tones: float = TONES) -> np.ndarray:
    """[n, 3] stops between two cameras at at most `POINTS` of some points [m, 2, 3] of which `light` is the logarithm
    to base 2: the darkest first, evenly in tone, and none of points whose thirds differ by less than `tones` in it."""
    tone = light.mean(axis=(1, 2))
    order, third = np.argsort(tone, kind="stable"), (len(light) + 2) // 3
    if not len(light) or np.median(tone[order[-third:]]) - np.median(tone[order[:third]]) < tones:
        return np.zeros((0, 3))
    kept = order[np.unique(np.rint(np.linspace(0, len(light) - 1, POINTS)).astype(int))]
    return np.asarray(light[kept, 0] - light[kept, 1])


def _hull_light(inputs: Inputs, view: int, others: list[int], numbers: np.ndarray) -> dict[int, np.ndarray]:
    """{other view: [n, 2, 3] logarithm to base 2 of the light of a view and of that one at points of the hull}, of some
    source frames, by the masks that came with the capture."""
    rig, warps = inputs.rig, dict[int, Warp]()
    found: dict[int, list[np.ndarray]] = {v: [np.zeros((0, 2, 3))] for v in others}
    for number in map(int, numbers):
        masks = masks_of(inputs, number, warps)
        views = sorted(masks)
        centre = look_at_point(rig.subset(views)) if views else np.zeros(3)
        near = [v for v in others if v in masks and _angle(rig.centres[[view, v]] - centre) <= ANGLE]
        if view not in masks or not near:
            continue
        silhouettes = Silhouettes.of(rig, masks, centre, searched_radius(rig, views, centre))
        blur = BLUR * float(rig.size[view].max())
        inner = {v: _inner(masks[v], blur) for v in (view, *near)}
        shown = {v: _warped(inputs, v, number, warps[v]) for v in inner}
        for v in near:
            points = shared_points(rig, (view, v), inner, silhouettes)
            light = np.stack([colors_at(shown[w], p, blur) for w, p in zip((view, v), points, strict=True)], axis=1)
            found[v].append(np.log2(light[(light > 0).all(axis=(1, 2))]))
    return {v: _bright(np.concatenate(parts)) for v, parts in found.items()}


def _angle(to: np.ndarray) -> float:
    """Degrees between two directions [2, 3]."""
    first, second = to / np.linalg.norm(to, axis=1, keepdims=True)
    return float(np.degrees(np.arccos(np.clip(first @ second, -1.0, 1.0))))


def _inner(mask: np.ndarray, blur: float) -> np.ndarray:
    """[h, w] bool: pixels whose blurred colour has nothing of what is beside a mask [h, w] uint8."""
    return cv2.erode((mask == 255).astype(np.uint8), np.ones((2 * round(NEAR * blur) + 1,) * 2, np.uint8)) > 0


def _warped(inputs: Inputs, view: int, number: int, warp: Warp) -> np.ndarray:
    """[h, w, 3] uint8 a view's picture of a source frame in pixels of the rig."""
    (picture,) = inputs.source("pictures").read(view, [number])
    return warp(to_display(picture))


def _bright(light: np.ndarray) -> np.ndarray:
    """Those points [n, 2, 3] that are about as bright as the brightest."""
    tone = light.mean(axis=(1, 2))
    return light[tone >= np.percentile(tone, 95) - BRIGHT] if len(light) else light


def seen(inputs: Inputs, view: int, number: int, shown: np.ndarray | None = None) -> Seen | None:
    """A view's picture, decoded unless it is `shown` [h, w, 3] uint8 or this process has seen it; None where the view
    has no such frame."""
    pictures = inputs.source("pictures")
    if number not in pictures.numbers(view):
        return None
    identity = pictures.identity(view, number)
    if identity in _KEPT:
        return _KEPT[identity]
    if shown is None:
        (picture,) = pictures.read(view, [number])
        shown = to_display(picture)
    return keep(identity, shown)


def shared(inputs: Inputs, views: tuple[int, int], number: int, first: Seen, second: Seen) -> Shared:
    """Features that two views' pictures of a source frame share."""
    pictures = inputs.source("pictures")
    key = pictures.identity(views[0], number), pictures.identity(views[1], number)
    if key not in _MATCHED:
        _MATCHED[key] = matched(first.features, second.features)
    while len(_MATCHED) > KEPT_MATCHES:
        _MATCHED.popitem(last=False)
    pairs = _MATCHED[key]
    pixels, mapped = [], np.ones(len(pairs), bool)
    for i, (v, picture) in enumerate(zip(views, (first, second), strict=True)):
        at = picture.features.points[pairs[:, i]] / picture.scale
        found, known = to_frames(at, inputs.captured_to_calibrated[v], inputs.source_rig, inputs.rig, v)
        pixels.append(found)
        mapped &= known
    return Shared(pairs, (pixels[0], pixels[1]), mapped)


def keep(identity: str, shown: np.ndarray) -> Seen:
    """Features of a captured picture [h, w, 3] uint8, reduced; kept for whoever asks for the same picture next in
    this process."""
    if identity not in _KEPT:
        scale = min(1.0, LONGEST / max(shown.shape[:2]))
        small = (
            cv2.resize(
                shown, (round(shown.shape[1] * scale), round(shown.shape[0] * scale)), interpolation=cv2.INTER_AREA
            )
            if scale < 1
            else shown
        )
        found = features(small, np.full(small.shape[:2], 255, np.uint8))
        _KEPT[identity] = Seen(colors_at(small, found.points), found, small.shape[1] / shown.shape[1])
    while len(_KEPT) > KEPT_PICTURES:
        _KEPT.popitem(last=False)
    return _KEPT[identity]


def _shared_light(inputs: Inputs, views: tuple[int, int], number: int, own: Seen, other: Seen) -> np.ndarray:
    """[n, 2, 3] logarithm to base 2 of the light of two cameras at the features they share."""
    both = shared(inputs, views, number, own, other)
    off = np.abs(signed_epipolar_distance(fundamental(inputs.rig, *views), *both.pixels))
    right = both.mapped & (off <= BESIDE * inputs.rig.size[list(views)].max())
    light = [picture.light[both.pairs[right, i]] for i, picture in enumerate((own, other))]
    lit = (light[0] > 0).all(axis=1) & (light[1] > 0).all(axis=1)
    return np.log2(np.stack([light[0][lit], light[1][lit]], axis=1))


def colors_at(picture: np.ndarray, points: np.ndarray, blur: float = 3.0) -> np.ndarray:
    """Colours [n, 3] in linear light around points [n, 2] px of [h, w, 3] uint8; 0 where nearly black, or beside
    what is clipped or glints."""
    at = np.rint(points_to_integer_centres(points)).astype(int)
    at = np.clip(at, 0, np.array(picture.shape[1::-1]) - 1)
    around = np.ones((2 * round(NEAR * blur) + 1,) * 2, np.uint8)
    sampled, brightest = (
        p[at[:, 1], at[:, 0]].astype(np.float64)
        for p in (cv2.GaussianBlur(picture, (0, 0), blur), cv2.dilate(picture, around))
    )
    exposed = ((sampled >= DARKEST) & (brightest < CLIPPED)).all(axis=1)
    light = to_linear(sampled)
    glints = (to_linear(brightest) > np.exp2(GLINT) * light).all(axis=1)
    return np.where((exposed & ~glints)[:, None], light, 0.0)
