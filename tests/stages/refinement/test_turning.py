"""Cameras that are turned together with the Gaussians: slopes by finite differences, and where they end."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.small_turns import following, turned
from posegaussian.stages.judge import turning
from posegaussian.stages.refinement.frame import FrameGaussians
from posegaussian.stages.refinement.schedule import Schedule
from posegaussian.stages.refinement.steps.optimise import NEWEST
from posegaussian.stages.refinement.steps.turning import RATE, TurnedCameras, TurningWalk, turns_with_gaussians
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.stages.refinement.walks import begun


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=6, size=96, frames=1, held_out=0)


def written(person: PersonCapture, turns: np.ndarray) -> PersonCapture:
    """The same pictures and depth of cameras that are written down turned."""
    return replace(person, rig=turned(person.rig, turns))


def pixels(person: PersonCapture, seed: int) -> np.ndarray:
    """[V, 3] rad that turn pictures by a pixel, one standard deviation an axis, with nothing of a shifted subject."""
    rig = person.rig
    turns = np.random.default_rng(seed).normal(size=(len(rig), 3)) / rig.intrinsics[:, :1, 0]
    together = following(rig)
    return (turns.ravel() - together @ (together.T @ turns.ravel())).reshape(-1, 3)


def test_turns_that_follow_a_subject_are_those_that_keep_it_where_it_was_in_every_picture(
    person: PersonCapture,
) -> None:
    rig, shift = person.rig, np.array([0.003, -0.002, 0.001])
    together = following(rig)
    np.testing.assert_allclose(together.T @ together, np.eye(3), atol=1e-12)
    ahead = look_at_point(rig) - rig.centres
    about = np.cross(ahead, shift) / (ahead**2).sum(axis=1)[:, None]
    wanted = np.einsum("vij,vj->vi", rig.rotations, about).ravel()
    np.testing.assert_allclose(together @ (together.T @ wanted), wanted, atol=1e-12)


@pytest.mark.parametrize("view", [0, 3])
def test_slopes_by_turns_are_those_of_where_gaussians_come_to_lie_before_the_camera(
    person: PersonCapture, view: int
) -> None:
    """A value of the Gaussians' places in the axes of the camera that sees them, linear in them."""
    walk = TurningWalk(*begun(person), TurnedCameras(person.rig))
    slopes = np.random.default_rng(2).normal(size=(len(walk.gaussians), 3))  # by places in that camera's axes

    def value(turns: np.ndarray) -> float:
        rig = turned(person.rig, turns)
        walk.gaussians.rays.poses[:] = rig.world_to_camera[list(walk.gaussians.views), :3]
        places = walk.gaussians.gaussians().mean.detach().numpy().astype(np.float64)
        pose = rig.world_to_camera[view]
        return float((slopes * (places @ pose[:3, :3].T + pose[:3, 3])).sum())

    step, none = 1e-3, np.zeros((len(person.rig), 3))
    value(none)
    places = walk.gaussians.gaussians().mean.detach().numpy()
    found = walk._by_turns(view, places, slopes @ person.rig.rotations[view])
    for v, axis in ((view, 0), (view, 2), (1, 0), (1, 1), (5, 2)):
        by = none.copy()
        by[v, axis] = step
        wanted = (value(by) - value(-by)) / (2 * step)
        # metres in float32, differences of 1e-3
        assert found[v, axis] == pytest.approx(wanted, rel=2e-3, abs=2e-2), (v, axis)


def test_cameras_written_down_a_pixel_off_come_back_more_than_half_way(person: PersonCapture) -> None:
    off = pixels(person, 1)
    given = written(person, off)
    found = turns_with_gaussians(given.rig, [begun(given)])
    left = (off + found) * person.rig.intrinsics[:, :1, 0]  # turns so small add up
    assert np.sqrt((left[:, :2] ** 2).mean()) < 0.5
    assert np.abs(following(given.rig).T @ found.ravel()).max() < 1e-12


def test_cameras_that_stand_right_hardly_turn(person: PersonCapture) -> None:
    found = turns_with_gaussians(person.rig, [begun(person)]) * person.rig.intrinsics[:, :1, 0]
    assert np.sqrt((found[:, :2] ** 2).mean()) < 0.25


