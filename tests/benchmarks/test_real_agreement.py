"""What two views of a known surface say about depths of it:
nothing against the true one, and what is wrong about others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.network.agreement import SEEN, Shown, carried, drawn_from, drawn_row, outside, pair_rows, zncc
from posegaussian.stages.network.silhouettes import silhouettes_of
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import sphere_mask
from tests.support.network_views import UPRIGHT, plane_depth, source, two_cameras

torch.set_num_threads(1)
KINDS = ("true", "off")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return two_cameras()


@pytest.fixture(scope="module")
def true(rig: Rig) -> dict[int, np.ndarray]:
    return {v: plane_depth(rig, v) for v in range(2)}


@pytest.fixture(scope="module")
def shown(rig: Rig, true: dict[int, np.ndarray]) -> Shown:
    views = {v: source(rig, v, z) for v, z in true.items()}
    return Shown(rig, {v: s.color for v, s in views.items()}, {v: s.mask for v, s in views.items()})


def rows(
    shown: Shown, true: dict[int, np.ndarray], off: dict[int, np.ndarray]
) -> tuple[dict[str, dict[str, float]], dict[str, np.ndarray]]:
    found, maps = pair_rows(shown, (0, 1), {"true": true, "off": off}, silhouettes_of(shown.rig, shown.mask))
    return {r["depth"]: r for r in found}, maps


def nearer(rig: Rig, true: dict[int, np.ndarray], px: float) -> dict[int, np.ndarray]:
    """The depths brought nearer by so many px of disparity."""
    # Both cameras stand 2 m away, 24 degrees apart, of 1.8 x 128 px.
    sensitivity = 1.8 * 128 * 2 * 2 * np.sin(np.radians(12)) * np.cos(np.radians(8))
    return {
        v: np.where(z > 0, 1 / (1 / np.where(z > 0, z, 1) + px / sensitivity), 0).astype(np.float32)
        for v, z in true.items()
    }


def test_nothing_speaks_against_the_true_depth(shown: Shown, true: dict[int, np.ndarray]) -> None:
    found, _ = rows(shown, true, true)
    assert found["true"] == {**found["off"], "depth": "true"}
    # What the disc's slanted rim cuts off is all that one view does not see.
    assert found["true"]["px"] > 0.95 * (true[0] > 0).sum()
    assert found["true"]["< 1 px"] > 0.99
    # Interpolation of 25 px waves of 240 steps, and half a step of rounding.
    assert found["true"]["colour median"] < 2
    # Patches at the disc's rim and where the waves are nearly flat count, too.
    assert found["true"]["ZNCC"] > 0.95
    assert found["true"]["outside"] < 0.01


@pytest.mark.parametrize("px", [1.5, -1.5])
def test_depths_that_differ_are_told_in_px(shown: Shown, true: dict[int, np.ndarray], px: float) -> None:
    one = {0: nearer(shown.rig, true, px)[0], 1: true[1]}
    # The plane leans: of the 3 x 3 pixels the best one counts, which takes off a part.
    assert np.nanmedian(carried(shown, (0, 1), one).apart) == pytest.approx(abs(px), abs=0.4)


def test_what_is_off_in_both_views_shows_in_colours_and_patches_though_the_depths_agree(
    shown: Shown, true: dict[int, np.ndarray]
) -> None:
    found, maps = rows(shown, true, nearer(shown.rig, true, 4.0))
    assert found["off"]["colour median"] > 5 * found["true"]["colour median"]
    assert found["off"]["ZNCC"] < found["true"]["ZNCC"] - 0.1
    assert np.nanmedian(maps["off"] - maps["true"]) > 5


def test_harm_is_not_hidden_by_leaving_out_what_it_touched(shown: Shown, true: dict[int, np.ndarray]) -> None:
    spoilt = {0: true[0].copy(), 1: true[1]}
    spoilt[0][40:80, 40:80] *= 1.1
    found, maps = rows(shown, true, spoilt)
    assert (carried(shown, (0, 1), spoilt).apart[45:75, 45:75] > SEEN).all(), (
        "by itself the other view says nothing of them"
    )
    assert found["off"]["px"] == found["true"]["px"] == np.isfinite(maps["off"]).sum()
    assert np.isfinite(maps["off"][45:75, 45:75]).all()
    assert found["off"]["colour mean"] > 3 * found["true"]["colour mean"]
    swapped, _ = pair_rows(shown, (0, 1), {"off": spoilt, "true": true}, silhouettes_of(shown.rig, shown.mask))
    assert {r["depth"]: r for r in swapped} == found, "whichever comes first"


def test_a_gain_between_the_cameras_counts_for_nothing(shown: Shown, true: dict[int, np.ndarray]) -> None:
    darker = replace(shown, color={0: shown.color[0], 1: np.rint(0.6 * shown.color[1]).astype(np.uint8)})
    before, after = rows(shown, true, true)[0]["true"], rows(darker, true, true)[0]["true"]
    # Rounding of darker pixels is 1 / 0.6 as coarse.
    assert after["colour median"] < before["colour median"] + 1
    assert after["ZNCC"] == pytest.approx(before["ZNCC"], abs=0.02)


def test_points_beside_a_silhouette_are_counted() -> None:
    rig = two_cameras(angles=(0.0, 90.0))
    masks = {v: sphere_mask(rig, v, np.zeros(3), 0.2) for v in range(2)}
    depth = np.where(masks[0] > 127, 2.0, 0).astype(np.float32)
    assert outside(rig, 0, depth, silhouettes_of(rig, masks)) < 0.02
    depth[:64] *= 1.25
    assert outside(rig, 0, depth, silhouettes_of(rig, masks)) == pytest.approx(0.5, abs=0.05)


def test_correlation_knows_gain_noise_and_flat_patches() -> None:
    first = np.random.default_rng(0).uniform(50, 200, (40, 40))
    inside = np.ones((40, 40), bool)
    same, told = zncc(first, 0.5 * first + 20, inside)
    assert told.all()
    np.testing.assert_allclose(same, 1, atol=1e-6)
    np.testing.assert_allclose(zncc(first, 255 - first, inside)[0], -1, atol=1e-6)
    assert abs(zncc(first, np.random.default_rng(1).uniform(50, 200, (40, 40)), inside)[0].mean()) < 0.05
    assert not zncc(np.full((40, 40), 9.0), first, inside)[1].any()
    np.testing.assert_allclose(zncc(first, np.full((40, 40), 9.0), inside)[0], 0, atol=1e-9)


def test_a_view_drawn_from_its_partner_meets_its_silhouette(shown: Shown, true: dict[int, np.ndarray]) -> None:
    rig = shown.rig
    facing = rig.rotations[0] @ -UPRIGHT[0] / np.linalg.norm(UPRIGHT[0])
    facing = facing if facing[2] < 0 else -facing
    size = true[0].shape
    scale = np.where(true[0] > 0, 0.6 * true[0] / rig.intrinsics[0, 0, 0], 0)[None].repeat(3, 0).astype(np.float32)
    rest = (
        scale,
        np.broadcast_to(facing[:, None, None], (3, *size)).astype(np.float32),
        np.full((2, *size), 0.95, np.float32),
    )
    wide = np.ones(size, bool)
    near = drawn_row(shown, 1, drawn_from(shown, 1, (0,), {0: (true[0], *rest)}), wide)
    far = drawn_row(shown, 1, drawn_from(shown, 1, (0,), {0: (nearer(rig, true, 8.0)[0], *rest)}), wide)
    assert near["IoU"] > 0.95
    assert near["spill"] < 0.02
    assert near["mask PSNR"] > far["mask PSNR"] + 5
    assert far["IoU"] < near["IoU"] - 0.05
    assert far["spill"] > near["spill"] + 0.02
