"""Cameras 45 degrees apart around a cut-out person: too far for features, so that points of the hull must tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from posegaussian.stages.contract.facts import MASKS, Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.frames.effects import EXPOSURE_MATCHING
from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.stages.imaging.exposure import NONE, match
from posegaussian.stages.simulator.subjects.capsule_person import render, ring
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.stages.survey.algorithms.surface import surface_stops
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.spec import array_digest

SIZE, CAMERAS = 256, 8


@pytest.fixture(scope="module")
def filmed() -> tuple[Rig, list[np.ndarray], list[np.ndarray]]:
    """Of each camera the light [h, w, 3] and the mask [h, w] uint8."""
    rig = ring(CAMERAS, SIZE, 0)
    shots = [
        render(pose("stand", 0.0), rig.intrinsics[v], rig.world_to_camera[v], (SIZE, SIZE), 2) for v in range(CAMERAS)
    ]
    return rig, [to_linear(color.astype(np.float64)) for color, _, _ in shots], [mask for _, mask, _ in shots]


class Reader:
    """`posegaussian.stages.contract.io.PictureReader` over one picture a view."""

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self._pictures = pictures

    def numbers(self, view: int) -> np.ndarray:
        return np.arange(1)

    def size(self, view: int) -> tuple[int, int]:
        return SIZE, SIZE

    def identity(self, view: int, number: int) -> str:
        return array_digest(self._pictures[view])

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        return (self._pictures[view] for _ in numbers)


def surveyed(filmed: tuple[Rig, list[np.ndarray], list[np.ndarray]], stops: np.ndarray, facts: Facts) -> np.ndarray:
    """[S, S, 64, 3] surface points of cameras with these exposures [S]."""
    rig, light, masks = filmed
    pictures = [np.rint(to_srgb(np.clip(a * 2**s, 0, 1))).astype(np.uint8) for a, s in zip(light, stops, strict=True)]
    readers = {"pictures": Reader(pictures), "masks": Reader(masks)}
    inputs = SimpleNamespace(
        rig=rig,
        source_rig=rig,
        views=Views(rig.names, tuple(range(CAMERAS)), ()),
        captured_to_calibrated=np.tile([1.0, 0, 0], (CAMERAS, 1)),
        source=readers.__getitem__,
        facts=facts,
    )
    return np.stack([surface_stops(inputs, v, np.arange(1)) for v in range(CAMERAS)])  # type: ignore[arg-type]


def test_half_a_stop_is_found_and_undone(filmed: tuple[Rig, list[np.ndarray], list[np.ndarray]]) -> None:
    stops = np.array([0.0, -0.5, 0.0, 0.0, -0.5, 0.0, 0.0, -0.5])
    found = match(surveyed(filmed, stops, Facts(frozenset({MASKS}))))
    assert found is not None
    assert found.certain.max() > EXPOSURE_MATCHING.threshold
    # The hull of eight cameras lies beside the person, whose stripes are a few pixels wide at this size.
    np.testing.assert_allclose(np.log2(found.gains), -np.repeat(stops[:, None], 3, axis=1), atol=0.15)


def test_equal_cameras_stay_equal(filmed: tuple[Rig, list[np.ndarray], list[np.ndarray]]) -> None:
    found = match(surveyed(filmed, np.zeros(CAMERAS), Facts(frozenset({MASKS}))))
    assert found is not None
    np.testing.assert_array_equal(found.gains, 1.0)


def test_masks_link_cameras_that_features_do_not(filmed: tuple[Rig, list[np.ndarray], list[np.ndarray]]) -> None:
    without, linked = (
        (surveyed(filmed, np.zeros(CAMERAS), Facts(f)) < NONE).any(axis=(2, 3))
        for f in (frozenset(), frozenset({MASKS}))
    )
    assert (linked >= without).all()
    assert linked.sum() > without.sum()