def test_a_camera_kept_aside_stays_and_changes_nothing(person: PersonCapture) -> None:
    gaussians, filmed, order = begun(person)
    few = {v: g for v, g in gaussians.items() if v != 2}, filmed, tuple(v for v in order if v != 2)
    found = turns_with_gaussians(person.rig, [few])
    assert not found[2].any()
    rest = [v for v in order if v != 2]
    moved = person.rig.world_to_camera.copy()
    moved[2, :3, 3] += 1
    np.testing.assert_array_equal(found, turns_with_gaussians(replace(person.rig, world_to_camera=moved), [few]))
    assert np.abs(following(person.rig.subset(rest)).T @ found[rest].ravel()).max() < 1e-12


def test_a_first_step_is_the_rate_against_the_slope_and_what_is_no_number_turns_nothing(person: PersonCapture) -> None:
    cameras, rate = TurnedCameras(person.rig), RATE / person.rig.intrinsics[0, 0, 0]
    slopes = np.zeros((len(person.rig), 3))
    slopes[1, 0], slopes[2, 1], slopes[3, 2] = 5.0, np.nan, -0.1
    cameras.turn(slopes, slower=2.0)
    wanted = np.zeros_like(slopes)
    wanted[1, 0], wanted[3, 2] = -rate / 2, rate / 2
    np.testing.assert_allclose(cameras.reached, NEWEST * wanted, rtol=1e-5)  # float32
    np.testing.assert_allclose(cameras.rig.world_to_camera, turned(person.rig, wanted).world_to_camera, atol=1e-8)


def test_a_step_moves_gaussians_and_cameras_and_takes_the_gaussians_along(person: PersonCapture) -> None:
    cameras = TurnedCameras(person.rig)
    walk = TurningWalk(*begun(person), cameras)
    rigs = [cameras.rig.world_to_camera]
    for _ in range(3):
        walk.step()
        rigs.append(cameras.rig.world_to_camera)
    assert all(a.any() for name, a in walk.gaussians.offsets.items() if name in ("color", "depth", "scale"))
    assert not any(np.array_equal(a, b) for a, b in pairwise(rigs))
    # as they were when the last picture was drawn, before it moved the cameras
    poses = walk.gaussians.rays.poses
    assert not np.array_equal(poses, np.asarray(person.rig.world_to_camera[:, :3], np.float32))
    assert np.abs(poses - cameras.rig.world_to_camera[:, :3]).max() < 10 * RATE / person.rig.intrinsics[0, 0, 0]


def test_every_frame_turns_the_cameras_that_it_has_gaussians_of(person: PersonCapture) -> None:
    given = written(person, pixels(person, 1))
    gaussians, filmed, order = begun(given)
    first, second = (
        ({v: g for v, g in gaussians.items() if v in views}, filmed, tuple(v for v in order if v in views))
        for views in ((0, 1, 2, 3), (2, 3, 4, 5))
    )
    alone, both = turns_with_gaussians(given.rig, [first]), turns_with_gaussians(given.rig, [first, second])
    assert not alone[4:].any()
    assert both[4:].any(axis=1).all()


def test_without_a_frame_nobody_turns(person: PersonCapture) -> None:
    assert not turns_with_gaussians(person.rig, []).any()


def test_the_judges_frames_turn_cameras_towards_where_they_stand_and_unusable_ones_are_left_out(
    person: PersonCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    off = pixels(person, 1)
    given = written(person, off)
    gaussians, filmed, order = begun(given)
    plan = Schedule(order[0], (), order[1:])
    frames = [FrameGaussians(gaussians, filmed, plan), FrameGaussians({0: gaussians[0]}, {}, None)]
    reader = SimpleNamespace(frame=lambda f: frames[f])
    monkeypatch.setattr(turning, "FrameReader", lambda made, params: reader)
    made: Any = SimpleNamespace(rig=given.rig, partition=range(2))
    left = (off + turning.turns_together(made)) * person.rig.intrinsics[:, :1, 0]
    assert np.sqrt((left[:, :2] ** 2).mean()) < 0.5
