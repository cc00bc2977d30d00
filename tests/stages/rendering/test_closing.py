"""A body that cameras far apart saw from aside, closed for one between them."""

from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.geometry.projection import pixel_centres, rays
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering import closing
from posegaussian.stages.rendering.clipping import cover
from posegaussian.stages.rendering.closing import OPAQUE, Body, closed
from posegaussian.stages.rendering.facts import SURFACE_CLOSING
from posegaussian.stages.rendering.frame import FrameRenderer, MapReader
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.known_geometry import ring
from tests.support.memory_inputs import MemoryInputs, run_stage

SIZE, RADIUS, HALF = 96, 0.2, 0.4
COLOR = np.array([200, 100, 50], np.uint8)
LIMBS = np.array([[0.0, 0.0, -HALF, 0.0, 0.0, HALF, RADIUS]])
RIG: Rig = ring(4, (SIZE, SIZE), focal=110.0)
"""Cameras 90 degrees apart: three are sources, the fourth draws."""
SOURCES, TARGET = (0, 2, 3), 1


def surface(rig: Rig, view: int) -> np.ndarray:
    """[h, w] float32 depth of an upright cylinder with flat ends around the origin, 0 = none."""
    pixels = pixel_centres((SIZE, SIZE)).reshape(-1, 2)
    origin, d = rays(pixels, rig.intrinsics[view], rig.world_to_camera[view])
    # Along origin + z d, the roots of |x, y| = RADIUS bound the round wall, |z| = HALF the two ends.
    square = (d[:, :2] ** 2).sum(axis=1)
    half = (d[:, :2] @ origin[:2]) / square
    root = half**2 - (origin[:2] @ origin[:2] - RADIUS**2) / square
    wall = -half + np.sqrt(np.maximum(root, 0)) * np.array([[-1.0], [1.0]])
    ends = np.sort((np.array([[-HALF], [HALF]]) - origin[2]) / d[:, 2], axis=0)
    enters, leaves = np.maximum(wall[0], ends[0]), np.minimum(wall[1], ends[1])
    hit = (root > 0) & (enters <= leaves)
    return np.where(hit, enters, 0).reshape(SIZE, SIZE).astype(np.float32)


DEPTH = {v: surface(RIG, v) for v in range(4)}
CAMERA = Camera(RIG.intrinsics[TARGET], RIG.world_to_camera[TARGET], SIZE, SIZE)


def body(depth: dict[int, np.ndarray], limbs: np.ndarray = LIMBS) -> Body:
    masks = {v: (DEPTH[v] > 0).astype(np.uint8) * 255 for v in SOURCES}
    color = {v: np.broadcast_to(COLOR, (SIZE, SIZE, 3)) for v in SOURCES}
    return Body.of(RIG, agreed(RIG, masks), limbs, {v: depth[v] for v in SOURCES}, color, masks)


def picture(alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (alpha[..., None] * COLOR / 255).astype(np.float32), alpha.astype(np.float32)


EMPTY = picture(np.zeros((SIZE, SIZE)))


@pytest.fixture(scope="module")
def covered() -> np.ndarray:
    return cover(body(DEPTH).silhouettes, CAMERA, np.ones((SIZE, SIZE), bool))


def test_what_no_camera_faces_is_closed_within_the_hull_in_the_colour_of_the_others(covered: np.ndarray) -> None:
    color, alpha = closed(*EMPTY, body(DEPTH), CAMERA)
    true = DEPTH[TARGET] > 0
    assert alpha[true].mean() > 0.9  # the ends of the cylinder are rounded in the capsule and too thin at the rim
    assert (alpha <= covered + 1e-6).all()
    assert (alpha[covered == 0] == 0).all()
    np.testing.assert_allclose(color, alpha[..., None] * COLOR / 255, atol=1e-6)  # premultiplied


def test_what_is_drawn_stays() -> None:
    drawn = picture(np.where(DEPTH[TARGET] > 0, OPAQUE, 0.0))
    drawn[0][..., 1] = 0.3 * drawn[1]
    color, alpha = closed(*drawn, body(DEPTH), CAMERA)
    inner = drawn[1] > 0
    np.testing.assert_array_equal(color[inner], drawn[0][inner])
    assert alpha[~inner].sum() < 0.02 * inner.sum(), "strips beside the outline are no gaps"


def test_a_view_that_sees_through_the_body_forbids_it() -> None:
    behind = {**DEPTH, SOURCES[0]: np.full_like(DEPTH[SOURCES[0]], 50.0)}
    color, alpha = closed(*EMPTY, body(behind), CAMERA)
    assert not alpha.any()
    assert not color.any()


def test_without_limbs_nothing_is_known() -> None:
    color, alpha = closed(*EMPTY, body(DEPTH, np.zeros((0, 7))), CAMERA)
    assert not alpha.any()
    assert not color.any()


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=4, size=SIZE, frames=1, held_out=1)


