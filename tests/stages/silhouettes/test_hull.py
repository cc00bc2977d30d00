from dataclasses import replace

import cv2
import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.scene import Frame, Geometry, hulls
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.geometry.projection import pixel_centres, rays, unproject
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.hull import visual_hull as hull_of
from posegaussian.stages.silhouettes.march import motion, stride
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres
from tests.support.known_geometry import camera, on_ring, rig_of, ring, sphere_depth, sphere_mask


def visual_hull(
    rig: Rig,
    view: int,
    masks: dict[int, np.ndarray],
    centre: np.ndarray,
    radius: float,
    tolerance: tuple[float, float] = (0.0, 1.5),
    votes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    return hull_of(rig, view, masks[view], Silhouettes.of(rig, masks, centre, radius), tolerance, votes)


CENTRE, RADIUS = np.array([0.1, -0.05, 0.1]), 0.5


def sphere_hull(rig: Rig, view: int = 0, **more: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True depth, near and far of a sphere's hull."""
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(len(rig))}
    return sphere_depth(rig, view, CENTRE, RADIUS), *visual_hull(
        rig, view, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)), **more
    )  # type: ignore[arg-type]


def test_the_hull_holds_the_surface_and_shrinks_with_more_views():
    errors = []
    for views in (3, 6, 12, 24):
        rig = ring(views)
        truth, near, far = sphere_hull(rig)
        both = (truth > 0) & (near > 0)
        assert both.sum() > 0.97 * (truth > 0).sum()
        entry = unproject(near, rig.intrinsics[0], rig.world_to_camera[0])[both]
        # The hull may cut into the sphere by a quarter of a pixel (2 m / 60 px / 4),
        # what an edge of 4 x 4 samples can be off.
        assert (np.linalg.norm(entry - CENTRE, axis=1) >= RADIUS - 0.0085).all()
        behind = unproject(far, rig.intrinsics[0], rig.world_to_camera[0])[both]
        assert (np.linalg.norm(behind - CENTRE, axis=1) >= RADIUS - 0.0085).all()
        errors.append((truth - near)[both].mean())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.25 * errors[0]


def test_a_person_is_held_and_the_order_of_views_is_indifferent():
    c = capture_person(views=8, size=96, frames=1, held_out=0)
    centre = look_at_point(c.rig)
    radius = searched_radius(c.rig, list(range(8)), centre)
    masks = {v: c.mask[0, v] for v in range(8)}
    near, far = visual_hull(c.rig, 2, masks, centre, radius)
    truth = c.depth[0, 2]
    surface = (truth > 0) & (c.mask[0, 2] > 127)
    assert (near[surface] > 0).all()
    # A pixel is 2.4 cm at this size; what a hull of half-pixel edges eats stays below it.
    assert (near[surface] <= truth[surface] + 0.024).mean() > 0.99
    assert (far[surface] >= truth[surface] - 0.024).mean() > 0.99
    assert (near[c.mask[0, 2] <= 127] == 0).all()
    order = [5, 3, 2, 7, 0, 6, 1, 4]
    shuffled, _ = visual_hull(c.rig.subset(order), 2, {i: c.mask[0, v] for i, v in enumerate(order)}, centre, radius)
    np.testing.assert_array_equal(shuffled, near)


def test_a_view_that_sees_nothing_of_a_point_does_not_carve_it():
    rig = ring(8)
    truth, near, _ = sphere_hull(rig)
    # One more camera looks past the sphere: its whole picture is background.
    aside = rig_of([*rig.world_to_camera, camera(on_ring(20), np.array([0.0, 5.0, 0.0]))], (64, 64), 60.0)
    masks = {v: sphere_mask(aside, v, CENTRE, RADIUS) for v in range(9)}
    masks[8][0, 0] = 255
    again, _ = visual_hull(aside, 0, masks, np.zeros(3), 1.8)
    np.testing.assert_allclose(again, near, atol=1e-3)
    # An empty mask says nothing at all, even where the camera sees the sphere.
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(8)}
    masks[1][:] = 0
    without, _ = visual_hull(rig, 0, masks, np.zeros(3), 1.8)
    assert (without[truth > 0] > 0).mean() > 0.97


