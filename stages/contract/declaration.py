"""One declaration a stage; the plan, the arrays, the keys, the docs and the checks are derived from it.

Declarations import numpy and pydantic and nothing heavier: a kernel is a dotted name that the worker resolves.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic.fields import FieldInfo

from posegaussian.stages.contract.facts import Facts, fact
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.trust import Trust
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.spec import ArraySpec, Shape, TableSpec

if TYPE_CHECKING:
    from posegaussian.storage.model.capture import Capture

Axis = Literal["sequence", "time", "view", "path"]
ViewSelection = Literal["own", "sources", "held_out", "compared", "all"]
"""`compared`: sources and held-out views, not those that have no part in a run."""
Looked = TypeVar("Looked")
"""What an effect's decision may look at: `Evidence` of a stage's, a scene's own of the simulator's."""


class Params(BaseModel):
    """Settings of one stage. Unknown keys are errors; a volatile field cannot change a result and stays out of
    fingerprints."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_is_a_number(cls, value: Any, info: ValidationInfo) -> Any:
        """YAML's `yes` and `on` are truth values, and Python would take them for 1."""
        annotation = cls.model_fields[info.field_name].annotation if info.field_name else None
        if isinstance(value, bool) and annotation is not bool:
            raise ValueError(
                f"a {getattr(annotation, '__name__', annotation)} is expected, got the truth value {value}"
            )
        return value

    def hashed(self) -> dict[str, Any]:
        """The fields that can change a result."""
        volatile = {n for n, f in type(self).model_fields.items() if extra(f).get("volatile")}
        return self.model_dump(mode="json", exclude=volatile)


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "1",
    volatile: bool = False,
    quality_levels: list[Any] | None = None,
    **bounds: Any,
) -> Any:
    """A documented parameter: its unit, its bounds (ge, le, gt, lt), its quality levels from cheap to dear."""
    return Field(
        default,
        description=description,
        json_schema_extra={"unit": unit, "volatile": volatile, "quality_levels": quality_levels},
        **bounds,
    )


def extra(info: FieldInfo) -> dict[str, Any]:
    """Unit, volatility and quality levels of a field declared with `setting`."""
    return info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}


def always(params: Any, facts: Facts) -> bool:
    """The condition of a read that every task needs."""
    return True


@dataclass(frozen=True)
class Read:
    """One input of a stage."""

    array: str
    """Name of the array (`{path}` stands for the task's camera path), or of a source."""
    views: ViewSelection = "sources"
    """Which views are read of an array with a view axis."""
    halo: tuple[int, int] | Callable[[Any, Facts], tuple[int, int]] = (0, 0)
    """Frames before and after the partition; may follow from the params and the facts."""
    when: Callable[[Any, Facts], bool] = always
    """Whether the input is read at all, given params and facts."""
    is_source: bool = False
    """Whether it is a source file of the capture, read through a lazy reader."""

    @classmethod
    def source(
        cls,
        kind: str,
        views: ViewSelection = "own",
        when: Callable[[Any, Facts], bool] = always,
        halo: tuple[int, int] | Callable[[Any, Facts], tuple[int, int]] = (0, 0),
    ) -> Read:
        """A source of the capture: pictures, masks, joints, joints3d, depth or depth_maps; or the pose estimator."""
        return cls(kind, views=views, halo=halo, when=when, is_source=True)

    @property
    def along_path(self) -> bool:
        """Whether it is an array of the task's camera path."""
        return "{path}" in self.array

    def halo_for(self, params: Any, facts: Facts) -> tuple[int, int]:
        """(before, after) in frames."""
        return self.halo(params, facts) if callable(self.halo) else self.halo


@dataclass(frozen=True)
class Resources:
    """What one task needs."""

    cpu: int = 1
    """Threads."""
    gpu: int = 0
    """Devices; without a GPU worker the task falls to the CPU pool and the plan says so."""
    ram: int = 0
    """Projected peak of host memory, bytes."""
    vram: int = 0
    """Projected peak of device memory, bytes."""


