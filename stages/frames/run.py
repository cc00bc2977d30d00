"""Kernel of the frames stage: decode, warp, matte; one view of one partition."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from posegaussian.stages.contract.facts import GIVEN_DEPTH, JOINTS2D, SEVERAL_FRAMES, TRUTH_DEPTH
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.contract.judged import SHARED_LIGHT
from posegaussian.stages.frames.effects import NO_LINK, proven_offsets, white_point
from posegaussian.stages.frames.exposures import SURFACE, compared
from posegaussian.stages.frames.facts import (
    AVERAGED_WITH,
    EXPOSURE_MATCHING,
    GAP_OPENING,
    LIGHT_STEADYING,
    NOISE_AVERAGING,
    OUTLINE_CORRECTION,
    OUTLINE_REDRAWING,
    TONE_MAPPING,
)
from posegaussian.stages.frames.gaps import gaps_in, opened
from posegaussian.stages.frames.mask_doubts import MUCH, around_told, doubts, dropped_told, goes_around, hidden_told
from posegaussian.stages.frames.outline_redrawing import redrawn
from posegaussian.stages.frames.params import FramesParams, resolve_matte
from posegaussian.stages.frames.person_matte import person_matte
from posegaussian.stages.frames.plate_matte import UNSEEN, plate_matte
from posegaussian.stages.frames.segmentation_prior import Hints
from posegaussian.stages.geometry.subject import PERSON_RADIUS, STATURE, look_at_point
from posegaussian.stages.imaging.averaging import averaged
from posegaussian.stages.imaging.camera_mapping import switched
from posegaussian.stages.imaging.color import gain_table, to_display, tone_mapped
from posegaussian.stages.imaging.contrast import shows_nothing
from posegaussian.stages.imaging.exposure import match
from posegaussian.stages.imaging.noise import noise_at, size_worked_at
from posegaussian.stages.imaging.outline import moved
from posegaussian.stages.imaging.steady_light import steadied, stops_brighter
from posegaussian.stages.imaging.warp import Warp
from posegaussian.storage.model.errors import SourceError

LEAST_BODY = 0.05
"""Share of what a person covers where the cameras look, below which a part that a plate alone tells of is nobody."""


def run(inputs: Inputs, params: FramesParams) -> Iterator[Block]:
    """Yield color [F, h, w, 3] uint8 sRGB, mask [F, h, w] uint8, of simulated captures true depth and of views with
    depth maps their depth [F, h, w] float32 m.

    h and w are the largest of all views; a smaller view lies at the top left, its padding is black with mask 0 and
    depth 0, and so is a frame that the view has no picture of, or one that shows nothing (a frame that was dropped and
    written black) of a subject that is cut out. Linear float pictures are encoded to sRGB, and clipped
    at 1 while `tone_mapping` is off. While `outline_correction` is on, the outlines of a source view's given masks are
    moved to the pictures' edges; while `gap_opening` is on, they lose what shows the backdrop; while
    `outline_redrawing` is on, they follow the pictures' edges. While `noise_averaging` is on, a source view's pictures
    are averaged with those around them where these show the same. While `exposure_matching` is on, a source view's
    light is multiplied by its gain, after the mask was found. Raises SourceError for pictures or masks whose size
    contradicts the calibration or each other.
    """
    view = inputs.view
    assert view is not None, "the frames stage runs over views"
    pictures = inputs.source("pictures")
    source_rig, crops = switched(inputs.source_rig, inputs.captured_to_calibrated, inputs.facts)
    warp = Warp(view, pictures.size(view), source_rig, inputs.rig, crops[view])
    present = np.flatnonzero(inputs.valid[:, view])
    numbers = [int(n) for n in inputs.source_frames[present]]

    steady = _steadily(inputs, warp)
    color, maps_tones = _empty(inputs, (3,), np.uint8), TONE_MAPPING in inputs.facts
    # the plate is clipped at white, too
    looked_at = {GAP_OPENING, OUTLINE_REDRAWING} & inputs.facts
    if not maps_tones or looked_at or resolve_matte(params, inputs.facts) in ("plate", "person"):
        if NOISE_AVERAGING in inputs.facts and view in inputs.views.sources:
            _fill_averaged(inputs, warp, color, steady)
        else:
            for frame, picture in zip(present, pictures.read(view, numbers), strict=True):
                _place(color[frame], steady(warp(to_display(picture))))
    mask = _empty(inputs, (), np.uint8)
    notes = _fill_mask(inputs, params, warp, present, numbers, color, mask)
    matched = EXPOSURE_MATCHING in inputs.facts and view in inputs.views.sources
    if maps_tones:
        white, gain = (
            white_point(np.stack([inputs.read("survey/light", v) for v in inputs.views.sources])),
            (_gain(inputs, view) if matched else np.ones(3)),
        )
        for frame, picture in zip(present, pictures.read(view, numbers), strict=True):
            _place(color[frame], warp(tone_mapped(picture, gain, white)))
    elif matched:
        table = gain_table(_gain(inputs, view))
        for picture in color:
            cv2.LUT(picture, table, dst=picture)
    dropped = [] if resolve_matte(params, inputs.facts) == "none" else _dropped(warp, present, color, mask)
    yield Block("frames/color", color, view)
    del color
    notes = (*notes, *dropped_told([int(inputs.source_frames[f]) for f in dropped]))
    yield Block("frames/mask", mask, view, (*notes, *doubts(mask, resolve_matte(params, inputs.facts))))
    del mask
    if TRUTH_DEPTH in inputs.facts:
        depth = _empty(inputs, (), np.float32)
        for frame, truth in zip(present, inputs.source("depth").read(view, numbers), strict=True):
            _same_size(warp, "true depth", truth)
            _place(depth[frame], warp.nearest(truth))
        yield Block("truth/depth", depth, view)
    if GIVEN_DEPTH in inputs.facts:
        yield _given_depth(inputs, warp, dict(zip(numbers, present, strict=True)))


def _dropped(warp: Warp, present: np.ndarray, color: np.ndarray, mask: np.ndarray) -> list[int]:
    """Frames of the partition whose pictures, of color [F, h, w, 3], show nothing where mask [F, h, w] holds something;
    both are emptied there: black would be drawn into what other views show of the subject."""
    shown = np.s_[: warp.size[1], : warp.size[0]]
    found = [int(f) for f in present if shows_nothing(color[f][shown], mask[f][shown])]
    color[found], mask[found] = 0, 0
    return found


def _steadily(inputs: Inputs, warp: Warp) -> Callable[[np.ndarray], np.ndarray]:
    """What brings a picture [h, w, 3] of the view to its usual light; what leaves it as it is while `light_steadying`
    is off."""
    if LIGHT_STEADYING not in inputs.facts:
        return lambda picture: picture
    plate, spread = _plate(inputs, warp)
    known = (spread < UNSEEN) & (warp.coverage > 0)
    return lambda picture: steadied(picture, stops_brighter(picture, plate, known))


def _fill_averaged(inputs: Inputs, warp: Warp, color: np.ndarray, steady: Callable[[np.ndarray], np.ndarray]) -> None:
    """Fill color [F, h, w, 3] of a source view with averages over the frames around, each made `steady`."""
    view = warp.view
    size = size_worked_at(inputs.rig, inputs.source_rig, inputs.captured_to_calibrated)[view]
    noise = noise_at(inputs.read("survey/unrest", view), size)
    numbers, valid = inputs.footage("pictures")
    first = inputs.partition.start - inputs.span("pictures").start
    there = np.flatnonzero(valid[:, view])
    read = inputs.source("pictures").read(view, [int(n) for n in numbers[there]])
    shown = {int(i): steady(warp(to_display(picture))) for i, picture in zip(there, read, strict=True)}
    for frame in range(len(color)):
        at = first + frame
        around = [shown[i] for i in range(at - AVERAGED_WITH, at + AVERAGED_WITH + 1) if i != at and i in shown]
        if at in shown:
            _place(color[frame], averaged(shown[at], around, noise))


def _fill_mask(
    inputs: Inputs,
    params: FramesParams,
    warp: Warp,
    present: np.ndarray,
    numbers: list[int],
    color: np.ndarray,
    mask: np.ndarray,
) -> tuple[str, ...]:
    """Fill mask [F, h, w] of one view; sentences about what was missing."""
    (width, height), matte = warp.size, resolve_matte(params, inputs.facts)
    if matte == "given":
        return _fill_given(inputs, warp, present, numbers, color, mask)
    if matte == "none":
        mask[present, :height, :width] = warp.coverage
        return ()
    plate = _plate(inputs, warp) if matte == "plate" or SEVERAL_FRAMES in inputs.facts else None
    hints, unknown = Hints(inputs, params.hint_margin) if matte == "person" else None, 0
    hidden, strange = list[int](), 0
    least = 0.0 if hints is None else LEAST_BODY * _body_area(inputs, warp.view)
    for frame in present:
        picture, found = np.ascontiguousarray(color[frame, :height, :width]), None
        if hints is not None:
            if hints.hidden(warp.view, int(frame)):
                continue
            known = hints.known(warp.view, int(frame))
            found = person_matte(picture, known, plate, params.plate_threshold, params.hint_margin)
            if known.others is not None and known.others.hides > MUCH:
                hidden.append(int(inputs.source_frames[frame]))
            if found is None and known.others is not None:
                continue  # what a plate tells of is somebody else
            unknown += found is None
        if found is None and plate is not None:
            strangers = None if hints is None else hints.strangers(warp.view, int(frame))
            strange += strangers is not None
            apart = np.asarray if strangers is None else strangers.taken_out
            found = plate_matte(picture, *plate, params.plate_threshold, least, apart)
        if found is not None:
            _place(mask[frame], np.minimum(found, warp.coverage))
    instead = "the background plate tells alone there" if plate is not None else "their masks are empty"
    if strange:
        instead += f", without somebody else who is followed, in {strange} of them"
    told = f"view {inputs.view}: in {unknown} of {len(present)} frames nobody saw the person, and {instead}"
    return ((told,) if unknown else ()) + hidden_told(hidden)


def _fill_given(
    inputs: Inputs, warp: Warp, present: np.ndarray, numbers: list[int], color: np.ndarray, mask: np.ndarray
) -> tuple[str, ...]:
    """Fill mask [F, h, w] of one view with those that came with the capture; sentences about them."""
    (width, height), view = warp.size, warp.view
    inwards, reader, around = _offset(inputs), inputs.source("masks"), list[int]()
    is_source = view in inputs.views.sources
    opens = {GAP_OPENING, JOINTS2D} <= inputs.facts and is_source
    redraws = OUTLINE_REDRAWING in inputs.facts and is_source
    for frame, number, given in zip(present, numbers, reader.read(view, numbers), strict=True):
        _same_size(warp, "mask", given)
        around += [number] if goes_around(given) else []
        _place(mask[frame], warp(moved(given, inwards)))
        shown, held = color[frame, :height, :width], mask[frame, :height, :width]
        if opens:
            _open(inputs, shown, held, int(frame))
        if redraws:
            held[:] = np.minimum(redrawn(np.ascontiguousarray(shown), np.ascontiguousarray(held)), warp.coverage)
    return around_told(around, reader.turned(view, numbers), len(present))


def _open(inputs: Inputs, picture: np.ndarray, mask: np.ndarray, frame: int) -> None:
    """Take out of a mask [h, w] of the view the gaps that its picture [h, w, 3] shows."""
    assert inputs.joint_set is not None, "gaps are told from the body by joints"
    joints = np.asarray(inputs.read("pose/joints2d", inputs.view)[frame], dtype=np.float64)
    found = gaps_in(np.ascontiguousarray(picture), mask, joints[None], inputs.joint_set)
    if found is not None:
        mask[:] = opened(mask, found.where)


def _body_area(inputs: Inputs, view: int) -> float:
    """Square px of frames/* that a standing person covers in a view where the source cameras look; 0 behind it."""
    rig = inputs.rig
    ahead = float(rig.rotations[view, 2] @ (look_at_point(rig.subset(inputs.views.sources)) - rig.centres[view]))
    pixels = float(np.prod(rig.intrinsics[view, [0, 1], [0, 1]])) / ahead**2 if ahead > 0 else 0.0
    return np.pi / 2 * PERSON_RADIUS * STATURE * pixels


def _plate(inputs: Inputs, warp: Warp) -> tuple[np.ndarray, np.ndarray]:
    """Plate [h, w, 3] and spread [h, w] of the view in its frames pixels."""
    w, h = warp.captured
    plate, spread = (
        np.ascontiguousarray(inputs.read(name, warp.view)[:h, :w]) for name in ("survey/plate", "survey/spread")
    )
    return warp(plate), warp(spread)


def _given_depth(inputs: Inputs, warp: Warp, frames: dict[int, int]) -> Block:
    """The depth maps of one view; `frames` are those with a picture, {source frame number: index in the partition}."""
    reader, view = inputs.source("depth_maps"), inputs.view
    held = [n for n in frames if n in set(reader.numbers(view).tolist())]
    given = _empty(inputs, (), np.float32)
    for number, depth_map in zip(held, reader.read(view, held) if held else (), strict=True):
        _place(given[frames[number]], warp.depth(depth_map))
    lacking = len(frames) - len(held)
    return Block(
        "frames/depth",
        given,
        view,
        notes=(
            (f"{lacking} of {len(frames)} pictures have no depth map; nothing is known of their depth",)
            if held and lacking
            else ()
        ),
    )


def _offset(inputs: Inputs) -> float:
    """Captured px by which the view's outlines are moved inwards."""
    view = inputs.view
    if OUTLINE_CORRECTION not in inputs.facts or view not in inputs.views.sources:
        return 0.0
    return float(proven_offsets(inputs.read("survey/outlines", view)[None])[0])


def _gain(inputs: Inputs, view: int) -> np.ndarray:
    """[3] factor on the light of one source view, from what was seen of all of them, as decided by."""
    sources = list(inputs.views.sources)
    if compared(inputs.facts) == SURFACE:
        found = match(np.stack([inputs.read(SURFACE, v) for v in sources])[:, sources])
    else:
        found = match(inputs.read(SHARED_LIGHT)[np.ix_(sources, sources)])
    if found is None:
        raise SourceError(f"effects.exposure_matching is on, but {NO_LINK}; set it to auto or off")
    return found.gains[sources.index(view)]


def _empty(inputs: Inputs, tail: tuple[int, ...], dtype: type) -> np.ndarray:
    width, height = inputs.rig.size.max(axis=0)
    return np.zeros((len(inputs.partition), int(height), int(width), *tail), dtype=dtype)


def _place(target: np.ndarray, picture: np.ndarray) -> None:
    target[: picture.shape[0], : picture.shape[1]] = picture


def _same_size(warp: Warp, what: str, given: np.ndarray) -> None:
    if given.shape[:2] != warp.captured[::-1]:
        raise SourceError(
            f"camera {warp.name}: a {what} is {given.shape[1]}x{given.shape[0]} px but its picture is"
            f" {warp.captured[0]}x{warp.captured[1]}; export it at the picture's size, or leave it out of the capture"
        )


def check(block: Block, params: FramesParams) -> list[str]:
    """Raise ValueError for a depth that is not finite or negative."""
    if block.array in ("truth/depth", "frames/depth"):
        wrong = ~(np.isfinite(block.data) & (block.data >= 0))
        if wrong.any():
            raise ValueError(
                f"{block.array} of view {block.view}: {int(wrong.sum())} pixels hold {block.data[wrong][0]}; a depth is"
                " finite and at least 0 m"
            )
    return []
