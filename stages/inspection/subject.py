"""Findings from the subject: joints in space and time, masks, focus."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, MASKS
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.subject import body_points, look_at_point, up_direction
from posegaussian.stages.geometry.sync import TimeOffsets, time_offsets
from posegaussian.stages.imaging.camera_mapping import captured_positions
from posegaussian.stages.inspection.bundle import FEWEST as FEWEST_POSED
from posegaussian.stages.inspection.bundle import pair_error, refit
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured, unmeasured
from posegaussian.stages.inspection.footage import LOOSE, Footage
from posegaussian.stages.inspection.joint_fit import FEWEST, WITHIN, JointFit, joint_fit
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.inspection.sharpness import edge_width
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.stages.survey.algorithms.silhouettes import odd_one_out, share_left
from posegaussian.storage.model.masks import ROUND, foreground, rim_share

RESIDUAL = (0.008, 0.016)
"""Share of the longer side, median: 2 and 4 cm on a person who fills it. Detectors alone scatter by 0.4 %."""
POSES = (0.005, 0.008)
"""Share of the longer side by which the calibration's epipolar lines miss the joints, scatter taken out: 1.2 and 2
cm. Two views differ by about a centimetre in what a detector calls a hip, in every frame alike, so that less is no
proof against a calibration."""
OFFSET = (0.25, 0.75)
"""Frames: below a quarter the pictures are as good as in step;
beyond three quarters whole frames can and must be corrected."""
BLUR = (0.7, 2.0)
"""Captured px of blur beyond that of the other cameras: 0.7 px halves the contrast of details of 4 px, 2 px leave
none of it."""
SHARP = (2.0, 4.0)
"""Captured px of blur of an edge, whatever the others have:
pictures that were enlarged, or out of focus in all cameras."""
AGREEMENT = (0.98, 0.9)
"""Share of a mask's rim that the other masks leave something of; the pipeline clips by silhouettes from 0.98 on."""
RIM = (0.5, ROUND)
"""Share of the picture's rim that is white: half of it where a head and shoulders fill the picture."""
ON_MASK = (0.8, 0.5)
"""Share of the joints that lie on the mask; what stands before the subject may hide some."""
MEND_MASKS = (
    "look at the outlines in the pictures: masks that lack a limb, timing, or a camera that stands elsewhere than its"
    " calibration says; leave out the one that agrees least (views.sources) and inspect again"
)
NO_JOINTS = "the capture has no 2D joints"
ADD_JOINTS = "import it with joints"


def of_poses(footage: Footage) -> list[Finding]:
    """Every pair's calibration by the joints: how far poses that fit the joints lie from it. Believed cameras are
    judged among themselves, each other one among them."""
    if JOINTS2D not in footage.facts or len(footage.rig) < 2:
        return []
    out = _poses_among(footage, footage.believed)
    for v in footage.left_out:
        out += [f for f in _poses_among(footage, (*footage.believed, v)) if footage.names[v] in f.cameras]
    return out


def _poses_among(footage: Footage, views: tuple[int, ...]) -> list[Finding]:
    seen, space = footage.joints
    seen = np.where(seen[..., 2:] >= SCORE, seen, 0.0)
    counts = ((seen[..., 2] > 0) & (space[:, None, :, 3] > 0)).sum(axis=(0, 2))
    enough = sorted(v for v in views if counts[v] >= FEWEST_POSED)
    rig = footage.rig.subset(enough)
    found = refit(rig, seen[:, enough], space)
    if found is None:
        return [unmeasured("calibration by joints", (), "px", 0, 0, "too few joints are seen by two cameras")]
    out: list[Finding] = []
    for i, j in combinations(range(len(enough)), 2):
        a, b = enough[i], enough[j]
        px, longest = float(footage.px[[a, b]].mean()), float(footage.longest[[a, b]].max())
        off, error = (n * px for n in pair_error(rig, found, i, j))
        bounds = (round(POSES[0] * longest, 2), round(POSES[1] * longest, 2))
        names = (footage.names[a], footage.names[b])
        if not np.isfinite(error):
            out.append(unmeasured("calibration by joints", names, "px", *bounds, "they see no joint in common"))
            continue
        told = (
            f"poses of the cameras that fit the joints lie {off:.1f} +- {error:.1f} px beside the calibration's"
            f" epipolar lines; they would lower the joints' median residual from {found.before * px:.1f} to"
            f" {found.after * px:.1f} px in all cameras"
        )
        advice = (
            "calibrate these cameras again: the joints fit each other, but not the calibration; check size, crop, units"
            " and pose.joints_frame first"
        )
        out.append(
            measured("calibration by joints", names, max(0.0, off - 2 * error), "px", *bounds, told, advice, True)
        )
    return out


