"""What a calibration says of itself, and what files of pictures say: sizes, lens, principal point, where the cameras
look, frames that are lacking or shown twice. No picture is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.camera_mapping import distort, left_out, one_to_one
from posegaussian.stages.inspection.finding import COUNTED, Finding, FindingVerdict, measured, unmeasured
from posegaussian.stages.inspection.footage import Footage, shared_numbers
from posegaussian.storage.model.cameras import Rig

DISPLACED = (0.1, 0.25)
"""Share of the longer side by which a lens moves a corner: a wide lens with 100 degrees makes a tenth; a quarter is
mostly an error of the fit."""
LEFT_OUT = 0.01
"""Share of the picture left out by undistortion from which on it is said; nobody misses less."""
OFF = "principal point"
OFF_CENTRE = (0.08, 0.2)
"""Share of the longer side by which the principal point is off the middle: sensors are mounted within a few percent;
more is a crop that nobody noted."""
ANISOTROPY = (0.02, 0.1)
"""Relative difference of the two focal lengths: pixels of today's sensors are square."""
ASIDE = (0.6, 1.0)
"""Where the point that all cameras look at lies in a picture: 0 in the middle, 1 at the border."""
COVERED = (0.95, 0.8)
"""Share of the calibrated picture that the captured one fills after `frames.crop`; 0.96 is a letterbox of 4 %."""
MISSING = (0.02, 0.2)
"""Share of the frames that a camera lacks."""
REPEATED = (0.02, 0.2)
"""Share of the frames in which a camera shows the picture before once more, while others go on: as bad as `MISSING`."""
LINES = ("epipolar distance", "agreement")
"""Measures of whether what a camera shows lies where its calibration says."""
FARTHEST = 9.99
"""Ways to a corner or border beyond which nobody asks how far."""


def of_lens(rig: Rig, view: int) -> list[Finding]:
    """Findings on one camera's intrinsics and distortion."""
    name, k, size = rig.names[view], rig.intrinsics[view], rig.size[view]
    longest = float(size.max())
    off = float(np.abs(k[:2, 2] - size / 2).max()) / longest
    skewed = float(abs(k[0, 0] / k[1, 1] - 1))
    return [
        measured(
            OFF,
            [name],
            off,
            "of the longer side",
            *OFF_CENTRE,
            f"the principal point ({k[0, 2]:.0f}, {k[1, 2]:.0f}) lies {off:.1%} of the longer side off the middle of"
            f" {size[0]}x{size[1]} px",
            "check that the calibration is for this picture and not for a crop or another resolution of it; say how"
            " they relate with frames.crop",
        ),
        measured(
            "focal lengths",
            [name],
            skewed,
            "relative",
            *ANISOTROPY,
            f"fx {k[0, 0]:.0f} px and fy {k[1, 1]:.0f} px differ by {skewed:.2%}",
            "calibrate with square pixels (fx = fy) unless the picture is stretched",
        ),
        _displacement(rig, view),
        _one_to_one(rig, view),
    ]


def confirmed(findings: Sequence[Finding]) -> list[Finding]:
    """The same findings; a principal point far off the middle is doubtful, not bad, where what its camera shows lies on
    the lines of others: the pictures are a crop, and the calibration is of that crop."""
    verdicts: dict[str, set[FindingVerdict]] = {}
    for f in findings:
        if f.measure in LINES and f.verdict in COUNTED:
            for name in f.cameras:
                verdicts.setdefault(name, set()).add(f.verdict)
    fit = {name for name, found in verdicts.items() if found == {FindingVerdict.GOOD}}
    return [_confirmed(f) if f.measure == OFF and fit.issuperset(f.cameras) else f for f in findings]


def _confirmed(finding: Finding) -> Finding:
    if finding.verdict is not FindingVerdict.BAD:
        return finding
    return replace(
        finding,
        verdict=FindingVerdict.DOUBTFUL,
        sentence=f"{finding.sentence}, and what it shows lies on the lines of other cameras",
        advice="nothing, where these pictures were cut out of larger ones and calibrated so",
    )


