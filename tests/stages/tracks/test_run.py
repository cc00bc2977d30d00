"""The tracks stage: the same bytes however many frames are in memory, the subject by name, and sentences on who there
is."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.people.params import PeopleParams
from posegaussian.stages.people.stage import STAGE as PEOPLE
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE as POSE
from posegaussian.stages.tracks import run as kernel
from posegaussian.stages.tracks.params import TracksParams
from posegaussian.stages.tracks.stage import STAGE
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import ConfigError
from tests.stages.following.test_following import People, crossing, filmed
from tests.support.memory_inputs import MemoryInputs, run_stage
from tests.support.walking_skeleton import ring, roles

RIG = ring(4, size=512, focal=0.9, radius=3.5)
FRAMES = 16
FACTS = frozenset({"joints2d", "detected", "tracked", "several_frames"})
SHIRTS = ((200, 40, 40), (40, 60, 200))


class Pictures:
    """Everybody's detections painted in the colour of their clothes."""

    def __init__(self, people: People, order: np.ndarray) -> None:
        self.people, self.order, self.read_of = people, order, list[tuple[int, int]]()

    def read(self, view: int, numbers: list[int]) -> Any:
        for n in numbers:
            self.read_of.append((view, n))
            picture = np.full((512, 512, 3), 120, np.uint8)
            for i, joints in enumerate(self.people[n][view]):
                hull = cv2.convexHull(np.rint(joints[:, :2]).astype(np.int32))
                cv2.fillConvexPoly(picture, hull, SHIRTS[int(self.order[n, view, i])])
            yield picture


def detected(people: People) -> np.ndarray:
    """[F, V, 3, 17, 3] as the detection stage writes it."""
    out = np.zeros((len(people), len(people[0]), 3, 17, 3), np.float32)
    for f, views in enumerate(people):
        for v, found in enumerate(views):
            out[f, v, : len(found)] = found
    return out


def followed(people: People, order: np.ndarray, rig: Rig = RIG) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    arrays = {"detection/joints2d": detected(people)}
    sources = {"pictures": Pictures(people, order)}
    frames = len(people)
    inputs = MemoryInputs(
        STAGE, TracksParams(), arrays, rig, roles(rig), range(frames), frames, sources=sources, facts=FACTS
    )
    blocks = list(kernel.run(inputs, TracksParams()))
    return {b.array: b.data for b in blocks}, tuple(n for b in blocks for n in b.notes)


@pytest.fixture(scope="module")
def scene() -> tuple[People, np.ndarray]:
    return filmed(crossing(FRAMES), RIG)


def test_blocks_of_any_length_give_the_same_bytes(
    scene: tuple[People, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, told = followed(*scene)
    monkeypatch.setattr(kernel, "BLOCK", 5)
    again, _ = followed(*scene)
    assert all(np.array_equal(again[name], whole[name]) for name in whole)
    assert int(whole["tracks/choice"][2]) == 2
    (sentence,) = told
    assert "2 people are followed: person1 in 100% of the frames" in sentence


@pytest.mark.parametrize("length", [3, 16])
@pytest.mark.parametrize("who", ["person1", "person2"])
def test_pose_takes_the_person_it_was_told_in_every_frame_and_view(
    scene: tuple[People, np.ndarray], who: str, length: int
) -> None:
    people, order = scene
    tracks, _ = followed(people, order)
    arrays: dict[str, np.ndarray] = {"detection/joints2d": detected(people), **tracks}
    arrays |= run_stage(PEOPLE, PeopleParams(), arrays, RIG, roles(RIG), FRAMES, length=length, facts=FACTS)
    out = run_stage(
        POSE,
        PoseParams(subject=who, heatmaps="drawn"),
        arrays,
        RIG,
        roles(RIG),
        FRAMES,
        length=length,
        facts=FACTS | {"segmented"},
    )
    chosen = np.take_along_axis(order, out["pose/chosen"][..., None].astype(int), axis=2)[..., 0]
    assert len(np.unique(chosen)) == 1
    middle = np.median(out["pose/joints3d"][..., :2], axis=1)
    assert np.linalg.norm(np.diff(middle, axis=0), axis=1).max() < 0.3


def test_a_name_that_nobody_has_is_refused_with_those_there_are(scene: tuple[People, np.ndarray]) -> None:
    tracks, _ = followed(*scene)
    arrays: dict[str, np.ndarray] = {"detection/joints2d": detected(scene[0]), **tracks}
    arrays |= run_stage(PEOPLE, PeopleParams(), arrays, RIG, roles(RIG), FRAMES, facts=FACTS)
    with pytest.raises(ConfigError, match="called 'person3'; there are person1, person2"):
        run_stage(POSE, PoseParams(subject="person3"), arrays, RIG, roles(RIG), FRAMES, facts=FACTS)
    with pytest.raises(ValueError, match="subject"):
        PoseParams(subject="the tall one")


def test_pictures_are_looked_at_only_where_there_are_several_people(scene: tuple[People, np.ndarray]) -> None:
    people, order = scene
    alone = [[p[:1] if order[f, v, 0] == 0 else p[1:] for v, p in enumerate(views)] for f, views in enumerate(people)]
    pictures = Pictures(alone, order)
    inputs = MemoryInputs(
        STAGE,
        TracksParams(),
        {"detection/joints2d": detected(alone)},
        RIG,
        roles(RIG),
        range(FRAMES),
        FRAMES,
        sources={"pictures": pictures},
        facts=FACTS,
    )
    blocks = list(kernel.run(inputs, TracksParams()))
    assert not pictures.read_of
    assert not any(b.notes for b in blocks)
    assert int(blocks[-1].data[2]) == 1


@pytest.mark.parametrize("there", [(7,), (7, 8), (2, 13)])
def test_who_is_in_fewer_than_three_frames_is_followed_where_nobody_is_in_the_others(
    scene: tuple[People, np.ndarray], there: tuple[int, ...]
) -> None:
    """That no two cameras agreed was said, and the cameras were blamed."""
    people, order = scene
    few = [[p[order[f, v, : len(p)] == 0] for v, p in enumerate(views)] for f, views in enumerate(people)]
    few = [views if f in there else [found[:0] for found in views] for f, views in enumerate(few)]
    tracks, told = followed(few, np.zeros_like(order))
    assert not [t for t in told if "no two cameras agree" in t]
    assert (tracks["tracks/people"][list(there), :, 0] == 0).all()
    assert int(tracks["tracks/choice"][2]) == 1


def test_cameras_that_agree_on_nobody_are_said_so(scene: tuple[People, np.ndarray]) -> None:
    """Each shows somebody elsewhere in every frame."""
    people, order = scene
    off = np.zeros((len(people), len(RIG), 1, 17, 3))
    off[..., :2] = np.random.default_rng(0).uniform(-200, 200, off[..., :2].shape)
    astray = [[found[:1] + off[f, v] for v, found in enumerate(views)] for f, views in enumerate(people)]
    _, told = followed(astray, np.zeros_like(order))
    assert [t for t in told if "no two cameras agree" in t]
