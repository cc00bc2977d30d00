"""The tracks kernel: everybody followed through all frames, told apart by their looks where paths cross."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.following.appearance import look, together
from posegaussian.stages.following.choice import FIELDS, People
from posegaussian.stages.following.everybody import CANDIDATES, Everybody, Frame, LookAt
from posegaussian.stages.geometry.points import focus
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.pose.subject_detections import DETECTIONS, in_frames
from posegaussian.stages.tracks.params import TracksParams
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import to_set

BLOCK = 1024
"""Frames whose joints are in memory at once."""


def run(inputs: Inputs, params: TracksParams) -> Iterator[Block]:
    """Yield tracks/people, tracks/about and tracks/choice.

    Where no two views agree on anybody in any frame, and with one source view, people are followed in each picture by
    itself, and those of equal rank in different views have the same number.
    """
    sources = list(inputs.views.sources)
    found = _followed(inputs, params, sources)
    alone = [found] if len(sources) == 1 else []
    if len(sources) > 1 and not found.places:
        alone = [_followed(inputs, params, [v]) for v in sources]
    parts = alone or [found]
    people = np.full((len(inputs.partition), len(inputs.rig), CANDIDATES), -1, np.int16)
    for part, views in zip(parts, [[v] for v in sources] if alone else [sources], strict=True):
        people[:, views] = part.numbers
    about = _about(inputs, parts, sources, bool(alone))
    everybody = People(about)
    told = everybody.told("px" if alone else "m") if len(about) > 1 else []
    if len(alone) > 1:
        told.append(
            "no two cameras agree on where anybody is, so that people are followed in each camera's pictures alone and"
            " the largest of each camera are taken for one person; `posegaussian inspect` says what is wrong with the"
            " cameras"
        )
    yield Block("tracks/people", people)
    padded = np.zeros((CANDIDATES, len(FIELDS)), np.float32)
    padded[: len(about)] = about
    yield Block("tracks/about", padded, notes=tuple(told))
    yield Block("tracks/choice", np.array([everybody.largest(), everybody.central(), len(about)], np.int16))


def _followed(inputs: Inputs, params: TracksParams, views: list[int]) -> Everybody:
    """Everybody in the pictures of some views."""
    found = Everybody.of(inputs.rig.subset(views), _frames(inputs, views), inputs.time, params.gap)
    found.settle(_looks(inputs, found.look_at(), views), params.gap)
    return found


def _frames(inputs: Inputs, views: list[int]) -> Iterator[Frame]:
    """COCO-17 joints of everybody in every frame, px of `inputs.rig`, a block of frames in memory at once."""
    for start in range(0, len(inputs.partition), BLOCK):
        block = range(start, min(start + BLOCK, len(inputs.partition)))
        seen = [_detections(inputs, v, block) for v in views]
        for f in block:
            people = [in_frames(inputs, v, found[f - start]) for v, found in zip(views, seen, strict=True)]
            yield f, float(inputs.time[f]), people


def _detections(inputs: Inputs, view: int, frames: range) -> list[np.ndarray]:
    """[P, 17, 3] COCO-17 px as captured, of one view in some frames; P at most `CANDIDATES`."""
    if ESTIMATED in inputs.facts:
        assert inputs.joint_set is not None, "estimated joints belong to a joint set"
        given, joint_set = list(inputs.read(DETECTIONS, view, frames)), inputs.joint_set
    else:
        reader = inputs.source("joints")
        joint_set = reader.joint_set
        given = [
            reader.read(view, int(inputs.source_frames[f])) if inputs.valid[f, view] else np.zeros((0, 1, 3))
            for f in frames
        ]
    return [
        to_set(np.asarray(g, dtype=np.float64)[:CANDIDATES], joint_set, "coco17") if len(g) else np.zeros((0, 17, 3))
        for g in given
    ]


def _looks(inputs: Inputs, wanted: LookAt, views: list[int]) -> dict[tuple[int, int], np.ndarray]:
    """{(number, piece): histograms [2, 192]} from the pictures that are wanted, each read once."""
    taken: dict[tuple[int, int], list[np.ndarray]] = defaultdict(list)
    for at, frames in sorted(wanted.items()):
        view, chosen = views[at], sorted(frames)
        numbers = [int(inputs.source_frames[f]) for f in chosen]
        for f, picture in zip(chosen, inputs.source("pictures").read(view, numbers), strict=True):
            people, shown = _detections(inputs, view, range(f, f + 1))[0], to_display(picture)
            for index, number, piece in frames[f]:
                taken[number, piece].append(look(shown, people[index]))
    return {key: together(found) for key, found in sorted(taken.items(), key=lambda x: x[0])}


def _about(inputs: Inputs, parts: list[Everybody], sources: list[int], alone: bool) -> np.ndarray:
    """[N, 8] what there is to say of everybody, see `choice.FIELDS`."""
    count = max((len(p.places) for p in parts), default=0)
    out = np.zeros((count, len(FIELDS)))
    pictures = max(1, int(inputs.valid[:, sources].sum()))
    for n in range(count):
        seen = [p.numbers == n for p in parts]
        shown = sum(int(s.any(axis=2).sum()) for s in seen)
        out[n, 0] = np.mean(np.any([s.any(axis=(1, 2)) for s in seen], axis=0))
        out[n, 1] = shown / pictures
        out[n, 2] = sum(float(p.spans[s].sum()) for p, s in zip(parts, seen, strict=True)) / max(1, shown)
        own = next(p for p in parts if n in p.places)
        middle = np.median([m for _, m in own.places[n]], axis=0)
        out[n, 3 : 3 + len(middle)], out[n, 6] = middle, own.sizes[n]
        out[n, 7] = np.linalg.norm(middle - _looked_at(inputs.rig, sources, parts.index(own), alone))
    return out


def _looked_at(rig: Rig, sources: list[int], part: int, alone: bool) -> np.ndarray:
    """[3] what the cameras look at, or [2] the middle of the one picture."""
    return np.asarray(rig.size[sources[part]] / 2.0 if alone else focus(rig.subset(sources)))
