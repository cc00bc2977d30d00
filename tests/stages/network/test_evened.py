"""Noise of learned depth is averaged away where the network is believed, and nothing else."""

import numpy as np

from posegaussian.stages.network.run import evened

SENSITIVITY = 600.0
"""Px of disparity for 1/metre: a step of inverse depth of 1/600 is a px."""


def slope(side: int = 24) -> np.ndarray:
    """[h, w] float32 depth of a plane that leans by half a px a column."""
    return np.tile(1 / (0.4 + np.arange(side) * 0.5 / SENSITIVITY), (side, 1)).astype(np.float32)


def noisy(px: float, seed: int = 1) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, px, slope().shape) / SENSITIVITY
    return (1 / (1 / slope() + noise)).astype(np.float32)


def off(depth: np.ndarray) -> float:
    """Px of disparity from the plane, root mean square beside the margin."""
    return float(np.sqrt(np.mean(((1 / depth - 1 / slope())[4:-4, 4:-4] * SENSITIVITY) ** 2)))


def test_a_plane_stays_and_its_noise_falls_as_far_as_the_network_is_believed() -> None:
    start, sure = np.full_like(slope(), 3.0), np.ones_like(slope())
    # float32 has 24 bits: of 1/depth 0.5, times 600, half of 1e-4 px
    assert off(evened(start, slope(), sure, SENSITIVITY)) < 1e-3
    found = [off(evened(start, noisy(0.2), sure * c, SENSITIVITY)) for c in (0, 0.25, 0.5, 1)]
    # twice 24 neighbours of a spread of 1.3 px leave about a fifth
    np.testing.assert_allclose(found[0], off(noisy(0.2)), rtol=1e-5)
    assert found[0] > 1.2 * found[1] > 1.2 * 1.2 * found[2]
    assert found[2] < 0.06
    assert found[2] == found[3], "a confidence of a half is that of a match: all of it is evened"


def test_what_the_network_left_and_what_has_no_depth_stays_bit_by_bit() -> None:
    start, refined = noisy(0.2, 2), noisy(0.2)
    refined[:12], refined[:, :3] = start[:12], 0
    out = evened(start, refined, np.ones_like(start), SENSITIVITY)
    assert out[:12].tobytes() == refined[:12].tobytes()
    assert not out[:, :3].any()
    assert (out[12:, 3:] != refined[12:, 3:]).mean() > 0.9
    for confidence, sensitivity in ((np.ones_like(start), 0.0), (np.full_like(start, np.nan), SENSITIVITY)):
        np.testing.assert_allclose(evened(start, refined, confidence, sensitivity), refined, rtol=2e-7)


def test_an_edge_between_two_surfaces_is_not_bridged() -> None:
    start, refined = np.full((24, 24), 5.0, np.float32), np.full((24, 24), 2.0, np.float32)
    refined[:, 12:] = 1 / (1 / 2.0 - 20 / SENSITIVITY)
    found = evened(start, refined, np.ones_like(start), SENSITIVITY)
    np.testing.assert_allclose(found, refined, rtol=1e-6)