@dataclass(frozen=True)
class Unit:
    """What seconds of a stage are in proportion to, for every frame and view, as a weighted sum of pixels."""

    worked: float = 1.0
    """Of a pixel of `frames/*`, or of the camera path of a stage that runs over paths."""
    captured: float = 0.0
    """Of a pixel of the picture as it was captured, which is decoded whatever size is worked on."""
    besides: float = 0.0
    """Frames' worth of it that a task of a partition does beside those of its own frames."""

    @property
    def name(self) -> str:
        """`1 worked + 0.1 captured`: seconds per unit of work are compared with those of the same name alone."""
        parts = ((self.worked, "worked"), (self.captured, "captured"), (self.besides, "frames"))
        return " + ".join(f"{n:g} {of}" for n, of in parts if n)


@dataclass(frozen=True)
class Typical:
    """What tasks of a stage took of captures of people, for estimates in an archive without a history of them; from
    `python -m benchmarks.pipeline.typical_rates ARCHIVE...`, of captures with 4 to 16 cameras at 150 to 1024 px."""

    seconds: float
    """Of one core, per unit of work, rounded."""
    ratio: float = 1.0
    """Bytes on disk over bytes before compression, rounded up: what a run may start by."""


@dataclass(frozen=True)
class Decision:
    """What an effect's measure led to."""

    on: bool
    """Whether the effect is computed."""
    measured: float | None
    """The measured value, in the effect's unit; None where there is nothing to measure."""
    bound: float
    """The bound it was compared with."""
    reason: str
    """One sentence for the plan."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a decision may look at. Pictures are not among it: what must be read of them, the survey took."""

    params: Any
    """Settings of the stage that declares the effect."""
    facts: Facts
    """What the capture has."""
    rig: Rig
    """Cameras of `frames/*`, as they are calibrated."""
    source_rig: Rig
    """Cameras as calibrated, with their lenses."""
    captured_size: np.ndarray
    """[V, 2] (width, height) of the captured pictures, px."""
    captured_to_calibrated: np.ndarray
    """[V, 3] (scale, dx, dy): a captured pixel x is the calibrated pixel scale x + (dx, dy)."""
    sources: tuple[int, ...]
    """Indices of the views to reconstruct from."""
    joint_views: tuple[int, ...]
    """Those of them that came with 2D joints."""
    stride: int
    """Source frames from one worked frame to the next."""
    targets: tuple[CameraPath, ...]
    """Camera paths that are rendered."""
    noted: Mapping[str, np.ndarray]
    """By array, the noted outputs of sequence-wide stages, [S, ...] of the source views where it has a view axis;
    empty before they ran."""


@dataclass(frozen=True)
class Effect(Generic[Looked]):
    """Something computed only where a measure calls for it: while it is on, its name is among the facts of its stages.

    The first stage in the flow that declares it decides. What a stage reads with an effect off, it or what it reads
    must also read with the effect on: while a decision waits for the survey, work is ordered as if the effect were on.
    """

    name: str
    """Key below `effects` in the configuration."""
    summary: str
    """One sentence: what is done while it is on."""
    measure: str
    """What is measured, in a few words."""
    threshold: float
    """Bound above which the effect is on."""
    unit: str
    """Unit of measure and bound."""
    decide: Callable[[Looked, float], Decision | None]
    """Pure, `decide(evidence, threshold)`; None: `asks` must be noted first."""
    asks: tuple[str, ...] = ()
    """Outputs of sequence-wide stages that the measure is made of; empty where cameras and settings suffice. Those of
    a later stage are asked for only where those of the earlier ones leave it open."""
    stand: Callable[[Rig, Mapping[str, np.ndarray]], Rig] | None = None
    """(cameras as calibrated, what of `uses` is noted) -> the cameras as they stand while the effect is on."""
    uses: tuple[str, ...] = ()
    """Outputs of sequence-wide stages that `stand` looks at: noted before the effect is on, be it forced."""
    lacks: Callable[[Looked], str | None] = lambda evidence: None
    """What this capture lacks for the effect, which is off then whatever the settings say; or None."""
    refusal: Callable[[Looked], str | None] = lambda evidence: None
    """Why this capture cannot do without the effect, with what to change where it is forced off; or None."""

    def __post_init__(self) -> None:
        fact(self.name)

    def quantity(self, number: str) -> str:
        """A number of the measure with its unit; a share, unit 1, stands alone."""
        return number if self.unit == "1" else f"{number} {self.unit}"


