from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.declaration import Evidence
from posegaussian.stages.contract.io import Block
from posegaussian.stages.depth.algorithms.occluding_contour import turn_away
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, hull_only, hulls, reliefs
from posegaussian.stages.depth.notes import notes
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.depth.run import check, matched_note, run
from posegaussian.stages.depth.stage import STAGE
from posegaussian.stages.geometry.pairs import alone
from posegaussian.stages.metrics.depth_error import depth_error
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.errors import UserError
from tests.support.known_geometry import rig_of
from tests.support.memory_inputs import MemoryInputs, run_stage

DEPTH, CONFIDENCE = "depth/depth", "depth/confidence"


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=96, frames=2, held_out=1)


def arrays(c: PersonCapture) -> dict[str, np.ndarray]:
    return {"frames/color": c.color, "frames/mask": c.mask, "truth/depth": c.depth}


def depth_of(
    c: PersonCapture, length: int | None = None, more: dict[str, Any] | None = None, **params: Any
) -> dict[str, np.ndarray]:
    return run_stage(STAGE, DepthParams(**params), arrays(c), c.rig, c.views, len(c.color), length, **(more or {}))


@pytest.fixture(scope="module", params=["sgbm", "sweep"])
def method(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def estimate(person: PersonCapture, method: str) -> dict[str, np.ndarray]:
    return depth_of(person, method=method)


def mean_epe(c: PersonCapture, depth: np.ndarray) -> float:
    errors = [
        depth_error(depth[f, v], c.depth[f, v], c.mask[f, v], c.rig, v, c.views.sources)
        for f in range(len(depth))
        for v in c.views.sources
    ]
    return float(np.mean([e.epe for e in errors if e]))


def test_every_view_gets_arrays_and_views_that_are_no_sources_get_zeros(
    person: PersonCapture, estimate: dict[str, np.ndarray]
) -> None:
    assert estimate[DEPTH].shape == estimate[CONFIDENCE].shape == (2, 9, 96, 96)
    assert not estimate[DEPTH][:, 8].any()
    assert not estimate[CONFIDENCE][:, 8].any()


def test_depth_lies_exactly_on_the_mask_with_confidence(person: PersonCapture, estimate: dict[str, np.ndarray]) -> None:
    inside = person.mask[:, :8] > 127
    np.testing.assert_array_equal(estimate[DEPTH][:, :8] > 0, inside)
    np.testing.assert_array_equal(estimate[CONFIDENCE][:, :8] > 0, inside)
    assert estimate[CONFIDENCE].max() <= 1


def test_matching_beats_the_hull_where_the_hull_is_coarse(method: str) -> None:
    # At 60 degrees between cameras the hull is several pixels off, also in small pictures.
    c = capture_person(views=6, size=128, frames=1, held_out=0)
    assert mean_epe(c, depth_of(c, method=method)[DEPTH]) < 0.8 * mean_epe(c, depth_of(c, method="hull")[DEPTH])


def test_confidence_ranks_pixels_by_error(method: str) -> None:
    # Small pictures of a narrow ring have too few bad pixels to tell: at 128 px the ratio is 0.62 to 0.79.
    c = capture_person(views=6, size=160, frames=1, held_out=0)
    found = depth_of(c, method=method)
    surface = (c.mask > 127) & (c.depth > 0)
    error = np.abs(1 / np.where(surface, found[DEPTH], 1) - 1 / np.where(surface, c.depth, 1))[surface]
    trust = found[CONFIDENCE][surface].astype(float)
    assert error[trust > 0.97].mean() < 0.7 * error[(trust > 0.5) & (trust < 0.9)].mean()


def test_partitions_of_one_frame_give_the_bytes_of_the_whole(
    person: PersonCapture, estimate: dict[str, np.ndarray], method: str
) -> None:
    parts = depth_of(person, length=1, method=method)
    for name in (DEPTH, CONFIDENCE):
        np.testing.assert_array_equal(parts[name], estimate[name])


def test_threads_do_not_change_a_byte(person: PersonCapture, method: str) -> None:
    before = cv2.getNumThreads()
    try:
        results = []
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            results.append(depth_of(person, method=method)[DEPTH])
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(*results)


def test_held_out_pictures_and_masks_are_never_looked_at(
    person: PersonCapture, estimate: dict[str, np.ndarray], method: str
) -> None:
    noise = np.random.default_rng(0)
    color, mask = person.color.copy(), person.mask.copy()
    color[:, 8], mask[:, 8] = noise.integers(0, 255, color[:, 8].shape), noise.integers(0, 255, mask[:, 8].shape)
    np.testing.assert_array_equal(
        depth_of(replace(person, color=color, mask=mask), method=method)[DEPTH], estimate[DEPTH]
    )


def test_a_view_without_a_picture_gets_zeros_and_is_used_by_nobody(
    person: PersonCapture, estimate: dict[str, np.ndarray], method: str
) -> None:
    valid = np.ones((2, 9), bool)
    valid[1, 2] = False
    garbage, mask = person.color.copy(), person.mask.copy()
    garbage[1, 2], mask[1, 2] = 77, 0
    found = depth_of(person, more={"valid_all": valid}, method=method)[DEPTH]
    again = depth_of(replace(person, color=garbage, mask=mask), more={"valid_all": valid}, method=method)[DEPTH]
    np.testing.assert_array_equal(found, again)
    np.testing.assert_array_equal(found[0], estimate[DEPTH][0])
    assert not found[1, 2].any()
    assert (found[1, 1] > 0).sum() == (person.mask[1, 1] > 127).sum()


@pytest.mark.parametrize("views", [(0, 1, 2, 3, 4, 5, 6, 7), (0, 2, 4, 6)])
def test_the_hull_stands_before_the_truth_and_hull_depth_is_not_before_the_hull(
    person: PersonCapture, views: tuple[int, ...]
) -> None:
    geometry, frame = Geometry.of(person.rig, views, DepthParams()), Frame({}, {v: person.mask[0, v] for v in views})
    found, rounded = hulls(geometry, frame), hull_only(geometry, frame)
    near, depth = (np.stack([maps[v][0] for v in views]) for maps in (found, rounded))
    true = person.depth[0, list(views)]
    surface = (person.mask[0, list(views)] > 127) & (true > 0)
    # A pixel at this size is 2.4 cm.
    assert (near[surface] <= true[surface] + 0.024).mean() > 0.99
    assert (depth[surface] >= near[surface]).all()
    if len(views) == 4:  # of eight views the hull is round already
        assert np.abs(depth - true)[surface].mean() < np.abs(near - true)[surface].mean()


def test_views_that_no_pair_serves_get_the_hull_with_low_confidence(method: str) -> None:
    c = capture_person(views=3, size=64, frames=1, held_out=0)
    found, hull = depth_of(c, method=method), depth_of(c, method="hull")
    np.testing.assert_array_equal(found[DEPTH], hull[DEPTH])
    assert found[DEPTH].any()
    assert found[CONFIDENCE].max() < 0.5


@pytest.mark.parametrize("views", [(0, 4), (0, 1), (0, 4, 1)])
def test_views_along_each_other_show_the_subject_where_the_cameras_look(
    person: PersonCapture, method: str, views: tuple[int, ...]
) -> None:
    """From behind or from one place, camera 1 stands where camera 0 does: the hull begins at the side of the searched
    sphere that is nearer, 1.7 m before the person."""
    poses, mask, color, true = (a.copy() for a in (person.rig.world_to_camera, person.mask, person.color, person.depth))
    poses[1], mask[:, 1], color[:, 1], true[:, 1] = poses[0], mask[:, 0], color[:, 0], true[:, 0]
    rig, chosen = replace(person.rig, world_to_camera=poses), replace(person.views, sources=views)
    found = depth_of(replace(person, rig=rig, mask=mask, color=color, views=chosen), method=method)
    for v in views:
        np.testing.assert_array_equal(found[DEPTH][:, v] > 0, mask[:, v] > 127)
        surface = (found[DEPTH][:, v] > 0) & (true[:, v] > 0)
        assert np.abs(found[DEPTH][:, v] - true[:, v])[surface].max() < 0.5  # as deep as a person is anywhere
        assert np.abs(found[DEPTH][:, v] - true[:, v])[surface].mean() < 0.15
        assert found[CONFIDENCE][:, v].max() < 0.5
    assert alone(rig, views) == views


def test_a_camera_to_the_side_tells_how_far_away_the_subject_is(person: PersonCapture, method: str) -> None:
    views = (0, 2, 4)
    geometry = Geometry.of(person.rig, views, DepthParams(method=method))
    assert reliefs(geometry, Frame({}, {v: person.mask[0, v] for v in views})) == {}
    blind = {v: person.mask[0, v] if v != 2 else np.zeros_like(person.mask[0, 2]) for v in views}
    assert sorted(reliefs(geometry, Frame({}, blind))) == [0, 4], "which says nothing where its mask is empty"
    assert "cam00, cam04: every other camera looks along the same rays" in " ".join(_told(person, (0, 4)))
    assert "every other camera" not in " ".join(_told(person, views))
    assert reliefs(geometry, Frame({}, {0: blind[0]})) == reliefs(geometry, Frame({}, {2: blind[2]})) == {}


def test_masks_that_contradict_all_others_in_a_frame_are_named(person: PersonCapture) -> None:
    """One that is empty in the second frame, and one that is the whole picture in the first; right ones are not."""
    spoilt = person.mask.copy()
    spoilt[1, 3], spoilt[0, 5] = 0, 255
    for mask, wrong in ((spoilt, {3: "frame 1:", 5: "frame 0:"}), (person.mask, {})):
        given = {**arrays(person), "frames/mask": mask}
        params, facts = DepthParams(method="hull"), frozenset({"masks"})
        inputs = MemoryInputs(STAGE, params, given, person.rig, person.views, range(2), 2, facts=facts)
        told = {b.view: b.notes for b in run(inputs, params) if b.notes}
        assert told.keys() == wrong.keys()
        assert all(which in told[view][0] for view, which in wrong.items())


def test_somebody_elses_arm_in_a_mask_has_no_depth_and_is_named(person: PersonCapture) -> None:
    """That of a view alone, in the second frame."""
    spoilt, at = person.mask.copy(), int(np.median(np.nonzero(person.mask[1, 3])[0]))
    spoilt[1, 3, at - 3 : at + 4, np.nonzero(person.mask[1, 3, at])[0].max() :] = 255
    given = {**arrays(person), "frames/mask": spoilt}
    inputs = MemoryInputs(
        STAGE, DepthParams(method="hull"), given, person.rig, person.views, range(2), 2, facts=frozenset({"masks"})
    )
    blocks = list(run(inputs, DepthParams(method="hull")))
    told = {b.view: b.notes for b in blocks if b.notes}
    assert told.keys() == {3}
    assert told[3][0].startswith(
        "1 of 2 masks hold something that most other cameras have nothing of, those of frame 1"
    )
    (depth,) = (np.asarray(b.data) for b in blocks if (b.array, b.view) == (DEPTH, 3))
    assert (depth[1][spoilt[1, 3] != person.mask[1, 3]] > 0).mean() < 0.15
    assert (depth[1][person.mask[1, 3] > 127] > 0).all()


def _told(c: PersonCapture, views: tuple[int, ...]) -> list[str]:
    """What a plan says of the depth of these source views."""
    size = c.rig.size
    return notes(
        Evidence(DepthParams(), frozenset(), c.rig, c.rig, size, np.tile([1.0, 0, 0], (9, 1)), views, views, 1, (), {})
    )


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (7, 1)])
def test_a_picture_of_a_single_row_or_column_has_no_contour_that_turns_away(shape: tuple[int, int]) -> None:
    rig = rig_of([np.eye(4)], shape[::-1], 4.0)
    depth, inside = np.full(shape, 2.0, np.float32), np.zeros(shape, bool)
    out, trust = turn_away(rig, 0, depth, depth / 2, depth, depth + 1, inside)
    np.testing.assert_array_equal(out, depth)
    np.testing.assert_array_equal(trust, depth / 2)


