"""How captured pixels become calibrated ones where the sizes differ: plain scaling, or black bars around the scaled
picture.

Bars are measured: rows and columns that stay dark in several frames while the picture begins beside them with a step.
They count where they explain both sizes at once; a dark scene has no step, and what is left open is refused, not
guessed.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from posegaussian.storage.importers.common import whole_scale
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.crop import Crop, crop_settings
from posegaussian.storage.model.errors import CalibrationError
from posegaussian.storage.readers.sources import open_source
from posegaussian.storage.readers.video import VideoFile

LOOKED_AT = 7
"""Frames of a camera in which bars are looked for."""
DARK = (40, 64)
"""Of 255, what three quarters and 98 in 100 pixels of a bar's row stay below: codecs let the picture beside it ring
in (balance: 35 and 52)."""
STEP = 24
"""Of 255, by which the picture beside a bar is brighter than the bar,
or it is no bar that can be told from a dark scene."""
EDGE = 1.25
"""Captured px by which a measured edge may lie beside the one that the sizes lead to: a whole row, and the fraction
that scaling leaves."""
SAME = 0.5
"""Calibrated px anywhere in the picture below which two explanations are one."""

Size = tuple[int, int]


class Bar(NamedTuple):
    """One side of every picture that was looked at."""

    dark: int
    """Rows or columns that are always dark."""
    clear: bool
    """Whether the picture begins beside them with a step, so that they are bars and no dark part of the scene."""


class Border(NamedTuple):
    """The four sides."""

    left: Bar
    top: Bar
    right: Bar
    bottom: Bar


class Fit(NamedTuple):
    """One explanation of two sizes."""

    crop: Crop
    how: str
    """For a sentence: what was done to the picture, and how that is known."""


def fitted(capture: Capture, given: Mapping[str, Crop]) -> Capture:
    """The capture with the crop of every camera whose pictures have not the calibrated size: the given one, else what
    its pictures show.

    Raises CalibrationError for crops of no camera, and, with settings to copy, where the pictures do not tell how the
    sizes relate.
    """
    rig = capture.rig
    unknown = [n for n in given if n not in rig.names]
    if unknown:
        raise CalibrationError(
            f"frames.crop names {', '.join(unknown)}, but the cameras are {', '.join(rig.names)}; correct the name, or"
            " move it below sequences: NAME: frames: crop"
        )
    found: dict[str, Fit] = {}
    faults: list[str] = []
    open_crops: dict[str, list[Fit]] = {}
    for v, (name, stream) in enumerate(zip(rig.names, capture.pictures, strict=True)):
        calibrated = (int(rig.size[v, 0]), int(rig.size[v, 1]))
        if name in given or tuple(stream.size) == calibrated:
            continue
        pictures = open_source(capture, "pictures")
        border = measured(pictures.read(v, spread(stream.numbers)))
        fits = explanations(calibrated, stream.size, border)
        if len(fits) == 1:
            found[name] = fits[0]
            continue
        what, guesses = _not_square(stream) or _left_open(calibrated, stream.size, border, fits)
        faults.append(
            f"camera {name}: pictures are {_size(stream.size)} px,"
            f" the calibration is for {_size(calibrated)} px; {what}"
        )
        if guesses:
            open_crops[name] = guesses
    if faults:
        raise CalibrationError("\n".join([*faults, *(_settings(open_crops) if open_crops else [])]))
    crops = {n: given[n] if n in given else found[n].crop for n in rig.names if n in given or n in found}
    return replace(capture, crops=crops, notes=(*capture.notes, *_notes(capture, found)))


def spread(numbers: Sequence[int]) -> list[int]:
    """LOOKED_AT frame numbers from the first to the last."""
    return [numbers[i] for i in np.unique(np.linspace(0, len(numbers) - 1, LOOKED_AT).round().astype(int))]


def measured(pictures: Iterable[np.ndarray]) -> Border:
    """The border of pictures [h, w, 3] of one camera, uint8 or float 0..1;
    columns are judged in those rows that are no bars."""
    shown = [_brightness(p) for p in pictures]
    top, bottom = _bars(shown, axis=1)
    height = len(shown[0])
    rows = slice(top.dark, height - bottom.dark) if top.dark + bottom.dark < height else slice(height)
    left, right = _bars([s[rows] for s in shown], axis=0)
    return Border(left, top, right, bottom)


def explanations(calibrated: Size, captured: Size, border: Border) -> list[Fit]:
    """What agrees with both sizes and the border: none, one, or several that differ by SAME and more."""
    out: list[Fit] = []
    for fit in (
        _scaled(calibrated, captured),
        _letterboxed(calibrated, captured, border) or _framed(calibrated, captured, border),
    ):
        if fit is not None and all(_apart(fit.crop, other.crop, captured) >= SAME for other in out):
            out.append(fit)
    return out


def _brightness(picture: np.ndarray) -> np.ndarray:
    """[h, w] the brightest channel, 0..255."""
    brightest = picture.max(axis=2)
    return brightest if brightest.dtype == np.uint8 else np.clip(brightest.astype(np.float32), 0, 1) * 255


def _bars(shown: Sequence[np.ndarray], axis: int) -> tuple[Bar, Bar]:
    """The bars before and behind along the rows (axis 1 is summed up) or columns (axis 0) of all frames together."""
    most = np.max([np.percentile(s, 75, axis=axis) for s in shown], axis=0)
    nearly_all = np.max([np.percentile(s, 98, axis=axis) for s in shown], axis=0)
    dark = (most <= DARK[0]) & (nearly_all <= DARK[1])
    return _bar(most, dark), _bar(most[::-1], dark[::-1])


def _bar(level: np.ndarray, dark: np.ndarray) -> Bar:
    """The bar at the first entries; where the picture rings into it, its edge is where brightness has come half way."""
    count = len(dark) if dark.all() else int(np.argmin(dark))
    if count in (0, len(dark)):
        return Bar(count, False)
    inside, outside = (
        float(np.median(level[:count])),
        (float(np.median(level[count + 2 : count + 8])) if count + 2 < len(level) else 0.0),
    )
    edge = count
    while edge < min(count + 3, len(level)) and level[edge] < (inside + outside) / 2:
        edge += 1
    return Bar(edge, outside - inside >= STEP and edge < count + 3)


def _scaled(calibrated: Size, captured: Size) -> Fit | None:
    """The whole picture, scaled, where the shapes agree to a pixel."""
    scale = whole_scale(captured, calibrated)
    if scale is None:
        return None
    return Fit(
        _centred(calibrated, captured, scale), f"the same shape, so the whole picture is taken as {_ratio(scale)}"
    )


def _letterboxed(calibrated: Size, captured: Size, border: Border) -> Fit | None:
    """The calibrated picture scaled to fit in, bars of equal breadth at two sides: one of them must be seen, none
    may be contradicted."""
    (w, h), (cw, ch) = calibrated, captured
    scale = max(w / cw, h / ch)
    upright = ch - h / scale > cw - w / scale
    expected = max(ch - h / scale, cw - w / scale) / 2
    sides = (border.top, border.bottom) if upright else (border.left, border.right)
    seen = [s for s in sides if s.clear and abs(s.dark - expected) <= EDGE]
    if expected <= SAME or not seen or any(s.dark < expected - EDGE for s in sides):
        return None
    words = ("rows above", "rows below") if upright else ("columns at the left", "columns at the right")
    told = " and ".join(f"{s.dark} black {what}" for s, what in zip(sides, words, strict=True) if s in seen)
    return Fit(
        _centred(calibrated, captured, scale),
        f"{_ratio(scale)} and letterboxed: {told} are always dark,"
        f" where this leaves {expected:.1f} at each of the two sides",
    )


def _framed(calibrated: Size, captured: Size, border: Border) -> Fit | None:
    """The calibrated picture, scaled or not, inside bars of any breadth, each of which is seen."""
    if not any(s.dark for s in border) or any(s.dark and not s.clear for s in border):
        return None
    (w, h), (cw, ch) = calibrated, captured
    inner = (cw - border.left.dark - border.right.dark, ch - border.top.dark - border.bottom.dark)
    if min(inner) < 1:
        return None
    # An edge between bars is known to a pixel or so; a side without bars is exact, and the longer one is known best.
    exact = [not (border.left.dark or border.right.dark), not (border.top.dark or border.bottom.dark)]
    across = exact[0] if exact[0] != exact[1] else inner[0] >= inner[1]
    scale = w / inner[0] if across else h / inner[1]
    if abs(scale - round(scale)) * max(inner) < EDGE * max(1.0, scale):
        scale = float(max(1, round(scale)))
    over = np.array([w - scale * inner[0], h - scale * inner[1]])
    if np.abs(over).max() > 2 * EDGE * max(1.0, scale):
        return None
    offset = over / 2 - scale * np.array([border.left.dark, border.top.dark])
    bars = ", ".join(
        f"{s.dark} {what}"
        for s, what in zip(border, ("at the left", "above", "at the right", "below"), strict=True)
        if s.dark
    )
    return Fit(
        Crop(scale=scale, offset=(float(offset[0]), float(offset[1]))),
        f"{_ratio(scale)} inside black bars, which are always dark: {bars}",
    )


def _centred(calibrated: Size, captured: Size, scale: float) -> Crop:
    return Crop(
        scale=scale, offset=((calibrated[0] - scale * captured[0]) / 2, (calibrated[1] - scale * captured[1]) / 2)
    )


def _apart(a: Crop, b: Crop, captured: Size) -> float:
    """Calibrated px between what two crops make of a corner of the picture, at most."""
    corners = np.array([[0, 0], [captured[0], 0], [0, captured[1]], captured], float)
    return float(np.abs(corners * a.scale + a.offset - corners * b.scale - b.offset).max())


def _not_square(stream: Stream) -> tuple[str, list[Fit]] | None:
    """Why a video's pictures have another shape than their calibration, where its pixels are not square; then no crop
    helps."""
    if stream.kind != "video" or (shown := VideoFile(stream.files[0].path).square_size) == tuple(stream.size):
        return None
    width, height = shown
    place = shlex.quote(stream.files[0].path)
    said = (
        f"the video's pixels are not square, and players show it as {_size(shown)} px: write it so, and its masks:"
        f" ffmpeg -i {place} -vf scale={width}:{height},setsar=1 OUT"
    )
    return said, []


def _left_open(calibrated: Size, captured: Size, border: Border, fits: Sequence[Fit]) -> tuple[str, list[Fit]]:
    """(why the sizes are not explained, guesses to choose from, the first the likeliest)."""
    if fits:
        return "both is possible: " + "; or ".join(f.how for f in fits), list(fits)
    (w, h), (cw, ch) = calibrated, captured
    if _scaled((h, w), captured):
        return (
            (
                "the picture is turned by a quarter: write the videos upright as they were calibrated, or calibrate"
                " them as they are"
            ),
            [],
        )
    dark = ", ".join(
        f"{s.dark} {what}"
        for s, what in zip(border, ("at the left", "above", "at the right", "below"), strict=True)
        if s.dark
    )
    seen = (
        f"dark rows and columns ({dark}) do not explain it" if dark else "there are no black bars that would explain it"
    )
    guesses = [
        Fit(_centred(calibrated, captured, w / cw), "scaled to the calibrated width, centred"),
        Fit(_centred(calibrated, captured, h / ch), "scaled to the calibrated height, centred"),
    ]
    if 1 not in (w / cw, h / ch):
        guesses.append(Fit(_centred(calibrated, captured, 1.0), "not scaled, centred"))
    return f"that is another shape, and {seen}", guesses


def _settings(guesses: Mapping[str, Sequence[Fit]]) -> list[str]:
    """Lines that are a sentence and settings to copy, the first guess as value and others as comments."""
    head = (
        "say how captured pixels become calibrated ones, in ./pipeline.yaml or a file for --config; the likeliest, with"
        " others as comments:"
    )
    return [head, *crop_settings({n: [(f.crop, f.how) for f in fits] for n, fits in guesses.items()})]


def _notes(capture: Capture, found: Mapping[str, Fit]) -> list[str]:
    """A sentence for the cameras that have one explanation and sizes in common."""
    alike: dict[str, list[str]] = {}
    for name, fit in found.items():
        v = capture.rig.names.index(name)
        captured, calibrated = capture.pictures[v].size, capture.rig.size[v]
        dx, dy = fit.crop.offset
        told = (
            f"pictures are {_size(captured)} px, the calibration is for {_size(calibrated)} px: {fit.how}; captured x"
            f" becomes {fit.crop.scale:.6g} x + ({dx:.4g}, {dy:.4g}), unless frames.crop says otherwise"
        )
        alike.setdefault(told, []).append(name)
    return [f"camera{'s' if len(names) > 1 else ''} {', '.join(names)}: {told}" for told, names in alike.items()]


def _ratio(scale: float) -> str:
    if scale == 1:
        return "not scaled"
    return f"scaled down by {scale:.6g}" if scale > 1 else f"scaled up by {1 / scale:.6g}"


def _size(size: Sequence[int] | np.ndarray) -> str:
    return f"{int(size[0])}x{int(size[1])}"