@dataclass(frozen=True)
class Picked:
    """What a choice came to by what was measured."""

    fact: str
    """The fact that tells the answer to `Choice.resolve`."""
    reason: str
    """One sentence for the plan."""


@dataclass(frozen=True)
class Choice:
    """A setting with more than two answers that `auto` resolves by what the capture has, or by what was measured of
    it; shown beside the effects."""

    setting: str
    """Key of the stage's setting."""
    resolve: Callable[[Any, Facts], tuple[str, str]]
    """(params, facts) -> the answer, and one sentence that says why. While a pick is awaited it is the answer that
    reads most: work is ordered by it."""
    picks: Callable[[Any, Facts], bool] = lambda params, facts: False
    """(params, facts of the capture) -> whether a measure has a say."""
    pick: Callable[[Evidence], Picked | None] | None = None
    """Pure; asked only where `picks`. None: `asks` must be noted first."""
    asks: tuple[str, ...] = ()
    """Outputs of sequence-wide stages that the pick is made of."""
    facts: tuple[str, ...] = ()
    """The facts that it may come to."""

    def __post_init__(self) -> None:
        for name in self.facts:
            fact(name)


@dataclass(frozen=True)
class Tolerance:
    """How far serial and distributed results may differ, and why."""

    absolute: float
    """In the array's unit."""
    reason: str
    """Why the bytes cannot be equal."""


def needed(params: Any, facts: Facts) -> str | None:
    """The answer of a stage that every capture needs and can serve."""
    return None


@dataclass(frozen=True)
class Asset:
    """Models or weights, which are no files of the capture: a stage reads them as a source of that name."""

    name: str
    """Of the source."""
    digest: Callable[[Any], str]
    """Of their contents, from the settled settings. Raises ConfigError where they are not there."""
    open: Callable[[Any], Any]
    """What a kernel gets, made once in a process, from the settled settings. It alone imports what is heavy."""
    settled: Callable[[Any, Facts], Any] = lambda params, facts: params
    """(params of the stage that declares it, facts of the capture) -> the settings that say which, `auto` resolved."""
    code: Callable[[Any], str] | None = None
    """The module, by dotted name, whose code counts with the contents; None: the stages' kernels import it all."""


Undistorted = Callable[[Rig, Rig, np.ndarray, np.ndarray, Facts], Rig]
"""(cameras without lenses, as calibrated, [V, 2] px of their pictures, [V, 3] captured to calibrated, effects that are
not set off) -> those without lenses, whose pictures reach as far as they filmed."""


@dataclass(frozen=True)
class Paths:
    """How texts become camera paths. What a path needs to know of other stages' settings it is given with all of
    them: where pictures lie between cameras depends on what depth can match."""

    make: Callable[[str, Rig, Views, np.ndarray, Any], CameraPath]
    """(text, cameras of `frames/*`, their roles, source frame numbers [F], settings of all stages) -> the target
    cameras. Raises UserError for a text that names no path."""
    default: Callable[[Rig, Views, Any], str]
    """(cameras of `frames/*`, their roles, settings of all stages) -> the text that is taken where none is set."""


