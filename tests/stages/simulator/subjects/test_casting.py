"""What is kept for measuring and for validation is seen nowhere else."""

from typing import Any

import pytest

from posegaussian.stages.simulator.effects.second_person import SecondPerson, apply
from posegaussian.stages.simulator.scene import Scene, faults
from posegaussian.stages.simulator.setup import play
from posegaussian.stages.simulator.subjects.motion_names import MOTION_NAMES, VALIDATION_MOTION
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS
from posegaussian.stages.simulator.subjects.splits import (
    FIRST_KEPT_SEED,
    FIRST_VALIDATION_SEED,
    KEPT_OUTFITS,
    KEPT_SUBJECTS,
    OPEN_OUTFITS,
    OPEN_SUBJECTS,
    VALIDATION_SUBJECT,
    cast,
    casting,
    refusal,
)


def test_everybody_is_open_kept_or_for_validation() -> None:
    assert sorted((*OPEN_SUBJECTS, *KEPT_SUBJECTS, VALIDATION_SUBJECT)) == sorted(LOOKS)
    assert sorted((*OPEN_OUTFITS, *KEPT_OUTFITS)) == sorted(OUTFITS)
    assert len(OPEN_SUBJECTS) == len(KEPT_SUBJECTS) == len(OPEN_OUTFITS) == len(KEPT_OUTFITS) == 4


@pytest.mark.parametrize(
    ("seeds", "subjects", "outfits"),
    [
        (range(1, 100), OPEN_SUBJECTS, OPEN_OUTFITS),
        (range(7900, FIRST_VALIDATION_SEED), OPEN_SUBJECTS, OPEN_OUTFITS),
        (range(FIRST_VALIDATION_SEED, FIRST_KEPT_SEED), (VALIDATION_SUBJECT,), OPEN_OUTFITS),
        (range(FIRST_KEPT_SEED, FIRST_KEPT_SEED + 100), KEPT_SUBJECTS, KEPT_OUTFITS),
    ],
)
def test_a_seed_shows_only_whom_it_may(seeds: range, subjects: tuple[str, ...], outfits: tuple[str, ...]) -> None:
    seen = {cast(s) for s in seeds}
    assert seen == {(a, b) for a in subjects for b in outfits}, "and every pair of them"
    for s in seeds:
        assert (VALIDATION_MOTION in casting(s).motions) == (FIRST_VALIDATION_SEED <= s < FIRST_KEPT_SEED)
        assert not [n for n in cast(s) if refusal(s, n)]


def test_the_second_person_of_a_scene_is_cast_by_the_same_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[str, str]] = []
    monkeypatch.setattr(
        "posegaussian.stages.simulator.wardrobe.actors.Performer", lambda who, what, *rest: seen.append((who, what))
    )
    for seeds, subjects, outfits in (
        (range(1, 60), OPEN_SUBJECTS, OPEN_OUTFITS),
        (range(9000, 9060), KEPT_SUBJECTS, KEPT_OUTFITS),
    ):
        seen.clear()
        for s in seeds:
            apply(SecondPerson(), s)
            assert not {*seen[-1]} & {*cast(s)}, "somebody else, in other clothes"
        assert {w for w, _ in seen} == set(subjects)
        assert {o for _, o in seen} == set(outfits)


def told(**scene: Any) -> list[tuple[str, str]]:
    return [(".".join(map(str, place)), why) for place, why in faults(Scene.model_validate(scene))]


def test_naming_what_is_kept_in_another_scene_is_a_fault() -> None:
    assert [p for p, _ in told(seed=4, subject={"person": "gao", "outfit": "dots"})] == [
        "subject.person",
        "subject.outfit",
    ]
    assert "seed from 9000 on; this seed is 8999" in told(seed=8999, subject={"person": "gao"})[0][1]
    assert [p for p, _ in told(seed=9000, subject={"person": "ines"}, motion="throw")] == [
        "subject.person",
        "motion.name",
    ]
    assert [p for p, _ in told(seed=4, effects={"second_person": {"motion": "throw"}})] == [
        "effects.second_person.motion"
    ]
    assert not told(seed=9000, subject={"person": "gao", "outfit": "dots"})
    assert not told(seed=8000, subject={"person": "ines"}, motion="throw")
    for name in (*OPEN_SUBJECTS, *OPEN_OUTFITS, *(m for m in MOTION_NAMES if m != VALIDATION_MOTION)):
        assert all(refusal(s, name) is None for s in (0, 8000, 9000)), "what is open may be named anywhere"


def test_a_scene_is_played_by_whom_it_casts() -> None:
    scene = Scene.model_validate({"seed": 9001})
    assert (
        play(scene).mesh
        is play(
            Scene.model_validate({"seed": 9001, "subject": dict(zip(("person", "outfit"), cast(9001), strict=True))})
        ).mesh
    )