def test_a_view_that_sees_half_of_the_body_does_not_carve_the_other_half():
    rig = ring(8)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(8)}
    # One tolerance: a second try at a wider one would make the two hulls incomparable.
    whole, _ = visual_hull(rig, 0, masks, np.zeros(3), 1.8, (0.5, 0.5), votes=False)
    size = rig.size.copy()
    size[[1, 7], 0] = 30
    half, _ = visual_hull(replace(rig, size=size), 0, masks, np.zeros(3), 1.8, (0.5, 0.5), votes=False)
    surface = whole > 0
    assert (half[surface] > 0).all()
    # Fewer pictures carve less, and never more; 1/16 of a step of a pixel (2 m / 60 px) is the bisection's.
    assert (half[surface] <= whole[surface] + 2.1e-3).all()


def test_masks_behind_the_padding_are_not_read():
    rig = ring(8, (64, 48))
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(8)}
    near, _ = visual_hull(rig, 0, masks, np.zeros(3), 1.8)
    padded = {v: np.pad(m, ((0, 16), (0, 32))) for v, m in masks.items()}
    wide, _ = visual_hull(rig, 0, padded, np.zeros(3), 1.8)
    np.testing.assert_array_equal(wide[:48, :64], near)
    assert not wide[48:].any()


@pytest.mark.parametrize(("poles", "rows"), [(4, 2), (6, 2), (6, 3)])
def test_cameras_in_stacks_see_no_body_up_to_the_camera(poles: int, rows: int) -> None:
    """Those of one's own stack and of the opposite one look along a ray and keep all of it; those to the side, whose
    pictures do not reach so far, say where a body ends that stands upright in all of them."""
    cameras = [
        camera(np.array([*on_ring(360 * p / poles)[:2], h]), np.zeros(3))
        for p in range(poles)
        for h in np.linspace(-0.5, 0.5, rows)
    ]
    rig = rig_of(cameras, (64, 64), 90.0)
    masks = {v: _column(rig, v) for v in range(len(rig))}
    radius = searched_radius(rig, list(masks), np.zeros(3))
    near, far = visual_hull(rig, 0, masks, np.zeros(3), radius)
    found = near > 0
    assert (found == (masks[0] > 127)).mean() > 0.99
    # The hull of four stacks is square about a column of 0.15 m: 0.15 / cos 45 degrees, and a pixel and a half more,
    # 2 m / 90 px each, for the edges of masks.
    for depth in (near, far):
        ends = unproject(depth, rig.intrinsics[0], rig.world_to_camera[0])[found]
        assert np.hypot(*ends[:, :2].T).max() < 0.15 * np.sqrt(2) + 1.5 * 2 / 90


def _column(rig: Rig, view: int) -> np.ndarray:
    """Mask of an upright column of 0.15 m, farther up and down than any picture reaches."""
    origin, directions = rays(pixel_centres((64, 64)).reshape(-1, 2), rig.intrinsics[view], rig.world_to_camera[view])
    across = np.abs(directions[:, 0] * origin[1] - directions[:, 1] * origin[0]) / np.hypot(*directions[:, :2].T)
    return np.where(across.reshape(64, 64) < 0.15, 255, 0).astype(np.uint8)


def test_no_other_view_no_hull():
    rig = ring(8)
    near, far = visual_hull(rig, 0, {0: sphere_mask(rig, 0, CENTRE, RADIUS)}, np.zeros(3), 1.8)
    assert not near.any()
    assert not far.any()


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_thin_limbs_survive_a_calibration_that_is_off(shift: float) -> None:
    c = capture_person(views=8, size=96, frames=1, held_out=0)
    k = c.rig.intrinsics.copy()
    k[1::2, 0, 2] += shift
    rig = replace(c.rig, intrinsics=k)
    near, _ = visual_hull(rig, 0, {v: c.mask[0, v] for v in range(8)}, look_at_point(rig), 2.0)
    assert (near[c.mask[0, 0] > 127] > 0).mean() > 0.97


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=128, frames=1, held_out=0)