def joint_fits(footage: Footage) -> list[JointFit | None]:
    """How each camera's joints fit, captured px; None where they cannot be judged."""
    offsets, known = footage.joint_offsets
    return [
        joint_fit(offsets[:, v] * footage.px[v], known[:, v], int(footage.comparable[v]), float(footage.longest[v]))
        for v in range(len(footage.rig))
    ]


def of_joints(footage: Footage) -> list[Finding]:
    """Residual of every camera's joints."""
    if JOINTS2D not in footage.facts or len(footage.rig) < 2:
        why = NO_JOINTS if JOINTS2D not in footage.facts else "one camera's joints cannot be triangulated"
        return [unmeasured("joint residual", (), "px", 0, 0, why, ADD_JOINTS if why is NO_JOINTS else "")]
    out: list[Finding] = []
    for name, longest, fit in zip(footage.names, footage.longest, joint_fits(footage), strict=True):
        bounds = (round(RESIDUAL[0] * float(longest), 2), round(RESIDUAL[1] * float(longest), 2))
        if fit is None and _shows_somebody(footage, len(out)):
            told = f"its joints agree with no other camera's within {LOOSE:.0%} of the longer side"
            advice = (
                f"calibrate {name} again, or check that its videos and joints are of this recording; until then leave"
                " it out with views.sources"
            )
            out.append(measured("joint residual", (name,), LOOSE * float(longest), "px", *bounds, told, advice, True))
        elif fit is None:
            out.append(
                unmeasured(
                    "joint residual",
                    (name,),
                    "px",
                    *bounds,
                    f"fewer than {FEWEST} joints could be compared with another camera's",
                )
            )
        else:
            out.append(_residual(name, fit, bounds))
    return out


def _shows_somebody(footage: Footage, view: int) -> bool:
    """Whether others could agree with what a camera shows: in half of the frames, and joints enough to judge by."""
    return bool((footage.shown[:, view] > 0).mean() >= 0.5 and footage.comparable[view] >= FEWEST)


def _residual(name: str, fit: JointFit, bounds: tuple[float, float]) -> Finding:
    told = (
        f"{fit.count} joints lie a median of {fit.median:.1f} px from where the cameras together put them,"
        f" {fit.share:.0%} within {WITHIN:.0%} of the longer side"
    )
    advice = (
        "look at the joints in the picture: where they sit on the person, the calibration or the timing is off; where"
        " not, the detector is (and see pose.joints_frame)"
    )
    return measured("joint residual", (name,), fit.median, "px", *bounds, told, advice)


def of_time(footage: Footage) -> tuple[list[Finding], TimeOffsets | None]:
    """Time offset of every camera."""
    if JOINTS2D not in footage.facts or len(footage.rig) < 2:
        why = NO_JOINTS if JOINTS2D not in footage.facts else "one camera has nobody to be in step with"
        return [unmeasured("time offset", (), "frames", *OFFSET, why, ADD_JOINTS if why is NO_JOINTS else "")], None
    found = _offsets(footage)
    numbers = found.frames * footage.step
    setting = ", ".join(f"{n}: {o:.2f}" for n, o in zip(footage.names, numbers, strict=True) if round(float(o)))
    out: list[Finding] = []
    for v, name in enumerate(footage.names):
        told = found.sentence(v, name).partition(": ")[2]
        if not found.told[v]:
            out.append(
                unmeasured(
                    "time offset",
                    (name,),
                    "frames",
                    *OFFSET,
                    told,
                    "film a few seconds of quick movement, a clap or a jump, that all cameras see",
                )
            )
            continue
        left = float(numbers[v] - round(float(numbers[v])))
        late = (
            f"{told}, {1000 * numbers[v] / footage.frame_rate:+.1f} ms,"
            f" of which whole frames leave {abs(left):.2f} of a frame"
            if v != found.reference
            else told
        )
        advice = (
            f"set frames: {{time_offset: {{{setting}}}}}; whole frames are corrected"
            if round(float(numbers[v]))
            else (
                "less than half a frame, which cannot be corrected;"
                " trigger the cameras together, or film at a higher rate"
            )
        )
        out.append(
            measured(
                "time offset",
                (name,),
                max(0.0, abs(float(found.frames[v])) - 2 * float(found.error[v])),
                "frames",
                *OFFSET,
                late,
                advice,
                at_least=True,
            )
        )
    return out, found


