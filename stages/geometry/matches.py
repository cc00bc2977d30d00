"""Do features that two pictures share lie on each other's epipolar lines?

Features are matched by `posegaussian.stages.geometry.features`. Wrong matches lie
anywhere, right ones beside the epipolar line as far as the calibration is off. Two answers are compared: what the
calibration says, and what the matches say among themselves, by a robust fundamental matrix that knows no calibration.
Matches that fit each other and not the calibration accuse the calibration; matches that fit neither say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.geometry.epipolar import signed_epipolar_distance

NEAR = 0.02
"""Share of the picture's longer side within which a match may be a right one:
calibrations that are worse accuse themselves otherwise."""
FREE = 2.0
"""Px within which matches fit the free fundamental matrix."""
FEWEST_FREE, SHARE_FREE = 20, 0.3
"""Matches, and share of all, that must fit a free fundamental matrix: of wrong matches alone it fits its own 7 and a
few more, up to 13 of 35 and 22 of 205 seen."""
PROOF = 10.0
"""Log likelihood by which `near the lines` must beat `anywhere`: one in 20 000."""


@dataclass(frozen=True, eq=False)
class EpipolarFit:
    """What the matches of one pair say about its calibration."""

    distances: np.ndarray
    """[n] px of every match from the calibration's lines."""
    agree: np.ndarray
    """[n] bool: matches that are held for right ones."""
    error: float | None
    """Px, median distance of the right ones; None where the matches tell nothing."""
    proof: float
    """Log likelihood of matches near the calibration's lines over matches anywhere."""
    free: np.ndarray
    """[n] bool: matches that fit the free fundamental matrix; none where that is chance."""
    free_error: float | None
    """Px, their median distance from its lines."""

    @property
    def share(self) -> float:
        """Share of the matches that are held for right ones."""
        return float(self.agree.mean()) if len(self.agree) else 0.0


def epipolar_fit(matrix: np.ndarray, first: np.ndarray, second: np.ndarray, longest: float) -> EpipolarFit:
    """Judge matched points [n, 2] of two cameras by the calibration's fundamental matrix; `longest`: px of the longer
    side.

    Where enough matches fit a free fundamental matrix, those are the right ones and the error is theirs. Else the right
    ones are those near the calibration's lines, by a half-normal over a uniform distribution within `NEAR`, if that is
    proven.
    """
    distances = np.abs(signed_epipolar_distance(matrix, first, second))
    free, free_error = _free_fit(first, second)
    near = distances <= NEAR * longest
    spread, proof, weight = _mixture(distances[near], NEAR * longest)
    if free.any():
        return EpipolarFit(distances, free, float(np.median(distances[free])), proof, free, free_error)
    agree = np.zeros(len(distances), bool)
    if proof >= PROOF:
        agree[np.flatnonzero(near)[weight > 0.5]] = True
    if not agree.any():
        return EpipolarFit(distances, agree, None, proof, free, free_error)
    return EpipolarFit(distances, agree, 0.6745 * spread, proof, free, free_error)


def _free_fit(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, float | None]:
    """Matches [n] that fit one fundamental matrix, and their median distance, px; none where that may be chance."""
    nobody = np.zeros(len(first), bool)
    if len(first) < FEWEST_FREE:
        return nobody, None
    cv2.setRNGSeed(0)
    try:
        matrix, _ = cv2.findFundamentalMat(
            first.astype(np.float32), second.astype(np.float32), cv2.USAC_MAGSAC, FREE, 0.999, 20000
        )
    except cv2.error:  # of points so alike that no sample of them gives a matrix it fails instead of saying so
        return nobody, None
    if matrix is None or matrix.shape != (3, 3):
        return nobody, None
    off = np.abs(signed_epipolar_distance(matrix, first, second))
    fits = off <= FREE
    if fits.sum() < max(FEWEST_FREE, SHARE_FREE * len(fits)):
        return nobody, None
    return fits, float(np.median(off[fits]))


def _mixture(distances: np.ndarray, reach: float) -> tuple[float, float, np.ndarray]:
    """Of distances within `reach`: spread of the right ones, log likelihood over a uniform distribution, probability
    [n] to be right.

    Expectation maximisation from several spreads, the likeliest counts.
    """
    best = (reach, 0.0, np.zeros(len(distances)))
    for start in (0.01, 0.03, 0.1, 0.3) if len(distances) else ():
        spread, share, weight = start * reach, 0.5, np.zeros(len(distances))
        for _ in range(60):
            right = share * np.sqrt(2 / np.pi) / spread * np.exp(-0.5 * (distances / spread) ** 2)
            wrong = (1 - share) / reach
            weight = right / (right + wrong)
            spread = float(np.clip(np.sqrt((weight * distances**2).sum() / max(weight.sum(), 1e-12)), 0.1, reach / 3))
            share = float(np.clip(weight.mean(), 1e-3, 1 - 1e-3))
        likelihood = float(np.log((right + wrong) * reach).sum())
        if likelihood > best[1]:
            best = (spread, likelihood, weight)
    return best