def hull_errors(c: PersonCapture, masks: dict[int, np.ndarray]) -> tuple[float, float]:
    """Mean distance of the hull's surface from the truth, m, and share of the surface without a hull: over views
    whose mask is the true one."""
    params = DepthParams(method="hull")
    found = hulls(Geometry.of(c.rig, tuple(range(8)), params), Frame({}, masks))
    apart, missing = [], []
    for v in range(8):
        if masks[v] is c.mask[0, v] or np.abs(masks[v].astype(int) - c.mask[0, v]).mean() < 8:
            surface = (c.mask[0, v] > 127) & (c.depth[0, v] > 0) & (masks[v] > 127)
            near = found[v][0][surface]
            apart.append(np.abs(near - c.depth[0, v][surface])[near > 0].mean())
            missing.append((near == 0).mean())
    return float(np.mean(apart)), float(np.mean(missing))


def test_masks_that_are_a_pixel_too_small_still_have_a_hull(person: PersonCapture) -> None:
    masks = {v: cv2.erode(person.mask[0, v], np.ones((3, 3), np.uint8)) for v in range(8)}
    whole, (apart, missing) = (
        hull_errors(person, {v: person.mask[0, v] for v in range(8)})[0],
        hull_errors(person, masks),
    )
    assert missing < 0.01
    # A pixel is 1.8 cm at this size; a silhouette that closes in by one moves the surface
    # by up to 1.4 along a ray 45 degrees off.
    assert apart < whole + 1.4 * 0.018


@pytest.mark.parametrize("kind", ["empty", "full", "shifted", "of nobody"])
def test_one_wrong_mask_costs_no_more_than_the_view_itself(person: PersonCapture, kind: str) -> None:
    masks = {v: person.mask[0, v] for v in range(8)}
    seven = {v: m for v, m in masks.items() if v != 3}
    params = DepthParams(method="hull")
    views = tuple(seven)
    lean = hulls(Geometry.of(person.rig, views, params), Frame({}, seven))
    masks[3] = {
        "empty": np.zeros_like(masks[3]),
        "full": np.full_like(masks[3], 255),
        "shifted": np.roll(masks[3], 24, axis=1),
        "of nobody": np.roll(masks[3][::-1], 40, axis=1),
    }[kind]
    found = hulls(Geometry.of(person.rig, tuple(range(8)), params), Frame({}, masks))
    for v in views:
        surface = person.depth[0, v] > 0
        both = surface & (lean[v][0] > 0)
        assert ((found[v][0] > 0) == (lean[v][0] > 0))[surface].mean() > 0.995
        # The searched sphere and the steps differ a little without the view.
        assert np.abs(found[v][0] - lean[v][0])[both].mean() < 0.002


def test_a_limb_that_one_mask_lacks_is_kept_by_the_vote_of_the_others(person: PersonCapture) -> None:
    masks = {v: person.mask[0, v].copy() for v in range(8)}
    rows = np.nonzero(masks[2].any(axis=1))[0]
    masks[2][rows[-1] - 25 :] = 0
    found = hulls(Geometry.of(person.rig, tuple(range(8)), DepthParams(method="hull")), Frame({}, masks))
    for v in (0, 1, 4, 6):
        feet = person.depth[0, v] > 0
        feet[: np.nonzero(feet.any(axis=1))[0][-1] - 20] = False
        assert (found[v][0][feet] > 0).mean() > 0.97


def test_a_post_before_one_camera_costs_the_others_little(person: PersonCapture) -> None:
    """Its mask has a gap 8 px wide from head to feet: carved by it, the hull would be 15 to 60 mm off on the mean."""
    masks = {v: person.mask[0, v].copy() for v in range(8)}
    exact = hulls(Geometry.of(person.rig, tuple(range(8)), DepthParams(method="hull")), Frame({}, masks))
    middle = int(np.median(np.nonzero(masks[3])[1]))
    masks[3][:, middle - 4 : middle + 4] = 0
    found = hulls(Geometry.of(person.rig, tuple(range(8)), DepthParams(method="hull")), Frame({}, masks))
    for v in (0, 1, 2, 4):
        both = (found[v][0] > 0) & (exact[v][0] > 0)
        assert both.sum() > 0.995 * (exact[v][0] > 0).sum()
        assert np.abs(found[v][0] - exact[v][0])[both].mean() < 0.004


