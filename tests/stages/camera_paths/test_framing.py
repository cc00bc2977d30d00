"""Laws of how much of the subject a path's pictures show: a person whom the cameras show whole stays whole, whatever
their distances and the sizes of their pictures, and ordinary rings keep their own sizes and focal lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.camera_paths.framing import common_size, focal_in, without_close_ups
from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.subject import body_points, look_at_point
from posegaussian.storage.model.cameras import CameraPath, Rig
from tests.support.known_geometry import camera, on_ring, rig_of, ring

MIDDLE = np.zeros(3)


def path_of(text: str, rig: Rig, frames: int = 24) -> CameraPath:
    return make_path(text, rig, Views(rig.names, tuple(range(len(rig))), ()), np.arange(frames))


def resized(rig: Rig, *sizes: tuple[int, int]) -> Rig:
    """Pictures cut or grown about their middles."""
    size = np.array(sizes)
    k = rig.intrinsics.copy()
    k[:, :2, 2] = size / 2
    return replace(rig, size=size, intrinsics=k)


def scaled(rig: Rig, view: int, by: float) -> Rig:
    """One camera's pictures in another resolution."""
    size, k = rig.size.copy(), rig.intrinsics.copy()
    size[view] = size[view] * by
    k[view, :2] *= by
    return replace(rig, size=size, intrinsics=k)


def at(place: tuple[float, float, float], focal: float, size: tuple[int, int] = (1024, 1024)) -> Rig:
    return rig_of([camera(on_ring(*place), MIDDLE)], size, focal)


def together(*rigs: Rig) -> Rig:
    found = rig_of([pose for r in rigs for pose in r.world_to_camera])
    return replace(
        found,
        intrinsics=np.concatenate([r.intrinsics for r in rigs]),
        size=np.concatenate([r.size for r in rigs]),
    )


def extents(path: CameraPath, subject: np.ndarray = MIDDLE) -> np.ndarray:
    """[S, 2, 2] least and largest x and y of a standing person in each picture, over its width and height."""
    points = body_points(subject, np.array([0.0, 0.0, 1.0]))
    seen = [
        project(points, k, m)[0] / path.size[0]
        for k, m in zip(path.intrinsics[:, 0], path.world_to_camera[:, 0], strict=True)
    ]
    return np.stack([[s.min(axis=0), s.max(axis=0)] for s in seen])


def heights(path: CameraPath) -> np.ndarray:
    """[S] of a person, over the picture's."""
    return np.asarray(np.ptp(extents(path)[..., 1], axis=1))


def own_heights(rig: Rig) -> np.ndarray:
    """[V] of a person in each camera's own picture, over that picture's."""
    return np.array([heights(path_of(f"still {n}", rig, 1))[0] for n in rig.names])


def assert_whole(path: CameraPath) -> None:
    found = extents(path)
    assert (found[:, 0] >= 0).all()
    assert (found[:, 1] <= 1).all()


@pytest.mark.parametrize("views", [5, 8, 16])
@pytest.mark.parametrize("size", [(64, 64), (640, 480), (479, 641)])
def test_ordinary_rings_keep_size_and_focal_length_to_the_byte(views: int, size: tuple[int, int]) -> None:
    """Cameras of one size at one distance, whatever differs a little."""
    rig = ring(views, size, 600.0)
    rig.intrinsics[:, [0, 1], [0, 1]] += 10.0 * (np.arange(views) % 3)[:, None]
    focal = rig.intrinsics[:, 0, 0]
    distances = np.linalg.norm(rig.centres - look_at_point(rig), axis=1)
    np.testing.assert_array_equal(common_size(rig), size)
    np.testing.assert_array_equal(focal_in(rig, rig.size[0]), focal)
    np.testing.assert_array_equal(without_close_ups(focal, distances, tuple(range(views))), focal)
    orbit, between = path_of("orbit", rig), path_of("between", rig)
    expected = [[np.median(focal), 0, size[0] / 2], [0, np.median(focal), size[1] / 2], [0, 0, 1]]
    for path in (orbit, between):
        np.testing.assert_array_equal(path.size, [size])
    np.testing.assert_array_equal(orbit.intrinsics, np.broadcast_to(expected, orbit.intrinsics.shape))
    np.testing.assert_array_equal(between.intrinsics[0, 0], rig.intrinsics[0])
    k, share = rig.intrinsics, np.linspace(0, 1, 24)[:, None, None]
    arc = path_of("arc cam0 cam2", rig)
    np.testing.assert_array_equal(arc.size, [size])
    np.testing.assert_array_equal(arc.intrinsics[:-1, 0], (k[0] + share * (k[2] - k[0]))[:-1])
    np.testing.assert_array_equal(arc.intrinsics[-1, 0], k[2])