def test_truth_is_passed_on_and_refused_where_there_is_none(person: PersonCapture) -> None:
    found = depth_of(person, method="truth", more={"facts": frozenset({"truth_depth"})})
    np.testing.assert_array_equal(found[DEPTH][:, :8], person.depth[:, :8])
    assert not found[DEPTH][:, 8].any()
    np.testing.assert_array_equal(found[CONFIDENCE] == 1, found[DEPTH] > 0)
    with pytest.raises(UserError, match=r"depth\.method is truth"):
        depth_of(person, method="truth")


def test_without_masks_only_consistent_pixels_keep_a_depth(method: str) -> None:
    c = capture_person(views=16, size=96, frames=1, held_out=0)
    found = depth_of(replace(c, mask=np.full_like(c.mask, 255)), depth_range=(1.6, 3.2), method=method)
    depth, trust = found[DEPTH], found[CONFIDENCE]
    np.testing.assert_array_equal(depth > 0, trust > 0)
    assert (trust[depth > 0] >= 0.5).all()
    assert depth[depth > 0].min() > 1.5
    assert depth.max() < 3.3
    surface = (c.mask > 127) & (c.depth > 0) & (depth > 0)
    assert surface.sum() > 0.6 * (c.mask > 127).sum()
    assert np.median(np.abs(depth - c.depth)[surface]) < 0.05


