import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, project, rays, unproject
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_depth


def test_the_optical_axis_meets_the_principal_point():
    pose = camera(on_ring(30), np.zeros(3))
    rig = rig_of([pose], size=(640, 480))
    pixels, depth = project(np.zeros(3), rig.intrinsics[0], pose)
    # Distance 2 m by construction; float64 rounding.
    np.testing.assert_allclose(pixels, [320, 240], atol=1e-9)
    np.testing.assert_allclose(depth, 2.0, atol=1e-12)


def test_top_left_pixel_centre_is_a_half():
    assert pixel_centres((3, 2))[0, 0].tolist() == [0.5, 0.5]
    assert pixel_centres((3, 2))[1, 2].tolist() == [2.5, 1.5]


def test_unproject_then_project_returns_pixels_and_depth_of_a_picture_that_is_not_square():
    rng = np.random.default_rng(0)
    pose = camera(on_ring(200, 15), np.array([0.1, 0.2, -0.1]))
    rig = rig_of([pose], size=(9, 5), focal=7.0)
    rig.intrinsics[0, 0, 1] = 0.3
    depth = rng.uniform(0.5, 4, (5, 9))
    pixels, back = project(unproject(depth, rig.intrinsics[0], pose), rig.intrinsics[0], pose)
    np.testing.assert_allclose(back, depth, rtol=1e-12)
    np.testing.assert_allclose(pixels, pixel_centres((9, 5)), atol=1e-11)


def test_rays_advance_one_metre_along_the_axis():
    pose = camera(on_ring(75), np.zeros(3))
    rig = rig_of([pose])
    origin, directions = rays(np.array([[10.0, 900.0], [512, 512]]), rig.intrinsics[0], pose)
    np.testing.assert_allclose(origin, on_ring(75), atol=1e-12)
    np.testing.assert_allclose(directions @ pose[2, :3], 1.0, atol=1e-12)


def test_unprojected_sphere_lies_on_the_sphere():
    rig = rig_of([camera(on_ring(10), np.zeros(3))], size=(48, 40), focal=40.0)
    depth = sphere_depth(rig, 0, np.zeros(3), 0.5)
    points = unproject(depth, rig.intrinsics[0], rig.world_to_camera[0])[depth > 0]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.5, atol=1e-12)
