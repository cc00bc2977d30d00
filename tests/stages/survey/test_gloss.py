"""Cameras around a person of dark, glossy cloth, exactly alike, and around a matt one, really apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.frames.effects import EXPOSURE_MATCHING
from posegaussian.stages.frames.stage import STAGE
from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.stages.imaging.exposure import Matching, match
from posegaussian.stages.simulator.subjects.capsule_person import render, ring
from posegaussian.stages.simulator.subjects.motion import pose
from posegaussian.stages.survey.algorithms.surface import surface_stops
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.spec import array_digest

SIZE, CAMERAS, APART = 360, 4, 15
LAMPS = ([1.0, 0.6, 0.8], [-0.3, 1.0, 0.5], [1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def filmed() -> tuple[Rig, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Four cameras 15 degrees apart; of each the light [h, w, 3], what is covered [h, w] 0..1 and the depth [h, w]."""
    rig, out = ring(360 // APART, SIZE, 0).subset(list(range(CAMERAS))), []
    for v in range(CAMERAS):
        color, mask, depth = render(pose("stand", 0.0), rig.intrinsics[v], rig.world_to_camera[v], (SIZE, SIZE), 2)
        out.append((to_linear(color.astype(np.float64)), mask / 255.0, depth))
    return rig, out


def highlights(rig: Rig, view: int, depth: np.ndarray, lamp: np.ndarray, sharp: float) -> np.ndarray:
    """[h, w] 0..1 Blinn's lobe of a lamp in direction [3]: where normals point halfway between lamp and camera."""
    u, v = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    at = (
        np.stack([u, v, np.ones_like(u)], axis=-1)
        @ np.linalg.inv(rig.intrinsics[view]).T
        * cv2.GaussianBlur(depth, (0, 0), 1.0)[..., None]
    )
    normal = np.cross(np.gradient(at, axis=1), np.gradient(at, axis=0))
    normal *= -np.sign((normal * at).sum(axis=-1, keepdims=True))
    half = rig.rotations[view] @ lamp - unit(at)
    return np.clip((unit(normal) * unit(half)).sum(axis=-1), 0, 1) ** sharp * (depth > 0)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


class Photographs:
    """`posegaussian.stages.contract.io.PictureReader` over one picture a view."""

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self._pictures = pictures

    def numbers(self, view: int) -> np.ndarray:
        return np.arange(1)

    def identity(self, view: int, number: int) -> str:
        return array_digest(self._pictures[view])

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        return (self._pictures[view] for _ in numbers)


def surveyed(rig: Rig, light: list[np.ndarray], stops: np.ndarray) -> np.ndarray:
    """[S, S, 64, 3] surface points of cameras with these exposures [S], and a sensor's noise."""
    rng = np.random.default_rng(0)
    pictures = [
        np.clip(np.rint(to_srgb(np.clip(a * 2**s, 0, 1)) + rng.normal(0, 1, a.shape)), 0, 255).astype(np.uint8)
        for a, s in zip(light, stops, strict=True)
    ]
    reader = Photographs(pictures)
    inputs = SimpleNamespace(
        rig=rig,
        source_rig=rig,
        views=Views(rig.names, tuple(range(CAMERAS)), ()),
        captured_to_calibrated=np.tile([1.0, 0, 0], (CAMERAS, 1)),
        source=lambda kind: reader,
        facts=Facts(),
    )
    return np.stack([surface_stops(inputs, v, np.arange(1)) for v in range(CAMERAS)])  # type: ignore[arg-type]


def proven(found: Matching | None) -> float:
    """Stops that are certain of any camera; 0 where nothing could be compared."""
    return 0.0 if found is None else float(found.proven.max())


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize(("albedo", "gloss", "sharp"), [(0.1, 0.1, 8.0), (0.2, 0.4, 12.0)])
def test_gloss_on_dark_cloth_proves_nothing_between_equal_cameras(
    filmed: tuple[Rig, list], albedo: float, gloss: float, sharp: float, lamp: list[float]
) -> None:
    rig, seen = filmed
    light = [
        albedo * a + (gloss * highlights(rig, v, depth, unit(np.array(lamp)), sharp) * cover)[..., None]
        for v, (a, cover, depth) in enumerate(seen)
    ]
    # Far below the 0.25 stops from which the effect is on.
    assert proven(match(surveyed(rig, light, np.zeros(CAMERAS)))) < 0.12


def test_half_a_stop_between_cameras_around_a_matt_person_is_found_and_undone(filmed: tuple[Rig, list]) -> None:
    rig, seen = filmed
    stops = np.array([0.0, 0.0, 0.5, 0.0])
    found = match(surveyed(rig, [light for light, _, _ in seen], stops))
    assert found is not None
    assert found.proven[2] > EXPOSURE_MATCHING.threshold
    np.testing.assert_allclose(np.log2(found.gains), -np.repeat(stops[:, None], 3, axis=1), atol=0.1)
    assert proven(match(surveyed(rig, [light for light, _, _ in seen], np.zeros(CAMERAS)))) < 0.05


def test_joints_can_neither_switch_it_on_nor_change_a_gain() -> None:
    """Nothing that is measured beside joints is read: folds, gloss and dark pixels differ where cameras are alike."""
    assert EXPOSURE_MATCHING.asks == ("survey/surface", "judge/shared_light", "judge/exposure")
    read = {
        r.array for r in STAGE.reads_for(STAGE.params(), frozenset({"exposure_matching", "joints2d", "several_frames"}))
    }
    assert {a for a in read if a.startswith("survey/")} == {"survey/surface", "survey/plate", "survey/spread"}
