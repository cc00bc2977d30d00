"""Laws of the light that views share: a gain is a gain whatever glints, and what is not one surface says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import TaskScope, Views
from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.stages.imaging.exposure import NONE
from posegaussian.stages.judge.light import FEWEST, POINTS, shared_light, stops_between
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.simulator.subjects.capsule_person import render, ring
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.storage.model.cameras import Rig

SIZE, CAMERAS = 192, 3


def cloth(count: int, seed: int = 0) -> np.ndarray:
    """[n, 3] light of coloured cloth, lit brightly and dimly."""
    random = np.random.default_rng(seed)
    return np.array([0.5, 0.25, 0.1]) * random.uniform(0.15, 1.0, (count, 1))


@pytest.mark.parametrize("stops", [0.0, 0.5, -1.0])
def test_highlights_that_are_elsewhere_in_each_view_change_no_gain(stops: float) -> None:
    """White gloss on two fifths of the points, in the first view alone: by their light it would be a tenth of a stop
    off by the median, and half a stop by the mean."""
    light, random = cloth(4000), np.random.default_rng(1)
    gloss = random.uniform(0, 3.0, (4000, 1)) * light.mean() * (random.random((4000, 1)) < 0.4)
    found = stops_between(2.0**stops * (light + gloss), light)
    assert found.shape == (POINTS, 3)
    np.testing.assert_allclose(np.median(found, axis=0), stops, atol=0.03)
    assert np.log2((light + gloss) / light).mean() > 0.5


def test_a_channels_own_gain_is_found_beside_the_common_one() -> None:
    light, gain = cloth(4000), np.exp2([0.7, 0.3, 0.3])
    np.testing.assert_allclose(stops_between(gain * light, light), np.tile([0.7, 0.3, 0.3], (POINTS, 1)), atol=1e-6)


def test_a_pair_the_other_way_round_says_the_opposite() -> None:
    light = cloth(2000)
    other = light * np.exp2(0.4 + 0.05 * np.random.default_rng(2).normal(size=(2000, 1)))
    np.testing.assert_allclose(
        np.median(stops_between(light, other), axis=0), -np.median(stops_between(other, light), axis=0), atol=0.01
    )


def test_grey_cloth_is_compared_by_its_light_if_it_has_dark_and_bright_points() -> None:
    grey = np.repeat(np.exp2(np.random.default_rng(3).uniform(-4, -1, (3000, 1))), 3, axis=1)
    np.testing.assert_allclose(stops_between(grey * 2**0.5, grey), 0.5, atol=1e-6)
    flat = np.full((3000, 3), 0.2)
    assert not len(stops_between(flat * 2**0.5, flat)), "of one tone gloss and gain are the same"
    assert not len(stops_between(cloth(FEWEST - 1), cloth(FEWEST - 1)))


def filmed(rig: Rig, stops: np.ndarray, apart: float = 0.0) -> Frames:
    """A person seen by cameras with these exposures; the last one's depth is `apart` m too far."""
    pictures, masks, depths = [], [], []
    for v in range(CAMERAS):
        color, mask, depth = render(pose("stand", 0.0), rig.intrinsics[v], rig.world_to_camera[v], (SIZE, SIZE), 2)
        light = np.clip(to_linear(color.astype(np.float64)) * 2 ** stops[v] / 2, 0, 1)
        pictures.append(np.rint(to_srgb(light)).astype(np.uint8))
        masks.append(mask)
        depths.append(np.where(depth > 0, depth + (apart if v == CAMERAS - 1 else 0), 0))
    arrays = {"frames/color": pictures, "frames/mask": masks, "depth/depth": depths}
    held = {name: np.stack(maps)[None] for name, maps in arrays.items()}
    held["depth/confidence"] = (held["depth/depth"] > 0).astype(np.float32)
    scope = TaskScope(
        partition=range(1),
        source_frames=np.arange(1),
        time=np.zeros(1),
        valid=np.ones((1, CAMERAS), bool),
        view=None,
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0, 0], (CAMERAS, 1)),
        views=Views(rig.names, tuple(range(CAMERAS)), ()),
        path=None,
        facts=Facts(),
        joint_set=None,
    )
    return Frames(scope, held)


def test_points_that_two_views_see_tell_how_they_differ_and_what_is_behind_them_nothing() -> None:
    rig, stops = ring(360 // 20, SIZE, 0).subset(list(range(CAMERAS))), np.array([0.0, 0.5, -0.3])
    found = shared_light(filmed(rig, stops))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        np.testing.assert_allclose(np.median(found[a, b], axis=0), stops[a] - stops[b], atol=0.05)
        assert (found[b, a] == NONE).all(), "each pair is told once"
    off = shared_light(filmed(rig, stops, apart=0.2))
    assert (off[0, 1] < NONE).all()
    assert (off[:2, 2] == NONE).all(), "depths that contradict each other are not one surface"
