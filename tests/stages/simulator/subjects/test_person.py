"""The capsule person against analytic truth."""

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres, project, unproject
from posegaussian.stages.simulator.render.raycast import ELLIPSOID, ROUND_CONE, cast, ellipsoid_hit, round_cone_hit
from posegaussian.stages.simulator.render.texture import noise
from posegaussian.stages.simulator.subjects.capsule_person import capture_person, render, ring
from posegaussian.stages.simulator.subjects.motion import GEOMETRY, KINDS, MOTIONS, PART_BONES, joints_at, pose

K = np.array([[60.0, 0.0, 24.0], [0.0, 55.0, 23.5], [0.0, 0.0, 1.0]])


def _cast_one(kind: int, geometry: list[float], size: int = 48) -> np.ndarray:
    row = np.array([[*geometry, *[0.0] * (8 - len(geometry))]])
    return cast(np.array([kind]), row, np.eye(3)[None], np.zeros((1, 3)), K, (size, size), 1)[0]


def _rays(size: int = 48) -> np.ndarray:
    uv = pixel_centres((size, size))
    return np.concatenate([(uv - K[:2, 2]) / [K[0, 0], K[1, 1]], np.ones((size, size, 1))], axis=-1)


def test_depth_of_a_ball_is_the_quadratic_formula() -> None:
    centre, radius = np.array([0.1, -0.2, 3.0]), 0.7
    d = _rays()
    b, a = d @ centre, np.sum(d * d, axis=-1)
    h = b * b - a * (centre @ centre - radius * radius)
    expected = np.where(h >= 0, (b - np.sqrt(np.maximum(h, 0))) / a, np.inf)
    np.testing.assert_allclose(_cast_one(ELLIPSOID, [*centre, *[radius] * 3]), expected, rtol=1e-12)


@pytest.mark.parametrize("radii", [(0.3, 0.3), (0.45, 0.1), (0.1, 0.5)])
@pytest.mark.parametrize("end", [(0.4, 0.3, 3.4), (0.05, 0.0, 2.1)])
def test_round_cone_is_the_union_of_its_balls(radii: tuple[float, float], end: tuple[float, float, float]) -> None:
    a, b = np.array([-0.2, -0.1, 3.0]), np.array(end)
    depth = _cast_one(ROUND_CONE, [*a, *b, *radii])
    # A round cone is the union of the balls between its ends: 4000 of them stand for all. Their hull lies inside.
    steps = np.linspace(0, 1, 4001)[:, None]
    d = _rays().reshape(-1, 3)
    best = np.full(len(d), np.inf)
    for centre, radius in zip(a + steps * (b - a), radii[0] + steps[:, 0] * (radii[1] - radii[0]), strict=True):
        p, q = d @ centre, np.sum(d * d, axis=-1)
        h = p * p - q * (centre @ centre - radius * radius)
        best = np.minimum(best, np.where(h >= 0, (p - np.sqrt(np.maximum(h, 0))) / q, np.inf))
    depth, hit = depth.ravel(), np.isfinite(best)
    assert np.isfinite(depth)[hit].all()
    assert (np.isfinite(depth) & ~hit).sum() <= 2
    # Balls 0.4 mm apart are scalloped by far less than 0.1 mm, except where a ray grazes the outline.
    close = np.abs(depth[hit] - best[hit]) < 1e-4
    assert close.mean() > 0.99
    assert np.abs(depth[hit] - best[hit]).max() < 0.03


def test_screen_boxes_lose_no_hit() -> None:
    rig, bones = ring(3, 40, 0), pose("kick", 0.15)
    for v in range(3):
        m = rig.world_to_camera[v] @ bones[PART_BONES]
        rotation, shift = np.ascontiguousarray(m[:, :3, :3]), np.ascontiguousarray(m[:, :3, 3])
        depth, _ = cast(KINDS, GEOMETRY, rotation, shift, rig.intrinsics[v], (40, 40), 1)
        d = np.concatenate([(pixel_centres((40, 40)) - 20.0) / rig.intrinsics[v, 0, 0], np.ones((40, 40, 1))], axis=-1)
        for i in range(0, 40, 3):
            for j in range(40):
                best = np.inf
                for p in range(len(KINDS)):
                    hit = ellipsoid_hit if KINDS[p] == ELLIPSOID else round_cone_hit
                    best = min(best, hit(-rotation[p].T @ shift[p], rotation[p].T @ d[i, j], GEOMETRY[p]))
                assert depth[i, j] == pytest.approx(best, rel=1e-9)


def test_noise_is_continuous_and_in_range() -> None:
    x = np.linspace(-3.0, 3.0, 2001)
    values = np.array([noise(v, 0.3, -1.7) for v in x])
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    # 3t² - 2t³ is at most 1.5 steep and lattice values differ by at most 1.
    assert np.abs(np.diff(values)).max() <= 1.5 * (x[1] - x[0]) + 1e-12
    assert values.std() > 0.1


