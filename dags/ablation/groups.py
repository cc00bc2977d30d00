"""What an ablation compares: groups of rows, each row a variant of one training, or of one run of the pipeline; plain
data.

A group is one table. Its rows say only the settings in which they differ; everything else is as in the configuration of
the ablation, so that a row that several groups have in common is trained once (`cells.py`). Rows of a group
that has `footage` are not trained: the pipeline runs on simulated sequences with weights that there are
(`pipeline_runs.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from posegaussian.stages.network.model.presets import FusionKind
from posegaussian.stages.simulator.quality_scenes import ablation_scene
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED, FIRST_VALIDATION_SEED
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import ConfigError

ERROR = "epe"
"""The measure of depth in which rows are compared with the reference, seed by seed."""
PICTURES = "pictures"
"""Name of the runs that draw pictures with what was trained."""
DRAWN = ("psnr box", "ssim box", "lpips box", "psnr full", "ssim full", "lpips full")
"""What is measured of pictures, LPIPS where its weights are given."""
TRAINED = (ERROR, "1px", *DRAWN)
"""What a table of trainings shows and compares: depth as the training validates it, and pictures."""


@dataclass(frozen=True)
class SimulatedFootage:
    """The simulated sequences on which the rows of a group run, one a seed."""

    frames: int
    frame_rate: float
    """Frames a second."""
    size: int
    """Side of the pictures, px."""
    cameras: int = 8
    """Source cameras, where a row does not say."""
    effects: Mapping[str, Any] = field(default_factory=dict)
    """Of the scene, laid over a clean one."""

    def scene(self, seed: int, cameras: int | None = None) -> Scene:
        """The sequence of a seed of the ablation, of as many cameras as a row says.
        Raises ConfigError where there is none."""
        most = FIRST_KEPT_SEED - FIRST_VALIDATION_SEED
        if seed >= most:
            raise ConfigError(
                f"--seeds {seed}: there are {most} sequences for validation, one a seed from 0 on; use smaller seeds,"
                " or leave tps and cameras out with --only, and pictures with --no-pictures"
            )
        return ablation_scene(
            FIRST_VALIDATION_SEED + seed, cameras or self.cameras, self.size, self.frames, self.frame_rate, self.effects
        )


FOOTAGE = {
    # 4 px at 512 px, 10 % missing, 2 % elsewhere: the faults of docs/measurements/joints.md.
    "tps": SimulatedFootage(8, 30.0, 256, effects={"joint_noise": {"pixels": 2.0, "dropouts": 0.1, "outliers": 0.02}}),
    "cameras": SimulatedFootage(2, 2.0, 512),
    PICTURES: SimulatedFootage(2, 2.0, 512),
}
"""{group: what its rows run on}: as few and as small pictures as show what the group is about."""


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    label: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Of a `TrainingConfig`, those that the row is about."""
    iterations: int | None = None
    """Steps of refinement with which a finished training is measured again; None: its own validation counts."""
    pipeline: tuple[str, ...] = ()
    """Settings of a run of the pipeline, `stage.key=value`, where the group has footage."""
    cameras: int | None = None
    """Of the sequence, where the group has footage and the row is about them."""


@dataclass(frozen=True)
class Group:
    """One table."""

    name: str
    """As `--only` knows it."""
    title: str
    rows: tuple[Row, ...]
    reference: str
    """Label of the row that the others are compared with, seed by seed."""
    comparable: str
    """What may be compared with the paper and between rows, and what not."""
    joint: bool = False
    """Whether its settings matter in the second phase of training alone."""
    footage: SimulatedFootage | None = None
    """What its rows run on; None: they are trainings."""
    shown: tuple[str, ...] = TRAINED
    """Measures in the table, in their order."""
    compared: tuple[str, ...] = TRAINED
    """Measures in which rows are compared with the reference, seed by seed."""

    def row(self, label: str) -> Row:
        """By its label."""
        return next(r for r in self.rows if r.label == label)


def groups(config: TrainingConfig) -> tuple[Group, ...]:
    """All tables, in the order in which they are shown."""
    return (
        _fusion(),
        _pose(),
        _pose_weight(),
        _render_weights(),
        _iterations(config.iterations),
        _heads(),
        _encoders(),
        _stabilizer(),
        _cameras(),
    )


def chosen(config: TrainingConfig, names: Sequence[str]) -> tuple[Group, ...]:
    """The groups of `--only`, all for none. Raises ConfigError for a name that is no group."""
    every = groups(config)
    for name in names:
        if name not in {g.name for g in every}:
            raise ConfigError(f"--only {name}: no such group; these are {', '.join(g.name for g in every)}")
    return tuple(g for g in every if not names or g.name in names)


def _fusion() -> Group:
    return Group(
        "fusion",
        "Fusion of image and pose features",
        tuple(Row(kind, {"fusion": kind}) for kind in get_args(FusionKind)),
        "concatenation",
        "Both are end-point errors in px, but of other people and other pairs of cameras, and the paper says neither on"
        " which data nor over which pixels: compare the order of the rows, not the values. Parameters are those of the"
        " whole network here and of the paper's own model there.",
    )


