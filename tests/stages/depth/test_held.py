"""How cameras are held and stand changes no depth: rolled pictures, tilted and upright baselines, swapped views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import cv2
import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, Maps
from posegaussian.stages.depth.algorithms.stereo import estimate
from posegaussian.stages.depth.algorithms.sweeping import sweep_hull
from posegaussian.stages.depth.params import DepthParams
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_mask, textured_sphere

SIZE, FOCAL, RADIUS, ORIGIN = (112, 112), 120.0, 0.6, np.zeros(3)
AZIMUTHS = (-24.0, 0.0, 24.0)
METHODS: dict[str, Callable[..., Maps]] = {"sgbm": estimate, "sweep": sweep_hull}
Film = tuple[Rig, dict[int, np.ndarray], dict[int, np.ndarray], dict[int, np.ndarray]]
"""Cameras, pictures, masks and true depths by view."""


def filmed(poses: Sequence[np.ndarray]) -> Film:
    rig = rig_of(list(poses), SIZE, FOCAL)
    seen = [textured_sphere(rig, v, ORIGIN, RADIUS) for v in range(len(rig))]
    masks = {v: sphere_mask(rig, v, ORIGIN, RADIUS) for v in range(len(rig))}
    return rig, {v: c for v, (c, _) in enumerate(seen)}, masks, {v: z for v, (_, z) in enumerate(seen)}


def depths(method: str, film: Film) -> Maps:
    rig, colors, masks, _ = film
    geometry = Geometry.of(rig, tuple(range(len(rig))), DepthParams(method=method))
    return METHODS[method](geometry, Frame(colors, masks), DepthParams(method=method))


def epe(maps: Maps, film: Film) -> float:
    """Mean error in px of the least sensitive of neighbours 24 degrees apart, inside the rims."""
    errors = []
    for v, (depth, _) in maps.items():
        truth = film[3][v]
        inner = cv2.erode((truth > 0).astype(np.uint8), np.ones((9, 9))) > 0
        assert (depth[inner] > 0).all()
        errors.append(FOCAL * 0.83 * np.abs(1 / depth[inner] - 1 / truth[inner]))
    return float(np.concatenate(errors).mean())


def arc(rolls: Sequence[float] = (0, 0, 0)) -> Film:
    return filmed([camera(on_ring(a), ORIGIN, r) for a, r in zip(AZIMUTHS, rolls, strict=True)])


def turned_rig(tilt: float, roll: float) -> Film:
    """The arc turned about the middle camera's line of sight, its pictures rolled."""
    axis = on_ring(0) / np.linalg.norm(on_ring(0))
    rotation = cv2.Rodrigues(axis * np.radians(tilt))[0]
    return filmed([camera(rotation @ on_ring(a), ORIGIN, roll) for a in AZIMUTHS])


@cache
def level(method: str) -> float:
    film = arc()
    return epe(depths(method, film), film)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rolls", [(90, 90, 90), (45, 45, 45), (27, 27, 27), (0, 90, 180), (-30, 45, 200)])
def test_rolled_cameras_measure_as_well_as_level_ones(method: str, rolls: tuple[float, ...]) -> None:
    film = arc(rolls)
    # The sphere falls on other pixels: level rigs a degree apart differ by 6 % themselves.
    assert epe(depths(method, film), film) < 1.15 * level(method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("tilt", "roll"), [(90, 0), (45, 0), (45, 45), (90, 90)])
def test_tilted_and_stacked_cameras_measure_as_well_as_level_ones(method: str, tilt: float, roll: float) -> None:
    film = turned_rig(tilt, roll)
    # Other sides of the textured ball, with more or less to hold on to.
    assert epe(depths(method, film), film) < 1.3 * level(method)


def quarter(film: Film, turns: int) -> Film:
    """The same pictures, masks, depths and cameras, turned counter-clockwise by quarters."""
    rig, *maps = film
    a = np.radians(90.0 * turns)
    turn = np.eye(4)
    turn[:2, :2] = np.rint([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    poses = [turn @ pose for pose in rig.world_to_camera]
    colors, masks, depth = ({v: np.ascontiguousarray(np.rot90(m, turns)) for v, m in part.items()} for part in maps)
    return rig_of(poses, SIZE, FOCAL), colors, masks, depth


def test_pictures_turned_by_quarters_are_what_rolled_cameras_film() -> None:
    film = arc()
    for turns in (1, 2, 3):
        ours, theirs = quarter(film, turns), arc([-90 * turns] * 3)
        for v in range(3):
            np.testing.assert_allclose(ours[3][v], theirs[3][v], atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turns", [1, 2, 3])
def test_turning_pictures_and_cameras_by_quarters_turns_the_depth(method: str, turns: int) -> None:
    film = arc()
    before, after = depths(method, film), depths(method, quarter(film, turns))
    for v in before:
        back = np.rot90(after[v][0], -turns)
        known = before[v][0] > 0
        np.testing.assert_array_equal(back > 0, known)
        apart = FOCAL * 0.83 * np.abs(1 / back[known] - 1 / before[v][0][known])
        # sgbm's paths come from above only, and the rectified pictures may stand on their heads.
        assert np.median(apart) < (0.15 if method == "sgbm" else 0.03)
        assert np.percentile(apart, 90) < 0.4


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_the_views_changes_nothing(method: str) -> None:
    film, order = arc((0, 90, 45)), [2, 0, 1]
    swapped = (film[0].subset(order), *({i: part[v] for i, v in enumerate(order)} for part in film[1:]))
    before, after = depths(method, film), depths(method, swapped)  # type: ignore[arg-type]
    for i, v in enumerate(order):
        # Sums run in another order, and a rectified picture may stand on its head.
        inside = before[v][0] > 0
        apart = FOCAL * 0.83 * np.abs(1 / after[i][0][inside] - 1 / before[v][0][inside])
        assert np.median(apart) < 0.03
