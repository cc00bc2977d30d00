"""Cameras that are written down turned by a little are turned back by what pairs of them share, and no others."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.judged import CALIBRATION, TURNS
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.imaging.calibration import ALONE_GAIN, CALIBRATION_CORRECTION, NEAR
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.small_turns import LINKS, MOST, POINTS, Links, fitted_turns, turned
from posegaussian.stages.judge.turning import near
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.model.cameras import Rig

SIZE = 512


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Eight cameras on a ring about a person, in pictures of 512 px."""
    return capture_person(views=8, size=SIZE, frames=1, held_out=0).rig


def points_about(rig: Rig, seed: int = 0) -> np.ndarray:
    """[24, 3] m in a person's place."""
    random = np.random.default_rng(seed)
    middle = np.linalg.lstsq(*_rays(rig), rcond=None)[0]
    return middle + random.uniform(-0.4, 0.4, (POINTS, 3))


def _rays(rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Planes through each camera's axis, which meet where all look."""
    across = [np.eye(3) - np.outer(a, a) for a in rig.rotations[:, 2]]
    return np.concatenate(across), np.concatenate([p @ c for p, c in zip(across, rig.centres, strict=True)])


def noted(rig: Rig, points: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """`survey/links` of points that all cameras of a rig see, in directions of its axes."""
    random, count = np.random.default_rng(1), len(rig)
    out = np.zeros((count, count, POINTS, 4))
    for a in range(count):
        for b in range(a + 1, count):
            for v, at in ((a, slice(0, 2)), (b, slice(2, 4))):
                pixels = project(points, rig.intrinsics[v], rig.world_to_camera[v])[0]
                pixels = pixels + random.normal(size=pixels.shape) * noise
                seen = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(rig.intrinsics[v]).T
                out[a, b, :, at] = seen[:, :2]
    return out


def error(true: Rig, rig: Rig) -> float:
    """Px by which pairs of a rig miss points that the true cameras see, root mean square."""
    points, off = points_about(true, 5), []
    for a in range(len(rig)):
        for b in range(a + 1, len(rig)):
            x, y = (project(points, true.intrinsics[v], true.world_to_camera[v])[0] for v in (a, b))
            off.append(signed_epipolar_distance(fundamental(rig, a, b), x, y))
    return float(np.sqrt(np.mean(np.square(off))))


def small(rig: Rig, pixels: float, seed: int) -> np.ndarray:
    """[V, 3] rad of random turns that move pictures by so many px, one standard deviation an axis."""
    return np.random.default_rng(seed).normal(size=(len(rig), 3)) * pixels / rig.intrinsics[:, :1, 0]


def test_the_distances_are_those_of_the_fundamental_matrix(rig: Rig) -> None:
    written = turned(rig, small(rig, 2.0, 0))
    links = Links.of(noted(rig, points_about(rig)))
    for n in range(0, len(links.views), 7):
        a, b = links.views[n]
        x, y = (d @ written.intrinsics[v].T for v, d in ((a, links.first[n]), (b, links.second[n])))
        expected = signed_epipolar_distance(fundamental(written, a, b), x[:2], y[:2])
        assert abs(links.missed(written)[n]) == pytest.approx(abs(expected), abs=1e-9)


def test_slopes_are_finite_differences(rig: Rig) -> None:
    """But for what the length of a line changes with a turn, a hundredth, unless cameras look at each other."""
    given = noted(turned(rig, small(rig, 1.0, 3)), points_about(rig))
    for v in range(4):
        given[v, v + 4] = 0.0
    links = Links.of(given)
    off, *by_turn = links._missed(rig)
    step = 1e-6
    for v in (0, 3):
        for axis in range(3):
            by = np.zeros((len(rig), 3))
            by[v, axis] = step
            numeric = (links.missed(turned(rig, by)) - off) / step
            slopes = sum(np.where(links.views[:, i] == v, by_turn[i][:, axis], 0.0) for i in range(2))
            assert np.abs(numeric - slopes).max() < 1e-2 * np.abs(by_turn).max()


@pytest.mark.parametrize("pixels", [0.3, 1.0, 3.0])
def test_turns_are_found_without_noise(rig: Rig, pixels: float) -> None:
    """Down to what is held of the calibration: where the subject lies is not told, which leaves an eighth and less."""
    written = turned(rig, small(rig, pixels, 2))
    links = Links.of(noted(rig, points_about(rig)))
    found = turned(written, fitted_turns(written, links))
    assert error(rig, found) < error(rig, written) / 6
    assert np.allclose(found.centres, rig.centres), "cameras are turned in their places"


def test_exact_cameras_stay(rig: Rig) -> None:
    turns = fitted_turns(rig, Links.of(noted(rig, points_about(rig))))
    assert np.abs(turns).max() * rig.intrinsics[0, 0, 0] < 1e-6


def test_noise_of_the_links_is_averaged(rig: Rig) -> None:
    """0.3 px a coordinate, 24 links a pair: cameras end within a third of it, from a pixel."""
    written = turned(rig, small(rig, 1.0, 4))
    links = Links.of(noted(rig, points_about(rig), noise=0.3))
    assert error(rig, turned(written, fitted_turns(written, links))) < 0.1


def test_some_wrong_links_turn_nobody(rig: Rig) -> None:
    """A tenth of the links lies 20 px off; by least squares alone that would turn cameras by more than a pixel."""
    given = noted(rig, points_about(rig))
    random = np.random.default_rng(0)
    wrong = (random.random(given.shape[:3]) < 0.1)[..., None] & given.any(axis=-1, keepdims=True)
    given = np.where(wrong, given + 20 / rig.intrinsics[0, 0, 0], given)
    assert error(rig, turned(rig, fitted_turns(rig, Links.of(given)))) < 0.2


def test_what_links_do_not_tell_stays(rig: Rig) -> None:
    """A camera without links stays as it is written down, and so do two that are turned alike about their baseline."""
    given = noted(rig, points_about(rig))
    given[0], given[:, 0] = 0.0, 0.0
    assert np.abs(fitted_turns(turned(rig, small(rig, 1.0, 6)), Links.of(given))[0]).max() < 1e-15
    pair = rig.subset([0, 1])
    baseline = np.diff(pair.centres, axis=0)[0]
    together = pair.rotations @ (baseline / np.linalg.norm(baseline)) / pair.intrinsics[0, 0, 0]
    links = Links.of(noted(pair, points_about(rig)))
    assert np.abs(fitted_turns(turned(pair, together), links)).max() < 1e-3 * np.abs(together).max()


def test_the_size_of_pictures_changes_nothing(rig: Rig) -> None:
    """Turns are the same from pictures of half the size: scatter and what is held of the calibration follow it."""
    scale = np.diag([0.5, 0.5, 1.0])
    half = replace(rig, intrinsics=scale @ rig.intrinsics, size=rig.size // 2)
    by = small(rig, 1.0, 8)
    links = Links.of(noted(rig, points_about(rig), noise=0.2))
    found = [fitted_turns(turned(r, by), links) for r in (rig, half)]
    assert np.allclose(*found, atol=1e-9)


def test_the_bound_is_the_same_at_every_size_of_frames_and_of_the_judge_s_pictures(rig: Rig) -> None:
    """Links of exact cameras that scatter as those of masks do lie within it; what they miss by is told in px of the
    pictures that they were found in."""
    scale = np.diag([4.0, 4.0, 1.0])
    source = replace(rig, intrinsics=scale @ rig.intrinsics, size=4 * rig.size)
    links = noted(rig, points_about(rig), noise=0.14)
    px = [Links.of(links).medians(rig)["outlines"]]
    assert 0.5 * NEAR < px[0] < NEAR
    for size in (384, 512, 2048):
        frames = frames_rig(source, size)
        for scores in ((20.0, 20.0 + 0.9 * ALONE_GAIN), (20.0, 20.0 + 1.1 * ALONE_GAIN)):
            drawn = np.array([[[psnr, 0.9, 1.0] for psnr in scores]])
            evidence: Any = SimpleNamespace(
                rig=frames,
                source_rig=source,
                sources=range(len(rig)),
                noted={LINKS: links, TURNS: np.zeros((len(rig), 3)), CALIBRATION: drawn},
            )
            decision = CALIBRATION_CORRECTION.decide(evidence, NEAR)
            assert decision is not None
            assert decision.on == (scores[1] > 20.0 + ALONE_GAIN)
            px.append(decision.measured)
        inputs: Any = SimpleNamespace(
            rig=frames,
            source_rig=source,
            views=Views(rig.names, tuple(range(len(rig))), ()),
            read=lambda _, v: links[v],
        )
        assert near(inputs)
    np.testing.assert_allclose(px, px[0], rtol=1e-9)


def test_medians_are_told_by_kind(rig: Rig) -> None:
    given = noted(rig, points_about(rig))
    given[:, :, MOST:] = 0.0
    assert Links.of(given).medians(rig).keys() == {"outlines"}
    assert Links.of(np.zeros_like(given)).medians(rig) == {}
