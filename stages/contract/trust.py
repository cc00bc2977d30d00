"""Which cameras are believed: declared by the stage that measures how well they agree; the setting and what was
measured become one verdict a camera, with its reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

TrustSetting = Literal["auto", "all"] | list[str]
KINDS = ("features", "outlines", "joints", "carving")
"""What two cameras are compared by, in the order in which it is noted."""


@dataclass(frozen=True)
class Belief:
    """What the others say of one camera."""

    believed: bool
    """Whether it may be a source."""
    measured: float | None
    """By how much what it shows misses what the believed cameras show, in the unit of the bound; None where nothing can
    be compared."""
    reason: str
    """One sentence for the plan."""


@dataclass(frozen=True)
class Trust:
    """How cameras are found that contradict the others."""

    asks: tuple[str, ...]
    """Noted outputs of the stage that declares it; that stage alone works on all cameras that may be sources."""
    bound: float
    """Above it two cameras contradict each other."""
    unit: str
    """Of measure and bound."""
    fewest: int
    """Cameras below which nobody can tell who is wrong: all are believed."""
    decide: Callable[[tuple[str, ...], Mapping[str, np.ndarray]], tuple[Belief, ...]]
    """(names of S cameras, notes [S, S, ...] of their pairs by array) -> what is said of each."""


@dataclass(frozen=True)
class CameraVerdict:
    """What is known of one camera that may be a source."""

    camera: str
    """Its name."""
    forced: bool
    """Whether the configuration says that it is believed."""
    belief: Belief | None
    """None: the survey must run first."""

    @property
    def state(self) -> Literal["believed", "left out", "undecided"]:
        """Whether pictures are reconstructed from it, or undecided until the survey ran."""
        return "undecided" if self.belief is None else "believed" if self.belief.believed else "left out"

    @property
    def sentence(self) -> str:
        """`camera p098 left out (auto): ...`."""
        assert self.belief is not None, f"camera {self.camera} is not decided"
        return f"camera {self.camera} {self.state} ({'forced' if self.forced else 'auto'}): {self.belief.reason}"


def asks(trust: Trust, cameras: Sequence[str], setting: TrustSetting) -> bool:
    """Whether the survey has a say: of enough cameras, one of which is not believed whatever it finds."""
    return len(cameras) >= trust.fewest and setting != "all" and not set(cameras) <= set(setting)


def judged_cameras(
    trust: Trust, cameras: tuple[str, ...], setting: TrustSetting, noted: Mapping[str, np.ndarray]
) -> dict[str, CameraVerdict]:
    """The verdict on every camera that may be a source, by name.

    `noted`: [S, S, ...] of these cameras, by array; empty before the survey ran.
    """
    measured: tuple[Belief | None, ...] = (None,) * len(cameras)
    if len(cameras) < trust.fewest:
        few = f"nobody can tell which is wrong of fewer than {trust.fewest} cameras"
        measured = (Belief(True, None, few),) * len(cameras)
    elif set(trust.asks) <= noted.keys():
        measured = trust.decide(cameras, noted)
    found = {}
    for camera, belief in zip(cameras, measured, strict=True):
        forced = setting == "all" or camera in setting
        if forced:
            said = f"; {belief.reason}" if belief is not None else ""
            belief = Belief(True, belief.measured if belief else None, f"views.trust says so{said}")
        found[camera] = CameraVerdict(camera, forced, belief)
    return found