def test_pictures_that_are_not_square_and_padded_views(person: PersonCapture, method: str) -> None:
    # The lower 16 rows are cut off every view, and view 3 loses 10 columns too: its arrays keep them as padding.
    size = person.rig.size.copy()
    size[:, 1] = 80
    size[3, 0] = 86
    color, mask, depth = (np.ascontiguousarray(a[:1, :, :80]) for a in (person.color, person.mask, person.depth))
    mask[:, 3, :, 86:] = 0
    c = replace(person, rig=replace(person.rig, size=size), color=color, mask=mask, depth=depth)
    found = depth_of(c, method=method)[DEPTH]
    assert found.shape == (1, 9, 80, 96)
    surface = (mask[:, :8] > 127) & (depth[:, :8] > 0)
    assert np.median(np.abs(found[:, :8] - depth[:, :8])[surface]) < 0.03


def test_a_single_source_view_and_an_empty_frame_have_no_depth(person: PersonCapture, method: str) -> None:
    lonely = replace(person, views=replace(person.views, sources=(0,)))
    assert not depth_of(lonely, method=method)[DEPTH].any()
    empty = replace(person, mask=np.zeros_like(person.mask))
    assert not depth_of(empty, method=method)[DEPTH].any()
    nobody = depth_of(person, more={"valid_all": np.zeros((2, 9), bool)}, method=method)
    assert not nobody[DEPTH].any()


