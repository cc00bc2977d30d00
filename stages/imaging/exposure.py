"""How bright cameras see the same surface points: their exposures' disagreement, and the gains that even them out.

What is brighter in one camera at every tone, in all pairs alike, is the camera's exposure. Gloss, folds and dark pixels
make some points brighter and others not, and differ from tone to tone and from pair to pair: that is the error of the
measure, however many points share it. A difference is certain as far as it exceeds two standard errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

NONE = 99.0
"""Stops where two cameras share no surface point."""
FEWEST_POINTS = 16
"""Surface points that two cameras must share before they are compared."""
TONES = 3
"""Parts, dark, middle and bright, in which a pair's points are looked at by themselves."""
FLOOR = 0.06
"""Stops by which any pair's difference may be wrong however well its points agree: equal cameras of simulated and
real scenes differ by that."""
ERRORS = 2.0
"""Standard errors by which a difference is lessened before it is compared with a bound."""


class Matching(NamedTuple):
    """What brings S cameras to the same exposure and white balance."""

    gains: np.ndarray
    """[S, 3] factors on linear light; 1 for a camera that differs by no more than one standard error."""
    stops: np.ndarray
    """[S] largest correction of a channel."""
    proven: np.ndarray
    """[S] largest difference of a channel from the middle camera less two standard errors, at least 0, in stops."""
    apart: np.ndarray
    """[S, S] largest difference of a channel between two cameras of one group, in stops; 0 between groups."""
    certain: np.ndarray
    """[S, S] the same less two standard errors, at least 0."""


def match(surface: np.ndarray) -> Matching | None:
    """Compare S cameras by surface points [S, S, 64, 3], stops in the order of tone (`surface.surface_stops`).

    Two cameras that share at least `FEWEST_POINTS` of them differ by their median. Least squares over all such pairs
    gives each camera's offset. A pair's error is how its dark, middle and bright points differ, its own or that of all
    pairs, whichever is more, and at least how far pairs contradict each other. Cameras that pairs link are a group and
    are brought to its median camera, so that one odd camera follows the others; nothing is known between groups, or of
    a camera without a pair. None without any pair.
    """
    count = len(surface)
    pairs = {
        (a, b): d
        for a in range(count)
        for b in range(a + 1, count)
        if len(d := _points(surface[a, b])) >= FEWEST_POINTS
    }
    if not pairs:
        return None
    first, second = np.array(list(pairs)).T
    sides = np.eye(count)[first] - np.eye(count)[second]  # [P, S]
    weight = np.array([float(len(d)) for d in pairs.values()])
    inverse = np.linalg.pinv(sides.T @ (weight[:, None] * sides)) @ (sides.T * weight)  # [S, P]
    apart = np.array([np.median(d, axis=0) for d in pairs.values()])
    off = inverse @ apart
    linked = np.linalg.matrix_power((sides.T @ sides != 0) | np.eye(count, dtype=bool), count)
    wanted = np.stack([_middle(off[group]) @ inverse[group] for group in linked]) - inverse[:, None]  # [S, 3, P]
    stops = np.einsum("scp,pc->sc", wanted, apart)
    variance = _variance(list(pairs.values()), apart - sides @ off, np.linalg.matrix_rank(sides))
    error = np.sqrt(np.einsum("scp,pc->sc", np.square(wanted), variance))
    proven = np.maximum(np.abs(stops) - ERRORS * error, 0.0).max(axis=1)
    # It takes two errors to switch matching on; once it is on, whatever exceeds one is better corrected than left.
    stops = np.where((np.abs(stops) > error).any(axis=1, keepdims=True), stops, 0.0)
    between, certain = _between(inverse, apart, variance, linked)
    return Matching(np.exp2(stops), np.abs(stops).max(axis=1), proven, between, certain)


def _between(
    inverse: np.ndarray, apart: np.ndarray, variance: np.ndarray, linked: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """`Matching.apart` and `Matching.certain` from what the P pairs [P, 3] say, each with its variance [P, 3];
    `inverse` [S, P] makes cameras' offsets of them, `linked` [S, S] says which cameras are of one group."""
    sides = inverse[:, None] - inverse[None]
    stops = np.abs(np.einsum("stp,pc->stc", sides, apart))
    error = np.sqrt(np.einsum("stp,pc->stc", np.square(sides), variance))
    known = linked.astype(bool)[..., None]
    return tuple(np.where(known, a, 0.0).max(axis=-1) for a in (stops, np.maximum(stops - ERRORS * error, 0.0)))


def _middle(off: np.ndarray) -> np.ndarray:
    """[3, S] weights of the cameras that are the median of offsets [S, 3], channel by channel: one, or two halves."""
    order, count = np.argsort(off, axis=0, kind="stable"), len(off)
    out = np.zeros((3, count))
    for rank in ((count - 1) // 2, count // 2):
        out[np.arange(3), order[rank]] += 0.5
    return out


def _variance(pairs: list[np.ndarray], residual: np.ndarray, rank: int) -> np.ndarray:
    """[P, 3] stops²: variance of each pair's difference, from its points [n, 3] in the order of tone and from what the
    fit leaves of it [P, 3].

    Of tones that differ any one may be right, so their mean is no surer than they are.
    """
    tones = np.array([[np.median(part, axis=0) for part in np.array_split(d, TONES)] for d in pairs])  # [P, TONES, 3]
    within = tones.var(axis=1, ddof=1)
    between = np.square(residual).sum(axis=0) / max(1, len(pairs) - rank)
    return np.maximum(np.maximum(within, within.mean(axis=0)), between) + FLOOR**2


def _points(stops: np.ndarray) -> np.ndarray:
    """[n, 3] of the surface points [64, 3] those that there are."""
    return stops[(stops < NONE).all(axis=-1)].astype(np.float64)
