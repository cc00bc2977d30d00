"""Laws of the truth: views agree with each other, normals with depth,
masks with coverage, joints with what hides them."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.geometry.projection import pixel_centres, project, unproject
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.setup import Staged, stage
from posegaussian.stages.simulator.take import Shot

SIZE = (200, 260)


def filmed(**changes: Any) -> tuple[Staged, list[Shot]]:
    base = {"seed": 2, "frames": 1, "motion": {"name": "walk", "phase": 0.2}, "rig": {"cameras": 8, "size": SIZE}}
    staged = stage(Scene.model_validate({**base, **changes}))
    return staged, [staged.take.shoot(0, v) for v in range(3)]


@pytest.fixture(scope="module")
def walk() -> tuple[Staged, list[Shot]]:
    return filmed()


def neighbourhood(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest depth of the 3 x 3 pixels around each; infinite where one of them has none."""
    padded = np.pad(np.where(depth > 0, depth, np.inf), 1, constant_values=np.inf)
    all_ = np.stack([padded[i : i + depth.shape[0], j : j + depth.shape[1]] for i in range(3) for j in range(3)])
    return all_.min(axis=0), all_.max(axis=0)


def test_a_surface_point_of_one_view_lies_on_the_surface_of_the_next_or_behind_it(
    walk: tuple[Staged, list[Shot]],
) -> None:
    staged, shots = walk
    rig = staged.take.rig
    for a, b in ((0, 1), (1, 0), (1, 2)):
        points = unproject(shots[a].depth, rig.intrinsics[a], rig.world_to_camera[a])[shots[a].depth > 0]
        uv, z = project(points, rig.intrinsics[b], rig.world_to_camera[b])
        column, row = np.floor(uv[:, 0]).astype(int), np.floor(uv[:, 1]).astype(int)
        assert ((column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])).all()
        near, far = (n[row, column] for n in neighbourhood(shots[b].depth))
        inside = np.isfinite(far)
        seen = inside & (z < far + 0.002)
        assert seen.sum() > 0.4 * len(points), "45 degrees apart, much is seen by both"
        # an edge nearer than a pixel from the centre may pass between the nine samples
        assert (z[seen] > near[seen] - 0.002).mean() > 0.998
        hidden = inside & ~seen
        assert hidden.sum() < 0.25 * len(points)


def test_normals_are_those_of_the_depth(walk: tuple[Staged, list[Shot]]) -> None:
    staged, shots = walk
    k = staged.take.rig.intrinsics[0]
    for s in shots:
        rays = np.concatenate(
            [(pixel_centres(SIZE) - k[:2, 2]) @ np.linalg.inv(k[:2, :2]).T, np.ones((*s.depth.shape, 1))], axis=-1
        )
        p = rays * s.depth[..., None]
        across, down = p[1:-1, 2:] - p[1:-1, :-2], p[2:, 1:-1] - p[:-2, 1:-1]
        n = np.cross(down, across)
        n /= np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12)
        near, far = neighbourhood(s.depth)
        smooth = (np.isfinite(far) & (far - np.where(np.isfinite(near), near, 0) < 0.02))[1:-1, 1:-1]
        assert smooth.sum() > 3000
        cosine = np.abs(np.sum(n * s.normal[1:-1, 1:-1], axis=-1))[smooth]
        # a facet of the mesh is about two pixels wide, so differences over two pixels mix neighbours
        assert np.rad2deg(np.arccos(np.clip(np.median(cosine), 0, 1))) < 4
        assert (np.rad2deg(np.arccos(np.clip(cosine, 0, 1))) < 25).mean() > 0.95
        outward = np.sum(s.normal * rays, axis=-1)[s.depth > 0]
        assert (outward < 1e-6).all(), "it faces the camera"


def test_the_mask_is_the_share_of_the_pixel_that_is_covered(walk: tuple[Staged, list[Shot]]) -> None:
    _, shots = walk
    _, fine = filmed(samples=8)
    for s, f in zip(shots, fine, strict=True):
        off = s.true_mask / 255.0 - f.true_mask / 255.0
        rim = (f.true_mask > 0) & (f.true_mask < 255)
        assert not off[f.true_mask == 0].any()
        assert abs(off[rim].mean()) < 0.02, "no bias"
        assert np.abs(off[rim]).mean() < 0.15, "four samples resolve a quarter"
        assert set(np.unique(s.true_mask)) <= {0, 64, 128, 191, 255}
        np.testing.assert_array_equal(s.depth, f.depth)


def test_a_joint_behind_something_is_not_seen_and_one_beside_it_is() -> None:
    """A thick post half a metre before the body, low enough to hide the legs alone."""
    post = {"position": [0.55, 0.0], "radius": 0.4, "height": 0.7, "switch": "on"}
    _, free = filmed(motion="stand")
    _, hidden = filmed(motion="stand", effects={"occluding_object": post})
    before, after = free[0].true_joints2d, hidden[0].true_joints2d
    assert before is not None
    assert after is not None
    assert before[[13, 14, 15, 16], 2].all()
    assert not after[[15, 16], 2].any(), "ankles"
    np.testing.assert_array_equal(after[:11], before[:11])
    np.testing.assert_array_equal(after[:, :2], before[:, :2])
    assert hidden[0].true_mask.sum() < free[0].true_mask.sum()
    assert not hidden[0].depth[hidden[0].true_mask == 0].any(), "the post has neither mask nor depth"


def test_from_the_left_the_right_side_is_hidden() -> None:
    staged = stage(
        Scene.model_validate(
            {
                "seed": 1,
                "frames": 1,
                "motion": "stand",
                "rig": {"kind": "list", "cameras": [{"name": "left", "position": [0, 3, 1]}]},
            }
        )
    )
    joints = staged.take.shoot(0, 0).true_joints2d
    assert joints is not None
    left, right = joints[[3, 5, 7, 9, 11, 13, 15], 2], joints[[4, 6], 2]
    assert left.all(), "from the left, all of the left side is seen"
    assert not right.any(), "and neither the right ear nor the right shoulder"


def test_simulating_needs_neither_anny_nor_torch() -> None:
    code = (
        "import sys\n"
        "sys.modules['anny'] = sys.modules['torch'] = None\n"
        "from posegaussian.stages.simulator.quality_scenes import benchmark_scene\n"
        "from posegaussian.stages.simulator.setup import stage\n"
        "print(stage(benchmark_scene(1, 1, 32, 1, held_out=0)).take.shoot(0, 0).true_mask.max())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "255"


def test_what_a_seed_may_not_show_is_not_staged() -> None:
    with pytest.raises(ValueError, match="gao is kept for measuring"):
        stage(Scene.model_validate({"seed": 1, "subject": {"person": "gao"}}))
