"""How cameras stand by their silhouettes, or by joints, before anything else is measured of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, reduce
from hashlib import blake2b
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, MASKS
from posegaussian.stages.contract.io import Block, Inputs, TaskScope
from posegaussian.stages.contract.trust import Told
from posegaussian.stages.detection.reader import EstimatedJoints, joint_reader
from posegaussian.stages.imaging.small_turns import SIDE, turned
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.silhouettes.coherence import FEWEST, Outlined, Standing, as_written, standing
from posegaussian.stages.survey.algorithms.joints import by_size, people_of
from posegaussian.stages.survey.algorithms.links import few_of
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.algorithms.sample import compared_numbers, of_somebody, sample_numbers, worked_numbers
from posegaussian.stages.survey.algorithms.silhouettes import masks_of
from posegaussian.stages.survey.standing.by_joints import same_person_first, standing_by_joints
from posegaussian.stages.survey.standing.lacking import lacking
from posegaussian.stages.survey.standing.moved import without_moved
from posegaussian.stages.survey.standing.out_of_step import late_by_joints, late_by_silhouettes
from posegaussian.stages.survey.standing.upside_down import upside_down
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

LACKS = (
    "its masks lack something that those of most others have, a limb, the feet or what is held, which may be missing in"
    " new views: complete them, or make all anew (frames.matte: person)"
)
_KEPT: dict[bytes, Standing] = {}
"""That of a few captures, as every view's task asks for it."""
KEPT = 8


class AsTheyStand(Inputs):
    """What a task may see, with the cameras as they stand."""

    def __init__(self, inputs: Inputs, found: Standing) -> None:
        """Of a task's inputs, and how its cameras stand."""
        scope = TaskScope(**{name: getattr(inputs, name) for name in TaskScope.__dataclass_fields__})
        source_rig = turned(inputs.source_rig, found.turns)
        super().__init__(replace(scope, rig=turned(inputs.rig, found.turns), source_rig=source_rig))
        self._inputs, self.standing = inputs, found

    def span(self, array: str) -> range:
        """As the task's own."""
        return self._inputs.span(array)

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """As the task's own."""
        return self._inputs.read(array, view, frames, first)

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """As the task's own."""
        return self._inputs.footage(array)

    def source(self, kind: str) -> Any:
        """As the task's own."""
        return self._inputs.source(kind)


class StandingLook(Look):
    """survey/standing [7] of one view."""

    def __init__(self, name: str, inputs: Inputs, view: int) -> None:
        """name: of the array; inputs: with the cameras as they stand, as the survey gives them."""
        assert isinstance(inputs, AsTheyStand), f"{name} is asked for, so it was found first"
        self._name, self._rows, self._view = name, told(inputs.standing, inputs), view

    def blocks(self) -> Iterator[Block]:
        """Of what was found before."""
        row = self._rows[self._view]
        yield Block(self._name, row, self._view, notes=(LACKS,) if row[4] == Told.LACKING else ())


def told(found: Standing, inputs: Inputs) -> np.ndarray:
    """[V, 7] float64, as `survey/standing` holds it."""
    rig, longest = inputs.rig, inputs.rig.size.max(axis=1)
    apart = found.apart / float(longest.max())
    how = Told.EXCHANGED if found.exchanged else Told.MIRRORED if found.mirrored else Told.WRONG
    wrong = np.isin(np.arange(len(apart)), list(found.wrong)) * how
    as_written = ~found.turns.any(axis=1)
    lacks = np.isin(np.arange(len(apart)), list(found.lacking)) & as_written
    told = np.where(found.by_joints & ~as_written, Told.BY_JOINTS, np.where(lacks, Told.LACKING, wrong))
    rows = np.column_stack([found.turns, apart, told, np.zeros((len(apart), 2))])
    for v, moved in found.moved.items():
        share = np.linalg.norm(moved.by) * rig.intrinsics[v, 0, 0] / longest[v]
        rows[v] = *moved.by, share, Told.MOVED, moved.before, moved.after
    rows[list(found.upside_down), 4] = Told.UPSIDE_DOWN
    for v, by in found.late.items():
        rows[v, 4:6] = Told.LATE, by
    return rows


def as_they_stand(inputs: Inputs, sample: int) -> AsTheyStand:
    """A task's inputs with its source cameras as they are seen to stand in a few of the frames that all of them have,
    and that show somebody, of a sample of so many."""
    numbers = reduce(np.intersect1d, [worked_numbers(inputs, v) for v in inputs.views.sources])
    return AsTheyStand(inputs, standing_in(inputs, of_somebody(inputs, sample_numbers(numbers, sample))))