@pytest.mark.parametrize("views", [1, 2, 3, 8])
def test_past_a_close_up_the_person_stays_whole(views: int) -> None:
    """Its focal length is for a face, and the path looks at the middle of the body."""
    whole = rig_of([camera(on_ring(40.0 * v), MIDDLE) for v in range(views)])
    close = rig_of([camera(on_ring(20.0, 20.0, 1.6), np.array([0.0, 0.0, 0.3]))], focal=4000.0)
    path = path_of("between", together(whole, close))
    assert_whole(path)
    assert heights(path).min() > 0.8 * own_heights(whole).min()


def test_cameras_that_all_look_at_a_part_keep_their_focal_lengths() -> None:
    rig = ring(8, (1024, 1024), 4000.0)
    np.testing.assert_array_equal(path_of("between", rig).intrinsics[:, 0, 0, 0], 4000.0)


def test_the_size_is_the_most_common_one_else_one_that_holds_them_all() -> None:
    rig = ring(8)
    twice = [(512, 512), (384, 640), (720, 400), (170, 170)]
    for sizes, expected in (
        ([(100, 100)] * 5 + [(400, 400)] * 3, (100, 100)),
        ([(100, 100)] * 4 + [(400, 400)] * 4, (400, 400)),
        ([(640, 480)] * 4 + [(480, 640)] * 4, (480, 640)),
        (twice * 2, (720, 640)),
        ([(147 + 20 * v, 384 - v) for v in range(8)], (287, 384)),
    ):
        np.testing.assert_array_equal(common_size(resized(rig, *sizes)), expected)


@pytest.mark.parametrize("text", ["between", "orbit"])
def test_a_person_stays_whole_whatever_the_sizes_of_the_pictures(text: str) -> None:
    """Pictures cut each to its person, arms out or not, cameras upright and lying, and many resolutions: what a camera
    shows is in the picture beside it, and nobody is small everywhere."""
    rig = ring(8, (512, 512), 440.0)
    crops = [(230 + 37 * (3 * v % 8), 440 + 9 * v) for v in range(8)]
    for found in (
        resized(rig, *crops),
        resized(rig, *([(240, 460)] * 5 + [(500, 440)] * 3)),
        resized(rig, *([(680, 440)] * 5 + [(440, 680)] * 3)),
        scaled(scaled(scaled(rig, 0, 0.25), 4, 0.5), 6, 2.0),
    ):
        path = path_of(text, found)
        assert_whole(path)
        assert heights(path).max() > 0.6
        beside = path.size[0] / focal_in(found, path.size[0])[:, None]
        assert (beside * (1 + 1e-12) >= found.size / found.intrinsics[:, [0, 1], [0, 1]]).all()


@pytest.mark.parametrize(
    "standing",
    [
        [(45.0 * v, (52.0, -13.0)[v % 2], 3.2) for v in range(8)],
        [(45.0 * v, 8.0, 2.0 if v < 3 else 6.0) for v in range(8)],
        [(45.0 * v, 8.0, (1.5, 6.0)[v % 2]) for v in range(8)],
    ],
    ids=["from the ceiling and the floor", "few near ones", "near and far"],
)
def test_an_orbit_shows_the_person_as_large_as_the_cameras_do(standing: list[tuple[float, float, float]]) -> None:
    """At their mean radius and height it stands nearer than they do on the mean where their heights differ."""
    rig = together(*(at(p, 420.0 * p[2]) for p in standing))
    own = own_heights(rig)
    found = heights(path_of("orbit", rig))
    assert_whole(path_of("orbit", rig))
    # Seen from above a person is shorter than from the side.
    assert found.max() < 1.05 * own.max()
    assert found.min() > 0.95 * own.min()


@pytest.mark.parametrize("by", [0.25, 0.5, 3.0])
def test_an_arc_between_resolutions_keeps_the_subject_where_the_cameras_have_it(by: float) -> None:
    rig = scaled(ring(8, (512, 512), 440.0), 2, by)
    path = path_of("arc cam0 cam2", rig)
    found = extents(path)
    np.testing.assert_allclose(found, np.broadcast_to(found[:1], found.shape), atol=0.01)
    np.testing.assert_array_equal(path.size, [rig.size[[0, 2]].max(axis=0)])


def test_an_arc_ends_with_the_whole_picture_of_each_camera_in_the_middle_of_its_own() -> None:
    rig = scaled(resized(ring(8, (512, 512), 440.0), *[(320, 240)] * 2, (100, 150), *[(320, 240)] * 5), 2, 2.0)
    path = path_of("arc cam0 cam2", rig)
    np.testing.assert_array_equal(path.size, [(320, 300)])
    for step, view, inside in ((0, 0, [[0, 30], [320, 270]]), (-1, 2, [[60, 0], [260, 300]])):
        corners = np.array([[0, 0, 1], [*rig.size[view], 1]])
        drawn = corners @ np.linalg.inv(rig.intrinsics[view]).T @ path.intrinsics[step, 0].T
        np.testing.assert_allclose(drawn[:, :2] / drawn[:, 2:], inside, atol=1e-9)
