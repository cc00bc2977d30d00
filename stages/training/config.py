"""The settings of a training: everything its result follows from. Plain data; nothing here imports torch."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import ValidationInfo, field_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.network.model.presets import (
    PRESETS,
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
Phase = Literal["depth", "joint"]
SEEDS_OF_TRAINING = "scenes for training have seeds of 0 to 7999"
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


class TrainingConfig(Params):
    """One training: network, data, phases, optimiser, loss and when it is looked at."""

    preset: Literal["paper", "base", "fast"] = setting("fast", "Widths and resolutions of the network.")
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
        None, "Weights to continue from, a .safetensors file, with a fresh optimiser; null: random ones."
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
        (6, 8, 12), "Numbers of cameras on the ring that scenes are filmed with.", unit="cameras", min_length=1
    )
    size: int = setting(512, "Side of the filmed pictures.", unit="px", ge=32, le=2048)
    methods: tuple[Method, ...] = setting(
        ("sweep", "sgbm"), "Kinds of analytic depth that the network refines.", min_length=1
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
        4, "Most iterations of the refinement of depth; a step draws from 1 to this.", unit="iterations", ge=1, le=32
    )

    learning_rate: float = setting(1e-3, "The largest rate of AdamW.", gt=0, le=1)
    warm_up: int = setting(100, "Steps in which the rate rises from nothing.", unit="steps", ge=0, le=100_000)
    weight_decay: float = setting(1e-5, "Of AdamW.", ge=0, le=1)
    clip: float = setting(1.0, "Bound of the gradient's norm.", gt=0)
    ema: float = setting(
        0.995,
        "Share of the old average that a step keeps in the averaged weights, which are the ones that count.",
        ge=0,
        lt=1,
    )

    mu: float = setting(0.9, "Weight of an iteration's depth relative to that of the next one.", gt=0, le=1)
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

    @field_validator("pose_in", "cameras", "methods")
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
        size, preset = info.data.get("size"), info.data.get("preset")
        if size is not None and value > size:
            raise ValueError(f"a crop of {value} px does not fit into pictures of {size} px; at most `size`")
        stride = PRESETS[preset].stride if preset is not None else 1
        if value % stride:
            raise ValueError(f"a crop of {value} px is no multiple of {stride} px, the stride of preset {preset}")
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
        """The network's shape: the preset with the variants that were chosen."""
        return replace(
            PRESETS[self.preset],
            fusion=self.fusion,
            pose_in=frozenset(self.pose_in),
            rotation_head=self.rotation_head,
            opacity_head=self.opacity_head,
            normalisation=self.normalisation,
            downsampling=self.downsampling,
            residual=self.residual,
            further_views=self.further_views,
        )