def test_a_view_that_the_picture_cuts_off_carves_nothing_beyond_its_picture(person: PersonCapture) -> None:
    # View 1 films the upper half alone: the lower half of its picture is gone.
    half = int(np.nonzero(person.mask[0, 1].any(axis=1))[0].mean())
    size, masks = person.rig.size.copy(), {v: person.mask[0, v] for v in range(8)}
    size[1, 1] = half
    masks[1] = masks[1].copy()
    masks[1][half:] = 0
    rig = replace(person.rig, size=size)
    found = hulls(Geometry.of(rig, tuple(range(8)), DepthParams(method="hull")), Frame({}, masks))
    whole = hulls(
        Geometry.of(person.rig, tuple(range(8)), DepthParams(method="hull")),
        Frame({}, {v: person.mask[0, v] for v in range(8)}),
    )
    for v in (0, 2, 3, 5):
        surface = (person.depth[0, v] > 0) & (whole[v][0] > 0)
        assert (found[v][0][surface] > 0).all()
        # It carves less, never more.
        assert (found[v][0][surface] <= whole[v][0][surface] + 2e-3).mean() > 0.99


@pytest.mark.parametrize("seed", [0, 5])
def test_a_ray_that_grazes_a_hull_thinner_than_a_step_has_a_far_end_behind_its_near_one(seed: int):
    """Outlines of thin lines leave slivers: the walk back from the far side may stride over what the walk forth met."""
    rig, rng = ring(4), np.random.default_rng(seed)
    masks = {v: np.zeros((64, 64), np.uint8) for v in range(4)}
    for mask in masks.values():
        for _ in range(14):
            a, b = rng.integers(0, 64, (2, 2))
            cv2.line(mask, a.tolist(), b.tolist(), int(rng.integers(120, 256)), 1, cv2.LINE_AA)
    for view in range(4):
        near, far = visual_hull(
            rig, view, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)), (0.0, 0.3)
        )
        assert (near > 0).any()
        assert (near >= 0).all()
        assert (far >= near).all()


def test_the_hull_of_the_others_is_what_those_alone_leave() -> None:
    """Asked for without copying what the others say: depths and hits are the same."""
    rig = ring(7, (64, 64))
    masks = {v: sphere_mask(rig, v, np.array([0.1, 0.05, 0.0]), 0.4) for v in (0, 1, 3, 4, 6)}
    masks[3] = np.roll(masks[3], 9, axis=1)
    silhouettes = Silhouettes.of(rig, masks, np.zeros(3), 1.0)
    for view in (0, 2, 3):
        pixels = pixel_centres((64, 64)).reshape(-1, 2)
        origin, directions = rays(pixels, rig.intrinsics[view], rig.world_to_camera[view])
        others = silhouettes.kept({*silhouettes.views} - {view})
        alone = others.ends(origin, directions)
        np.testing.assert_array_equal(silhouettes.ends(origin, directions, without=view), alone)
        first = others.ends(origin, directions, (0.5, 0.5), votes=False)[:, 0] > 0
        np.testing.assert_array_equal(silhouettes.met(origin, directions, 0.5, without=view), first)
        assert 0 < first.sum() < len(first)


