"""Kernel of the judge stage: a few frames, all source views but one at a time, candidate by candidate."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.contract.judged import (
    CALIBRATION,
    DEPTH,
    EXPOSURE,
    FEWEST,
    LEARNED,
    MEASURES,
    NONE,
    POSE,
    SHARED_LIGHT,
    TURNS,
    mean_of_asked,
    mean_scores,
)
from posegaussian.stages.depth.choice import best_of as best_method
from posegaussian.stages.depth.choice import tried as tried_methods
from posegaussian.stages.depth.methods.registry import BY_PICTURES, METHODS
from posegaussian.stages.depth.params import AUTO
from posegaussian.stages.frames.exposures import SURFACE, points_of
from posegaussian.stages.imaging.color import gain_table
from posegaussian.stages.imaging.exposure import NONE as UNSEEN
from posegaussian.stages.imaging.exposure import Matching, match
from posegaussian.stages.judge.body import body_facts
from posegaussian.stages.judge.drawing import scores, with_gaussians
from posegaussian.stages.judge.footage import frames_of
from posegaussian.stages.judge.learned import learned, with_joints
from posegaussian.stages.judge.left_out import left_out
from posegaussian.stages.judge.light import POINTS, shared_light
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.judge.params import JudgeParams
from posegaussian.stages.judge.turning import as_filmed, turns_by_links
from posegaussian.stages.network.choice import CANDIDATES
from posegaussian.stages.network.choice import best_of as best_weights
from posegaussian.stages.network.params import NONE as NO_WEIGHTS
from posegaussian.stages.rendering.facts import POSE_BLENDING

COUNT = {CALIBRATION: 2, DEPTH: len(BY_PICTURES), EXPOSURE: 2, LEARNED: len(CANDIDATES), POSE: 2}
"""Candidates of each choice."""
PLAIN, WEIGHED = (Facts(frozenset(on)) for on in ((), (POSE_BLENDING,)))


def run(inputs: Inputs, params: JudgeParams) -> Iterator[Block]:
    """Yield `judge/calibration`, `judge/depth`, `judge/exposure`, `judge/network` and `judge/pose` [picture, candidate,
    measure], `judge/turns` [V, 3] and `judge/shared_light` [V, V, point, 3], as far as asked for.

    Where turned cameras draw left-out views better, all else is compared with them. Depth methods are compared in
    pictures without gains: what they match does not follow from a camera's exposure.
    Gains are compared by the method that is picked, or that is set, and the network and joints with the gains that drew
    best.
    """
    asked = [name for name in (CALIBRATION, DEPTH, EXPOSURE, LEARNED, POSE) if name in inputs.facts]
    found = dict(_compared(inputs, params, asked)) if len(inputs.views.sources) >= FEWEST else {}
    if TURNS in inputs.facts:
        turns = found.get(TURNS)
        yield Block(TURNS, turns_by_links(inputs) if turns is None else turns)
    if SHARED_LIGHT in inputs.facts:
        light = found.get(SHARED_LIGHT)
        yield Block(SHARED_LIGHT, _features(inputs) if light is None else light)
    for name in asked:
        out = np.full((params.frames * params.views, COUNT[name], len(MEASURES)), NONE)
        drawn = found.get(name, out[:0])
        out[: len(drawn)] = drawn
        yield Block(name, out)


def _compared(inputs: Inputs, params: JudgeParams, asked: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    """(array, [picture, candidate, measure]), and the light that views share."""
    depth, views = inputs.settings["depth"], left_out(inputs.rig, inputs.views.sources, params.views)
    methods: tuple[str, ...] = BY_PICTURES[-1:] if depth.method == AUTO else (depth.method,)
    if DEPTH in asked:
        methods = tried_methods(inputs.rig, inputs.views.sources)
    if any(METHODS[m].of_frame is None for m in methods):
        return  # depth that came with the capture lies in files that no frame here holds
    made, drawn = dict[str, Frames](), dict[str, np.ndarray]()
    if {TURNS, CALIBRATION} & inputs.facts:
        (frames, made[methods[-1]], drawn[methods[-1]]), turns, with_turns = as_filmed(
            inputs, params.frames, methods[-1], views
        )
        yield TURNS, turns
        yield CALIBRATION, with_turns
    else:
        frames = frames_of(inputs, params.frames)
    filmed = frames.read("frames/color")
    for m in methods:
        if m not in made:
            made[m] = with_gaussians(frames, depth, m, body_facts(inputs, m))
            drawn[m] = scores(made[m], filmed, views, PLAIN)
    best = methods[0]
    if DEPTH in asked:
        nothing = np.full_like(drawn[best], NONE)
        by_method = np.stack([drawn.get(m, nothing) for m in BY_PICTURES], axis=1)
        yield DEPTH, by_method
        means = mean_of_asked(by_method)
        best = best if means is None else BY_PICTURES[best_method(means)]
    chosen, reached = made[best], drawn[best]
    if SHARED_LIGHT in inputs.facts:
        points, matched, after = _evened(inputs, chosen, reached, filmed, views)
        yield SHARED_LIGHT, points
        if EXPOSURE in asked:
            yield EXPOSURE, np.stack([reached, after], axis=1)
        chosen, reached = (matched, after) if _psnr(after) >= _psnr(reached) else (chosen, reached)
    if LEARNED in asked:
        tried = {name: (made, scores(made, filmed, views, PLAIN)) for name, made in learned(inputs, chosen).items()}
        with_each = np.stack([tried.get(name, (chosen, reached))[1] for name in CANDIDATES], axis=1)
        yield LEARNED, with_each
        means = mean_scores(with_each)
        best_tried = NO_WEIGHTS if means is None else CANDIDATES[best_weights(means, list(tried))]
        chosen, reached = tried.get(best_tried, (chosen, reached))
    if POSE in asked and (posed := with_joints(chosen, inputs)) is not None:
        yield POSE, np.stack([reached, scores(posed, filmed, views, WEIGHED)], axis=1)


def _psnr(drawn: np.ndarray) -> float:
    """Mean of scores [picture, measure]; 0 dB where nothing was drawn."""
    means = mean_scores(drawn[:, None])
    return 0.0 if means is None else float(means[0, 0])


def _evened(
    inputs: Inputs, plain: Frames, reached: np.ndarray, filmed: np.ndarray, views: list[int]
) -> tuple[np.ndarray, Frames, np.ndarray]:
    """`judge/shared_light`: features with what depth shows of the surface, or alone, whichever gains draw left-out
    views better; the frames with these gains, and what they score (`reached` where there are none)."""
    sources, features = list(inputs.views.sources), _features(inputs)
    measured, tried = (points_of(features, shared_light(plain)), features), []
    for points in measured:
        color = _with_gains(filmed, sources, match(points[np.ix_(sources, sources)]))
        if color is not None:
            made = plain.with_array("frames/color", color)
            tried.append((points, made, scores(made, filmed, views, PLAIN)))
    return max(tried, key=lambda t: _psnr(t[2]), default=(measured[0], plain, reached))


def _features(inputs: Inputs) -> np.ndarray:
    """[V, V, 64, 3] what features show of the light that views share; nothing of a view that is no source."""
    count = len(inputs.rig)
    out = np.full((count, count, POINTS, 3), UNSEEN, np.float32)
    for v in inputs.views.sources:
        out[v] = inputs.read(SURFACE, v)
    return out


def _with_gains(color: np.ndarray, sources: list[int], found: Matching | None) -> np.ndarray | None:
    """Pictures [F, V, h, w, 3] with the gains of the source views; None where there are none."""
    if found is None or (found.gains == 1).all():
        return None
    out = color.copy()
    for v, gain in zip(sources, found.gains, strict=True):
        for picture in out[:, v]:
            cv2.LUT(picture, gain_table(gain), dst=picture)
    return out