def _pose() -> Group:
    places = {"neither": (), "depth": ("depth",), "decoder": ("decoder",), "both": ("depth", "decoder")}
    return Group(
        "pose",
        "Where pose enters",
        tuple(Row(label, {"pose_in": value}) for label, value in places.items()),
        "both",
        "The paper's pictures are of THuman2.0, ours of simulated people: not comparable in value; whether pose helps"
        " at all is. Without pose in the decoder there is no pose fusion loss either, so two rows differ from the"
        " reference in the loss, too.",
    )


def _pose_weight() -> Group:
    return Group(
        "lambda",
        "Weight of the pose fusion loss",
        tuple(
            Row(f"beta 0.5, gamma 0.5, lambda {v:g}", {"beta": 0.5, "gamma": 0.5, "pose_fusion": v})
            for v in (0.0, 0.1, 0.5, 1.0, 2.0)
        ),
        "beta 0.5, gamma 0.5, lambda 1",
        "The paper's PSNR, SSIM and LPIPS are of pictures of THuman2.0, ours of simulated people: not comparable in"
        " value. In the paper lambda 0 is no pose fusion at all; here it takes the alignment out of the loss and leaves"
        " pose in the network (for that see the table on where pose enters).",
    )


def _render_weights() -> Group:
    return Group(
        "beta_gamma",
        "Weights of the rendered picture's MAE and SSIM, without the pose fusion loss",
        tuple(
            Row(f"beta {b:g}, gamma {g:g}, lambda 0", {"beta": b, "gamma": g, "pose_fusion": 0.0})
            for b, g in ((0.5, 0.5), (0.3, 0.7), (0.8, 0.2))
        ),
        "beta 0.5, gamma 0.5, lambda 0",
        "The paper calls gamma a weight of depth in its text and of SSIM in its equation; here it is SSIM's. Its"
        " pictures are of THuman2.0, ours of simulated people: not comparable in value.",
        joint=True,
    )


def _iterations(most: int) -> Group:
    return Group(
        "iterations",
        "Iterations T of the refinement, of one training",
        tuple(Row(f"T = {t}", iterations=t) for t in range(1, most + 1)),
        f"T = {most}",
        "The paper does not vary T. Rows are the same weights measured with another T, so what differs between them"
        " owes nothing to chance in training.",
    )


def _heads() -> Group:
    kinds = {
        "rotation 3, opacity 2": ("normal", "facing"),
        "rotation 4 (quaternion), opacity 2": ("quaternion", "facing"),
        "rotation 3, opacity 1": ("normal", "single"),
    }
    return Group(
        "heads",
        "Heads of the decoder",
        tuple(
            Row(label, {"rotation_head": rotation, "opacity_head": opacity})
            for label, (rotation, opacity) in kinds.items()
        ),
        "rotation 3, opacity 2",
        "The paper has the first row alone and no comparison. Heads shape the picture: an error of depth says only"
        " whether one of them harms depth; which one draws better, pictures say.",
        joint=True,
    )


def _encoders() -> Group:
    changes: dict[str, dict[str, Any]] = {
        "group normalisation, residual, strides": {},
        "batch normalisation": {"normalisation": "batch"},
        "no residual units": {"residual": False},
        "down-sampling by averages": {"downsampling": "pool"},
    }
    plain = {"normalisation": "group", "residual": True, "downsampling": "stride"}
    return Group(
        "encoders",
        "Encoders",
        tuple(Row(label, {**plain, **change}) for label, change in changes.items()),
        "group normalisation, residual, strides",
        "The paper says of its four variants only that they explore batch normalisation, residual blocks and"
        " down-sampling layers; each row here changes one of the three. Its network normalises over the batch, ours by"
        " groups, because a batch here is a few pairs.",
    )


def _stabilizer() -> Group:
    methods = tuple(
        Row(m, pipeline=("effects.temporal_smoothing=on", f"smoothing.method={m}"))
        for m in ("pairwise", "recurrent", "adaptive")
    )
    shown = ("change of ssim", "its deviation", *DRAWN, ERROR, "1px", "joints", "jitter", "lag")
    return Group(
        "tps",
        "Temporal Pose Stabilizer",
        (Row("off", pipeline=("effects.temporal_smoothing=off",)), *methods),
        "off",
        "Both change of SSIM are abs(SSIM - SSIM of the frame before), mean and standard deviation over frames; ours is"
        " over the person's box, of a clean simulated sequence with noisy joints, and follows from motion, frame rate"
        " and region as much as from the method: not comparable in value. The paper compares itself with other methods"
        " and never with its own stabilizer switched off. Here the stabilizer reaches pictures through the network's"
        " heatmaps alone; `joints`, `jitter` and `lag` are of what these heatmaps hold: mean error, mean second"
        " difference of the error, and delay (docs/measurements/joints.md).",
        footage=FOOTAGE["tps"],
        shown=shown,
        compared=shown,
    )


def _cameras() -> Group:
    shown = (*DRAWN, ERROR, "1px", "depth")
    return Group(
        "cameras",
        "6 and 8 cameras",
        tuple(Row(f"{n} cameras", cameras=n) for n in (6, 8)),
        "8 cameras",
        "The paper's numbers are of THuman2.0, under the heading Training, and it says neither which views it measures"
        " nor over which pixels; ours are of simulated people, the same two held-out views for both rows, each in the"
        " middle between two sources: what 2 cameras more are worth may be compared, the values not. An error in px"
        " grows with the distance between neighbours, so between rows only that of depth in mm compares.",
        footage=FOOTAGE["cameras"],
        shown=shown,
        compared=shown,
    )
