"""The people of a capture with a picture of each: who is in the frames that are looked at, by the names that
`pose.subject` takes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D
from posegaussian.stages.following.appearance import look, together
from posegaussian.stages.following.choice import name_of
from posegaussian.stages.following.everybody import CANDIDATES, Everybody
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.inspection.finding import TO_MEND, Finding
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.people import MEASURE as PEOPLE
from posegaussian.stages.inspection.people import of_places
from posegaussian.stages.inspection.report import Report
from posegaussian.storage.model.joint_sets import to_set

GAP = 1e6
"""Seconds: the few frames that are looked at lie far apart."""
AROUND = 0.15
"""Share of a person's extent that a picture of them shows around."""
AGREE = 3
"""Cameras that must agree on a place: of a body that is not there two agree by chance, where both stand as high."""
MISFITS = ("agreement", "joint residual", "calibration by joints", "epipolar distance")
"""Measures that tell of cameras that stand elsewhere than their calibration says."""
NAMED = (
    "A run follows people through all of its frames and names them by how many pictures show them, so that names may"
    " differ from these; its warnings say who is who. pose.subject: NAME chooses."
)
"""What to know of the names."""


@dataclass(frozen=True)
class Portrait:
    """One person and where to see them."""

    name: str
    """person1, ..."""
    frames: int
    """Frames in which the person was found."""
    of_frames: int
    """Frames that were looked at."""
    cameras: dict[str, int]
    """{camera: pictures of it that show the person}."""
    view: int
    """Index of the camera whose picture shows the person largest."""
    number: int
    """Its source frame number."""
    box: tuple[int, int, int, int]
    """Left, top, right, bottom in that picture, captured px."""
    places: dict[int, tuple[np.ndarray, int]]
    """{source frame number: (middle [D], m in space, px of a single camera; cameras that agree on it)}."""

    @property
    def sentence(self) -> str:
        """`person1: in 3 of 3 frames that were looked at; cam01 3, cam02 3`."""
        seen = ", ".join(f"{camera} {count}" for camera, count in self.cameras.items())
        return (
            f"{self.name}: in {self.frames} of {self.of_frames} frames that were looked at; pictures by camera: {seen}"
        )


def who_is_who(people: Sequence[Portrait], findings: Sequence[Finding]) -> list[str]:
    """A sentence a person where there are several; before them, where `findings` know of no second one, how they are
    told apart."""
    if len(people) < 2:
        return []
    known = any(f.measure == PEOPLE and f.value for f in findings)
    apart = (
        f"people by place: {len(people)}, though no picture that was looked at shows two: cameras see different people,"
        f" or a detector errs{_or_the_calibration(findings)}"
    )
    return [*([] if known else [apart]), *(p.sentence for p in people)]


def told_by_place(report: Report, people: Sequence[Portrait]) -> Report:
    """The same report, whose finding on people, where no picture shows two, tells of the nearest two that `AGREE`
    cameras each place apart: of people who touch, a detector often finds the nearer one alone."""
    apart = [found for a, b in combinations(people, 2) if (found := _nearest(a, b)) is not None]
    if not apart or any(f.measure == PEOPLE and f.value for f in report.findings):
        return report
    distance, number, a, b = min(apart, key=lambda found: found[0])
    told = (
        f"two people stand {distance:.1f} m apart in frame {number}: {a.name}, on whom {a.places[number][1]} cameras"
        f" agree, and {b.name}, on whom {b.places[number][1]} do, though no picture that was looked at shows two: some"
        f" cameras show the nearer one alone{_or_the_calibration(report.findings)}; one is reconstructed: who is in"
        " most pictures and largest in them, or whom pose.subject names"
    )
    finding = of_places(report.planned, report.footage.names[b.view], len(people), told)
    return replace(report, findings=tuple(finding if f.measure == PEOPLE else f for f in report.findings))


def _nearest(a: Portrait, b: Portrait) -> tuple[float, int, Portrait, Portrait] | None:
    """(m, source frame number, the two) where two people are nearest of the frames in which both are agreed on."""
    both = [n for n in a.places if n in b.places and min(a.places[n][1], b.places[n][1]) >= AGREE]
    found = [(float(np.linalg.norm(a.places[n][0] - b.places[n][0])), n) for n in both]
    return (*min(found), a, b) if found else None


