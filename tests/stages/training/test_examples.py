"""What a step is given follows from its number, agrees with the truth, and looks at one point of the body."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.network.model.pairs import MAPS
from posegaussian.stages.network.model.warping import warp
from posegaussian.stages.training import examples
from posegaussian.stages.training.augmentation import shifted
from posegaussian.stages.training.contract import Frame
from posegaussian.stages.training.examples import Example, crop, drawn, frames_of_step, whole
from posegaussian.stages.training.frames import make_frame
from tests.support.training_examples import ball, tiny

torch.set_num_threads(1)
CONFIG = tiny(batch=2, iterations=6, window=2, steps_per_frame=3)
DOUBTFUL = tiny(strange=0.5)
THIRD = tiny(further_views=True)


@pytest.fixture(scope="module")
def frame() -> Frame:
    return ball()


def tensors(example: Example) -> list[torch.Tensor]:
    views = [getattr(example.views, name) for name in MAPS]
    return [
        *views,
        example.truth,
        example.picture,
        example.seen,
        example.cover,
        example.views.of_pose,
        *(torch.as_tensor(np.asarray(c.intrinsics)) for c in (*example.cameras, example.target)),
    ]


def same(a: Example, b: Example) -> bool:
    return all(
        torch.equal(x.nan_to_num(nan=-1e6), y.nan_to_num(nan=-1e6)) for x, y in zip(tensors(a), tensors(b), strict=True)
    )


def test_a_step_draws_the_same_whenever_it_is_asked(frame: Frame) -> None:
    at_hand = dict.fromkeys(frames_of_step(CONFIG, 7), frame)
    (first, t), (again, u), (later, _) = (
        drawn(CONFIG, 7, at_hand),
        drawn(CONFIG, 7, {**at_hand, 99: frame}),
        drawn(CONFIG, 8, dict.fromkeys(frames_of_step(CONFIG, 8), frame)),
    )
    assert t == u
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not same(first[0], first[1])
    assert not same(first[0], later[0])


def test_iterations_are_drawn_from_1_to_the_most(frame: Frame) -> None:
    few = tiny(iterations=3)
    found = {drawn(few, step, {0: frame})[1] for step in range(25)}
    assert found == {1, 2, 3}


def test_pictures_are_spoilt_and_nothing_else(frame: Frame, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step's start, truth, windows, heatmaps and target are those it has without."""
    spoilt = [crop(frame, DOUBTFUL, np.random.default_rng(seed)) for seed in range(24)]
    with monkeypatch.context() as m:
        m.setattr(examples, "spoilt", lambda color, cover, random: (color, cover))
        m.setattr(examples, "shifted", lambda color, rows: color)
        plain = [crop(frame, DOUBTFUL, np.random.default_rng(seed)) for seed in range(24)]
    assert {e.strange for e in spoilt} == {True, False}
    for a, b in zip(spoilt, plain, strict=True):
        assert same(replace(a, views=replace(a.views, color=b.views.color, cover=b.views.cover)), b)
        assert bool(torch.isfinite(a.views.color).all())
        assert 0 <= float(a.views.color.min()) <= float(a.views.color.max()) <= 1


@pytest.mark.parametrize("rows", [3.0, -5.0])
def test_a_shift_by_whole_rows_loses_only_what_leaves_the_picture(rows: float) -> None:
    picture = torch.rand(3, 16, 12, generator=torch.Generator().manual_seed(0))
    back = shifted(shifted(picture, rows), -rows)
    kept = slice(0, 16 - int(rows)) if rows > 0 else slice(int(-rows), 16)
    torch.testing.assert_close(back[:, kept], picture[:, kept], rtol=0, atol=1e-6)  # OpenCV's weights are exact there
    assert not bool(back.sum(dim=(0, 2))[[r for r in range(16) if r not in range(*kept.indices(16))]].any())


def test_the_window_of_frames_moves_on_and_never_back() -> None:
    ranges = [frames_of_step(CONFIG, s) for s in range(30)]
    assert ranges[0] == range(2)
    assert ranges[3] == range(1, 3)
    assert all(len(r) == CONFIG.window for r in ranges)
    assert all(a.start <= b.start and a.stop <= b.stop for a, b in pairwise(ranges))


def test_a_start_made_from_the_truth_is_the_truth() -> None:
    exact = ball(exact=True)
    for example in (crop(exact, CONFIG, np.random.default_rng(3)), whole(exact, 0, CONFIG), whole(exact, 1, CONFIG)):
        both = torch.isfinite(example.truth) & example.views.known
        assert both.float().mean() > 0.2
        assert torch.equal(example.truth[both], example.views.start[both])
        assert torch.equal(torch.isfinite(example.truth), example.views.known)


