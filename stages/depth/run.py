"""Depth and confidence of every source view, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from posegaussian.stages.contract.facts import MASKS, SINGLE_SOURCE
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.depth.algorithms.pose_prior import flesh_of, limbs_of
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, has_silhouettes, reliefs
from posegaussian.stages.depth.facts import LEFT_RIGHT_CHECK, LIMB_BOUNDS
from posegaussian.stages.depth.methods.declaration import DepthMethod, OfFrame, OfView
from posegaussian.stages.depth.params import UNTOLD, DepthParams, refusal, resolve_method
from posegaussian.stages.geometry.subject import STATURE, subject_distance
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.joint_sets import to_set
from posegaussian.storage.model.masks import foreground

FEW_MATCHES = 0.3
"""Share of the surface below which a view is reported as poorly matched."""
OFF = 1.3
"""Factor by which the subject of a single view may be farther or nearer than assumed before it is reported."""


def run(inputs: Inputs, params: DepthParams) -> Iterator[Block]:
    """Blocks `depth/depth` and `depth/confidence` of every view; views that are not sources get zeros.

    Each frame follows from its own pictures, masks and valid views alone. While `left_right_check` is off, a match
    counts whatever the other view says; while `limb_bounds` is on, the hull's near side follows the joints. Raises
    UserError for a method that this capture cannot serve.
    """
    reason = refusal(params, inputs.facts)
    if reason:
        raise UserError(reason)
    method = resolve_method(params, inputs.facts)
    if method.of_view is not None:
        yield from _alone(inputs, params, method, method.of_view)
    else:
        assert method.of_frame is not None, f"depth method {method.name} computes nothing"
        yield from _together(inputs, params, method, method.of_frame)


def _together(inputs: Inputs, params: DepthParams, method: DepthMethod, of_frame: OfFrame) -> Iterator[Block]:
    """Blocks of all views, each compared with the others."""
    sources = inputs.views.sources
    masks = {v: inputs.read("frames/mask", v) for v in sources}
    colors = {v: inputs.read("frames/color", v) for v in sources} if "frames/color" in method.reads else {}
    shape, (limbs, flesh) = _shape(inputs), _limbs(inputs)
    depth = {v: np.zeros(shape, np.float32) for v in sources}
    confidence = {v: np.zeros(shape, np.float16) for v in sources}
    untold: set[int] = set()
    doubted: dict[int, list[int]] = {v: [] for v in sources}
    strays: dict[int, list[int]] = {v: [] for v in sources}

    @cache
    def geometry(valid: tuple[int, ...], silhouettes: bool) -> Geometry:
        return Geometry.of(inputs.rig, valid, params, silhouettes)

    for f in range(shape[0]):
        valid = tuple(v for v in sources if inputs.valid[f, v])
        frame = Frame(
            {v: colors[v][f] for v in valid if v in colors}, {v: masks[v][f] for v in valid}, limbs[f], flesh[f]
        )
        known = geometry(valid, has_silhouettes(inputs.rig, frame.masks))
        assumed = reliefs(known, frame) if known.silhouettes else {}
        untold.update(assumed)
        for v, (z, c) in {**of_frame(known, frame, params, LEFT_RIGHT_CHECK in inputs.facts), **assumed}.items():
            depth[v][f], confidence[v][f] = z, c
        for v in frame.contradicting if MASKS in inputs.facts else ():
            doubted[v].append(int(inputs.source_frames[f]))
        for v in frame.strays if MASKS in inputs.facts else ():
            strays[v].append(int(inputs.source_frames[f]))
    for v in range(len(inputs.rig)):
        sure = confidence.get(v, np.zeros(shape, np.float16))
        yield Block("depth/depth", depth.get(v, np.zeros(shape, np.float32)), v)
        told = (UNTOLD,) if v in untold else matched_note(sure) if method.matches else ()
        odd = (*doubted_note(doubted.get(v, []), shape[0]), *stray_note(strays.get(v, []), shape[0]))
        yield Block("depth/confidence", sure, v, notes=(*told, *odd))


def _shape(inputs: Inputs) -> tuple[int, int, int]:
    """(frames, height, width) of the arrays: pictures are padded to the largest."""
    width, height = inputs.rig.size.max(axis=0)
    return len(inputs.partition), int(height), int(width)


def _limbs(inputs: Inputs) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """[N, 7] and [M, 7] capsules of each frame, of limbs and of what of them is surely there; none while `limb_bounds`
    is off."""
    if LIMB_BOUNDS not in inputs.facts or inputs.joint_set is None:
        none = [np.zeros((0, 7))] * len(inputs.partition)
        return none, none
    joints = to_set(inputs.read("pose/joints3d"), inputs.joint_set, "coco17")
    return [limbs_of(j) for j in joints], [flesh_of(j) for j in joints]


def _alone(inputs: Inputs, params: DepthParams, method: DepthMethod, of_view: OfView) -> Iterator[Block]:
    """Blocks of all views, each from its own maps alone; zeros in frames without a picture."""
    for v in range(len(inputs.rig)):
        depth, confidence = np.zeros(_shape(inputs), np.float32), np.zeros(_shape(inputs), np.float16)
        notes: tuple[str, ...] = ()
        if v in inputs.views.sources:
            valid = inputs.valid[:, v]
            depth[valid], confidence[valid] = (a[valid] for a in of_view(inputs, params, v))
            if SINGLE_SOURCE in inputs.facts and method.distance != "known":
                notes = distance_note(inputs.rig, v, depth, inputs.read("frames/mask", v), params, method)
        yield Block("depth/depth", depth, v, notes=notes)
        yield Block("depth/confidence", confidence, v)


def check(block: Block, params: DepthParams) -> list[str]:
    """Raise ValueError for values that no depth or confidence can have."""
    bound = np.inf if block.array == "depth/depth" else 1.0
    data = np.asarray(block.data)
    wrong = ~(np.isfinite(data) & (data >= 0) & (data <= bound))
    if wrong.any():
        raise ValueError(
            f"{block.array} of view {block.view}: {int(wrong.sum())} values such as {data[wrong][0]} are not in [0,"
            f" {bound:g}]"
        )
    return []


def matched_note(confidence: np.ndarray) -> tuple[str, ...]:
    """A sentence about a view [F, h, w] that matching could hardly serve."""
    if not confidence.any():
        return ()
    matched = float((confidence >= 0.5).sum() / (confidence > 0).sum())
    if matched >= FEW_MATCHES:
        return ()
    return (
        (
            f"{matched:.0%} of the surface was matched with another view (at least {FEW_MATCHES:.0%} expected); the"
            " rest follows neighbours and the hull"
        ),
    )


def _which(frames: list[int]) -> str:
    return f"frame{'s' if len(frames) > 1 else ''} {', '.join(map(str, frames))}"


def stray_note(frames: list[int], count: int) -> tuple[str, ...]:
    """A sentence about the source frames of a view, of `count`, in which its mask has parts that are not the
    subject."""
    told = (
        f"{len(frames)} of {count} masks hold something that most other cameras have nothing of, those of"
        f" {_which(frames)}: somebody else's arm, a piece of the floor; nothing is made of it, but cut it out of the"
        " mask there if it hides the subject"
    )
    return (told,) if frames else ()


def doubted_note(frames: list[int], count: int) -> tuple[str, ...]:
    """A sentence about the source frames of a view, of `count`, in which its mask as a whole contradicts the others."""
    told = (
        f"{len(frames)} of {count} masks contradict those of the other cameras as a whole, those of {_which(frames)}:"
        " nothing where these see somebody, or much where they do not; look at mask and picture there"
    )
    return (told,) if frames else ()


def distance_note(
    rig: Rig, view: int, depth: np.ndarray, masks: np.ndarray, params: DepthParams, method: DepthMethod
) -> tuple[str, ...]:
    """A sentence where the subject of a single view is elsewhere than assumed: measured depth says so, or the height
    of the silhouettes [F, h, w]."""
    assumed = subject_distance(rig, view, params.subject_distance)
    inside = foreground(masks)
    if method.distance == "measured":
        seen = depth[inside & (depth > 0)]
        likely = float(np.median(seen)) if seen.size else assumed
        says = f"the {method.name} depth of the subject"
    else:
        if params.subject_distance is not None or not inside.any() or inside.all():
            return ()
        tall = float(np.median([np.ptp(np.nonzero(m.any(axis=1))[0]) + 1 for m in inside if m.any()]))
        likely = float(rig.intrinsics[view, 1, 1]) * STATURE / tall
        says = f"the silhouette, if of a standing person of {STATURE:g} m,"
    if 1 / OFF <= likely / assumed <= OFF:
        return ()
    turns = f"the {method.name} lies at" if method.distance == "assumed" else "`sway` turns about a point at"
    return (f"{says} is at {likely:.2g} m and {turns} {assumed:.2g} m; set depth.subject_distance: {likely:.2g}",)