def _border(rig: Rig, view: int) -> np.ndarray:
    """[n, 2] normalised coordinates of the picture's border, lens not undone: what the lens made of its directions."""
    w, h = rig.size[view]
    t = np.linspace(0, 1, 17)[:, None]
    edge = np.concatenate([t * [w, 0], t * [w, 0] + [0, h], t * [0, h], t * [0, h] + [w, 0]])
    k = rig.intrinsics[view]
    return (edge - k[:2, 2]) / k[[0, 1], [0, 1]]


def _displacement(rig: Rig, view: int) -> Finding:
    """How far the lens moves what a camera without it would show at the border."""
    border, k = _border(rig, view), rig.intrinsics[view]
    moved = float(
        np.linalg.norm((distort(border, rig.distortion[view]) - border) * k[[0, 1], [0, 1]], axis=1).max()
        / rig.size[view].max()
    )
    lost = left_out(rig, view)
    told = f"; without it {lost:.1%} of the picture, in its corners, is left out" if lost >= LEFT_OUT else ""
    advice = (
        "calibrate again with fewer coefficients (k1 k2 alone) and a board that reaches the corners; a fisheye lens"
        " needs another model"
    )
    return measured(
        "lens distortion",
        [rig.names[view]],
        moved,
        "of the longer side",
        *DISPLACED,
        f"the lens moves the border by up to {moved:.1%} of the longer side{told}",
        advice,
    )


def _one_to_one(rig: Rig, view: int) -> Finding:
    """Whether the lens model can be undone within the picture."""
    held = one_to_one(rig, view, FARTHEST)
    sentence = (
        "the lens model is one-to-one in the whole picture"
        if held >= 1
        else f"the lens model folds back at {held:.0%} of the way to the corner: what lies beyond cannot be undone"
    )
    return measured(
        "lens model",
        [rig.names[view]],
        held,
        "times the way to the corner",
        1.0,
        0.9,
        sentence,
        "calibrate again with fewer coefficients; until then the corners stay black",
        at_least=held == FARTHEST,
    )


def of_sizes(rig: Rig, view: int, captured: tuple[int, int], crop: np.ndarray) -> Finding:
    """Whether captured pictures of (width, height) px fill the calibrated picture under `crop` [3] (scale, dx, dy)."""
    name, (w, h), size = rig.names[view], captured, rig.size[view].astype(float)
    low, high = crop[1:], crop[0] * np.array([w, h], float) + crop[1:]
    filled = float(np.prod(np.clip(np.minimum(high, size) - np.maximum(low, 0), 0, None)) / np.prod(size))
    told = (
        "as calibrated"
        if tuple(size) == (w, h)
        else f"the calibration is for {int(size[0])}x{int(size[1])} px, frames.crop maps them onto {filled:.1%} of it"
    )
    return measured(
        "picture size",
        [name],
        filled,
        "filled",
        *COVERED,
        f"pictures of {w}x{h} px, {told}",
        f"check frames.crop: {{{name}: {{scale: ..., offset: [dx, dy]}}}}: the captured picture should fill the"
        " calibrated one",
    )


def size_unexplained(name: str, captured: tuple[int, int], calibrated: tuple[int, int], suggestion: str) -> Finding:
    """Of a camera whose pictures have another size than its calibration, and no crop says how they relate."""
    sentence = (
        f"pictures are {captured[0]}x{captured[1]} px, the calibration is for {calibrated[0]}x{calibrated[1]} px, and"
        " nothing says how they relate; below they are taken to be scaled to its width and centred"
    )
    return measured(
        "picture size",
        [name],
        0.0,
        "filled",
        *COVERED,
        sentence,
        f"say how they relate, for example frames: {suggestion}",
    )


