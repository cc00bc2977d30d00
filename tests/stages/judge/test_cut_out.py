"""Who the subject is on the judge's frames: the masks are the run's own, and what limbs do is decided as in a run."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from posegaussian.dags.inspection.judged import left_out_views
from posegaussian.dags.planning.results import Results
from posegaussian.dags.runtime.events import EffectsDecided
from posegaussian.stages.contract.facts import JOINTS2D, SEGMENTED, Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.judged import DEPTH, GIVEN_MATTE, PERSON_MATTE
from posegaussian.stages.depth.choice import tried
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.judge import footage
from posegaussian.stages.judge import run as judge
from posegaussian.stages.judge.body import body_facts
from posegaussian.stages.judge.footage import spread
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from tests.support.pipeline import Pipeline, film


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, list, Frames, list[int]]:
    """A run of a capture without masks, its events, the frames that its judge looked at, and by how many frames joints
    of these were bridged."""
    folder, seen, bridged = tmp_path_factory.mktemp("plain"), [], []
    film(folder / "capture", views=4, frames=2, held_out=0, masks=False, depth=False)
    settings = ["depth.method=auto", "frames.range=0:1", "judge.views=3"]
    p = Pipeline(folder / "archive", folder / "capture", settings, held_out="[]")
    p.register()
    with pytest.MonkeyPatch.context() as patch:
        original = judge.frames_of
        patch.setattr(judge, "frames_of", lambda *a: seen.append(original(*a)) or seen[-1])
        posed = footage.pose_of
        patch.setattr(footage, "pose_of", lambda few, given: bridged.append(given.bridge) or posed(few, given))
        before = left_out_views(p.plan().context)
        assert "was not measured" in before
        events = p.run()
    return p, events, seen[0], bridged


def test_joints_of_a_few_frames_far_apart_are_not_bridged(plain: tuple[Pipeline, list, Frames, list[int]]) -> None:
    p, *_, bridged = plain
    assert p.plan().context.settings.pose.bridge > 0
    assert set(bridged) == {0}


def test_masks_of_the_judge_are_those_of_the_run(plain: tuple[Pipeline, list, Frames, list[int]]) -> None:
    """The pictures are smaller than the judge's, so that both work at one size; one frame, so that no other helps."""
    results, few = Results(plain[0].plan().context), plain[2]
    for v in few.views.sources:
        for name in ("frames/mask", "frames/color"):
            np.testing.assert_array_equal(few.read(name, v), results.read(name, range(1), v))
        assert few.read("frames/mask", v).any()


def test_a_capture_without_masks_is_judged(plain: tuple[Pipeline, list, Frames, list[int]]) -> None:
    p, events, *_ = plain
    told = [s for e in events if isinstance(e, EffectsDecided) for s in e.sentences]
    assert any(s.startswith("depth.method: left-out source views") for s in told)
    plan = p.plan()
    assert plan.all_fresh
    asked = [m in tried(plan.context.rig, range(4)) for m in BY_PICTURES]
    assert any(asked)
    np.testing.assert_array_equal((plan.context.noted[DEPTH][:3] >= 0).all(axis=-1), [asked] * 3)


def test_inspection_says_what_was_measured_and_else_how_to(
    plain: tuple[Pipeline, list, Frames, list[int]],
) -> None:
    p = plain[0]
    assert left_out_views(p.plan().context).startswith("measured: left-out source views")
    assert "cannot be measured" in left_out_views(p.with_settings("frames.matte=none").plan().context)


def test_limbs_count_where_joints_fit_and_close_gaps_between_cameras_that_stand_apart() -> None:
    def facts(views: int, share: float, *known: str) -> set[str]:
        rig = capture_person(views=views, size=16, frames=1, held_out=0, motion="kick").rig
        sources = tuple(range(views))
        fit = np.array([0.01, share, 12.0])
        inputs = SimpleNamespace(
            rig=rig, views=Views(rig.names, sources, ()), facts=Facts(frozenset(known)), read=lambda a, v: fit
        )
        return set(body_facts(inputs, "sweep"))  # type: ignore[arg-type]

    person = PERSON_MATTE, JOINTS2D, SEGMENTED
    assert facts(4, 0.9, *person) == {"limb_bounds", "surface_closing", "hole_filling"}
    assert facts(8, 0.9, *person) == {"limb_bounds", "hole_filling"}, "45 degrees apart"
    assert facts(4, 0.4, *person) == {"hole_filling"}, "joints do not fit"
    assert facts(4, 0.9, GIVEN_MATTE, JOINTS2D) == set()


def test_the_judge_s_frames_are_as_many_as_there_can_be_and_none_twice() -> None:
    """A video is read in order: a frame that is asked for twice would end the run."""
    for frames in range(61):
        for most in range(1, 26):
            at = spread(frames, most)
            assert len(at) == min(frames, most)
            assert (np.diff(at) > 0).all()
            assert not len(at) or (at[0] == frames - 1 - at[-1]) or abs(at[0] - (frames - 1 - at[-1])) <= 1
