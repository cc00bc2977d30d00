"""The shapes of network that are trained and shipped, as plain data: nothing here imports torch."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Literal, get_args

from posegaussian.storage.model.documents import parse_json

FusionKind = Literal["concatenation", "attention", "gated", "addition", "multiplication", "weighted", "outer"]
"""How image and pose features become one; `stages/network/model/fusion.py` has the equations."""
Normalisation = Literal["group", "batch"]
Downsampling = Literal["stride", "pool"]
PosePlace = Literal["depth", "decoder"]
"""Where pose enters: fused into the features that are correlated, or through the joint skips of the decoder."""
ScaleHead = Literal["footprint"]
RotationHead = Literal["normal", "quaternion"]
OpacityHead = Literal["facing", "single"]
WIDEST = 1024
"""Channels of a level, or cells of a look-up, at most: a file may ask for more than any memory holds."""
TRAINED_ANGLE = 62.0
"""Degrees: the widest pairs of rings of six cameras stand 60 apart."""
LONELY_ANGLE = 70.0
"""Degrees up to which a view that has no pair otherwise is shown with its nearest: so wide a pair says less than those
of the training, and more than none (docs/measurements/network.md)."""
TRAINED_SIDE = 640
"""Larger pictures are looked at as if their longer side had this many px: the networks know people of this size."""
GROUP = 8
"""Channels of one group of a group normalisation."""


@dataclass(frozen=True)
class Preset:
    """Widths, resolutions and variants of one network. Raises ValueError for what no network can be built from."""

    name: str
    """`paper`, `base`, `fast`, or that of a variant."""
    stem_stride: int = 2
    """Pixels a cell of the finest features: 1 as in the paper, or 2 with heads that shuffle pixels."""
    widths: tuple[int, int, int, int] = (32, 64, 96, 128)
    """Channels of the encoders' levels, finest first; multiples of 8."""
    stages: int = 3
    """k: the features that are correlated have one cell per 2**k pixels; 3 or 4."""
    hidden: int = 96
    """Channels of the recurrent state."""
    correlation_levels: int = 4
    """Levels of the correlation pyramid."""
    correlation_radius: int = 4
    """Cells looked up to either side of the current match, on every level."""
    fusion: FusionKind = "concatenation"
    """How image and pose features become one."""
    pose_in: frozenset[PosePlace] = field(default=frozenset({"depth", "decoder"}))
    """Where pose enters; empty: nowhere."""
    normalisation: Normalisation = "group"
    """`group` treats each picture by itself; `batch` is the paper's variant."""
    residual: bool = True
    """Whether units add their input."""
    downsampling: Downsampling = "stride"
    """By strided convolutions or by averaging 2 x 2 cells."""
    scale_head: ScaleHead = "footprint"
    """Metres as the pixel's footprint times softplus(x) / softplus(0)."""
    rotation_head: RotationHead = "normal"
    """3 channels, the unit normal, or 4, a quaternion."""
    opacity_head: OpacityHead = "facing"
    """2 channels, seen face-on and at grazing angle, or 1."""
    pose_cell: int = 4
    """Pixels a cell of the heatmaps that the pose encoder sees: 4 as they are stored, or 1 as in the paper; levels
    finer than that have no pose."""
    further_views: bool = False
    """Whether a third view is looked up by warping, beside the rows of the pair."""
    alone: bool = False
    """Whether a view without a partner can be refined: what stands in for the correlation is learnt."""
    widest: float = TRAINED_ANGLE
    """Degrees between the views of the widest pairs it was trained on, and a little more: wider ones are not shown to
    it."""

    def __post_init__(self) -> None:
        if self.stem_stride not in (1, 2):
            raise ValueError(f"preset {self.name}: stem_stride is {self.stem_stride}; 1 or 2")
        if self.stages not in (3, 4):
            raise ValueError(f"preset {self.name}: stages is {self.stages}; 3 or 4")
        if self.pose_cell not in (1, 4):
            raise ValueError(f"preset {self.name}: pose_cell is {self.pose_cell}; 1 or 4")
        if len(self.widths) != 4 or any(w < GROUP or w % GROUP for w in self.widths):
            raise ValueError(f"preset {self.name}: widths are {self.widths}; four positive multiples of {GROUP}")
        if max(*self.widths, self.hidden, self.correlation_levels, self.correlation_radius) > WIDEST:
            raise ValueError(f"preset {self.name}: a width, level or radius is beyond {WIDEST}")
        if self.hidden < 1 or self.correlation_levels < 1 or self.correlation_radius < 0:
            raise ValueError(
                f"preset {self.name}: hidden {self.hidden}, correlation_levels {self.correlation_levels},"
                f" correlation_radius {self.correlation_radius}; at least 1, 1 and 0"
            )
        kinds: tuple[tuple[str, object], ...] = (
            ("fusion", FusionKind),
            ("normalisation", Normalisation),
            ("downsampling", Downsampling),
            ("scale_head", ScaleHead),
            ("rotation_head", RotationHead),
            ("opacity_head", OpacityHead),
        )
        for name, kind in kinds:
            if getattr(self, name) not in get_args(kind):
                raise ValueError(
                    f"preset {self.name}: {name} is {getattr(self, name)!r}; one of {', '.join(get_args(kind))}"
                )
        if not 0 < self.widest < 180:
            raise ValueError(f"preset {self.name}: widest is {self.widest} degrees; between 0 and 180")
        if unknown := self.pose_in - set(get_args(PosePlace)):
            raise ValueError(
                f"preset {self.name}: pose_in holds {', '.join(sorted(unknown))}; any of"
                f" {', '.join(get_args(PosePlace))}"
            )

    def as_json(self) -> str:
        """Everything, as text that `from_json` reads."""
        return json.dumps({**asdict(self), "pose_in": sorted(self.pose_in)}, sort_keys=True)

    @staticmethod
    def from_json(text: str) -> Preset:
        """The preset that `as_json` wrote. Raises ValueError for what is none."""
        try:
            found = parse_json(text, "the shape of a network")
            return Preset(**{**found, "widths": tuple(found["widths"]), "pose_in": frozenset(found["pose_in"])})
        except (TypeError, KeyError) as e:
            raise ValueError(f"{text[:80]} describes no network: {e}") from e

    @property
    def stride(self) -> int:
        """Pixels a cell of the features that are correlated; pictures are a multiple of it high and wide."""
        return 2**self.stages