def test_standing_person_is_as_tall_as_said() -> None:
    capture = capture_person(views=4, size=256, frames=1, held_out=0, motion="stand")
    points = np.concatenate(
        [
            unproject(capture.depth[0, v], capture.rig.intrinsics[v], capture.rig.world_to_camera[v])[
                capture.depth[0, v] > 0
            ]
            for v in range(4)
        ]
    )
    # A pixel is 9 mm at the person: the outermost centres lie up to a pixel inside the outline;
    # soles are seen from above.
    assert points[:, 2].max() == pytest.approx(1.75, abs=0.01)
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("motion", sorted(MOTIONS))
def test_masks_depth_and_joints_agree(motion: str) -> None:
    capture = capture_person(views=4, size=64, frames=6, held_out=2, motion=motion)
    assert capture.color.shape == (6, 6, 64, 64, 3)
    assert ((capture.mask == 255) <= (capture.depth > 0)).all()
    assert ((capture.mask == 0) <= (capture.depth == 0)).all()
    assert (capture.color.max(axis=-1) <= capture.mask.astype(int) + 1).all(), "colour is premultiplied"
    border = np.ones((64, 64), bool)
    border[1:-1, 1:-1] = False
    assert not capture.mask[..., border].any(), "the person keeps a margin"
    for f in range(6):
        for v in range(6):
            uv, z = project(capture.joints3d[f, :, :3], capture.rig.intrinsics[v], capture.rig.world_to_camera[v])
            np.testing.assert_allclose(uv, capture.joints2d[f, v, :, :2])
            column, row = uv.astype(int).T
            nearby = np.stack(
                [
                    capture.mask[f, v][np.clip(row + i, 0, 63), np.clip(column + j, 0, 63)]
                    for i in (-1, 0, 1)
                    for j in (-1, 0, 1)
                ]
            )
            assert (nearby.max(axis=0) > 0).all(), "a joint lies on the person"
            surface = capture.depth[f, v][row, column]
            # Joints lie inside the body; 7 cm covers a nose in profile whose pixel of 36 mm sees the cheek behind it.
            assert (z[surface > 0] > surface[surface > 0] - 0.07).all()


def test_depth_of_one_view_lands_on_the_surface_of_its_neighbour() -> None:
    capture = capture_person(views=12, size=256, frames=1, held_out=1)
    a, b = 0, 12
    points = unproject(capture.depth[0, a], capture.rig.intrinsics[a], capture.rig.world_to_camera[a])
    inside = capture.mask[0, a] == 255
    uv, z = project(points[inside], capture.rig.intrinsics[b], capture.rig.world_to_camera[b])
    column, row = uv.astype(int).T
    surface = capture.depth[0, b][row, column]
    # 15° to the side hides little; a pixel is 9 mm, and the nearest pixel's depth on a slanted skin is some way off.
    lands = np.abs(z - surface) < 0.02
    assert lands.mean() > 0.85
    assert (z > surface - 0.06)[surface > 0].mean() > 0.995, "nothing may lie in front of the first surface"
    bilinear = capture.mask[0, b][row, column] == 255
    difference = np.abs(
        capture.color[0, a][inside][lands & bilinear].astype(float) - capture.color[0, b][row, column][lands & bilinear]
    )
    shuffled = np.abs(
        capture.color[0, a][inside][lands & bilinear].astype(float)
        - np.roll(capture.color[0, b][row, column][lands & bilinear], 997, axis=0)
    )
    # The texture's finest cell is 11 mm, one pixel here: half a pixel of error costs contrast, a wrong point costs all.
    assert np.median(difference) < 14
    assert np.median(difference) < 0.4 * np.median(shuffled)


def test_a_frame_and_a_view_do_not_depend_on_the_others() -> None:
    long, short = capture_person(4, 32, 4, 2, "kick"), capture_person(4, 32, 2, 1, "kick")
    np.testing.assert_array_equal(short.color, long.color[:2, [0, 1, 2, 3, 4]])
    np.testing.assert_array_equal(short.depth, long.depth[:2, [0, 1, 2, 3, 4]])


def test_supersampled_colour_is_the_mean_of_a_finer_picture() -> None:
    rig, bones = ring(1, 32, 0), pose("wave", 0.2)
    coarse = render(bones, rig.intrinsics[0], rig.world_to_camera[0], (32, 32), 4)[0]
    k = rig.intrinsics[0].copy()
    k[:2] *= 4
    fine = render(bones, k, rig.world_to_camera[0], (128, 128), 1)[0]
    # Rounding to 8 bits before and after averaging: at most one step.
    assert np.abs(coarse - fine.reshape(32, 4, 32, 4, 3).mean(axis=(1, 3))).max() <= 1.0


def test_limbs_are_rigid_and_the_kick_is_fast() -> None:
    times = np.arange(24) / 30
    joints = np.stack([joints_at(pose("kick", t)) for t in times])
    for a, b in ((6, 8), (8, 10), (12, 14), (14, 16), (11, 13)):
        lengths = np.linalg.norm(joints[:, a] - joints[:, b], axis=1)
        np.testing.assert_allclose(lengths, lengths[0], rtol=1e-12)
    steps = np.linalg.norm(np.diff(joints, axis=0), axis=2)
    assert steps[:6, 16].max() > 0.2, "the right ankle moves more than 20 cm a frame within the first frames"
    assert steps[:, 15].max() < 1e-12, "the left foot stands"


def test_held_out_cameras_stand_in_the_middle_of_gaps() -> None:
    rig = ring(8, 48, 3)
    centres = rig.centres
    gaps = [np.argsort(np.linalg.norm(centres[:8] - c, axis=1))[:2] for c in centres[8:]]
    for c, (i, j) in zip(centres[8:], gaps, strict=True):
        assert np.linalg.norm(c - centres[i]) == pytest.approx(np.linalg.norm(c - centres[j]))
    assert len({tuple(sorted(g)) for g in gaps}) == 3
    np.testing.assert_allclose(np.linalg.norm(centres[:, :2], axis=1), 2.4)
    rig.check()


def test_errors_name_what_is_known() -> None:
    with pytest.raises(ValueError, match="stand, wave, kick"):
        pose("dance", 0.0)
    with pytest.raises(ValueError, match="held-out"):
        ring(2, 48, 3)
