"""The person as matte: cut out to the pixel from a poor hint, held to what other views confirm, and harmless where
little is known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posegaussian.stages.frames.bodies.body import body_shape
from posegaussian.stages.frames.params import FramesParams, better_matte, matte_choice
from posegaussian.stages.frames.person_matte import Known, person_matte
from posegaussian.stages.frames.stage import STAGE
from posegaussian.stages.pose.facts import HIDDEN
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.frame_readers import Pictures, overlap, wall
from tests.support.memory_inputs import run_stage
from tests.support.person_estimates import FACTS, hints_of, segmented
from tests.support.walking_skeleton import SKELETON

SIZE = 160
THRESHOLD, MARGIN = FramesParams().plate_threshold, FramesParams().hint_margin


def before_a_wall(frames: int = 1, views: int = 6) -> tuple[PersonCapture, np.ndarray]:
    """The person, filmed before a mottled wall [V, h, w, 3]."""
    person = capture_person(views, SIZE, frames, 0, motion="kick")
    walls = np.stack([wall(SIZE, v) for v in range(views)])
    noise = np.random.default_rng(5).normal(0, 2, person.color.shape)
    color = person.color + (1 - person.mask[..., None] / 255.0) * walls + noise
    return replace(person, color=np.clip(np.rint(color), 0, 255).astype(np.uint8)), np.clip(walls, 0, 255).astype(
        np.uint8
    )


def cut(person: PersonCapture, known: Known, view: int = 0, plate: np.ndarray | None = None) -> np.ndarray:
    spread = np.full((SIZE, SIZE), 2, np.uint8)
    found = person_matte(person.color[0, view], known, None if plate is None else (plate, spread), THRESHOLD, MARGIN)
    assert found is not None
    return found


@pytest.mark.parametrize(("plated", "least"), [(True, 0.98), (False, 0.92)])
def test_a_poor_hint_is_refined_to_the_pixel(plated: bool, least: float) -> None:
    size = 320
    y, x = np.mgrid[:size, :size] + 0.5
    truth = np.uint8(255) * (
        (np.hypot((x - 150) / 60, (y - 170) / 105) < 1) | ((np.abs(y - 120) < 16) & (x > 150) & (x < 275))
    )
    cloth = np.clip(np.array([60, 90, 190]) + np.random.default_rng(0).normal(0, 12, (size, size, 3)), 0, 255)
    ground = np.clip(wall(size, 3), 0, 255)
    picture = np.where(truth[..., None] > 0, cloth, ground).astype(np.uint8)
    # A hint of 32 cells, moved by 4 px and too wide by 3, as an estimator's may be.
    poor = np.roll(cv2.dilate(truth, np.ones((7, 7), np.uint8)), (4, -4), axis=(0, 1))
    hint = (
        cv2.GaussianBlur(
            cv2.resize(cv2.resize(poor, (32, 32), interpolation=cv2.INTER_AREA), (size, size)), (0, 0), 4
        ).astype(np.float32)
        / 255
    )
    known = Known(hint, np.zeros((17, 3)), "coco17", None, None)
    plate = (ground.astype(np.uint8), np.full((size, size), 2, np.uint8)) if plated else None
    found = person_matte(picture, known, plate, THRESHOLD, MARGIN)
    assert found is not None
    assert overlap((255 * hint).astype(np.uint8), truth) < 0.9
    assert overlap(found, truth) > least


def test_an_edge_is_as_soft_as_the_pixels_are_covered() -> None:
    person, walls = before_a_wall()
    found = cut(person, hints_of(person, segmented(person), 0).known(0, 0), plate=walls[0])
    truth = person.mask[0, 0]
    rim = (truth > 20) & (truth < 235)
    # Colours alone do not tell a covered share exactly; a hard mask would be off by 64 on average.
    assert np.abs(found[rim].astype(float) - truth[rim]).mean() < 55
    assert overlap(found, truth) > 0.96


def test_what_no_other_view_confirms_goes_and_what_they_confirm_stays() -> None:
    person, _ = before_a_wall()
    arrays = segmented(person)
    phantom = np.zeros((SIZE, SIZE), bool)
    phantom[20:60, 8:28] = True
    assert not (phantom & (person.mask[0, 0] > 0)).any()
    # An onlooker in the same clothes, segmented with the subject in one view.
    person.color[0, 0][phantom] = person.color[0, 0][person.mask[0, 0] == 255][: phantom.sum()]
    arrays["detection/person"][0, 0, 0] = np.maximum(
        arrays["detection/person"][0, 0, 0], cv2.resize(255 * phantom.astype(np.uint8), (256, 256))
    )
    together = hints_of(person, arrays, 0).known(0, 0)
    alone = replace(together, possible=None, confirmed=None)
    assert (cut(person, alone)[phantom] > 127).mean() > 0.8
    found = cut(person, together)
    assert (found[phantom] > 127).mean() < 0.01
    assert overlap(found, person.mask[0, 0]) > 0.9


def test_a_limb_that_only_the_own_segmentation_misses_comes_back() -> None:
    person, walls = before_a_wall()
    arrays = segmented(person)
    names = ["LKnee", "LAnkle"]
    knee, ankle = (person.joints2d[0, 0, COCO17.names.index(n), :2] for n in names)
    shin = np.zeros((SIZE, SIZE), np.uint8)
    cv2.line(
        shin,
        np.rint(knee + 0.2 * (ankle - knee)).astype(int).tolist(),
        np.rint(ankle + 0.4 * (ankle - knee)).astype(int).tolist(),
        1,
        16,
    )
    missing = (shin > 0) & (person.mask[0, 0] > 127)
    arrays["detection/person"][0, 0, 0][cv2.resize(shin, (256, 256)) > 0] = 0
    together = hints_of(person, arrays, 0).known(0, 0)
    alone = replace(together, possible=None, confirmed=None)
    assert (cut(person, alone, plate=walls[0])[missing] > 127).mean() < 0.7
    assert (cut(person, together, plate=walls[0])[missing] > 127).mean() > 0.85


def with_a_board(person: PersonCapture, wall: np.ndarray, at: np.ndarray) -> np.ndarray:
    """[h, w] bool: a board that view 0 sees at a place [2] px, painted into its picture; in its middle it looks like
    the wall."""
    x, y = np.rint(at).astype(int)
    board, middle = np.zeros((SIZE, SIZE), bool), np.zeros((SIZE, SIZE), bool)
    board[y - 9 : y + 9, x - 11 : x + 11] = True
    middle[y - 4 : y + 4, x - 5 : x + 5] = True
    board &= person.mask[0, 0] == 0
    person.color[0, 0][board] = (20, 160, 40)
    person.color[0, 0][board & middle] = wall[board & middle]
    return board


@pytest.mark.parametrize("plated", [True, False])
def test_what_is_held_belongs_to_the_person_where_a_plate_tells_it_from_what_is_behind(plated: bool) -> None:
    person, walls = before_a_wall()
    hand = person.joints2d[0, 0, COCO17.names.index("LWrist"), :2]
    elbow = person.joints2d[0, 0, COCO17.names.index("LElbow"), :2]
    board = with_a_board(person, walls[0], hand + 15 * (hand - elbow) / np.linalg.norm(hand - elbow))
    known = hints_of(person, segmented(person), 0).known(0, 0)
    # no estimator counts a board to the person, so the other views rule it out
    assert known.possible is not None
    assert (known.possible[board] < 0.5).mean() > 0.3
    found = cut(person, known, plate=walls[0] if plated else None) > 127
    assert board.sum() > 250
    if plated:
        assert found[board].mean() > 0.85  # its middle, too, which is the wall's colour: a fifth of it
        assert overlap(255 * found.astype(np.uint8), np.uint8(255) * (board | (person.mask[0, 0] > 127))) > 0.94
    else:  # colours alone do not tell a thing from what is behind
        assert found[board].mean() < 0.2


def test_what_the_plate_kept_at_a_hand_and_is_gone_is_not_held() -> None:
    person, walls = before_a_wall()
    hand = person.joints2d[0, 0, COCO17.names.index("LWrist"), :2]
    elbow = person.joints2d[0, 0, COCO17.names.index("LElbow"), :2]
    there, plate = person.color[0, 0].copy(), walls[0].copy()
    ghost = with_a_board(person, walls[0], hand + 15 * (hand - elbow) / np.linalg.norm(hand - elbow))
    plate[ghost], person.color[0, 0] = person.color[0, 0][ghost], there
    known = replace(hints_of(person, segmented(person), 0).known(0, 0), possible=None, confirmed=None)
    assert ghost.sum() > 250
    assert (cut(person, known, plate=plate)[ghost] > 127).mean() < 0.1


def test_nothing_is_held_where_somebody_else_is_there() -> None:
    person, walls = before_a_wall()
    hand = person.joints2d[0, 0, COCO17.names.index("LWrist"), :2]
    elbow = person.joints2d[0, 0, COCO17.names.index("LElbow"), :2]
    board = with_a_board(person, walls[0], hand + 15 * (hand - elbow) / np.linalg.norm(hand - elbow))
    arrays = segmented(person)
    arrays["pose/alone"][:] = 0
    known = replace(hints_of(person, arrays, 0).known(0, 0), possible=None, confirmed=None)
    assert (cut(person, known, plate=walls[0])[board] > 127).mean() < 0.2


def test_what_stands_where_no_hand_is_belongs_to_nobody() -> None:
    person, walls = before_a_wall()
    nose = person.joints2d[0, 0, COCO17.names.index("Nose"), :2]
    thing = with_a_board(person, walls[0], nose + np.array([14, -2]))
    thing[:, : round(nose[0]) + 14] = False  # half of it lies where the segmentation may be off
    known = replace(hints_of(person, segmented(person), 0).known(0, 0), possible=None, confirmed=None)
    assert thing.sum() > 150
    assert (cut(person, known, plate=walls[0])[thing] > 127).mean() < 0.2


def standing(under: np.ndarray, dark: float) -> tuple[np.ndarray, np.ndarray]:
    """A foot on mottled ground [200, 200, 3] uint8, `under` [200, 200] bool beside it as dark as a share of the ground,
    and the mask; an estimator counts what is dark within 7 px of the foot to it, with .75."""
    size, joints, foot = 200, np.zeros((17, 3)), np.zeros((200, 200), np.uint8)
    joints[[COCO17.names.index(n) for n in ("LHip", "LKnee", "LAnkle")]] = [(100, 20, 1), (100, 80, 1), (100, 140, 1)]
    cv2.rectangle(foot, (88, 10), (112, 145), 255, -1)
    cv2.rectangle(foot, (88, 130), (136, 150), 255, -1)
    under = under & (foot == 0)
    ground = np.clip(wall(size, 3), 0, 255).astype(np.uint8)
    shaded = np.where(under, dark, 1.0)[..., None] * ground + np.random.default_rng(1).normal(0, 1.5, (size, size, 3))
    cloth = np.random.default_rng(0).normal((70, 45, 35), 8, (size, size, 3))
    picture = np.where(foot[..., None] > 0, cloth, shaded).clip(0, 255).astype(np.uint8)
    counted = under & (cv2.dilate(foot, np.ones((15, 15), np.uint8)) > 0)
    hint = cv2.GaussianBlur(np.maximum(foot / 255, 0.75 * counted), (0, 0), 3).astype(np.float32)
    known = Known(hint, joints, "coco17", None, None)
    found = person_matte(picture, known, (ground, np.full((size, size), 2, np.uint8)), THRESHOLD, MARGIN)
    assert found is not None
    assert (found[foot > 0] > 127).mean() > 0.97
    return found > 127, under


@pytest.mark.parametrize("dark", [0.4, 0.5, 0.7])
def test_the_ground_in_the_shadow_of_a_foot_is_not_the_foot(dark: float) -> None:
    y, x = np.mgrid[:200, :200]
    found, shadow = standing(np.hypot((x - 120) / 48, (y - 153) / 16) < 1, dark)
    assert found[shadow].mean() < 0.25  # 0.69, 0.50 and 0.06 where shadows count as feet


def test_a_sole_as_dark_as_a_shadow_belongs_to_the_foot() -> None:
    y, x = np.mgrid[:200, :200]
    found, sole = standing((x >= 88) & (x <= 136) & (y > 150) & (y < 156), 0.4)
    assert found[sole].mean() > 0.9


def test_the_gap_between_arm_and_body_stays_open() -> None:
    size, joints = 160, np.zeros((17, 3))
    body = np.zeros((size, size), np.uint8)
    cv2.rectangle(body, (50, 20), (110, 150), 255, -1)
    cv2.rectangle(body, (65, 60), (80, 100), 0, -1)
    joints[[COCO17.names.index(n) for n in ("LShoulder", "LElbow", "LWrist")]] = [
        (55, 55, 1),
        (57, 80, 1),
        (60, 105, 1),
    ]
    ground = np.clip(wall(size, 3), 0, 255).astype(np.uint8)
    picture = np.where(body[..., None] > 0, np.array([60, 90, 190]), ground).astype(np.uint8)
    known = Known(body.astype(np.float32) / 255, joints, "coco17", None, None, alone=True)
    found = person_matte(picture, known, (ground, np.full((size, size), 2, np.uint8)), THRESHOLD, MARGIN)
    assert found is not None
    assert (found[63:98, 68:78] < 128).mean() > 0.9


def test_somebody_just_beside_a_picture_is_not_in_it() -> None:
    """The other views, coarse as they are, confirm a strip along its edge."""
    person, walls = before_a_wall()
    beside = np.zeros((SIZE, SIZE), np.float32)
    beside[:, :12] = 1.0
    joints = np.concatenate([person.joints2d[0, 0, :, :2], np.ones((17, 1))], axis=1)
    joints[:, 0] -= joints[:, 0].max() + 5
    known, plate = Known(None, joints, "coco17", beside, beside), (walls[0], np.full((SIZE, SIZE), 2, np.uint8))
    assert person_matte(walls[0], known, plate, THRESHOLD, MARGIN) is None
    joints[:, 0] += 10
    assert person_matte(walls[0], known, plate, THRESHOLD, MARGIN) is not None


def test_limbs_that_point_at_the_camera_are_as_thick_as_others() -> None:
    """Joints alone tell of somebody who lies along the optical axis: how far away is known, the limbs are short."""
    ground, scale = np.clip(wall(SIZE, 3), 0, 255).astype(np.uint8), 90.0
    upright = SKELETON[:, [1, 2]] * [1.0, -1.0]
    joints = np.concatenate([80 + scale * (upright - upright.mean(axis=0)) * [1.0, 0.3], np.ones((17, 1))], axis=1)
    body = body_shape(joints, "coco17", (SIZE, SIZE), scale)
    picture = np.where(body[..., None], np.array([60, 90, 190]), ground).astype(np.uint8)
    known = Known(None, joints, "coco17", None, None, scale=scale)
    for told, least, most in ((known, 0.95, 1.0), (replace(known, scale=0.0), 0.0, 0.9)):
        found = person_matte(picture, told, None, THRESHOLD, MARGIN)
        assert found is not None
        assert least <= overlap(found, 255 * body.astype(np.uint8)) <= most


def arrays_of(person: PersonCapture, walls: np.ndarray) -> dict[str, np.ndarray]:
    return {**segmented(person, 64), "survey/plate": walls, "survey/spread": np.full(walls.shape[:3], 2, np.uint8)}


def run(
    person: PersonCapture,
    arrays: dict[str, np.ndarray],
    view: int,
    length: int | None = None,
    facts: frozenset[str] = FACTS,
    **more,
) -> np.ndarray:
    pictures = Pictures([list(person.color[:, v]) for v in range(len(person.rig))])
    out = run_stage(
        STAGE,
        FramesParams(matte=more.pop("matte", "person")),
        arrays,
        person.rig,
        more.pop("roles", person.views),
        len(person.mask),
        length,
        view=view,
        sources={"pictures": pictures},
        facts=facts,
        joint_set="coco17",
        **more,
    )
    return out["frames/mask"][:, view]


def test_partitions_do_not_matter() -> None:
    person, walls = before_a_wall(3, 4)
    arrays = arrays_of(person, walls)
    whole = run(person, arrays, 1)
    for length in (1, 2):
        np.testing.assert_array_equal(run(person, arrays, 1, length), whole)


def test_threads_do_not_matter() -> None:
    person, walls = before_a_wall()
    known, before = hints_of(person, segmented(person, 64), 0).known(0, 0), cv2.getNumThreads()
    found = []
    try:
        for threads in (1, 2, 3):
            cv2.setNumThreads(threads)
            found.append(cut(person, known, plate=walls[0]))
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_joints_alone_and_a_plate_find_the_person() -> None:
    person, walls = before_a_wall()
    arrays = arrays_of(person, walls)
    only = {k: v for k, v in arrays.items() if not k.startswith("detection/") and k != "pose/chosen"}
    for facts in ({"joints2d"}, {"joints3d"}):
        assert overlap(run(person, only, 0, facts=frozenset({"several_frames", *facts}))[0], person.mask[0, 0]) > 0.9


def test_a_view_that_is_no_source_is_cut_out_by_what_the_others_saw() -> None:
    person, walls = before_a_wall()
    arrays, held_out = arrays_of(person, walls), replace(person.views, sources=(1, 2, 3, 4, 5), held_out=(0,))
    first = run(person, arrays, 0, roles=held_out)
    assert overlap(first[0], person.mask[0, 0]) > 0.9
    # Nothing that an estimator might have found in it is looked at.
    for name in ("detection/person", "detection/region", "pose/chosen"):
        arrays[name] = arrays[name].copy()
        arrays[name][:, 0] = 0
    np.testing.assert_array_equal(run(person, arrays, 0, roles=held_out), first)


def test_where_nobody_is_known_the_plate_tells_alone_and_says_so() -> None:
    person, walls = before_a_wall()
    arrays = arrays_of(person, walls)
    arrays["pose/chosen"] = np.full_like(arrays["pose/chosen"], -1)
    arrays["pose/joints2d"], arrays["pose/joints3d"] = (
        np.zeros_like(arrays["pose/joints2d"]),
        np.zeros_like(arrays["pose/joints3d"]),
    )
    assert overlap(run(person, arrays, 0)[0], person.mask[0, 0]) > 0.85
    assert not run(person, arrays, 0, facts=FACTS - {"several_frames"}).any()


def test_specks_are_nobody_where_nobody_is_known() -> None:
    """A cable that moved, not the subject, who has left."""
    person, walls = before_a_wall()
    empty = walls[None].copy()
    empty[:, :, 100:107, 60:67] = (250, 40, 40)
    gone = replace(person, color=empty)
    arrays = arrays_of(person, walls)
    arrays["pose/chosen"] = np.full_like(arrays["pose/chosen"], -1)
    for name in ("pose/joints2d", "pose/joints3d"):
        arrays[name] = np.zeros_like(arrays[name])
    assert not run(gone, arrays, 0).any()
    assert run(gone, arrays, 0, matte="plate").any(), "where no joints are looked at it may be the subject"


def test_a_view_from_which_somebody_hides_the_subject_holds_nothing_of_it() -> None:
    person, walls = before_a_wall()
    arrays = arrays_of(person, walls)
    chosen = arrays["pose/chosen"] = arrays["pose/chosen"].copy()
    chosen[:, 0] = -1
    unknown = run(person, arrays, 1)
    assert run(person, arrays, 0).any(), "of a view in which nobody was found joints tell"
    chosen[:, 0] = HIDDEN
    assert not run(person, arrays, 0).any()
    np.testing.assert_array_equal(run(person, arrays, 1), unknown)


def test_auto_takes_given_masks_then_the_person_then_a_plate() -> None:
    auto = FramesParams()
    wanted = [
        ({"masks", "segmented", "several_frames", "joints2d"}, "given"),
        ({"segmented", "several_frames", "joints2d", "detected"}, "person"),
        ({"segmented", "joints2d"}, "person"),
        ({"several_frames", "joints2d"}, "person"),
        ({"joints3d"}, "person"),
        ({"several_frames"}, "plate"),
        (set(), "none"),
    ]
    for facts, matte in wanted:
        answer, why = matte_choice(auto, frozenset(facts))
        assert answer == matte
        assert len(why) > 20
    assert matte_choice(FramesParams(matte="person"), frozenset({"masks"}))[0] == "person"


def test_what_would_be_better_is_said_with_its_command_and_only_where_it_is_not_here() -> None:
    auto = FramesParams()
    for facts in ({"joints2d", "several_frames"}, {"several_frames"}, set()):
        said = better_matte(auto, frozenset(facts))
        assert said is not None
        assert "posegaussian models fetch blazepose" in said
        assert better_matte(auto, frozenset(facts) | {"blazepose"}) is None
    assert better_matte(auto, frozenset({"masks", "joints2d"})) is None
    assert better_matte(FramesParams(matte="plate"), frozenset({"several_frames"})) is None, "it was asked for"


def test_a_person_without_joints_is_refused_with_what_to_do() -> None:
    said = STAGE.refusal(FramesParams(matte="person"), frozenset({"several_frames"}))
    assert said is not None
    assert "models fetch blazepose" in said
    assert "plate" in said
    assert STAGE.refusal(FramesParams(matte="person"), frozenset({"joints3d"})) is None
