"""`sway`: rigid, loops, begins at the camera, keeps the subject where it is, and stays as near as asked."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import SWAY, make_path
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.cone import cone_notes
from posegaussian.stages.geometry.pairs import angle_at
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.subject import look_at_point, middle_rays, subject_distance
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.errors import UserError
from tests.stages.camera_paths.test_paths import ring, views
from tests.support.known_geometry import cut_aside


def single(text: str = "sway", frames: int = 60, distance: float | None = 3.0) -> tuple[Rig, CameraPath]:
    rig = ring(3)
    return rig, make_path(text, rig, Views(rig.names, (1,), (0, 2)), np.arange(frames), distance)


def centres(path: CameraPath) -> np.ndarray:
    pose = path.world_to_camera.reshape(-1, 4, 4)
    return -np.einsum("nji,nj->ni", pose[:, :3, :3], pose[:, :3, 3])


def test_it_begins_at_the_only_source_camera_and_keeps_its_lens() -> None:
    rig, path = single()
    np.testing.assert_allclose(path.world_to_camera[0, 0], rig.world_to_camera[1], atol=1e-12)
    assert (path.intrinsics == rig.intrinsics[1]).all()
    assert (path.size == rig.size[1]).all()
    rotations = path.world_to_camera[:, 0, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-12
    )


@pytest.mark.parametrize(("text", "degrees"), [("sway", SWAY), ("sway cam0 2.5", 2.5)])
def test_the_subject_stays_where_it_is_and_the_swing_is_as_wide_as_asked(text: str, degrees: float) -> None:
    rig, path = single(text)
    view = 0 if "cam0" in text else 1
    subject = rig.centres[view] + 3.0 * rig.rotations[view, 2]
    for pose in path.world_to_camera[:, 0]:
        pixel, depth = project(subject[None], rig.intrinsics[view], pose)
        np.testing.assert_allclose(pixel[0], [160, 120], atol=1e-9)
        np.testing.assert_allclose(depth, 3.0)
    angles = [angle_at(subject, rig.centres[view], c) for c in centres(path)]
    assert 0.95 * degrees < max(angles) < 1.1 * degrees  # up and down it is a third of it


def test_a_picture_cut_beside_the_principal_point_turns_about_its_own_middle() -> None:
    rig = cut_aside(ring(3), 30.0)
    roles = Views(rig.names, (1,), (0, 2))
    path = make_path("sway", rig, roles, np.arange(60), 3.0)
    subject = rig.centres[1] + 3.0 * middle_rays(rig)[1]
    for pose in path.world_to_camera[:, 0]:
        np.testing.assert_allclose(project(subject, rig.intrinsics[1], pose)[0], [160, 120], atol=1e-9)
    orbit = make_path("orbit", rig, roles, np.arange(20), 3.0)
    for pose, k in zip(orbit.world_to_camera[:, 0], orbit.intrinsics[:, 0], strict=True):
        np.testing.assert_allclose(project(subject, k, pose)[0], [160, 120], atol=1e-9)
    farthest = max(angle_at(subject, rig.centres[1], c) for c in centres(orbit))
    assert f"goes {farthest:.0f} degrees" in cone_notes(rig, 1, 3.0, "its depth is given", 20.0, {"orbit": orbit})[1]


def test_it_loops_without_a_jump_and_a_long_sequence_swings_more_often() -> None:
    for frames in (60, 300):
        _, path = single(frames=frames)
        c = centres(path)
        steps = np.linalg.norm(np.diff(np.concatenate([c, c[:1]]), axis=0), axis=1)
        assert steps.max() < 2.5 * np.median(steps)
    x = (centres(path) - centres(path)[0]) @ ring(3).rotations[1, 0]
    assert ((x[:-1] > 1e-6) & (x[1:] <= 1e-6)).sum() == 3, "three swings of a hundred frames"


def test_with_several_sources_it_turns_about_what_they_look_at() -> None:
    rig = ring()
    path = make_path("sway cam2", rig, views(rig), np.arange(10), 99.0)
    subject = look_at_point(rig)
    away = np.linalg.norm(centres(path) - subject, axis=1)
    np.testing.assert_allclose(away, away[0], rtol=1e-3)  # the cameras' axes meet there but for a tenth of a millimetre
    assert path.served.all()


def test_one_frame_gets_48_cameras() -> None:
    assert single(frames=1)[1].served.shape == (1, 48)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sway cam9", "cam9"),
        ("sway cam0 much", "no number of degrees"),
        ("sway cam0 0", "not between 0 and 90"),
        ("sway cam0 nan", "not between"),
        ("sway a b c", "takes 0 or 1 or 2"),
    ],
)
def test_faults_are_sentences(text: str, said: str) -> None:
    with pytest.raises(UserError, match=said):
        single(text)


def test_the_cone_names_the_paths_that_leave_it() -> None:
    rig = ring(3)
    distance = subject_distance(rig, 1, None)
    roles = Views(rig.names, (1,), (0, 2))
    paths = {p.name: p for p in (make_path(t, rig, roles, np.arange(20)) for t in ("sway", "orbit", "still cam0"))}
    notes = cone_notes(rig, 1, distance, "its depth is a relief", 10.0, paths)
    assert "cam1 is the only source view" in notes[0]
    assert [n.split("'")[1] for n in notes[1:]] == ["orbit", "still cam0"], "as they were asked for"
    assert "goes 44 degrees" in cone_notes(rig, 1, 2.45, "its depth is given", 20.0, paths)[2]
