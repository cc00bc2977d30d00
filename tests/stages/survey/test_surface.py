"""Two cameras before a painted wall: their gains come back from the points that both show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.imaging.color import to_srgb
from posegaussian.stages.imaging.exposure import FEWEST_POINTS, NONE, match
from posegaussian.stages.survey.algorithms.sample import look
from posegaussian.stages.survey.algorithms.surface import SurfaceLook
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, rig_of

SIZE, FOCAL = (240, 200), 260.0
STOPS = np.array([[0.0, 0.0, 0.0], [0.9, 0.6, 0.4], [-0.5, -0.3, -0.6]])


def wall() -> np.ndarray:
    """[h, w, 3] linear light of a wall 3 m wide, 100 px a metre: blots of a few centimetres on broad stripes, one in
    two of them darker."""
    noise = np.random.default_rng(5).random((300, 300, 3)).astype(np.float32)
    blots = 0.05 + 0.25 * cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.5), None, 0, 1, cv2.NORM_MINMAX)
    return np.where((np.arange(300) // 50 % 2 > 0)[:, None], blots, 0.35 * blots).astype(np.float32)


def photograph(rig: Rig, view: int, stops: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8 of the wall in the plane y = 0, its middle at the origin."""
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(rig.intrinsics[view]).T @ rig.rotations[view]
    centre = rig.centres[view]
    at = centre + rays * (-centre[1] / rays[..., 1])[..., None]
    light = cv2.remap(
        wall(),
        (at[..., 0] * 100 + 150 - 0.5).astype(np.float32),
        (at[..., 2] * 100 + 150 - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    return np.rint(to_srgb(np.clip(light * np.exp2(stops), 0, 1))).astype(np.uint8)


class Photographs:
    """`posegaussian.stages.contract.io.PictureReader` over one picture a view."""

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self._pictures = pictures

    def numbers(self, view: int) -> np.ndarray:
        return np.arange(3)

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        return (self._pictures[view] for _ in numbers)

    def identity(self, view: int, number: int) -> str:
        return f"photograph {view} {number}"


@pytest.fixture(scope="module")
def found() -> np.ndarray:
    """[S, S, 64, 3] of three cameras 12 degrees apart."""
    places = [3.0 * np.array([np.sin(a), -np.cos(a), 0.0]) for a in np.deg2rad([-12, 0, 12])]
    rig = rig_of([camera(p, np.zeros(3)) for p in places], SIZE, FOCAL)
    reader = Photographs([photograph(rig, v, STOPS[v]) for v in range(3)])
    inputs = SimpleNamespace(
        rig=rig,
        source_rig=rig,
        views=Views(("a", "b", "c"), (0, 1, 2), ()),
        captured_to_calibrated=np.tile([1.0, 0, 0], (3, 1)),
        source=lambda kind: reader,
    )
    looks = [SurfaceLook(inputs, v, np.arange(3)) for v in range(3)]  # type: ignore[arg-type]
    return np.stack([block.data for v, seen in enumerate(looks) for block in look(inputs, v, [seen])])  # type: ignore[arg-type]


def test_differences_of_pairs_are_those_of_the_gains(found: np.ndarray) -> None:
    for a, b in ((0, 1), (0, 2), (1, 2)):
        points = found[a, b][(found[a, b] < NONE).all(axis=1)]
        assert len(points) >= FEWEST_POINTS
        # Colours are averaged over some 10 px that differ between the views by what 12 degrees foreshorten:
        # a few per cent.
        np.testing.assert_allclose(np.median(points, axis=0), STOPS[a] - STOPS[b], atol=0.06)
        assert (found[b, a] == NONE).all(), "a pair is looked at once"


def test_gains_bring_all_cameras_to_the_middle_one(found: np.ndarray) -> None:
    matching = match(found)
    assert matching is not None
    np.testing.assert_allclose(np.log2(matching.gains), -STOPS, atol=0.08)
    assert matching.proven[0] < 0.06
    assert (matching.proven[1:] > 0.4).all()


def test_too_few_points_say_nothing(found: np.ndarray) -> None:
    few = np.full_like(found, NONE)
    few[..., : FEWEST_POINTS - 1, :] = 1.0
    assert match(few) is None