def body_of(person: PersonCapture, *unknown: str) -> Body:
    """Of a frame in which nobody found these joints and whose masks are 10 px too wide."""
    joints = person.joints3d.copy()
    joints[:, [COCO17.names.index(name) for name in unknown], 3] = 0
    given: dict[str, np.ndarray] = {
        "depth/depth": person.depth,
        "depth/confidence": (person.depth > 0).astype(np.float16),
        "frames/color": person.color,
        "frames/mask": np.stack([[cv2.dilate(m, np.ones((21, 21), np.uint8)) for m in person.mask[0]]]),
        "pose/joints3d": joints,
    }
    given |= run_stage(stage("gaussians"), GaussiansParams(), given, person.rig, person.views, 1)
    params, on = RenderingParams(), frozenset({SURFACE_CLOSING})
    inputs: Any = MemoryInputs(
        stage("rendering"), params, given, person.rig, person.views, range(1), 1, facts=on, effects=on
    )
    found = FrameRenderer(MapReader(inputs), 0, params).body
    assert found is not None
    return found


@pytest.mark.parametrize("unknown", [("LAnkle", "RAnkle"), ("LWrist",), ("RElbow", "RWrist"), ("LEar", "REar")])
def test_where_a_limb_may_be_nothing_is_closed(person: PersonCapture, unknown: tuple[str, ...]) -> None:
    """A ball that holds the limb wherever it is was taken for flesh: 0.6 m around knees above the picture's border."""
    view = person.views.held_out[0]
    camera = Camera(person.rig.intrinsics[view], person.rig.world_to_camera[view], SIZE, SIZE)
    known, own = body_of(person), body_of(person, *unknown)
    assert own.limbs[:, 6].max() < 0.2
    whole, found = closed(*EMPTY, known, camera)[1] > 0, closed(*EMPTY, own, camera)[1] > 0
    beside = person.mask[0, view] == 0
    assert not found[beside & ~whole].any()
    assert found[~beside].sum() > 0.75 * whole[~beside].sum() > 0, "the rest is closed as ever"
    if "LAnkle" in unknown:
        assert not found[beside].any(), "of the whole body balls for feet reach farther"


def test_a_limb_elsewhere_closes_nothing() -> None:
    _, alpha = closed(*EMPTY, body(DEPTH, LIMBS + np.array([2.0, 0, 0, 2.0, 0, 0, 0])), CAMERA)
    assert not alpha.any()


@pytest.mark.parametrize("seed", [0, 1])
def test_the_hull_and_the_limbs_asked_of_every_pixel_say_the_same(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.setattr(closing, "GAP", 3 / SIZE)  # so that the grid has a pixel in nine
    rng = np.random.default_rng(seed)
    torn = cv2.GaussianBlur(rng.random((SIZE, SIZE)).astype(np.float32), (0, 0), 2.5)
    drawn = picture(np.where((torn > np.median(torn)) & (DEPTH[TARGET] > 0), rng.choice([0.45, 0.55, 1.0]), 0.0))
    apart = LIMBS + np.array([0.4, 0, 0.1, 0.4, 0, 0.1, 0])
    own = body(DEPTH, np.concatenate([LIMBS, apart]))
    quick = closed(*drawn, own, CAMERA)
    assert (quick[1] != drawn[1]).any(), "there is a gap to close"
    monkeypatch.setattr(closing, "_around_gaps", lambda alpha, *_: np.ones(alpha.shape, bool))
    monkeypatch.setattr(closing, "_of_limbs", lambda wanted, *_: wanted)
    for a, b in zip(quick, closed(*drawn, own, CAMERA), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_limb_that_holds_a_point_of_a_ray_is_near_it() -> None:
    rng = np.random.default_rng(2)
    limbs = np.concatenate([rng.uniform(-1, 1, (40, 6)), rng.uniform(0.05, 0.3, (40, 1))], axis=1)
    limbs[:3, 3:6] = limbs[:3, :3]  # balls
    origin, near, found = np.array([0.2, -3.0, 0.1]), np.empty(len(limbs), np.int64), 0
    depths, every = np.linspace(1.5, 4.5, 3000), np.arange(len(limbs))
    for direction in np.stack([rng.uniform(-0.4, 0.4, 100), np.ones(100), rng.uniform(-0.4, 0.4, 100)], axis=-1):
        points = origin + depths[:, None] * direction
        held = {n for n in every if any(closing._in_limb(p, limbs, every[n : n + 1]) for p in points[::10])}
        told = set(near[: closing._limbs_near(origin, direction, limbs, near)].tolist())
        assert held <= told
        for n in told - held:  # no others, but what a ray grazes between the points
            wider = limbs[n] + [0, 0, 0, 0, 0, 0, 0.002]
            assert any(closing._in_limb(p, wider[None], every[:1]) for p in points)
        found += len(held)
    assert found > 200


@pytest.mark.parametrize("radius", range(1, 24))
def test_every_disc_even_one_that_the_border_cuts_holds_a_pixel_of_the_grid(radius: int) -> None:
    for height, width in ((2 * radius + 1 + i, 3 * radius + 1 + 5 * i) for i in range(radius)):
        held = cv2.dilate(closing._grid((height, width), radius).astype(np.uint8), closing._disc(radius))
        assert held.all(), (height, width)