def _offsets(footage: Footage) -> TimeOffsets:
    """How far all cameras are out of step with the believed ones' reference. What is wrong with a camera that is left
    out must not move the others, so its own offset alone is taken of a comparison that it has a part in."""
    views = list(footage.believed)
    found = time_offsets(footage.rig.subset(views), footage.tracks[:, views])
    out = _spread(found, views, len(footage.rig))
    for v in footage.left_out:
        among = sorted((*views, v))
        other = _spread(time_offsets(footage.rig.subset(among), footage.tracks[:, among]), among, len(footage.rig))
        known = bool(other.told[v] and other.told[out.reference] and out.told[out.reference])
        late = other.frames[v] - other.frames[out.reference] if known else 0.0
        error = np.hypot(other.error[v], other.error[out.reference]) if known else 0.0
        for values, own in ((out.frames, late), (out.error, error), (out.told, known), (out.motion, other.motion[v])):
            values[v] = own
    return out


def _spread(found: TimeOffsets, views: list[int], count: int) -> TimeOffsets:
    """Offsets of some of `count` cameras as of all; the others are not told."""

    def of_all(values: np.ndarray) -> np.ndarray:
        out = np.zeros(count, values.dtype)
        out[views] = values
        return out

    told, reference = of_all(found.told), views[found.reference]
    return TimeOffsets(of_all(found.frames), of_all(found.error), told, reference, of_all(found.motion))


def of_masks(footage: Footage, planned: Planned, wrong: tuple[str, ...] = ()) -> list[Finding]:
    """How well each given mask's outline fits those that a run carves with; `wrong` are cameras whose masks are bad by
    themselves, which others are not to blame for."""
    if MASKS not in footage.facts:
        return [
            unmeasured(
                "mask agreement",
                (),
                "of the rim",
                *AGREEMENT,
                "the capture has no masks of every camera",
                "masks help everywhere; without them a background plate is used, see frames.matte",
            )
        ]
    if len(footage.rig) < 2:
        return [unmeasured("mask agreement", (), "of the rim", *AGREEMENT, "one camera's masks have nothing to fit to")]
    masks = [footage.masks(n) for n in footage.looked_at]
    odd = [None if wrong else odd_one_out(footage.rig, planned.masks_carving(m)) for m in masks]
    out: list[Finding] = []
    for v, name in enumerate(footage.names):
        of_frames = [
            (n, share_left(footage.rig, planned.masks_against(v, m), v, o), o == v)
            for n, m, o in zip(footage.looked_at, masks, odd, strict=True)
            if v in m
        ]
        shares = [s for _, s, _ in of_frames if s is not None]
        if not shares:
            out.append(
                unmeasured(
                    "mask agreement",
                    (name,),
                    "of the rim",
                    *AGREEMENT,
                    "its mask, or those of all others, are empty or missing",
                )
            )
            continue
        share = float(np.mean(shares))
        told = f"{share:.1%} of the outline is not contradicted by another camera's mask"
        if wrong_in := [(n, s) for n, s, is_odd in of_frames if is_odd]:
            left = np.mean([s for _, s in wrong_in if s is not None])
            told = (
                f"in frame{'s' * (len(wrong_in) > 1)} {', '.join(str(n) for n, _ in wrong_in)} it leaves {left:.1%} of"
                " the outlines of the others' masks, which agree without it"
            )
        advice = MEND_MASKS
        if others := [n for n in wrong if n != name]:
            advice = f"mend the masks of {', '.join(others)}, which it is compared with, and inspect again"
        out.append(measured("mask agreement", (name,), share, "of the rim", *AGREEMENT, told, advice))
    return out


def of_subjects_mask(footage: Footage) -> list[Finding]:
    """Whether each given mask is the subject's: by the picture's rim, and by the joints that should lie on it."""
    if MASKS not in footage.facts:
        return []
    masks = [footage.masks(n) for n in footage.looked_at]
    joints = _joints_on_masks(footage, masks) if JOINTS2D in footage.facts else []
    return [*_rims(footage, masks), *joints]


def wrong_masks(findings: Sequence[Finding]) -> tuple[str, ...]:
    """Names of the cameras whose masks are bad by what `of_subjects_mask` found."""
    return tuple(dict.fromkeys(n for f in findings if f.verdict is FindingVerdict.BAD for n in f.cameras))


