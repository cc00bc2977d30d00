import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.consensus import agreed
from posegaussian.stages.depth.algorithms.scene import Geometry, Maps
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.matching.bounds import inverse
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_depth

VIEWS, RADIUS = 5, 0.5
RIG = rig_of([camera(on_ring(25 * i), np.zeros(3)) for i in range(VIEWS)], (96, 96), 130.0)
GEOMETRY = Geometry.of(RIG, tuple(range(VIEWS)), DepthParams())
TRUTH = {v: sphere_depth(RIG, v, np.zeros(3), RADIUS).astype(np.float32) for v in range(VIEWS)}
FREE: Maps = {v: (np.where(z > 0, 0.1, 0).astype(np.float32), np.full_like(z, 9.0)) for v, z in TRUTH.items()}
"""Limits that nothing reaches."""
MIDDLE = np.s_[33:63, 33:63]
"""Pixels of a view that its neighbours see well, too."""


def of(depths: dict[int, np.ndarray], confidence: float = 0.9) -> Maps:
    return {v: (z, np.where(z > 0, confidence, 0).astype(np.float32)) for v, z in depths.items()}


def off(found: np.ndarray, truth: np.ndarray, view: int) -> np.ndarray:
    """Px of disparity."""
    return np.abs(inverse(found) - inverse(truth)) / GEOMETRY.pixel(view)


def moved(depth: np.ndarray, px: np.ndarray | float, view: int) -> np.ndarray:
    return np.where(depth > 0, inverse(inverse(depth) + GEOMETRY.pixel(view) * px), 0).astype(np.float32)


def test_surfaces_that_agree_stay() -> None:
    found = agreed(GEOMETRY, of(TRUTH), FREE)
    for v in range(VIEWS):
        # A sphere of 36 px drawn as triangles lies up to (px / 2)^2 / 72 px inside: 0.01 px of disparity.
        assert off(found[v][0], TRUTH[v], v)[MIDDLE].max() < 0.03
        assert ((found[v][0] > 0) == (TRUTH[v] > 0)).all()


def test_a_blunder_of_one_view_is_outvoted_and_harms_no_other() -> None:
    wrong = dict(TRUTH)
    wrong[2] = TRUTH[2].copy()
    patch = np.s_[40:56, 40:56]
    for px in (8.0, -8.0):  # in front of the surface, which others see through; and behind it
        wrong[2][patch] = moved(TRUTH[2], px, 2)[patch]
        found = agreed(GEOMETRY, of(wrong), FREE)
        for v in range(VIEWS):
            assert off(found[v][0], TRUTH[v], v)[MIDDLE].max() < 0.1


def test_noise_of_single_views_shrinks() -> None:
    random = np.random.default_rng(3)
    noisy = {v: moved(z, random.normal(0, 0.3, z.shape), v) for v, z in TRUTH.items()}
    found = agreed(GEOMETRY, of(noisy), FREE)
    before, after = (np.mean([off(z[v][0], TRUTH[v], v)[MIDDLE].mean() for v in (1, 2, 3)]) for z in (of(noisy), found))
    # Three views and more average to 0.58 of one's noise, were their noise of one size and all of it independent.
    assert after < 0.7 * before


def test_nothing_leaves_the_hull() -> None:
    limits = {v: (moved(z, 0.5, v), moved(z, -0.5, v)) for v, z in TRUTH.items()}
    wrong = dict(TRUTH) | {2: moved(TRUTH[2], -6.0, 2)}
    found = agreed(GEOMETRY, of(wrong), limits)
    changed = found[2][0] != wrong[2]
    assert changed[MIDDLE].all()
    assert (off(found[2][0], TRUTH[2], 2)[changed] < 0.51).all()


@pytest.mark.parametrize("azimuths", [(0.0,), (0.0, 180.0)])
def test_views_that_share_nothing_change_nothing(azimuths: tuple[float, ...]) -> None:
    rig = rig_of([camera(on_ring(a), np.zeros(3)) for a in azimuths], (64, 64), 90.0)
    geometry = Geometry.of(rig, tuple(range(len(azimuths))), DepthParams())
    maps = of({v: sphere_depth(rig, v, np.zeros(3), RADIUS).astype(np.float32) for v in range(len(azimuths))})
    found = agreed(geometry, maps, maps)
    for v in maps:
        assert np.array_equal(found[v][0], maps[v][0])
        assert np.array_equal(found[v][1], maps[v][1])


@pytest.mark.parametrize("heard", [True, False])
def test_views_ninety_degrees_apart_have_a_say_where_there_are_no_nearer_ones(heard: bool) -> None:
    """A ring of four; and of eight, of which two others stand at 45 degrees and agree with nobody."""
    count = 4 if heard else 8
    rig = rig_of([camera(on_ring(360 / count * i), np.zeros(3)) for i in range(count)], (96, 96), 130.0)
    geometry = Geometry.of(rig, tuple(range(count)), DepthParams())
    truth = {v: sphere_depth(rig, v, np.zeros(3), RADIUS).astype(np.float32) for v in range(count)}
    limits: Maps = {v: (np.where(z > 0, 0.1, 0).astype(np.float32), np.full_like(z, 9.0)) for v, z in truth.items()}
    side, wrong = np.s_[40:56, 22:28], dict(truth)  # of what view 0 shows, what the next one sees, too
    wrong[0] = truth[0].copy()
    wrong[0][side] = inverse(inverse(truth[0]) * np.float32(1.03))[side]
    maps = of(wrong)
    maps[0][1][side] = 0.3
    if not heard:  # nobody but views 90 degrees away knows better
        for v in (1, 7):
            maps[v] = (np.zeros_like(truth[v]), np.zeros_like(truth[v]))
    found = agreed(geometry, maps, limits)[0][0]
    mended = np.abs(found - truth[0])[side] < 0.2 * np.abs(wrong[0] - truth[0])[side]
    assert (mended.mean() > 0.9) == heard


def test_the_order_of_cameras_does_not_matter() -> None:
    random = np.random.default_rng(5)
    maps = of({v: moved(z, random.normal(0, 0.5, z.shape), v) for v, z in TRUTH.items()})
    turned = list(reversed(range(VIEWS)))
    geometry = Geometry.of(RIG.subset(turned), tuple(range(VIEWS)), DepthParams())
    straight = agreed(GEOMETRY, maps, FREE)
    other = agreed(
        geometry, {turned.index(v): m for v, m in maps.items()}, {turned.index(v): m for v, m in FREE.items()}
    )
    for v in range(VIEWS):
        # Sums in another order: float32 keeps 7 digits. Where two candidates score alike, either may win.
        same = np.isclose(straight[v][0], other[turned.index(v)][0], rtol=1e-5)
        assert same.mean() > 0.99


def test_confidence_stays_a_share() -> None:
    for _, trust in agreed(GEOMETRY, of(TRUTH, 1.0), FREE).values():
        assert trust.min() >= 0
        assert trust.max() <= 1
