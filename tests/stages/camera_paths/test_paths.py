"""Laws of camera paths: rigid, exact ends, constant distance, the subject still in the picture;
and a sentence for every fault."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import _looking_at, make_path
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.storage.model.cameras import CameraPath, Rig, rigid
from posegaussian.storage.model.errors import UserError

NEAR = 1e-4
"""Metres: `look_at_point` is pulled 5e-5 m off the ring's middle where focal lengths differ. Interpolated
translations miss by 0.1 m."""


def ring(count: int = 8, origin: tuple[float, float, float] = (0, 0, 0), tilt: float = 0.5, step: float = 45.0) -> Rig:
    """Cameras on a circle of 2.4 m around `origin`, `tilt` m above it; z is up; names with a space for the last."""
    subject, poses = np.array(origin, float), []
    for i in range(count):
        a = np.radians(step * i)
        centre = subject + np.array([2.4 * np.cos(a), 2.4 * np.sin(a), tilt])
        forward = (subject - centre) / np.linalg.norm(subject - centre)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        r = np.stack([right, np.cross(forward, right), forward])
        poses.append(rigid(r, -r @ centre))
    k = np.repeat(np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])[None], count, axis=0)
    k[:, 0, 0] += 10 * np.arange(count)
    names = (*(f"cam{i}" for i in range(count - 1)), "last one")
    return Rig(names, k, np.zeros((count, 8)), np.stack(poses), np.repeat([[320, 240]], count, axis=0))


def views(rig: Rig, held_out: tuple[int, ...] = (1, 3)) -> Views:
    return Views(rig.names, tuple(i for i in range(len(rig)) if i not in held_out), held_out)


def make(text: str, frames: int = 12, rig: Rig | None = None, held_out: tuple[int, ...] = (1, 3)) -> CameraPath:
    rig = rig or ring()
    return make_path(text, rig, views(rig, held_out), 10 + 2 * np.arange(frames))


def centres(path: CameraPath) -> np.ndarray:
    r = path.world_to_camera[..., :3, :3]
    return -np.einsum("...ji,...j->...i", r, path.world_to_camera[..., :3, 3])


def well_formed(path: CameraPath, frames: int) -> None:
    c = len(path.names)
    assert path.intrinsics.shape == (frames, c, 3, 3)
    assert path.world_to_camera.shape == (frames, c, 4, 4)
    assert path.size.shape == (c, 2)
    assert path.served.shape == (frames, c)
    r = path.world_to_camera[..., :3, :3]
    np.testing.assert_allclose(r @ np.swapaxes(r, -1, -2), np.broadcast_to(np.eye(3), r.shape), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(r), 1, atol=1e-9)


@pytest.mark.parametrize("text", ["held_out", "orbit", "arc cam0 cam2", "still cam4", 'arc cam0 "last one"'])
@pytest.mark.parametrize("frames", [1, 2, 12])
def test_every_path_is_rigid_and_its_name_is_stable(text: str, frames: int) -> None:
    path = make(text, frames)
    well_formed(path, frames)
    assert path.served.all()
    assert path.text == text
    assert path.name == make(text, frames).name
    assert path.name.startswith(text.split()[0] + "-")
    moves = text.split()[0] in ("orbit", "arc")  # standing cameras keep their folder when a sequence grows
    assert (path.name != make(text, frames + 1).name) == moves


def test_standing_cameras_are_those_of_the_rig() -> None:
    rig = ring()
    path = make("held_out", 3, rig)
    assert path.names == ("cam1", "cam3")
    for i in range(3):
        np.testing.assert_array_equal(path.world_to_camera[i], rig.world_to_camera[[1, 3]])
        np.testing.assert_array_equal(path.intrinsics[i], rig.intrinsics[[1, 3]])
    assert make('still "last one"').names == ("last one",)


@pytest.mark.parametrize("text", ["orbit", "arc cam0 cam1"])
def test_moving_paths_are_one_camera_or_48_steps_of_one_frame(text: str) -> None:
    kind = text.split()[0]
    assert make(text, 12).names == (kind,)
    single = make(text, 1)
    assert len(single.names) == 48
    assert (single.names[0], single.names[47]) == (f"{kind}_00", f"{kind}_47")
    np.testing.assert_allclose(single.world_to_camera[0], make(text, 48).world_to_camera[:, 0])


@pytest.mark.parametrize("origin", [(0, 0, 0), (1.8, -3.0, 0.7)])
@pytest.mark.parametrize("other", ["cam1", "cam2", "cam3", "cam4"])
def test_k1_an_arc_keeps_its_distance_and_the_subject_wherever_the_origin_lies(
    other: str, origin: tuple[float, float, float]
) -> None:
    """Up to 180 degrees (K2): translations that are interpolated would cut the corner
    as soon as the origin is elsewhere."""
    rig = ring(origin=origin)
    path, subject = make(f"arc cam0 {other}", 21, rig), look_at_point(rig)
    np.testing.assert_array_equal(path.world_to_camera[0, 0], rig.world_to_camera[0])
    np.testing.assert_array_equal(path.world_to_camera[-1, 0], rig.world_to_camera[rig.index(other)])
    np.testing.assert_array_equal(path.intrinsics[-1, 0], rig.intrinsics[rig.index(other)])
    offset = centres(path)[:, 0] - subject
    distance = np.linalg.norm(rig.centres[0] - subject)
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), distance, atol=NEAR)
    # on the ring, not over the head
    np.testing.assert_allclose(offset @ up_direction(rig), offset[0] @ up_direction(rig), atol=NEAR)
    steps = np.linalg.norm(np.diff(offset, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], atol=NEAR)
    at = (
        np.einsum("fij,fj->fi", path.world_to_camera[:, 0, :3, :3], subject + 0 * offset)
        + path.world_to_camera[:, 0, :3, 3]
    )
    pixel = np.einsum("fij,fj->fi", path.intrinsics[:, 0], at)
    np.testing.assert_allclose(pixel[:, :2] / pixel[:, 2:], [[160, 120]] * 21, atol=0.02)


def test_k2_a_half_turn_goes_around_the_rigs_up_axis_and_never_overhead() -> None:
    """Also where rounding in a text file puts the rotation a hair on either side of the half turn."""
    for hair in (0.0, 1e-7, -1e-7):
        rig = ring()
        turn = np.array([[np.cos(hair), -np.sin(hair), 0], [np.sin(hair), np.cos(hair), 0], [0, 0, 1]])
        rig.world_to_camera[4, :3, :3] = rig.world_to_camera[4, :3, :3] @ turn
        middle = centres(make("arc cam0 cam4", 3, rig, ()))[1, 0]
        np.testing.assert_allclose(middle, [0, 2.4, 0.5], atol=1e-5)


def test_an_arc_between_cameras_of_different_distance_and_size() -> None:
    rig = ring()
    r = rig.world_to_camera[2, :3, :3]
    rig.world_to_camera[2, :3, 3] = -r @ (rig.centres[2] * 2)
    rig.size[2] = (200, 300)
    path, subject = make("arc cam0 cam2", 5, rig, ()), look_at_point(rig)
    distance = np.linalg.norm(centres(path)[:, 0] - subject, axis=1)
    np.testing.assert_allclose(np.diff(distance), np.diff(distance)[0], atol=1e-9)
    assert path.size.tolist() == [[320, 300]]


def test_an_arc_from_a_camera_to_itself_stands_still() -> None:
    path = make("arc cam2 cam2", 4)
    np.testing.assert_allclose(
        path.world_to_camera, np.broadcast_to(path.world_to_camera[:1], path.world_to_camera.shape), atol=1e-12
    )


def test_cameras_of_many_frames_are_to_the_byte_those_of_one_frame_after_the_other() -> None:
    rng = np.random.default_rng(0)
    subject, up = rng.normal(size=3), np.array([0.0, -1.0, 0.0])
    centres = np.concatenate([rng.normal(size=(300, 3)), subject + 2 * np.eye(3)[[0, 2]], subject - np.eye(3)[[0, 2]]])
    each = []
    for centre in centres:
        forward = (subject - centre) / np.linalg.norm(subject - centre)
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        each.append(rigid(rotation, -rotation @ centre))
    assert _looking_at(subject, centres, up).tobytes() == np.stack(each).tobytes()


def test_an_orbit_goes_once_around_at_the_mean_radius_and_height() -> None:
    rig = ring(origin=(1.0, 2.0, 0.5))
    rig.size[5], rig.intrinsics[5, :2, 2] = (100, 100), 50
    path, subject = make("orbit", 16, rig, ()), look_at_point(rig)
    offset = centres(path)[:, 0] - subject
    np.testing.assert_allclose(np.linalg.norm(offset[:, :2], axis=1), 2.4, atol=NEAR)
    np.testing.assert_allclose(offset[:, 2], 0.5, atol=NEAR)
    angle = np.unwrap(np.arctan2(offset[:, 1], offset[:, 0]))
    np.testing.assert_allclose(np.diff(angle), 2 * np.pi / 16, atol=1e-9)
    np.testing.assert_allclose(path.world_to_camera[0, 0], rig.world_to_camera[0], atol=3 * NEAR)
    assert path.size.tolist() == [[320, 240]]
    # The median of 500, 505 ... 535 px without the square picture's, whose angle of view is another's.
    np.testing.assert_allclose(path.intrinsics[0, 0], [[515, 0, 160], [0, 515, 120], [0, 0, 1]])


@pytest.mark.parametrize("larger", [(0, 2, 4), (0, 1, 2, 3, 4)])
def test_an_orbit_of_cameras_of_several_sizes_has_their_angle_of_view(larger: tuple[int, ...]) -> None:
    """And not that of the pixels of the larger ones over the picture of the smaller, which cuts the subject off."""
    rig = ring(6, step=60)
    for v in range(6):
        times = 4 if v in larger else 1
        rig.size[v] = (320 * times, 240 * times)
        rig.intrinsics[v, :2] = np.array([[400.0, 0, 160], [0, 400, 120]]) * times
    rig.intrinsics[5, [0, 1], [0, 1]] = 1600.0  # a close-up of one camera makes none of the orbit
    path = make("orbit", 8, rig, ())
    assert path.size[0, 0] / path.intrinsics[0, 0, 0, 0] == pytest.approx(320 / 400)


def test_an_orbit_and_a_sway_of_a_single_camera_go_about_the_subject_as_far_away_as_is_said() -> None:
    rig = ring(1)
    for text in ("orbit", "sway"):
        for distance in (2.0, 5.0):
            path = make_path(text, rig, Views(rig.names, (0,), ()), np.arange(24), distance)
            subject = rig.centres[0] + distance * rig.rotations[0, 2]
            np.testing.assert_allclose(np.linalg.norm(centres(path)[:, 0] - subject, axis=1), distance)


@pytest.mark.parametrize("count", [1, 2])
def test_an_orbit_of_a_one_sided_rig_goes_all_the_way_around(count: int) -> None:
    path = make_path("orbit", ring(count), Views(ring(count).names, tuple(range(count)), ()), np.arange(8))
    well_formed(path, 8)
    spread = centres(path)[:, 0]
    assert np.linalg.norm(spread.max(axis=0) - spread.min(axis=0)) > 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("orbital", "did you mean 'orbit'"),
        ("", "is none of"),
        ("arc cam0", "arc takes 2 camera names, got 1"),
        ("orbit cam0", "orbit takes 0"),
        ("still cam9", "no camera named 'cam9'"),
        ("still cam9", "did you mean"),
        ('still "cam0', "pair of quotes"),
        ("missing.json", "No such file"),
    ],
)
def test_a_faulty_path_gets_a_sentence(text: str, says: str) -> None:
    with pytest.raises(UserError, match=says):
        make(text)


def test_held_out_without_held_out_cameras() -> None:
    with pytest.raises(UserError, match=r"views\.held_out"):
        make_path("held_out", ring(), views(ring(), ()), np.arange(3))


def test_an_orbit_needs_a_radius() -> None:
    rig = ring(1)
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    rig.world_to_camera[0] = rigid(down, -down @ [0, 0, 3.0])
    # its own up is sideways: an orbit over the top
    well_formed(make_path("orbit", rig, views(rig, ()), np.arange(3)), 3)
    above = Rig(
        ("a", "b"), rig.intrinsics[[0, 0]], rig.distortion[[0, 0]], rig.world_to_camera[[0, 0]].copy(), rig.size[[0, 0]]
    )
    above.world_to_camera[:, :3, :3] = [np.diag([1.0, 1, 1]), np.diag([1.0, 1, 1])]
    well_formed(make_path("orbit", above, views(above, ()), np.arange(3)), 3)


def entry(name: str = "a", **changes: Any) -> dict[str, Any]:
    e = {
        "name": name,
        "width": 64,
        "height": 48,
        "K": [[50, 0, 31.5], [0, 50, 23.5], [0, 0, 1]],
        "R": np.eye(3).tolist(),
        "t": [0, 0, 2],
    }
    e |= changes
    return {k: v for k, v in e.items() if v is not None}


def from_file(folder: Path, cameras: Any, **top: Any) -> CameraPath:
    file = folder / "cameras.json"
    file.write_text(json.dumps({"pixel_center": "half", "cameras": cameras} | top))
    return make(str(file), 3)  # source frames 10, 12, 14


def test_a_file_of_cameras(tmp_path: Path) -> None:
    path = from_file(tmp_path, [entry(), entry("b", frame=12), entry("b", frame=14, t=[0, 0, 3]), entry("b", frame=99)])
    well_formed(path, 3)
    assert (path.kind, path.names) == ("file", ("a", "b"))
    assert path.served.tolist() == [[True, False], [True, True], [True, True]]
    assert path.world_to_camera[1:, 1, 2, 3].tolist() == [2, 3]
    assert path.intrinsics[0, 0, 0, 2] == 31.5
    assert from_file(tmp_path, [entry()], pixel_center="integer").intrinsics[0, 0, :2, 2].tolist() == [32.0, 24.0]


def test_rotations_rounded_in_text_are_made_rigid(tmp_path: Path) -> None:
    """K5."""
    r = np.round(ring().world_to_camera[1, :3, :3], 4)
    well_formed(from_file(tmp_path, [entry(R=r.tolist(), t=[[1], [2], [3]])]), 3)


@pytest.mark.parametrize(
    ("cameras", "says"),
    [
        ([], "at least one camera"),
        ([entry(), entry()], "more than once"),
        ([entry(frame=12), entry(frame=12)], "frame 12"),
        ([entry(), entry(frame=12)], "more than once"),
        ([entry(frame=10), entry(frame=12, width=65)], "64x48 px and 65x48 px"),
        ([entry(t=[0, float("nan"), 1])], "t holds nan"),
        ([entry(K=[[1, 2], [3, 4]])], "K must be 3 x 3"),
        ([entry(K=[[-5, 0, 1], [0, 5, 1], [0, 0, 1]])], "positive fx and fy"),
        ([entry(R=(2 * np.eye(3)).tolist())], "off a rotation by 3"),
        ([entry(R=np.diag([1.0, 1, -1]).tolist())], "determinant -1"),
        ([entry(t=None)], "missing t"),
        ([entry(frames=3)], "unknown key frames"),
        ([entry(name="a/b")], "without slashes"),
        ([entry(width=0)], "width 0"),
        ([entry(width=64.5)], r"width 64\.5"),
        ([entry(frame="12")], "frame '12'"),
        ([entry(frame=11)], "not among the sequence's source frames 10..14"),
        ([7], r"cameras\[0\]"),
    ],
)
def test_a_faulty_camera_gets_a_sentence(tmp_path: Path, cameras: Any, says: str) -> None:
    with pytest.raises(UserError, match=says):
        from_file(tmp_path, cameras)


def test_a_faulty_file_gets_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(UserError, match='"pixel_center" is missing'):
        from_file(tmp_path, [entry()], pixel_center=None)
    with pytest.raises(UserError, match="\"pixel_center\" is 'corner'"):
        from_file(tmp_path, [entry()], pixel_center="corner")
    file = tmp_path / "broken.json"
    file.write_text('{"pixel_center": "half",\n "cameras": [}')
    with pytest.raises(UserError, match=r"broken\.json:2:14: not valid JSON"):
        make(str(file))
    file.write_text("[1]")
    with pytest.raises(UserError, match="must be an object"):
        make(str(file))
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UserError, match="UTF-8"):
        make(str(file))