def _rims(footage: Footage, masks: list[dict[int, np.ndarray]]) -> list[Finding]:
    out: list[Finding] = []
    for v, name in enumerate(footage.names):
        shares = [rim_share(foreground(m[v])) for m in masks if v in m]
        if shares:
            told = f"its masks are white along {np.mean(shares):.0%} of the picture's rim"
            advice = "the subject must be white and all else black: where masks mark the background, invert them"
            out.append(measured("mask at the rim", (name,), float(np.mean(shares)), "of the rim", *RIM, told, advice))
    return out


def _joints_on_masks(footage: Footage, masks: list[dict[int, np.ndarray]]) -> list[Finding]:
    """Of the subject's joints in the frames that are looked at, with `WITHIN` for where a detector errs."""
    seen, out = footage.joints[0], list[Finding]()
    rows = [footage.joint_numbers.index(n) for n in footage.looked_at]
    for v, name in enumerate(footage.names):
        on = [_on_mask(seen[f, v], m[v]) for f, m in zip(rows, masks, strict=True) if v in m]
        shown = np.concatenate([*on, np.zeros(0, bool)])
        if len(shown) < FEWEST:
            why = f"fewer than {FEWEST} joints of the subject are known in the pictures that were looked at"
            out.append(unmeasured("joints on masks", (name,), "of the joints", *ON_MASK, why))
            continue
        told = f"{shown.mean():.0%} of the subject's joints lie on its mask"
        advice = (
            "look at mask and joints in the pictures: the mask is empty, somebody else's, marks the background, or is"
            " of another moment; leave the camera out (views.sources) or give it masks of the subject"
        )
        out.append(measured("joints on masks", (name,), float(shown.mean()), "of the joints", *ON_MASK, told, advice))
    return out


def _on_mask(joints: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """[n] whether each known joint of [17, 3] px that lies in the picture is on the mask [h, w], or near it."""
    high, wide = mask.shape
    near = cv2.distanceTransform((~foreground(mask)).astype(np.uint8), cv2.DIST_L2, 3) <= WITHIN * max(high, wide)
    x, y = np.floor(joints[:, :2]).astype(int).T
    known = (joints[:, 2] >= SCORE) & (x >= 0) & (x < wide) & (y >= 0) & (y < high)
    return np.asarray(near[y[known], x[known]])


def of_focus(footage: Footage) -> list[Finding]:
    """Blur of every camera's strong edges around the subject, absolutely and against the others."""
    found = [_width(footage, v) for v in range(len(footage.rig))]
    out: list[Finding] = []
    for v, (name, width) in enumerate(zip(footage.names, found, strict=True)):
        others = [w for o in footage.believed if o != v and (w := found[o]) is not None]
        if width is None:
            out.append(unmeasured("focus", (name,), "px", *SHARP, "too few edges around the subject"))
            continue
        advice = f"focus {name} on the subject, clean its lens, shorten its shutter; or leave it out with views.sources"
        out.append(
            measured("focus", (name,), width, "px", *SHARP, f"its strong edges are blurred by {width:.2f} px", advice)
        )
        if others:
            middle = float(np.median(others))
            more = float(np.sqrt(max(0.0, width**2 - middle**2)))
            out.append(
                measured(
                    "blur against others",
                    (name,),
                    more,
                    "px",
                    *BLUR,
                    f"its edges are blurred by {width:.2f} px, those of the others by {middle:.2f} px",
                    advice,
                )
            )
    return out


def _width(footage: Footage, view: int) -> float | None:
    """Median over the frames that are looked at of the edges' width in captured px, in the box around a person where
    the cameras look."""
    region = _region(footage, view)
    found = [edge_width(footage.raw(view, n), region) for n in footage.looked_at if n in footage.numbers[view]]
    known = [w for w in found if w is not None]
    return float(np.median(known)) if known else None


def _region(footage: Footage, view: int) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 in captured px around a person at the point all cameras look at; the whole picture where
    that person would not be in it."""
    rig, size = footage.rig, footage.captured[view]
    body = body_points(look_at_point(rig.subset(footage.believed)), up_direction(rig.subset(footage.believed)))
    pixels, depth = project(body, rig.intrinsics[view], rig.world_to_camera[view])
    source, crop = footage.source_rig, footage.captured_to_calibrated[view]
    lens = source.intrinsics[view], source.distortion[view]
    at = captured_positions(pixels, rig.intrinsics[view], *lens, crop)
    shown = at[np.isfinite(at).all(axis=1)] if (depth > 0).all() else at[:0]
    low, high = (np.clip(f(axis=0, initial=i), 0, size).astype(int) for f, i in ((shown.min, np.inf), (shown.max, 0)))
    if (high - low < size / 8).any():
        return 0, 0, int(size[0]), int(size[1])
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
