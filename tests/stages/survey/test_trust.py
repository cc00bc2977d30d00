"""The vote of pairs: who is wrong, when nobody can tell, and who cannot be accused."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.trust import CameraVerdict, Told, asks, judged_cameras
from posegaussian.stages.inspection.trust import of_trust
from posegaussian.stages.survey.measures.agreement import NAME
from posegaussian.stages.survey.measures.contrast import CONTRAST, UNKNOWN
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.trust import TRUST

FEATURES, OUTLINES, JOINTS = range(3)
OFF = {FEATURES: 0.02, OUTLINES: 0.02, JOINTS: 0.03}


def notes(count: int) -> np.ndarray:
    """[S, S, 3, 2] of cameras that share nothing."""
    return np.zeros((count, count, 3, 2))


def told(pairs: np.ndarray, kind: int, a: int, b: int, off: float) -> None:
    pairs[min(a, b), max(a, b), kind] = off, 20


def parties(count: int, wrong: set[int], kind: int = OUTLINES) -> np.ndarray:
    """Two parties, each of which agrees within itself."""
    pairs = notes(count)
    for a in range(count):
        for b in range(a + 1, count):
            told(pairs, kind, a, b, OFF[kind] if (a in wrong) != (b in wrong) else 0.0)
    return pairs


def judged(
    pairs: np.ndarray, standing: np.ndarray, setting: object = "auto", contrast: np.ndarray | None = None
) -> list[CameraVerdict]:
    names = tuple(f"c{i}" for i in range(len(pairs)))
    noted = {NAME: pairs, STANDING: standing, CONTRAST: np.full(len(pairs), 100.0) if contrast is None else contrast}
    found = judged_cameras(TRUST, names, setting, noted)  # type: ignore[arg-type]
    return [found[n] for n in names]


def left_out(pairs: np.ndarray, setting: object = "auto") -> set[int]:
    found = judged(pairs, np.zeros((len(pairs), 5)), setting)
    return {i for i, verdict in enumerate(found) if verdict.state == "left out"}


def test_the_larger_party_is_believed_whoever_comes_first() -> None:
    for kind in OFF:
        for count, wrong in ((3, {0}), (8, {2}), (10, {7, 8, 9}), (9, {0, 1, 2, 3})):
            assert left_out(parties(count, wrong, kind)) == wrong


def test_equal_parties_are_both_believed() -> None:
    assert left_out(parties(4, {0, 1})) == set()
    assert left_out(parties(6, {1, 3, 5})) == set()
    assert left_out(parties(2, {0})) == set()


def test_who_shares_nothing_with_anybody_is_not_accused() -> None:
    assert left_out(notes(6)) == set()
    pairs = parties(6, {2})
    pairs[5], pairs[:, 5] = 0, 0
    assert left_out(pairs) == {2}


def test_a_single_accuser_is_no_majority() -> None:
    pairs = parties(6, set())
    told(pairs, OUTLINES, 1, 4, OFF[OUTLINES])
    assert left_out(pairs) == set()
    alone = notes(5)
    told(alone, OUTLINES, 0, 1, OFF[OUTLINES])
    assert left_out(alone) == set()


def test_masks_or_joints_alone_do_not_outvote_features_and_both_together_do() -> None:
    """A mask that is wrong, or a detector; a camera that is out of step before a background that stands still."""
    right = parties(6, set(), FEATURES)
    for kinds, expected in (((OUTLINES,), set()), ((JOINTS,), set()), ((OUTLINES, JOINTS), {3})):
        pairs = right.copy()
        for kind in kinds:
            pairs[:, :, kind] = parties(6, {3}, kind)[:, :, kind]
        assert left_out(pairs) == expected


def test_a_camera_whose_features_agree_is_told_that_its_masks_may_be_what_is_wrong() -> None:
    """Of a ring of twelve features tell of neighbours alone, and the outlines of one mask contradict all; where it is
    known to lack something the camera stays."""
    pairs = parties(12, {3})
    for a in range(12):
        for b in ((a + 1) % 12, (a + 2) % 12):
            told(pairs, FEATURES, a, b, 0.0)
    found = judged(pairs, np.zeros((12, 7)))
    assert [v.camera for v in found if v.state == "left out"] == ["c3"]
    assert "its features agree with 4 of these and contradict none" in found[3].sentence
    assert "its masks or its moment" in found[3].sentence
    lacking = np.zeros((12, 7))
    lacking[3, 4] = Told.LACKING
    kept = judged(pairs, lacking)
    assert [v.state for v in kept] == ["believed"] * 12
    assert "its masks lack something" in kept[3].sentence
    told(pairs, FEATURES, 3, 4, OFF[FEATURES])
    for standing in (np.zeros((12, 7)), lacking):
        against = judged(pairs, standing)[3]
        assert against.state == "left out"
        assert "its masks" not in against.sentence
    advice = [of_trust({"c3": verdict})[0].advice for verdict in (found[3], kept[3], against)]
    assert "look at its masks" in advice[0]
    assert "complete its masks" in advice[1]
    assert "calibrate it again" in advice[2]


def test_what_silhouettes_say_turns_a_camera_or_leaves_it_out_whatever_lies_on_its_lines() -> None:
    turn, standing = (0.0, 0.02, 0.001), np.zeros((6, 7))
    standing[2, :4], standing[4, 3:5] = (*turn, 0.01), (0.02, Told.WRONG)
    found = judged(parties(6, set()), standing)
    assert [v.state for v in found] == ["believed", "believed", "believed", "believed", "left out", "believed"]
    assert [i for i, v in enumerate(found) if v.turn.any()] == [2]
    assert tuple(found[2].turn) == turn
    assert "turned by 1.15 degrees" in found[2].sentence
    assert "1.00 % of the picture's longer side" in found[2].sentence
    assert "however it is turned" in found[4].sentence
    assert "its silhouette lies" in found[2].sentence
    assert [i for i, v in enumerate(found) if v.overruled] == [2, 4]
    standing[2, 4] = Told.BY_JOINTS
    by_joints = judged(parties(6, set()), standing)[2]
    assert (by_joints.state, tuple(by_joints.turn)) == ("believed", turn)
    assert "its joints lie" in by_joints.sentence


def test_two_cameras_whose_files_are_exchanged_are_told_so() -> None:
    standing = np.zeros((6, 7))
    standing[1, 3:5], standing[4, 3:5] = (0.02, Told.EXCHANGED), (0.03, Told.EXCHANGED)
    found = judged(parties(6, set()), standing)
    assert [v.state for v in found].count("left out") == 2
    assert "in the place of c4" in found[1].sentence
    assert "in the place of c1" in found[4].sentence


def test_a_camera_whose_pictures_are_mirrored_is_told_so() -> None:
    standing = np.zeros((6, 7))
    standing[2, 3:5], standing[4, 3:5] = (0.02, Told.MIRRORED), (0.02, Told.WRONG)
    found = judged(parties(6, set()), standing)
    assert [v.state for v in found].count("left out") == 2
    assert found[2].sentence.endswith("its pictures seem mirrored")
    assert "mirrored" not in found[4].sentence


def test_a_camera_whose_pictures_are_upside_down_is_left_out_with_what_to_do() -> None:
    standing = np.zeros((6, 7))
    standing[2, 3:5] = 0.33, Told.UPSIDE_DOWN
    found = judged(parties(6, set()), standing)
    assert [v.state for v in found].index("left out") == 2
    assert "joints lie 33.00 % of the picture's longer side beside those of the others" in found[2].sentence
    assert "(ffmpeg -i IN -vf hflip,vflip OUT)" in found[2].sentence


def test_a_camera_that_was_moved_in_mid_take_is_left_out_and_the_moment_is_said() -> None:
    standing = np.zeros((6, 7))
    standing[3] = 0.0, 0.02, 0.0, 0.04, Told.MOVED, 120, 124
    found = judged(parties(6, set()), standing)
    assert [v.state for v in found].index("left out") == 3
    assert not found[3].turn.any()
    assert "moved by 1.15 degrees between frames 120 and 124" in found[3].sentence
    assert found[3].belief is not None
    assert found[3].belief.measured is not None
    assert found[3].belief.measured > 0.3


def test_a_camera_that_is_out_of_step_is_left_out_and_what_to_set_is_said() -> None:
    standing = np.zeros((6, 7))
    for late, said in (
        (1.0, "what it shows 1 frame later does not: it seems late by 1 frame; set frames.time_offset: {c3: 1}"),
        (-2.0, "2 frames earlier does not: it seems early by 2 frames; set frames.time_offset: {c3: -2}"),
        (0.5, "half a frame later does not: it seems late by half a frame, and half a frame cannot be corrected"),
        (1.5, "late by 1.5 frames; set frames.time_offset: {c3: 1.5}, and half a frame cannot be corrected"),
    ):
        standing[3, 3:6] = 0.02, Told.LATE, late
        found = judged(parties(6, set()), standing)
        assert [v.camera for v in found if v.state == "left out"] == ["c3"]
        assert found[3].sentence.endswith(said)
        assert "2.00 % of the picture's longer side" in found[3].sentence
        assert "bring it into step" in of_trust({"c3": found[3]})[0].advice


def test_a_camera_that_its_lines_accuse_all_the_same_is_left_out_and_not_turned() -> None:
    standing = np.zeros((8, 7))
    standing[2, 1] = 0.02
    found = judged(parties(8, {2}), standing)
    assert found[2].state == "left out"
    assert not found[2].turn.any()


def test_who_is_forced_is_believed_as_it_stands() -> None:
    standing = np.zeros((6, 7))
    standing[2, 1], standing[4, 3:5] = 0.02, (0.02, 1)
    found = judged(parties(6, set()), standing, ["c2", "c4"])
    assert [v.state for v in found] == ["believed"] * 6
    assert found[2].turn.any()
    assert not found[4].turn.any()


def test_the_survey_is_asked_only_where_it_has_a_say() -> None:
    assert asks(TRUST, ("a", "b", "c"), "auto")
    assert asks(TRUST, ("a", "b", "c"), ["a"])
    assert not asks(TRUST, ("a", "b"), "auto")
    assert not asks(TRUST, ("a", "b", "c"), "all")
    assert not asks(TRUST, ("a", "b", "c"), ["c", "b", "a"])
    assert left_out(parties(8, {2}), "all") == set()
    assert left_out(parties(8, {2}), ["c2"]) == set()
    assert left_out(parties(8, {2}), ["c1"]) == {2}


def test_a_camera_whose_pictures_show_nothing_is_left_out_where_the_others_show_something() -> None:
    """However well its lines agree; dull pictures of all cameras accuse nobody, nor does an empty mask."""

    def blank(*contrast: float) -> list[int]:
        found = judged(parties(len(contrast), set()), np.zeros((len(contrast), 5)), contrast=np.array(contrast))
        return [i for i, verdict in enumerate(found) if verdict.state == "left out"]

    assert blank(100, 0, 90, 80, 120, 70) == [1]
    assert blank(100, 11, 90, 1, 120) == [1, 3]
    assert blank(100, 13, 90, 80, 120, 70) == []
    assert blank(20, 0, 30, 25, 22, 21) == []
    assert blank(100, 0, 0, 90) == []
    assert blank(100, UNKNOWN, 90, 80) == []
    sentence = judged(parties(4, set()), np.zeros((4, 5)), contrast=np.array([100.0, 0, 90, 80]))[1].sentence
    assert "show nothing" in sentence
    assert "0.0 of 255, of the other cameras by 90" in sentence