def of_aim(rig: Rig, believed: tuple[int, ...]) -> list[Finding]:
    """Whether every camera has the point in its picture that all believed ones look at."""
    if len(rig) < 2:
        return [
            unmeasured(
                "aim", list(rig.names), "of the way to the border", *ASIDE, "one camera alone looks at no common point"
            )
        ]
    point, out = look_at_point(rig.subset(believed)), []
    for v, name in enumerate(rig.names):
        x, y, z = rig.rotations[v] @ point + rig.world_to_camera[v, :3, 3]
        k, size = rig.intrinsics[v], rig.size[v]
        pixel = np.array([k[0, 0] * x, k[1, 1] * y]) / max(z, 1e-9) + k[:2, 2]
        aside = FARTHEST if z <= 0 else min(FARTHEST, float(np.abs(2 * pixel / size - 1).max()))
        where = (
            "behind it"
            if z <= 0
            else f"{z:.1f} m before it, at {aside:.0%} of the way from the middle of its picture to the border"
        )
        advice = (
            "check the pose: rotation and translation must lead from the world to the camera (x_cam = R X + t), axes x"
            " right, y down, z forward; or leave the camera out with views.sources"
        )
        out.append(
            measured(
                "aim",
                [name],
                aside,
                "of the way to the border",
                *ASIDE,
                f"the point all cameras look at lies {where}",
                advice,
                at_least=aside == FARTHEST,
            )
        )
    return out


def of_frames(names: tuple[str, ...], numbers: list[np.ndarray], believed: tuple[int, ...]) -> list[Finding]:
    """Whether the cameras have pictures of the same frames; `numbers`: source frame numbers of each."""
    every, advice = np.unique(np.concatenate([numbers[v] for v in believed])), _cut(numbers, believed)
    out = []
    for name, have in zip(names, numbers, strict=True):
        lacking = 1 - len(np.intersect1d(have, every)) / max(1, len(every))
        told = f"{len(have)} of the {len(every)} frames that any camera has" + (
            f", {have[0]}..{have[-1]}" if len(have) else ""
        )
        out.append(measured("frames", [name], lacking, "of the frames missing", *MISSING, told, advice))
    return out


def of_repeats(footage: Footage) -> list[Finding]:
    """Whether a camera's recording stood still: of every camera with several files of pictures. One whose mask holds
    nobody is no fault: what it shows may well stay the same."""
    out = []
    for v, runs in footage.repeats.items():
        numbers = footage.numbers[v]
        shown = [r for r in runs if "masks" not in footage.readers or footage.shows("masks", v, r[0])]
        if len(numbers) > 1:
            out.append(_repeated(footage.names[v], numbers, shown))
    return out


def _repeated(name: str, numbers: np.ndarray, runs: Sequence[tuple[int, int]]) -> Finding:
    again = sum(int(((numbers > first) & (numbers <= last)).sum()) for first, last in runs)
    told = "no picture is the one before it once more while other cameras' change"
    if runs:
        first, last = max(runs, key=lambda run: run[1] - run[0])
        told = (
            f"{again} of {len(numbers)} pictures are the one before once more, while other cameras' change: frames"
            f" {first} to {last} show the same"
        )
    advice = (
        "its recording stood still, or files were copied: give it the right pictures, leave these frames out"
        " (frames.range) or the camera (views.sources); masks of others that contradict it there are no fault of theirs"
    )
    share = again / max(1, len(numbers))
    return measured("repeated pictures", [name], share, "of the frames", *REPEATED, told, advice)


def _cut(numbers: list[np.ndarray], believed: tuple[int, ...]) -> str:
    """How to come to frames that all believed cameras have: the setting for the longest stretch of them."""
    check = "check that the recordings belong together and start together"
    every, shared = np.unique(np.concatenate(numbers)), shared_numbers(numbers, believed)
    if not len(shared):
        return f"{check}; no frame is in all of them: leave out the shortest with views.sources"
    places = np.searchsorted(every, shared)
    longest = max(np.split(shared, np.flatnonzero(np.diff(places) > 1) + 1), key=len)
    stride = int(np.diff(every).min()) if len(every) > 1 else 1
    text = f"{longest[0]}:{longest[-1] + 1}" + (f":{stride}" if stride > 1 else "")
    return f"{check}; cut them to what all have: frames.range={text}"