def standing_in(inputs: Inputs, numbers: np.ndarray) -> Standing:
    """How source cameras stand by their masks in some of the sampled source frames `numbers` [n], or, where fewer than
    `FEWEST` views have one that is not empty, by joints; as they are written down where these tell nothing either."""
    rig, warps = inputs.rig, dict[int, Warp]()
    asked = list(compared_numbers(numbers)) if MASKS in inputs.facts else []

    @cache
    def masks(number: int) -> dict[int, np.ndarray]:
        return masks_of(inputs, number, warps)

    def outlined(number: int) -> Outlined:
        return Outlined.of(rig, masks(number))

    def late(wrong: int) -> int:
        of_frames = {n: masks(n) for n in compared}
        return late_by_silhouettes(rig, of_frames, wrong, lambda n: masks_of(inputs, n, warps, [wrong]).get(wrong))

    compared = [n for n in map(int, asked) if sum(foreground(m).any() for m in masks(n).values()) >= FEWEST]
    if compared:
        of_all = [(n, masks(n)) for n in sorted({*compared, int(numbers[0]), int(numbers[-1])})]
        return _kept(
            (rig.digest, numbers.tolist(), [(n, sorted(m)) for n, m in of_all]),
            [m[v] for _, m in of_all for v in sorted(m)],
            lambda: _by_silhouettes(rig, numbers, outlined, compared, late),
        )
    few = few_of(numbers)
    if not len(few) or JOINTS2D not in inputs.facts or len(inputs.views.sources) < FEWEST or _doubtful_pixels(inputs):
        return as_written(rig)
    people = _people(inputs, inputs.views.sources, few)
    return _kept((rig.digest, inputs.views.sources, few), [people], lambda: _by_joints(inputs, people, few))


def _by_silhouettes(
    rig: Rig,
    numbers: np.ndarray,
    outlined: Callable[[int], Outlined],
    compared: Sequence[int],
    late: Callable[[int], int],
) -> Standing:
    """How cameras stand by the silhouettes of the frames `compared`, of all `numbers` that are sampled; by how many the
    only wrong one is late; and, of those that are right or turned to be so, whose masks lack something."""
    frames = [outlined(n) for n in compared]
    found = without_moved(rig, numbers, outlined, standing(rig, frames))
    if len(found.wrong) == 1 and not found.mirrored:
        found = replace(found, late={v: by for v in found.wrong if (by := late(v))})
    right = [f.among([v for v in f.silhouettes.views if v not in {*found.wrong, *found.moved}]) for f in frames]
    return replace(found, lacking=lacking(turned(rig, found.turns), right))


def _by_joints(inputs: Inputs, people: np.ndarray, numbers: np.ndarray) -> Standing:
    """How cameras stand by the joints [S, n, P, 17, 3] of the source views in frames `numbers` [n]; one that is out of
    step by what it shows at the moments of the others."""
    rig, sources = inputs.rig, list(inputs.views.sources)
    cameras = rig.subset(sources)
    people = same_person_first(cameras, people)

    def around(view: int, asked: np.ndarray) -> np.ndarray:
        return _people(inputs, [sources[view]], asked)[0, :, 0]

    late = late_by_joints(cameras, people[:, :, 0], numbers, around)
    if late is not None:
        people = people.copy()
        people[late.camera, :, 0] = late.joints
    found = standing_by_joints(cameras, people, numbers)
    turns, apart = np.zeros((len(rig), 3)), np.zeros(len(rig))
    turns[sources], apart[sources] = found.turns, found.apart
    apart *= rig.size.max() / cameras.size.max()
    moved = {sources[v]: m for v, m in found.moved.items()}
    if late is None:
        found = replace(found, turns=turns, apart=apart, moved=moved)
        overhead = upside_down(cameras, people[:, :, 0]) if not (moved or turns.any()) else None
        if overhead is None:
            return found
        camera, px = overhead
        apart[sources[camera]] = px * rig.size.max() / SIDE
        return replace(found, upside_down=frozenset({sources[camera]}))
    apart[sources[late.camera]] = late.apart * rig.size.max() / cameras.size.max()
    return replace(found, turns=turns, apart=apart, moved=moved, late={sources[late.camera]: late.frames})


def _people(inputs: Inputs, views: Sequence[int], numbers: np.ndarray) -> np.ndarray:
    """[S, n, P, 17, 3] (u, v, score) of the people each of some views shows in source frames `numbers` [n], px of the
    rig, the largest first; score 0 where there are fewer."""
    reader = joint_reader(inputs)
    if isinstance(reader, EstimatedJoints):
        for v in views:
            reader.look_at(v, numbers)
    of_view = [[by_size(people_of(inputs, v, int(n))) for n in numbers] for v in views]
    most = max([1, *(len(people) for frames in of_view for people in frames)])
    out = np.zeros((len(views), len(numbers), most, 17, 3))
    for v, frames in enumerate(of_view):
        for n, people in enumerate(frames):
            out[v, n, : len(people)] = people
    return out


def _doubtful_pixels(inputs: Inputs) -> bool:
    """Whether it is not known here which pixels joints refer to: given ones may be those of the calibrated picture
    (`pose.joints_frame`), where a camera that is cropped would look turned."""
    return ESTIMATED not in inputs.facts and not (inputs.captured_to_calibrated == [1.0, 0.0, 0.0]).all()


def _kept(of: object, parts: Sequence[np.ndarray], find: Callable[[], Standing]) -> Standing:
    """What is found, unless the same was before."""
    key = blake2b(b"".join([str(of).encode(), *(part.tobytes() for part in parts)])).digest()
    if key not in _KEPT:
        _KEPT[key] = find()
    while len(_KEPT) > KEPT:
        _KEPT.pop(next(iter(_KEPT)))
    return _KEPT[key]
