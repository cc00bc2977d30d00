"""Which cameras are believed: declared by the stage that measures how well they agree; the setting and what was
measured become one verdict a camera, with its reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import numpy as np

from posegaussian.storage.model.cameras import Rig

TrustSetting = Literal["auto", "all"] | list[str]
KINDS = ("features", "outlines", "joints")
"""What two cameras are compared by, in the order in which it is noted."""
JOINTS_AGREE = 0.006
"""Share of the longer side of the picture up to which joints of two cameras agree."""


class Told(IntEnum):
    """What is noted last of how a camera stands."""

    NOTHING = 0
    WRONG = 1
    """However it is turned."""
    EXCHANGED = 2
    """The same; in the place of another wrong one it would stand right."""
    BY_JOINTS = 3
    """It is turned by what joints say, in place of silhouettes."""
    MOVED = 4
    """In mid-take; what is noted of its turn is by how much."""
    MIRRORED = 5
    """It is wrong; were its pictures mirrored left-right, it would stand right."""
    LACKING = 6
    """Right; its masks lack something that those of the others have."""
    LATE = 7
    """It shows another moment; by how many frames it is late is noted next."""
    UPSIDE_DOWN = 8
    """It is wrong by joints; were its pictures turned by 180 degrees, it would stand right."""


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
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rad about its own axes by which it stands turned against what is written down."""
    moved: bool = False
    """Whether it was moved in mid-take."""
    late: float = 0.0
    """Frames by which what it shows tells that it is late."""
    in_place: bool = False
    """Whether its features lie where they should though it contradicts the others, so that its masks or its moment may
    be what is wrong; of one that is believed, its masks are."""


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
    """(names of S cameras, notes [S, ...] of them and [S, S, ...] of their pairs by array) -> what is said of each."""
    stand: Callable[[Rig, np.ndarray], Rig]
    """(cameras as they are written down, [V, 3] rad by which they are believed to be turned) -> as they stand."""


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
    def turn(self) -> np.ndarray:
        """[3] rad about its own axes by which it stands turned, 0 of a camera that is left out or undecided."""
        return np.array(self.belief.turn if self.belief is not None and self.belief.believed else (0.0, 0.0, 0.0))

    @property
    def overruled(self) -> bool:
        """Whether it is left out, or turned: something else is done than is written down."""
        return self.state == "left out" or bool(self.turn.any())

    @property
    def sentence(self) -> str:
        """`camera p098 left out (auto): ...`."""
        assert self.belief is not None, f"camera {self.camera} is not decided"
        turned = f" turned by {np.degrees(np.linalg.norm(self.turn)):.2f} degrees" if self.turn.any() else ""
        how = "forced" if self.forced else "auto"
        return f"camera {self.camera} {self.state}{turned} ({how}): {self.belief.reason}"


def asks(trust: Trust, cameras: Sequence[str], setting: TrustSetting) -> bool:
    """Whether the survey has a say: of enough cameras, one of which is not believed whatever it finds."""
    return len(cameras) >= trust.fewest and setting != "all" and not set(cameras) <= set(setting)


def judged_cameras(
    trust: Trust, cameras: tuple[str, ...], setting: TrustSetting, noted: Mapping[str, np.ndarray]
) -> dict[str, CameraVerdict]:
    """The verdict on every camera that may be a source, by name.

    `noted`: [S, ...] of these cameras and [S, S, ...] of their pairs, by array; empty before the survey ran.
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
            belief = replace(belief or Belief(True, None, ""), believed=True, reason=f"views.trust says so{said}")
        found[camera] = CameraVerdict(camera, forced, belief)
    return found