def _or_the_calibration(findings: Sequence[Finding]) -> str:
    """That it may be one person whom cameras place differently, where what they see does not fit the calibration."""
    off = [f.measure for f in findings if f.measure in MISFITS and f.verdict in TO_MEND]
    return f", or the calibration is off and they place one differently ({', '.join(dict.fromkeys(off))})" * bool(off)


def portraits(footage: Footage) -> list[Portrait]:
    """Everybody on whom two believed cameras agree (of a single camera everybody), in `footage.looked_at`, by the
    estimator where it is here, else by the joints that came with the capture; nobody where there is neither."""
    kind = "found" if "found" in footage.readers else "joints" if JOINTS2D in footage.facts else None
    if kind is None:
        return []
    numbers = sorted(footage.looked_at)
    times = np.array(numbers) / footage.frame_rate
    seen = [[_captured(footage, kind, v, n) for v in range(len(footage.rig))] for n in numbers]
    crops = footage.captured_to_calibrated if kind == "found" else footage.joint_crops
    frames = (
        (f, float(times[f]), [_in_rig(footage, crops[v], v, p) for v, p in enumerate(people)])
        for f, people in enumerate(seen)
    )
    found = Everybody.of(footage.rig, frames, times, GAP, least=1)
    taken: dict[tuple[int, int], list[np.ndarray]] = defaultdict(list)
    for v, wanted in found.look_at().items():
        for f, people in wanted.items():
            picture = footage.raw(v, numbers[f])
            for index, number, piece in people:
                taken[number, piece].append(look(picture, seen[f][v][index]))
    found.settle({key: together(looks) for key, looks in taken.items()}, GAP)
    return [_portrait(footage, found, seen, numbers, n) for n in range(len(found.places))]


def _captured(footage: Footage, kind: str, view: int, number: int) -> np.ndarray:
    """[P, 17, 3] COCO-17 of everybody in a picture, captured px; nobody where a camera lacks it or is not believed."""
    if number not in footage.numbers[view] or view not in footage.believed:
        return np.zeros((0, 17, 3))
    reader = footage.source(kind)
    found = np.asarray(reader.read(view, number), dtype=np.float64)[:CANDIDATES]
    if not found.size:
        return np.zeros((0, 17, 3))
    joints = to_set(found, reader.joint_set, "coco17")
    return np.where(np.isfinite(joints).all(axis=-1, keepdims=True), joints, 0.0)


def _in_rig(footage: Footage, crop: np.ndarray, view: int, people: np.ndarray) -> np.ndarray:
    """The same in pixels of `footage.rig`; score 0 where the lens maps a joint nowhere."""
    pixels, mapped = to_frames(people[..., :2], crop, footage.source_rig, footage.rig, view)
    return np.concatenate([pixels, np.where(mapped, people[..., 2], 0.0)[..., None]], axis=-1)


def _portrait(
    footage: Footage, found: Everybody, seen: list[list[np.ndarray]], numbers: list[int], person: int
) -> Portrait:
    where = np.argwhere(found.numbers == person)
    f, v, i = max(where.tolist(), key=lambda at: (float(found.spans[tuple(at)]), [-n for n in at]))
    joints = seen[f][v][i]
    known = joints[joints[:, 2] > 0, :2]
    around = AROUND * np.linalg.norm(np.ptp(known, axis=0))
    size = footage.captured[v]
    low, high = np.clip(known.min(axis=0) - around, 0, size), np.clip(known.max(axis=0) + around, 0, size)
    count = Counter(int(view) for _, view, _ in where)
    return Portrait(
        name_of(person),
        len(np.unique(where[:, 0])),
        len(numbers),
        {footage.names[view]: count[view] for view in sorted(count)},
        v,
        numbers[f],
        (int(low[0]), int(low[1]), int(np.ceil(high[0])), int(np.ceil(high[1]))),
        {numbers[f]: (middle, int((where[:, 0] == f).sum())) for f, middle in found.places[person]},
    )
