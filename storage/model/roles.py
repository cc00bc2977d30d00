"""Which cameras are reconstructed from: named, by a protocol of the data set, or so many, evenly around the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from posegaussian.storage.model.cameras import Rig, must_be_cameras
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.splits import PROTOCOLS, split_named

EVENLY = r"uniform [1-9][0-9]{0,3}"
"""How a setting asks for that many cameras."""


class Roles(NamedTuple):
    """Names of cameras."""

    sources: tuple[str, ...]
    """To reconstruct from."""
    held_out: tuple[str, ...]
    """Only metrics may look at."""


def roles_in(
    capture: Capture, sources: Sequence[str] | str | None, held_out: Sequence[str] | None, sequence: str
) -> Roles:
    """The roles of a capture's cameras as `views.sources` and `views.held_out` ask for them.

    What is held out is what is set, else what the protocol says that the sources are named by, else what the capture
    says, but for those that are named as sources. Raises ConfigError for names that the capture does not have or that
    play both roles, and where no source is left.
    """
    names, named = capture.rig.names, [] if sources is None or isinstance(sources, str) else list(sources)
    apart = tuple(n for n in capture.held_out if n in names and n not in named)
    asked, key = sources, "sources"
    if isinstance(sources, str) and sources in PROTOCOLS:
        split = split_named(sources, capture.splits, "views.sources", sequence, capture.layout)
        asked = named = list(split.sources)
        apart, key = split.held_out, f"sources {sources}"
    apart = apart if held_out is None else tuple(held_out)
    for what, chosen in ((key, named), ("held_out", apart)):
        must_be_cameras(f"views.{what}", chosen, names, sequence)
    used = tuple(sources_of(asked, capture.rig, apart))
    if both := sorted({*used} & {*apart}):
        raise ConfigError(f"views: {', '.join(both)} cannot be a source and held out at once")
    if not used:
        raise ConfigError(f"views: no camera of sequence {sequence} is left as a source; shorten views.held_out")
    return Roles(used, apart)


def sources_of(asked: Sequence[str] | str | None, rig: Rig, held_out: Sequence[str]) -> list[str]:
    """Names of the sources: those asked for, so many as `uniform N` asks for, or all that are not held out.

    Raises ConfigError where `uniform N` asks for more than there are.
    """
    free = [n for n in rig.names if n not in held_out]
    if asked is None:
        return free
    if not isinstance(asked, str):
        return list(asked)
    count = int(asked.split()[1])
    if count > len(free):
        raise ConfigError(
            f"views.sources: {asked} asks for {count} cameras, and {len(free)} are not held out; ask for fewer"
        )
    return evenly(rig.subset([rig.names.index(n) for n in free]), count)


def evenly(rig: Rig, count: int) -> list[str]:
    """Names of `count` cameras evenly by angle around the point that all look at, in the rig's order.

    Around a ring they stand 360/count degrees apart, the first where all others fit best; on an arc, from end to end.
    Of cameras above each other those nearest to the middle height go first.
    """
    away = _directions(rig)
    normal = np.linalg.svd(away - away.mean(axis=0))[2][2] if len(away) > 2 else _across(away)
    x = _unit(away[0] - (away[0] @ normal) * normal)
    y = np.cross(normal, x)
    angles = np.degrees(np.arctan2(away @ y, away @ x)) % 360
    height = float(np.median(away @ normal))
    around = np.sort(angles)
    gaps = np.diff([*around, around[0] + 360])
    if gaps.max() > 360 / count:  # an arc: it begins behind its largest gap
        begin = around[(int(gaps.argmax()) + 1) % len(around)]
        candidates = [begin + np.linspace(0, 360 - gaps.max(), count)]
    else:
        candidates = [a + np.arange(count) * 360 / count for a in angles]
    best: tuple[float, list[int]] | None = None
    for wanted in candidates:
        found = _nearest(wanted, angles, away @ normal - height)
        if best is None or found[0] < best[0] - 1e-9:
            best = found
    assert best is not None
    return [rig.names[i] for i in sorted(best[1])]


def _nearest(wanted: np.ndarray, angles: np.ndarray, heights: np.ndarray) -> tuple[float, list[int]]:
    """(sum of squared differences, a camera each) of angles wanted, each camera once."""
    apart = np.radians((angles[None] - wanted[:, None] + 180) % 360 - 180)
    cost = apart**2 + heights[None] ** 2
    taken: list[int] = []
    total = 0.0
    for row in cost:
        row = row.copy()
        row[taken] = np.inf
        taken.append(int(row.argmin()))
        total += float(row.min())
    return total, taken


def _directions(rig: Rig) -> np.ndarray:
    """[V, 3] unit vectors from the point nearest to all optical axes to the cameras."""
    axes, centres = np.asarray(rig.rotations)[:, 2], np.asarray(rig.centres)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    point = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, centres), rcond=1e-9)[0]
    away = centres - point
    length = np.linalg.norm(away, axis=1, keepdims=True)
    return np.where(length > 1e-12, away / np.maximum(length, 1e-12), -axes)


def _across(away: np.ndarray) -> np.ndarray:
    """[3] a unit vector across one or two directions."""
    other = away[-1] if len(away) > 1 and np.linalg.norm(np.cross(away[0], away[-1])) > 1e-6 else np.eye(3)[0]
    across = np.cross(away[0], other)
    return _unit(across) if np.linalg.norm(across) > 1e-6 else _unit(np.cross(away[0], np.eye(3)[1]))


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / max(1e-12, float(np.linalg.norm(vector))))