@dataclass(frozen=True)
class Cost:
    """What a whole network of a preset costs, all its modules together."""

    parameters: float
    """Numbers learnt."""
    gflop: dict[int, float]
    """{side of the picture, px: 10^9 operations}, one rectified pair in both directions, 8 iterations; a
    multiply-add is 2."""


PRESETS: dict[str, Preset] = {
    "paper": Preset("paper", stem_stride=1, pose_cell=1),
    "base": Preset("base"),
    "fast": Preset("fast", widths=(16, 32, 48, 64), hidden=64),
}
COSTS: dict[str, Cost] = {
    "paper": Cost(5.11e6, {256: 124, 384: 279, 512: 496}),
    "base": Cost(4.82e6, {256: 49, 384: 110, 512: 196}),
    "fast": Cost(1.47e6, {256: 16, 384: 37, 512: 65}),
}
FURTHER_COSTS: dict[str, Cost] = {
    "paper": Cost(864, {256: 10.3, 384: 23.2, 512: 41.2}),
    "base": Cost(864, {256: 3.3, 384: 7.4, 512: 13.1}),
    "fast": Cost(576, {256: 0.85, 384: 1.9, 512: 3.4}),
}
"""What `further_views` adds, a third view as large as the pair's; looking its features up, which is no product of
matrices, not counted."""
