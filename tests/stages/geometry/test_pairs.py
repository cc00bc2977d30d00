"""The rows of the catalogue of pairs: ring radius 2 m, elevation 8 degrees, focal length 819.2, 1024 x 1024, person
of 1.8 m."""

import numpy as np
import pytest

from posegaussian.stages.geometry.pairs import (
    SAME_BODY,
    PairVerdict,
    choose_pairs,
    classify,
    pair_notes,
    pair_report,
    shared_body,
)
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.rectification import rectify
from posegaussian.stages.geometry.subject import (
    body_points,
    expected_distance,
    look_at_point,
    middle_rays,
    subject_distance,
)
from posegaussian.stages.matching.sweep import nearest
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, cut_aside, on_ring, rig_of, ring

ORIGIN = np.zeros(3)
REFERENCE = camera(on_ring(0), ORIGIN)


def beside(azimuth: float, roll: float = 0.0) -> np.ndarray:
    return camera(on_ring(azimuth), ORIGIN, roll)


ROWS: dict[str, tuple[Rig, PairVerdict]] = {
    "22.5": (rig_of([REFERENCE, beside(22.5)]), PairVerdict.USABLE),
    "45": (rig_of([REFERENCE, beside(45)]), PairVerdict.USABLE),
    "60": (rig_of([REFERENCE, beside(60)]), PairVerdict.USABLE),
    "67.5": (rig_of([REFERENCE, beside(67.5)]), PairVerdict.USABLE),
    "72": (rig_of([REFERENCE, beside(72)]), PairVerdict.USABLE),
    "90": (rig_of([REFERENCE, beside(90)]), PairVerdict.USABLE),
    "120": (rig_of([REFERENCE, beside(120)]), PairVerdict.TOO_WIDE),
    "180": (rig_of([REFERENCE, beside(180)]), PairVerdict.TOO_WIDE),
    "vertical 20": (rig_of([REFERENCE, camera(on_ring(0, 28), ORIGIN)]), PairVerdict.USABLE),
    "diagonal 20/20.5": (rig_of([REFERENCE, camera(on_ring(20, 28.5), ORIGIN)]), PairVerdict.USABLE),
    "both rolled 90": (rig_of([camera(on_ring(0), ORIGIN, 90), beside(22.5, 90)]), PairVerdict.USABLE),
    "one rolled 90": (rig_of([REFERENCE, beside(22.5, 90)]), PairVerdict.USABLE),
    "one rolled 45": (rig_of([REFERENCE, beside(22.5, 45)]), PairVerdict.USABLE),
    "one upside down": (rig_of([REFERENCE, beside(22.5, 180)]), PairVerdict.USABLE),
    "one above the other, too far": (
        rig_of([camera(on_ring(0, -40), ORIGIN), camera(on_ring(0, 70), ORIGIN)]),
        PairVerdict.TOO_WIDE,
    ),
    "camera behind camera": (rig_of([REFERENCE, camera(on_ring(0, radius=3.0), ORIGIN)]), PairVerdict.BEHIND),
    "coincident": (rig_of([REFERENCE, REFERENCE]), PairVerdict.COINCIDENT),
    "same place, turned": (rig_of([REFERENCE, camera(on_ring(0), np.array([0.0, 0.2, 0.0]))]), PairVerdict.COINCIDENT),
    "baseline 0.1 mm": (
        rig_of([REFERENCE, camera(on_ring(0) + np.array([0, 1e-4, 0]), ORIGIN)]),
        PairVerdict.COINCIDENT,
    ),
    "focal lengths 1 : 1.5": (rig_of([REFERENCE, beside(22.5)], focal=[819.2, 1228.8]), PairVerdict.USABLE),
}


@pytest.mark.parametrize("row", ROWS)
def test_every_row_gets_its_verdict_in_either_order(row: str) -> None:
    rig, verdict = ROWS[row]
    report = classify(rig, 0, 1)
    swapped = classify(rig, 1, 0)
    assert report.verdict is verdict, report.sentence
    assert swapped.verdict is verdict
    assert swapped.measured == pytest.approx(report.measured, abs=1e-9)
    assert verdict.value in report.sentence
    assert "cam0 and cam1" in report.sentence
    assert np.isfinite([report.angle, report.measured, report.bound]).all()