@dataclass(frozen=True)
class Stage:
    """The declaration of one stage."""

    name: str
    """Key of its settings and prefix of its tasks."""
    summary: str
    """One sentence for help, docs and dashboard."""
    version: int
    """Raised by hand when results change in a way the code digest cannot see."""
    run: str
    """`module:function`, `run(inputs, params) -> Iterator[Block]`."""
    reads: tuple[Read, ...]
    """Inputs."""
    writes: tuple[ArraySpec | TableSpec, ...]
    """Outputs."""
    over: tuple[Axis, ...]
    """Axes of work: one task each combination."""
    params: type[Params]
    """Its settings."""
    needs: Callable[[Shape, Any], Resources]
    """Resources of one task, from the shape of one partition (`frame` is the partition's length) and the params."""
    typical: Typical
    """What its tasks took elsewhere."""
    sized_by: str = "frames.size"
    """The setting by which a task needs less memory."""
    unit: Unit = Unit()
    """What its work is counted in."""
    check: str | None = None
    """`module:function`, `check(block, params) -> list[str]`: warnings; an impossible value raises."""
    unneeded: Callable[[Any, Facts], str | None] = needed
    """Why this capture does not need the stage, or None."""
    refusal: Callable[[Any, Facts], str | None] = needed
    """Why these params cannot be served by this capture, with the setting to change, or None."""
    effects: tuple[Effect[Evidence], ...] = ()
    """Effects its reads, outputs or kernel depend on; the same object where several stages share one."""
    choices: tuple[Choice, ...] = ()
    """Settings that are shown with the effects."""
    tolerance: Tolerance | None = None
    """None: serial and distributed results are equal byte by byte."""
    optional: bool = False
    """Whether its settings may leave it out: while it is needed, its name is among the facts, so that later stages
    read its outputs in place of others."""
    sequence_wide: bool = False
    """Constants of a whole sequence: each made only where a needed stage reads it or an effect asks for it, and kept,
    whatever the sources' growth, until a run says `--from` this stage or works on frames of which it saw less than
    half. An output made only when asked for has `when` = its name, one made with it that name, too."""
    cameras: Callable[[Rig, Any], Rig] | None = None
    """(cameras as calibrated, params) -> the cameras it sees, before `undistorted` says how far their pictures reach;
    None: those of `frames/*`, as their stage declares. Where an effect says how they stand, all but sequence-wide
    stages see them so."""
    facts: Callable[[Capture, Views, Any, Facts], Iterable[str]] = lambda capture, views, params, facts: ()
    """Facts that it can tell of a capture: (capture, roles of the cameras, params, facts told by the stages before)."""
    joint_set: Callable[[Capture, Views, Any, Facts], str | None] | None = None
    """Of the stage that finds joints or takes given ones: (capture, roles, params, facts of the capture) -> the id of
    the joint set of `pose/*`, or None without joints."""
    dimensions: Callable[[Any, Facts], Mapping[str, int]] = lambda params, facts: {}
    """(params, facts of the capture) -> the lengths of dimensions that follow from its settings."""
    notes: Callable[[Evidence], Iterable[str]] = lambda evidence: ()
    """Sentences for the plan on what these settings give with this capture; asked only of a stage that is needed."""
    assets: tuple[Asset, ...] = ()
    """Models or weights that its settings name, for itself and for other stages."""
    paths: Paths | None = None
    """Of the stage that renders: how its paths are made."""
    undistorted: Undistorted | None = None
    """Of the stage that undoes lenses: how far pictures reach then."""
    sees: tuple[str, ...] = ()
    """Other stages whose settings its kernel gets, too, as `inputs.settings`: it does in memory what they do."""
    timed: bool = False
    """Whether its results depend on seconds, and not on the order of frames alone: another frame rate makes them
    anew."""
    trust: Trust | None = None
    """Of the stage that measures whether cameras agree: which of them are believed."""

    def __post_init__(self) -> None:
        for name in ([self.name] if self.optional else []) + [w.name for w in self.writes if self.sequence_wide]:
            fact(name)

    def reads_for(self, params: Any, facts: Facts) -> tuple[Read, ...]:
        """The inputs that count under these params and facts."""
        return tuple(r for r in self.reads if r.when(params, facts))

    def writes_for(self, facts: Facts) -> tuple[ArraySpec | TableSpec, ...]:
        """The outputs this capture gets."""
        return tuple(w for w in self.writes if w.when is None or w.when in facts)


def resolve(dotted: str) -> Callable[..., Any]:
    """The function behind `module:function`."""
    module, _, name = dotted.partition(":")
    return getattr(importlib.import_module(module), name)