def test_check_warns_of_poor_matching_and_refuses_impossible_values(
    person: PersonCapture, estimate: dict[str, np.ndarray]
) -> None:
    params = DepthParams()
    assert check(Block(DEPTH, estimate[DEPTH][:, 0], 0), params) == []
    assert check(Block(CONFIDENCE, estimate[CONFIDENCE][:, 0], 0), params) == []
    poor = np.full((1, 4, 4), 0.3, np.float16)
    assert check(Block(CONFIDENCE, poor, 5), params) == []
    assert "0% of the surface" in matched_note(poor)[0]
    assert matched_note(estimate[CONFIDENCE][:, 0]) == matched_note(0 * poor) == ()
    for bad in (np.nan, -1.0, np.inf):
        with pytest.raises(ValueError, match=r"depth/depth of view 1"):
            check(Block(DEPTH, np.full((1, 2, 2), bad, np.float32), 1), params)
    with pytest.raises(ValueError, match=r"not in \[0, 1\]"):
        check(Block(CONFIDENCE, np.full((1, 2, 2), 1.5, np.float16), 1), params)


def test_a_depth_range_must_ascend():
    for wrong in ((3.0, 1.0), (0.0, 2.0), (2.0, 2.0)):
        with pytest.raises(ValueError, match="0 < nearest < farthest"):
            DepthParams(depth_range=wrong)
