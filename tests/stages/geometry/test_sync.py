"""Offsets between cameras are found from made tracks whose offsets are known, and nothing is claimed of a subject
that stands still."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.sync import FURTHEST, SURE, time_offsets
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of

FRAMES, JOINTS = 100, 13
OFFSETS = [0.0, 1.0, -2.4, 0.0]


def made_rig(views: int = 4) -> Rig:
    return rig_of([camera(on_ring(30.0 * v, 10.0, 3.0), np.zeros(3)) for v in range(views)], (1000, 1000), 1000.0)


def joints_at(times: np.ndarray, speed: float = 1.0) -> np.ndarray:
    """[n, J, 3] metres: every joint swings about its place in its own way, within a decimetre and a half."""
    random = np.random.default_rng(5)
    place = random.uniform(-0.5, 0.5, (JOINTS, 3))
    phase, rate = random.uniform(0, 2 * np.pi, (2, JOINTS, 3)), random.uniform(0.06, 0.2, (2, JOINTS, 3))
    swing = sum(np.sin(speed * r * times[:, None, None] + p) for r, p in zip(rate, phase, strict=True))
    return place + 0.1 * swing * (speed > 0)


def filmed(rig: Rig, offsets: list[float], noise: float = 0.0, speed: float = 1.0, outliers: float = 0.0) -> np.ndarray:
    """[F, V, J, 3]: a camera that is late by o shows in picture n + o what others show in picture n."""
    random = np.random.default_rng(7)
    out = np.ones((FRAMES, len(rig), JOINTS, 3))
    for v, late in enumerate(offsets):
        out[:, v, :, :2] = project(
            joints_at(np.arange(FRAMES) - late, speed), rig.intrinsics[v], rig.world_to_camera[v]
        )[0]
    out[..., :2] += random.normal(size=out[..., :2].shape) * noise
    wild = random.random(out.shape[:3]) < outliers
    out[wild, :2] = random.uniform(0, 1000, (int(wild.sum()), 2))
    return out


@pytest.mark.parametrize(("noise", "outliers", "tolerance"), [(0.0, 0.0, 0.1), (2.0, 0.0, 0.15), (4.0, 0.1, 0.3)])
def test_known_offsets_are_found(noise: float, outliers: float, tolerance: float) -> None:
    """Without noise the parabola's error alone is left: the motion is not quadratic in time. A standard error says
    the size of the rest."""
    found = time_offsets(made_rig(), filmed(made_rig(), OFFSETS, noise, outliers=outliers))
    assert found.told.all()
    np.testing.assert_allclose(found.frames - found.frames[0], OFFSETS, atol=tolerance)
    assert (found.error <= SURE).all()
    np.testing.assert_array_less(np.abs(found.frames - found.frames[0] - OFFSETS), 5 * found.error + 0.1)


def test_cameras_in_step_are_said_to_be() -> None:
    found = time_offsets(made_rig(), filmed(made_rig(), [0.0] * 4, noise=2.0))
    assert found.told.all()
    np.testing.assert_allclose(found.frames, 0.0, atol=0.15)


def test_the_reference_is_the_camera_in_the_middle() -> None:
    found = time_offsets(made_rig(), filmed(made_rig(), [5.0, 1.0, 1.0, 1.0], noise=0.5))
    assert found.reference == 1
    np.testing.assert_allclose(found.frames, [4.0, 0.0, 0.0, 0.0], atol=0.15)


def test_two_cameras_are_enough() -> None:
    found = time_offsets(made_rig(2), filmed(made_rig(2), [0.0, -3.0], noise=1.0))
    np.testing.assert_allclose(found.frames, [0.0, -3.0], atol=0.2)


def test_an_error_of_the_calibration_is_not_taken_for_an_offset() -> None:
    """A camera whose principal point is off by 8 px sees everything beside its lines all the time."""
    tracks = filmed(made_rig(), [0.0] * 4, noise=1.0)
    tracks[:, 1, :, :2] += 8.0
    found = time_offsets(made_rig(), tracks)
    assert found.told.all()
    np.testing.assert_allclose(found.frames, 0.0, atol=0.2)


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_of_a_still_subject_nothing_can_be_told(noise: float) -> None:
    found = time_offsets(made_rig(), filmed(made_rig(), OFFSETS, noise, speed=0.0))
    assert not found.told.any()
    np.testing.assert_array_equal(found.frames, 0.0)
    assert "cannot be told" in found.sentence(1, "cam1")


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_tells_nothing(seed: int) -> None:
    tracks = np.ones((FRAMES, 4, JOINTS, 3))
    tracks[..., :2] = 500 + 3 * np.random.default_rng(seed).normal(size=tracks[..., :2].shape)
    assert not time_offsets(made_rig(), tracks).told.any()


def test_one_camera_and_few_frames_tell_nothing() -> None:
    assert not time_offsets(made_rig(1), filmed(made_rig(1), [0.0])).told.any()
    assert not time_offsets(made_rig(), filmed(made_rig(), OFFSETS)[:2]).told.any()
    assert not time_offsets(made_rig(), filmed(made_rig(), OFFSETS)[:0]).told.any()


def test_a_camera_without_joints_is_not_told_and_does_not_spoil_the_others() -> None:
    tracks = filmed(made_rig(), OFFSETS, noise=1.0)
    tracks[:, 3] = 0.0
    found = time_offsets(made_rig(), tracks)
    assert found.told.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.frames[1:3] - found.frames[0], OFFSETS[1:3], atol=0.2)


def test_an_offset_beyond_the_search_is_not_told_wrongly() -> None:
    """Whatever is found at the border of the search has no least there."""
    late = FURTHEST + 10.0
    found = time_offsets(made_rig(2), filmed(made_rig(2), [0.0, late], noise=1.0))
    assert not found.told.any() or abs(found.frames[1] - late) < 1.0
