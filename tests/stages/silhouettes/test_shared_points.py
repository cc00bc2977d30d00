"""Laws of points of the hull that two cameras see."""

import numpy as np

from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.shared_points import shared_points
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask

CENTRE, RADIUS = np.array([0.1, -0.05, 0.1]), 0.5


def seen(rig: Rig, pair: tuple[int, int], spheres: list[tuple[np.ndarray, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Shared points of the union of some spheres."""
    masks = {v: np.max([sphere_mask(rig, v, *s) for s in spheres], axis=0) for v in range(len(rig))}
    silhouettes = Silhouettes.of(rig, masks, np.zeros(3), searched_radius(rig, list(masks), np.zeros(3)))
    return shared_points(rig, pair, {v: m > 0 for v, m in masks.items()}, silhouettes)


def gap(rig: Rig, pair: tuple[int, int], pixels: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """[n] metres between the rays through both pixels, which meet at a shared point."""
    (o1, d1), (o2, d2) = (rays(p, rig.intrinsics[v], rig.world_to_camera[v]) for v, p in zip(pair, pixels, strict=True))
    across = np.cross(d1, d2)
    return np.abs(((o2 - o1) * across).sum(axis=-1)) / np.linalg.norm(across, axis=-1)


def test_rays_of_shared_points_meet_on_the_hull():
    rig = ring(24)
    first, second = seen(rig, (0, 2), [(CENTRE, RADIUS)])
    assert len(first) > 500
    np.testing.assert_allclose(gap(rig, (0, 2), (first, second)), 0.0, atol=1e-9)


def test_the_same_points_are_shared_either_way():
    """Nothing but the grid on which the first camera asks tells the two apart."""
    rig = ring(24)
    there, back = seen(rig, (0, 2), [(CENTRE, RADIUS)]), seen(rig, (2, 0), [(CENTRE, RADIUS)])
    assert abs(len(there[0]) - len(back[0])) < 0.1 * len(there[0])
    nearest = np.linalg.norm(there[1][:, None] - back[0][None], axis=-1).min(axis=1)
    # A pixel of the second camera lies within half a diagonal of any point; at the rim's grazing rays some have none.
    assert (nearest < 1.5).mean() > 0.95


def test_cameras_that_face_each_other_share_nothing():
    rig = ring(24)
    first, _ = seen(rig, (0, 12), [(CENTRE, RADIUS)])
    assert len(first) == 0


def test_what_another_limb_hides_from_the_second_camera_is_not_shared():
    rig = ring(24)
    # Towards the second camera, so that it stands before the sphere there alone.
    towards = rig.centres[4] / np.linalg.norm(rig.centres[4])
    alone, _ = seen(rig, (0, 4), [(CENTRE, 0.3)])
    behind, at = seen(rig, (0, 4), [(CENTRE, 0.3), (CENTRE + 0.7 * towards, 0.15)])
    hides = sphere_mask(rig, 4, CENTRE + 0.7 * towards, 0.15) == 255
    own = sphere_mask(rig, 0, CENTRE, 0.3) > 0
    of_the_sphere = own[tuple(np.floor(behind).astype(int).T[::-1])]
    under = hides[tuple(np.floor(at).astype(int).T[::-1])]
    assert len(alone) > 100
    assert not (of_the_sphere & under).any()
