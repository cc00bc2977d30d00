"""Nobody and nothing that is kept for measuring is ever trained on; a scene follows from its seed."""

import numpy as np
import pytest

from posegaussian.stages.simulator.scene import Arc, Person
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.subjects.motion_names import VALIDATION_MOTION
from posegaussian.stages.simulator.subjects.splits import (
    FIRST_KEPT_SEED,
    FIRST_VALIDATION_SEED,
    KEPT_OUTFITS,
    KEPT_SUBJECTS,
    VALIDATION_SUBJECT,
    cast,
    refusal,
)
from posegaussian.stages.simulator.wardrobe.description import NOTHING
from posegaussian.stages.training.frames import neighbours
from posegaussian.stages.training.scenes import training_scene

TRAINED = range(200)
VALIDATED = range(FIRST_VALIDATION_SEED, FIRST_VALIDATION_SEED + 21)


@pytest.fixture(scope="module")
def shown() -> dict[int, tuple[str, str, str]]:
    """Subject, outfit and motion of every scene, as they are filmed."""
    found = {}
    for seed in (*TRAINED, *VALIDATED):
        scene = training_scene(seed, 2, (3, 6), 64)
        assert isinstance(scene.subject, Person)
        assert not any(refusal(seed, n) for n in (scene.subject.person, scene.subject.outfit, scene.motion.name))
        found[seed] = (*cast(scene.seed, scene.subject.person, scene.subject.outfit), scene.motion.name)
    return found


def test_nothing_kept_for_measuring_appears(shown: dict[int, tuple[str, str, str]]) -> None:
    for seed, (subject, outfit, _) in shown.items():
        assert subject not in KEPT_SUBJECTS, seed
        assert outfit not in KEPT_OUTFITS, seed


def test_validation_shows_a_subject_and_a_motion_that_training_never_does(
    shown: dict[int, tuple[str, str, str]],
) -> None:
    assert not any(shown[s][0] == VALIDATION_SUBJECT or shown[s][2] == VALIDATION_MOTION for s in TRAINED)
    assert all(shown[s][0] == VALIDATION_SUBJECT for s in VALIDATED)
    assert all(shown[s][2] == VALIDATION_MOTION for s in VALIDATED if s % 2)
    assert len({shown[s][0] for s in TRAINED}) >= 4
    assert len({shown[s][2] for s in TRAINED}) >= 4


@pytest.mark.parametrize("seed", [FIRST_KEPT_SEED, FIRST_KEPT_SEED + 7, 10**6, -1])
def test_seeds_kept_for_measuring_are_refused(seed: int) -> None:
    with pytest.raises(ValueError, match="kept for measuring"):
        training_scene(seed, 2, (6,), 64)


def test_a_scene_follows_from_its_seed_and_validation_is_exact() -> None:
    assert training_scene(5, 2, (6, 8), 64) == training_scene(5, 2, (6, 8), 64)
    assert training_scene(5, 2, (6, 8), 64) != training_scene(6, 2, (6, 8), 64)
    effects = {
        s: {name for name, on in training_scene(s, 1, (6,), 64).effects if on is not None}
        for s in (*TRAINED, *VALIDATED)
    }
    assert all(effects[s] == {"ambient_occlusion"} for s in VALIDATED)
    spoilt = sum(len(effects[s]) > 1 for s in TRAINED)
    assert 0.2 < spoilt / len(TRAINED) < 0.85


def test_half_of_the_trained_people_are_dressed_as_captured_ones_and_no_validated_one() -> None:
    people = {s: training_scene(s, 1, (6,), 64).subject for s in (*TRAINED, *VALIDATED)}
    dressed = {s: p.extras() != NOTHING for s, p in people.items() if isinstance(p, Person)}
    assert not any(dressed[s] for s in VALIDATED)
    # five standard errors of 200 draws of 0.5
    assert sum(dressed[s] for s in TRAINED) / len(TRAINED) == pytest.approx(0.5, abs=0.18)
    own = [p for p in people.values() if isinstance(p, Person)]
    assert {s.kind for p in own for s in p.straps} == {"sash", "harness", "belt", "thighs", "bracers"}
    assert {c.thing for p in own for c in p.carries} == {"helmet", "bag", "board"}
    assert any(p.hair.strands for p in own)


def test_a_third_of_the_trained_rigs_are_arcs_that_lean_and_no_validated_one() -> None:
    found = {s: training_scene(s, 1, (4, 8, 16), 64) for s in (*TRAINED, *VALIDATED)}
    leaning = {s: scene for s, scene in found.items() if isinstance(scene.rig, Arc)}
    assert not leaning.keys() & set(VALIDATED)
    # four standard errors of 200 draws of 0.35
    assert len(leaning) / len(TRAINED) == pytest.approx(0.35, abs=0.14)
    assert {scene.rig.tilt > 0 for scene in leaning.values()} == {True, False}
    for scene in leaning.values():
        effects = {name for name, on in scene.effects if on is not None}
        assert not effects & {"background_room", "cast_shadow"}, "cameras under the floor would see it from below"


def test_pairs_of_a_leaning_arc_are_its_neighbours_and_run_diagonally() -> None:
    seed = next(s for s in TRAINED if isinstance(training_scene(s, 1, (8,), 64).rig, Arc))
    scene = training_scene(seed, 1, (8,), 64)
    assert isinstance(scene.rig, Arc)
    staged = stage(scene)
    rig, sources = staged.written, staged.sources
    assert sources == scene.rig.cameras
    assert len(rig) == 2 * sources - 1
    pairs = neighbours(rig, sources, closed=False)
    assert [tuple(p[:2]) for p in pairs] == [(i, i + 1) for i in range(sources - 1)], "the ends are no pair"
    assert len(set(pairs[:, 2])) == sources - 1
    rise = np.abs(np.diff(rig.centres[:sources, 2]))
    lean = np.degrees(np.arcsin(rise / np.linalg.norm(np.diff(rig.centres[:sources], axis=0), axis=1)))
    # an arc's chords lean as it does in its middle, less towards its ends
    assert lean.max() > 0.5 * abs(scene.rig.tilt)