@pytest.mark.parametrize("rolls", [(90, 90), (45, 45), (0, 90), (180, 0), (27, -63)])
@pytest.mark.parametrize("row", ROWS)
def test_how_cameras_are_held_changes_no_verdict(row: str, rolls: tuple[float, float]) -> None:
    rig, verdict = ROWS[row]
    turns = [np.radians(r) for r in rolls]
    held = [
        np.array([[np.cos(t), np.sin(t), 0, 0], [-np.sin(t), np.cos(t), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]) @ pose
        for t, pose in zip(turns, rig.world_to_camera, strict=True)
    ]
    rolled = rig_of(held, focal=rig.intrinsics[:, 0, 0].tolist())
    subject, up = look_at_point(rig), np.array([0.0, 0, 1])
    report = classify(rolled, 0, 1, subject=subject, up=up)
    assert report.verdict is verdict, report.sentence
    assert report.measured == pytest.approx(classify(rig, 0, 1, subject=subject, up=up).measured, abs=1e-9)


def test_the_lean_of_a_baseline_is_told_against_the_rigs_up() -> None:
    assert classify(ROWS["22.5"][0], 0, 1).lean == pytest.approx(0, abs=1e-9)
    assert classify(ROWS["vertical 20"][0], 0, 1).lean > 75
    ring_on_its_side = rig_of([camera(on_ring(a), ORIGIN, 90) for a in range(0, 360, 45)])
    assert classify(ring_on_its_side, 0, 1).lean == pytest.approx(0, abs=1e-6)


def test_pictures_that_show_different_ends_of_a_body_are_no_pair() -> None:
    head, feet = np.array([0.0, 0, 0.85]), np.array([0.0, 0, -0.85])
    rig = rig_of([camera(on_ring(0), head), camera(on_ring(30), feet)], (1024, 1024), 4000.0)
    for order in ((0, 1), (1, 0)):
        report = classify(rig, *order, subject=ORIGIN, up=np.array([0.0, 0, 1]))
        assert report.verdict is PairVerdict.UNSEEN
        assert "in the other" in report.sentence


def test_a_body_partly_beside_one_picture_does_not_refuse_a_pair() -> None:
    rig = rig_of([REFERENCE, camera(on_ring(30, 8, 1.5), np.array([0.0, 0, 0.6]))])
    subject, up = ORIGIN, np.array([0.0, 0, 1])
    assert shared_body(rig, 0, 1, subject, up) < 0.9
    assert shared_body(rig, 0, 1, subject, up) == shared_body(rig, 1, 0, subject, up)
    assert classify(rig, 0, 1, subject=subject, up=up).usable


@pytest.mark.parametrize(("distance", "field"), [(1.0, 0.30), (0.6, 0.25), (2.0, 0.08)])
def test_cameras_around_a_face_are_matched_with_their_neighbours(distance: float, field: float) -> None:
    """Their pictures show nothing of the outline of a person, who is all around; one that looks past it is told."""
    focal = 1024 * distance / field
    around = [camera(on_ring(a, 1, distance), ORIGIN) for a in range(0, 360, 45)]
    rig = rig_of(around, focal=focal)
    partners = choose_pairs(rig, range(8), 2)
    assert {v: sorted(p) for v, p in partners.items()} == {v: sorted([(v - 1) % 8, (v + 1) % 8]) for v in range(8)}
    past = camera(on_ring(22.5, 1, distance), ORIGIN + np.array([0.0, 0, 1.5 * field]))
    for poses in ([around[0], past], [past, around[0]]):
        report = classify(rig_of(poses, focal=focal), 0, 1, subject=ORIGIN, up=np.array([0.0, 0, 1]))
        assert report.verdict is PairVerdict.UNSEEN


def test_a_whole_person_in_one_picture_and_a_face_in_the_other_is_a_pair() -> None:
    rig = rig_of([REFERENCE, beside(22.5)], focal=[819.2, 8192.0])
    subject, up = ORIGIN, np.array([0.0, 0, 1])
    assert classify(rig, 0, 1, subject=subject, up=up).usable
    assert shared_body(rig, 0, 1, subject, up) > 0.5


def test_a_camera_that_looks_elsewhere_is_told_by_name_in_either_order():
    away = camera(on_ring(22.5), 10 * on_ring(22.5))
    for poses, name in (([REFERENCE, away], "cam1"), ([away, REFERENCE], "cam0")):
        report = classify(rig_of(poses), 0, 1, subject=ORIGIN, up=np.array([0.0, 0, 1]))
        assert report.verdict is PairVerdict.UNSEEN
        assert f"{name} has nothing of a person" in report.sentence


@pytest.mark.parametrize("row", [r for r, (_, verdict) in ROWS.items() if verdict is PairVerdict.USABLE])
def test_the_body_lies_inside_both_rectified_pictures_of_a_usable_pair(row: str) -> None:
    from posegaussian.stages.geometry.projection import project

    rig = ROWS[row][0]
    pair = rectify(rig, 0, 1, ORIGIN)
    for which in (0, 1):
        pixels, depth = project(
            body_points(ORIGIN, np.array([0.0, 0, 1])), pair.intrinsics[which], pair.world_to_camera(which)
        )
        assert (depth > 0).all()
        assert (pixels >= 0).all()
        assert (pixels <= pair.size).all()


def test_look_at_point_is_where_the_axes_meet_and_ahead_where_they_are_parallel():
    target = np.array([0.3, -0.2, 0.9])
    rig = rig_of([camera(target + on_ring(a), target) for a in (0, 45, 90)])
    # The pull towards the expected distance weighs 1e-4.
    np.testing.assert_allclose(look_at_point(rig), target, atol=1e-3)
    parallel = rig_of([camera(np.array([x, -3.0, 0]), np.array([x, 0.0, 0])) for x in (0.0, 0.3)])
    ahead = look_at_point(parallel) + np.array([0, 3, 0])
    # 819.2 * 1.8 / (0.75 * 1024) = 1.92 m fills three quarters of the picture.
    np.testing.assert_allclose(ahead, [0.15, 1.92, 0], atol=1e-6)


@pytest.mark.parametrize("degrees", [-35.0, 20.0])
def test_pictures_cut_beside_the_principal_point_look_where_their_middle_does(degrees: float) -> None:
    rig = ring(8)
    aside = cut_aside(rig, degrees)
    np.testing.assert_allclose(look_at_point(aside), look_at_point(rig), atol=1e-3)
    assert [r.verdict for r in pair_report(aside)] == [r.verdict for r in pair_report(rig)]
    # Of one camera alone: in the middle of its picture, as deep as a person fills it.
    one = aside.subset([0])
    pixels, depth = project(look_at_point(one), one.intrinsics[0], one.world_to_camera[0])
    np.testing.assert_allclose(pixels, one.size[0] / 2, atol=1e-6)
    assert depth == pytest.approx(expected_distance(one)[0]) == pytest.approx(subject_distance(one, 0, None))


def test_the_middle_of_a_skewed_picture_is_where_its_camera_looks() -> None:
    rig = cut_aside(ring(3), 25.0)
    rig.intrinsics[:, 0, 1] = 4.0
    for v, ray in enumerate(middle_rays(rig)):
        pixels, depth = project(rig.centres[v] + 2.5 * ray, rig.intrinsics[v], rig.world_to_camera[v])
        np.testing.assert_allclose([*pixels, depth], [*rig.size[v] / 2, 2.5])


def test_cameras_that_look_apart_still_have_a_point_ahead():
    rig = rig_of([camera(np.array([x, 0.0, 0]), np.array([3 * x, 5.0, 0])) for x in (-1.0, 1.0)])
    point = look_at_point(rig)
    assert (np.einsum("vi,vi->v", rig.rotations[:, 2], point - rig.centres) > 0).all()


def test_pairs_are_chosen_by_angle_and_only_among_sources():
    rig = ring(8)
    assert choose_pairs(rig, range(8), 2) == {v: sorted(((v - 1) % 8, (v + 1) % 8)) for v in range(8)}
    assert choose_pairs(rig, [0, 1, 4], 2) == {0: [1], 1: [0], 4: []}
    assert choose_pairs(ring(16), range(16), 4)[3] == [2, 4, 1, 5]
    assert choose_pairs(rig, [0], 2) == {0: []}


def with_close_ups(*azimuths: float) -> Rig:
    """Eight cameras around a whole person, and some that show the head alone."""
    head = np.array([0.0, 0, 0.75])
    around = [camera(on_ring(45 * k + off), ORIGIN) for k, off in enumerate((0, 4, -3, 6, 1, -5, 3, -2))]
    near = [camera(on_ring(a, 20, 1.5), head) for a in azimuths]
    return rig_of([*around, *near], focal=[819.2] * 8 + [3000.0] * len(near))


def chosen(rig: Rig, count: int = 2) -> tuple[dict[int, list[int]], dict[int, list[int]]]:
    """Partners by view: in rectified pairs, and in sweeps."""
    views = tuple(range(len(rig)))
    centre = look_at_point(rig)
    return choose_pairs(rig, views, count), {v: list(nearest(rig, v, views, count, 105.0, centre)) for v in views}


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("close_ups", [(20.0,), (20.0, 24.0), (16.0, 20.0, 24.0, 29.0)])
def test_a_close_up_takes_no_partners_place(close_ups: tuple[float, ...], count: int) -> None:
    """Each camera that shows the person whole is compared with those it would be compared with without close-ups, and
    with the nearest of these besides, at most as many; the close-up is compared with its neighbours."""
    rig = with_close_ups(*close_ups)
    for alone, found in zip(chosen(rig.subset(range(8)), count), chosen(rig, count), strict=True):
        for v in range(8):
            assert [w for w in found[v] if w < 8] == alone[v]
            assert len([w for w in found[v] if w >= 8]) <= count
        assert {w for v in (0, 1) for w in found[v] if w >= 8}
        assert all(len([w for w in found[v] if w < 8]) <= count for v in range(8, len(rig)))
    shares = {r.views: r.shares for r in pair_report(rig)}
    assert shares[0, 8][0] < SAME_BODY <= shares[0, 8][1]


@pytest.mark.parametrize("count", [1, 2, 4])
@pytest.mark.parametrize(
    "rig",
    [ring(5), ring(8), ring(16), rig_of([beside(a) for a in (0, 20, 35, 70, 85)]), cut_aside(ring(8), 20.0)],
    ids=["5", "8", "16", "arc", "cut aside"],
)
def test_cameras_that_all_show_the_whole_person_are_compared_with_the_nearest_ones(rig: Rig, count: int) -> None:
    reports = pair_report(rig)
    assert {r.shares for r in reports} == {(1.0, 1.0)}
    for v in range(len(rig)):
        own = sorted((round(r.angle, 1), sum(r.views) - v) for r in reports if r.usable and v in r.views)
        for found in chosen(rig, count):
            assert found[v] == [w for _, w in own[:count]]


@pytest.mark.parametrize(("far", "usable"), [(2.0, True), (3.5, True), (4.2, True), (6.0, False), (9.0, False)])
def test_neighbours_at_other_distances_are_matched_while_their_baseline_lies_aside(far: float, usable: bool) -> None:
    """In turn at 2 m and farther away, 45 degrees apart."""
    distances = [2.0, far] * 4
    rig = rig_of(
        [camera(on_ring(45 * k, 0, r), ORIGIN) for k, r in enumerate(distances)],
        focal=[819.2 * r / 2.0 for r in distances],
    )
    verdicts = {r.verdict for r in pair_report(rig) if r.angle < 50}
    assert verdicts == {PairVerdict.USABLE if usable else PairVerdict.BEHIND}


def test_no_pair_of_the_report_is_left_out():
    reports = pair_report(ring(8))
    assert len(reports) == 28
    assert sum(r.usable for r in reports) == 16
    assert {r.verdict for r in reports} == {PairVerdict.USABLE, PairVerdict.TOO_WIDE}


def test_every_pair_that_is_not_matched_is_spoken_of() -> None:
    rig = rig_of([REFERENCE, beside(22.5), beside(60), beside(180)])
    reports, notes = pair_report(rig), pair_notes(rig, range(4))
    refused = [r for r in reports if not r.usable]
    assert refused
    for verdict in {r.verdict for r in refused}:
        count = sum(r.verdict is verdict for r in refused)
        assert any(f"{count} of {len(reports)} pairs" in n and str(verdict) in n for n in notes)
    served = {v for r in reports if r.usable for v in r.views}
    (note,) = (n for n in notes if n.startswith("no usable pair serves"))
    alone = ", ".join(rig.names[v] for v in range(4) if v not in served)
    assert note == f"no usable pair serves {alone}: hull depth with low confidence there"


def test_a_ring_whose_neighbours_all_match_leaves_no_view_alone() -> None:
    assert not any(n.startswith("no usable pair") for n in pair_notes(ring(8), range(8)))