@pytest.mark.parametrize("overruled", [0, 1])
def test_strides_step_over_no_point_of_the_hull(person: PersonCapture, overruled: int) -> None:
    """Every point of a ray, a sixth of a pixel apart, that enough masks keep lies between the ends that were found."""
    rig, masks = person.rig, {v: person.mask[0, v] for v in range(1, 8)}
    silhouettes = Silhouettes.of(rig, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)))
    pixels = np.argwhere(person.mask[0, 0] > 127)[::37, ::-1]
    origin, directions = rays(points_from_integer_centres(pixels), rig.intrinsics[0], rig.world_to_camera[0])
    ends = silhouettes._marched(origin, directions, [(0.0, overruled)], None)
    step = silhouettes.pixel / np.linalg.norm(directions[0])
    depths = np.arange(1e-3, 2 * np.linalg.norm(origin), step / 6)
    missed = 0
    for d, (near, far) in zip(directions, ends, strict=True):
        points = origin + depths[:, None] * d
        seen, carved = np.zeros(len(points), int), np.zeros(len(points), int)
        for distance, projection, size in zip(
            silhouettes.distance, silhouettes.projections, silhouettes.sizes, strict=True
        ):
            x, y, w = projection @ np.c_[points, np.ones(len(points))].T
            x, y = x / w, y / w
            sees = (w > 0) & (x >= 0) & (y >= 0) & (x <= size[0] - 1) & (y <= size[1] - 1)
            px = cv2.remap(distance, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)[0]
            seen += sees
            carved += sees & (px > 1e-3)  # remap rounds places to a 32nd of a pixel
        kept = (carved <= overruled) & (seen - carved >= 2) & (np.linalg.norm(points, axis=1) < silhouettes.radius)
        if near == 0:
            missed += kept.any()
            continue
        # A lattice's point may miss what is thinner than a step; beyond that nothing is kept outside the ends.
        outside = kept & ((depths < near - step) | (depths > far + step))
        missed += longest(outside) > 6
    assert (ends[:, 0] > 0).mean() > 0.9
    assert missed <= 0.02 * len(directions)


def longest(flags: np.ndarray) -> int:
    """Most True in a row."""
    edges = np.flatnonzero(np.diff(np.r_[False, flags, False]))
    return int(np.diff(edges)[::2].max(initial=0))


def test_a_stride_moves_a_point_by_as_many_px_as_it_may() -> None:
    """Forth and back, towards a view and away from it, or never as far."""
    random, reached = np.random.default_rng(0), 0
    for _ in range(400):
        start, along = random.normal(size=(2, 1, 3)) * [300, 300, 1]
        z, px, ahead = random.uniform(0.5, 5), random.uniform(0.1, 60), float(random.choice([-1, 1]))
        moves = np.empty(1)
        motion(start, along, moves)
        here, w = _seen(start[0], along[0], z)
        if w <= 0:
            continue
        found = stride(px, ahead, w, 0, along, moves)
        assert found > 0
        if np.isfinite(found):
            there, beyond = _seen(start[0], along[0], z + ahead * found)
            assert beyond > 0, "never past the camera"
            assert np.linalg.norm(there - here) == pytest.approx(px, rel=1e-6)
            reached += 1
        else:
            assert np.linalg.norm(_seen(start[0], along[0], z + ahead * 1e9)[0] - here) < px
    assert reached > 100


def _seen(start: np.ndarray, along: np.ndarray, z: float) -> tuple[np.ndarray, float]:
    """Px of a ray's point at depth z, and how far in front of the view it is."""
    x, y, w = start + z * along
    return np.array([x, y]) / w, float(w)


@pytest.mark.parametrize("view", [1, 4])
def test_a_view_that_is_overruled_does_not_clip_the_ray(person: PersonCapture, view: int) -> None:
    """One mask holds the feet alone, so that its box cuts off nearly every ray: by vote the body is there all the same,
    where the others leave it."""
    rig, masks = person.rig, {v: person.mask[0, v].copy() for v in range(8)}
    rows = np.flatnonzero(masks[view].any(axis=1))
    masks[view][: rows[-1] - 2] = 0
    silhouettes = Silhouettes.of(rig, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)))
    pixels = np.argwhere(person.mask[0, 0] > 127)[::11, ::-1]
    origin, directions = rays(points_from_integer_centres(pixels), rig.intrinsics[0], rig.world_to_camera[0])
    voted = silhouettes._marched(origin, directions, [(0.0, 1)], 0)
    others = silhouettes.kept({*range(1, 8)} - {view})
    alone = others._marched(origin, directions, [(0.0, 0)], None)
    both = (voted[:, 0] > 0) & (alone[:, 0] > 0)
    assert both.mean() > 0.9
    # one wrong vote may be spent on a view that is right: the hull is no smaller than the others', but for a step
    step = silhouettes.pixel / np.linalg.norm(directions, axis=1)
    assert (voted[both, 0] <= alone[both, 0] + step[both]).all()
    assert (voted[both, 1] >= alone[both, 1] - step[both]).all()
