"""The settings of a training: everything its result follows from. Plain data; nothing here imports torch."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Self

from pydantic import ValidationInfo, field_validator, model_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.network.model.presets import (
    GROUP,
    PRESETS,
    WIDEST,
    Downsampling,
    FusionKind,
    Normalisation,
    OpacityHead,
    PosePlace,
    Preset,
    RotationHead,
)
from posegaussian.stages.simulator.subjects.splits import FIRST_KEPT_SEED, FIRST_VALIDATION_SEED

Method = Literal["sweep", "sgbm"]
Stabiliser = Literal["none", "pairwise", "recurrent", "adaptive"]
Phase = Literal["depth", "joint"]
SEEDS_OF_TRAINING = "scenes for training have seeds of 0 to 7999"
SHAPE = ("stages", "widths", "hidden", "correlation_levels", "correlation_radius", "stem_stride", "pose_cell")
"""Settings of the network's shape that are the preset's where they are null."""
ROUGHLY, WIDEST_PAIR = 2.0, 95.0
"""Degrees beyond the gap of the smallest ring that a pair may be apart, and the most that any pair may."""
HARMLESS = frozenset({"depth_steps", "joint_steps", "validate_every", "checkpoint_every"})
"""Settings that may differ when a training goes on:
they decide how long it is and when it is looked at, not what a step does."""


class Scenes(Params):
    """A range of seeds; who and what a seed may show is said in `stages/simulator/subjects/splits.py`."""

    first: int = setting(0, "The first seed.", ge=0)
    count: int = setting(480, "Scenes, one a seed.", unit="scenes", ge=1, le=8000)

    @property
    def end(self) -> int:
        """The seed after the last one."""
        return self.first + self.count


class Starts(Params):
    """Of what examples start from: shares, in any unit, each of their sum."""

    matched: float = setting(4.0, "The analytic depth of `methods`.", ge=0)
    hull: float = setting(3.0, "The surface of the visual hull, which no picture has a say in.", ge=0)
    noisy: float = setting(1.5, "True depth, off by some px in patches.", ge=0)
    truth: float = setting(1.0, "True depth, which is to be left alone.", ge=0)

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.matched + self.hull + self.noisy + self.truth > 0:
            raise ValueError("all shares of starts are 0; one of matched, hull, noisy and truth must not be")
        return self


class TrainingConfig(Params):
    """One training: network, data, phases, optimiser, loss and when it is looked at."""

    preset: Literal["paper", "base", "fast"] = setting("fast", "Widths and resolutions of the network.")
    stages: Literal[3, 4] | None = setting(
        None, "The paper's k: features that are correlated have a cell per 2^k px; null: the preset's."
    )
    widths: tuple[int, int, int, int] | None = setting(
        None, "Channels of the encoders' levels, finest first, multiples of 8; null: the preset's.", unit="channels"
    )
    hidden: int | None = setting(
        None, "Channels of the recurrent state; null: the preset's.", unit="channels", ge=1, le=WIDEST
    )
    correlation_levels: int | None = setting(
        None, "Levels of the correlation's pyramid; null: the preset's.", unit="levels", ge=1, le=16
    )
    correlation_radius: int | None = setting(
        None,
        "Cells looked up on either side of the match on every level; null: the preset's.",
        unit="cells",
        ge=0,
        le=64,
    )
    stem_stride: Literal[1, 2] | None = setting(
        None, "Px a cell of the finest features, 1 as in the paper; null: the preset's.", unit="px"
    )
    pose_cell: Literal[1, 4] | None = setting(
        None, "Px a cell of the heatmaps that the pose encoder sees; null: the preset's.", unit="px"
    )
    fusion: FusionKind = setting("concatenation", "How image and pose features become one.")
    pose_in: tuple[PosePlace, ...] = setting(
        ("depth", "decoder"), "Where pose enters: depth, decoder, both or neither."
    )
    rotation_head: RotationHead = setting("normal", "The unit normal in 3 channels, or a quaternion in 4.")
    opacity_head: OpacityHead = setting("facing", "Opacity face-on and at grazing angle, or a single one.")
    normalisation: Normalisation = setting(
        "group", "Of features: by groups of channels of each picture, or over the batch."
    )
    downsampling: Downsampling = setting("stride", "By strided convolutions or by averaging 2 x 2 cells.")
    residual: bool = setting(True, "Whether units add their input.")
    further_views: bool = setting(False, "Whether a third view is looked up by warping, beside the pair's own rows.")

    seed: int = setting(0, "Of the first weights and of every random choice.", ge=0, lt=2**31)
    start: str | None = setting(
        None,
        "Weights to continue from, with a fresh optimiser: a .safetensors file, or the name of weights that ship; null:"
        " random ones.",
    )
    precision: Literal["bf16", "float32"] = setting(
        "bf16", "Of the layers; correlation, coordinates and what the heads say stay in float32."
    )

    scenes: Scenes = setting(Scenes(), "Seeds of the scenes that are trained on, below 8000.")
    validation: Scenes = setting(
        Scenes(first=FIRST_VALIDATION_SEED, count=4),
        "Seeds of the scenes that are validated on, 8000 to 8999, one frame each.",
    )
    frames_per_scene: int = setting(1, "Moments filmed of each training scene.", unit="frames", ge=1, le=64)
    cameras: tuple[int, ...] = setting(
        (4, 5, 6, 8, 12, 16),
        "Numbers of cameras on the ring that scenes are filmed with; on an arc that leans as many at most.",
        unit="cameras",
        min_length=1,
    )
    pairs_per_frame: int = setting(
        4, "Most neighbouring pairs of a moment that are kept, with a held-out camera each.", unit="pairs", ge=1, le=64
    )
    size: int = setting(512, "Side of the filmed pictures.", unit="px", ge=32, le=2048)
    methods: tuple[Method, ...] = setting(
        ("sweep", "sgbm"), "Kinds of matched analytic depth, one a frame.", min_length=1
    )
    starts: Starts = setting(Starts(), "What examples start from, and how often.")
    single: float = setting(
        0.1,
        "Share of the examples whose views stand alone: a relief is refined by picture and pose, without correlation.",
        ge=0,
        le=1,
    )
    strange: float = setting(
        0.2,
        "Share of the examples in which nothing is to be learnt but to doubt: pictures that do not fit, somebody"
        " else's, things that are no person.",
        ge=0,
        le=1,
    )
    clip_frames: int = setting(
        3, "Frames up to the one that is shown, whose joints the stabiliser looks back at.", unit="frames", ge=1, le=16
    )
    stabilisers: tuple[Stabiliser, ...] = setting(
        ("none", "pairwise", "adaptive", "recurrent"),
        "How heatmaps for the pose encoder are stabilised, one drawn for each example.",
        min_length=1,
    )
    crop: int = setting(
        128,
        "Side of the pictures that are cut out for a step; a multiple of the network's stride. Many small ones teach"
        " more than few large ones.",
        unit="px",
        ge=32,
        le=2048,
    )
    batch: int = setting(8, "Pairs of views in a step.", unit="pairs", ge=1, le=256)
    window: int = setting(24, "Frames at hand at a time, of which steps draw.", unit="frames", ge=1, le=1024)
    steps_per_frame: int = setting(
        5, "Steps after which the oldest frame of the window makes room for a new one.", unit="steps", ge=1, le=10_000
    )

    depth_steps: int = setting(
        1500, "Steps of the first phase, which trains depth alone.", unit="steps", ge=0, le=10_000_000
    )
    joint_steps: int = setting(
        2500,
        "Steps of the second phase, which trains everything through the renderer.",
        unit="steps",
        ge=0,
        le=10_000_000,
    )
    iterations: int = setting(
        8, "Most iterations of the refinement of depth; a step draws from 1 to this.", unit="iterations", ge=1, le=32
    )

    learning_rate: float = setting(1e-3, "The largest rate of AdamW.", gt=0, le=1)
    warm_up: int = setting(100, "Steps in which the rate rises from nothing.", unit="steps", ge=0, le=100_000)
    settled: int = setting(
        1000, "Steps after which the rate falls with the root of the steps.", unit="steps", ge=1, le=10_000_000
    )
    weight_decay: float = setting(1e-5, "Of AdamW.", ge=0, le=1)
    clip: float = setting(1.0, "Bound of the gradient's norm.", gt=0)
    ema: float = setting(
        0.995,
        "Share of the old average that a step keeps in the averaged weights, which are the ones that count.",
        ge=0,
        lt=1,
    )

    mu: float = setting(0.9, "Weight of an iteration's depth relative to that of the next one.", gt=0, le=1)
    trust: float = setting(0.3, "Weight of the refinement's own trust, which only the decoder reads.", ge=0)
    learned: float = setting(1.0, "Weight of the learned disparity, px, which a low confidence must not starve.", ge=0)
    blended: float = setting(2.0, "Weight of the disparity that comes out, px: learned over start.", ge=0)
    confidence: float = setting(
        0.5,
        "Weight of the cross entropy of the confidence with whether the learned disparity is nearer to the truth than"
        " the start.",
        ge=0,
    )
    silence: float = setting(
        0.5, "Weight of the cross entropy of the shares with 0 where nothing can be learnt about depth.", ge=0
    )
    render: float = setting(
        20.0,
        "Weight of the rendered picture: px of disparity count in units, shares of brightness in hundredths; beta and"
        " gamma are shares of it.",
        ge=0,
    )
    beta: float = setting(0.5, "Weight of the mean absolute error of rendered pictures.", ge=0)
    gamma: float = setting(0.5, "Weight of 1 - SSIM of rendered pictures.", ge=0)
    pose_fusion: float = setting(1.0, "Weight of the pose fusion loss, the paper's lambda.", ge=0)
    heatmaps: float = setting(
        0.1, "Weight of reading the heatmaps back from pose features, which keeps these from collapsing.", ge=0
    )

    validate_every: int = setting(500, "Steps between two validations.", unit="steps", ge=1)
    checkpoint_every: int = setting(
        200, "Steps between two checkpoints: the most that a kill can cost.", unit="steps", ge=1
    )

    @field_validator("pose_in", "cameras", "methods", "stabilisers")
    @classmethod
    def _each_once(cls, value: tuple[object, ...]) -> tuple[object, ...]:
        if len(set(value)) < len(value):
            raise ValueError(f"each may be named once, got {', '.join(map(str, value))}")
        return value

    @field_validator("cameras")
    @classmethod
    def _rings_have_pairs(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if wrong := [n for n in value if not 3 <= n <= 64]:
            raise ValueError(f"a ring has 3 to 64 cameras, got {wrong[0]}")
        return value

    @field_validator("scenes")
    @classmethod
    def _open_scenes(cls, value: Scenes) -> Scenes:
        if value.end > FIRST_VALIDATION_SEED:
            raise ValueError(
                f"{SEEDS_OF_TRAINING}, these are {value.first} to {value.end - 1}; make first or count smaller"
            )
        return value

    @field_validator("validation")
    @classmethod
    def _validation_scenes(cls, value: Scenes) -> Scenes:
        if value.first < FIRST_VALIDATION_SEED or value.end > FIRST_KEPT_SEED:
            raise ValueError(
                f"scenes for validation have seeds of {FIRST_VALIDATION_SEED} to {FIRST_KEPT_SEED - 1}, these are"
                f" {value.first} to {value.end - 1}"
            )
        return value

    @field_validator("crop")
    @classmethod
    def _crops_fit(cls, value: int, info: ValidationInfo) -> int:
        size, preset, stages = (info.data.get(name) for name in ("size", "preset", "stages"))
        if size is not None and value > size:
            raise ValueError(f"a crop of {value} px does not fit into pictures of {size} px; at most `size`")
        stride = 2 ** (stages or PRESETS[preset].stages) if preset is not None else 1
        if value % stride:
            raise ValueError(
                f"a crop of {value} px is no multiple of {stride} px, the stride of the network's features"
            )
        return value

    @field_validator("widths")
    @classmethod
    def _whole_groups(cls, value: tuple[int, ...] | None) -> tuple[int, ...] | None:
        if value is not None and (wrong := [w for w in value if not GROUP <= w <= WIDEST or w % GROUP]):
            raise ValueError(f"a width of {wrong[0]} channels; multiples of {GROUP} up to {WIDEST}")
        return value

    @property
    def steps(self) -> int:
        """Of both phases."""
        return self.depth_steps + self.joint_steps

    def phase(self, step: int) -> Phase:
        """Of a step, counted from 0."""
        return "depth" if step < self.depth_steps else "joint"

    def scene_seed(self, index: int) -> int:
        """Seed of the scene that training frame `index` shows; beyond the last scene they come round again."""
        return self.scenes.first + index // self.frames_per_scene % self.scenes.count

    def scene_frames(self) -> int:
        """Different training frames that there are."""
        return self.scenes.count * self.frames_per_scene

    def validation_seed(self, index: int) -> int:
        """Seed of the scene that validation frame `index` (0 to validation.count - 1) shows."""
        return self.validation.first + index

    def network(self) -> Preset:
        """The network's shape: the preset with the variants that were chosen, and what it is shown."""
        chosen = {name: value for name in SHAPE if (value := getattr(self, name)) is not None}
        return replace(
            PRESETS[self.preset],
            **chosen,
            alone=self.single > 0,
            widest=min(360 / min(self.cameras) + ROUGHLY, WIDEST_PAIR),
            fusion=self.fusion,
            pose_in=frozenset(self.pose_in),
            rotation_head=self.rotation_head,
            opacity_head=self.opacity_head,
            normalisation=self.normalisation,
            downsampling=self.downsampling,
            residual=self.residual,
            further_views=self.further_views,
        )