def test_the_target_sees_the_point_in_its_middle_and_so_do_both_windows(
    frame: Frame, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = []
    target = examples._target
    monkeypatch.setattr(
        examples, "_target", lambda frame, view, point, side: points.append(point) or target(frame, view, point, side)
    )
    for seed in range(8):
        found = crop(frame, CONFIG, np.random.default_rng(seed))
        camera = found.target
        assert (camera.width, camera.height) == (16, 16)
        place = project(points[-1][None], np.asarray(camera.intrinsics), camera.world_to_camera)[0][0]
        # Whole px, and within the picture. 64 px and a ball of 0.4 of it:
        # a window of 16 px around the ball always fits.
        assert np.abs(place - 8).max() <= 0.5 + 1e-6
        for which in (0, 1):
            shown = found.cameras[which]
            seen = project(points[-1][None], np.asarray(shown.intrinsics), np.asarray(shown.world_to_camera))[0][0]
            assert np.abs(seen - [shown.width / 2, shown.height / 2]).max() <= 32 / 8 + 0.5 + 1e-6
        first, second = (np.asarray(c.intrinsics) for c in found.cameras)
        np.testing.assert_array_equal(first[1], second[1], err_msg="equal rows")


def test_a_third_view_looks_at_the_same_point_and_changes_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Now and then there is none. What is drawn for it alone comes from a generator of its own."""
    frame, points, joints = ball(angles=(-15.0, 15.0, 40.0)), [], []
    target = examples._target
    monkeypatch.setattr(
        examples, "_target", lambda frame, view, point, side: points.append(point) or target(frame, view, point, side)
    )
    found = []
    for seed in range(12, 24):
        g, h = np.random.default_rng(seed), np.random.default_rng(seed)
        plain, more = crop(frame, tiny(), g), crop(frame, THIRD, h)
        assert same(plain, more)
        assert g.random() == h.random(), "later draws are the same, too"
        again = crop(frame, THIRD, np.random.default_rng(seed))
        assert plain.views.third is None
        third = more.views.third
        found.append(third is not None)
        if third is None:
            assert again.views.third is None
            continue
        assert again.views.third is not None
        assert torch.equal(third.color, again.views.third.color)
        assert third.color.shape == (1, 3, 32, 32)
        assert third.heatmaps.shape == (1, 17, 8, 8)
        assert 0 <= float(third.color.min()) < float(third.color.max()) <= 1
        joints.append(bool(third.heatmaps.any()))
        for which in (0, 1):
            shown = more.cameras[which]
            place, depth = project(points[-1][None], np.asarray(shown.intrinsics), np.asarray(shown.world_to_camera))
            (u, v), z = place[0], depth[0]
            x, y, w = third.projection[which].numpy() @ [u * z, v * z, z, 1]
            assert w > 0
            assert np.abs(np.array([x, y]) / w - 16).max() <= 32 / 8 + 0.5 + 1e-6
    assert sum(found) == 8
    assert sum(joints) > 0  # some crops have none


def test_the_third_view_of_a_whole_pair_shows_what_the_pair_shows() -> None:
    """The true surface, seen in the third picture: smooth colours of points in space, a start at the true depth of
    the nearest pixel."""
    example = whole(ball(exact=True, angles=(-15.0, 15.0, 40.0)), 0, THIRD)
    third, views = example.views.third, example.views
    assert third is not None
    depth = torch.where(views.known, views.coding.depth(views.start.nan_to_num()), 0)
    seen, held = warp(third.color.expand(2, -1, -1, -1), depth, third.projection)
    sure = -torch.nn.functional.max_pool2d(-(views.known & held).float(), 9, stride=1, padding=4) > 0
    apart = (seen[:, 0] - views.color).abs().mean(1, keepdim=True)[sure]
    assert sure.sum() > 300
    assert float(apart.median()) < 0.02  # of waves of 20 px and heights of 0.86
    assert whole(ball(exact=True), 0, THIRD).views.third is None


def test_the_target_picture_is_what_its_camera_sees(frame: Frame) -> None:
    example = whole(frame, 0, CONFIG)
    height, width = frame["mask"].shape[1:]
    assert (example.target.width, example.target.height) == (width, height)
    np.testing.assert_allclose(example.seen[0].numpy(), np.moveaxis(frame["color"][2], -1, 0) / 255, atol=1e-6)
    np.testing.assert_allclose(example.cover[0, 0].numpy(), frame["mask"][2] / 255, atol=1e-6)


def test_a_simulated_frame_holds_what_the_head_of_the_file_says_and_comes_out_the_same() -> None:
    config = tiny(cameras=(3,), size=48)
    frame = make_frame(config, 0)
    assert {k: v.shape for k, v in frame.items()} == {
        "color": (6, 48, 48, 3),
        "mask": (6, 48, 48),
        "truth": (3, 48, 48),
        "depth": (3, 48, 48),
        "hull": (3, 48, 48),
        "confidence": (3, 48, 48),
        "joints": (3, 3, 17, 3),
        "intrinsics": (6, 3, 3),
        "world_to_camera": (6, 4, 4),
        "pairs": (3, 3),
        "about": (4,),
    }
    assert all(np.isfinite(v).all() for v in frame.values())
    assert frame["pairs"][:, 2].min() >= 3
    inside = frame["mask"][:3] > 127
    np.testing.assert_array_equal(frame["depth"] > 0, inside)
    assert ((frame["truth"][:3] > 0) == inside).mean() > 0.97  # soft rims
    example = crop(frame, CONFIG, np.random.default_rng(0))
    assert torch.isfinite(example.views.color).all()
    assert torch.isfinite(example.truth).any()
