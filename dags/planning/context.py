"""One sequence as a plan sees it: capture, settings, roles, time, shape and camera paths. No data is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from posegaussian.dags.planning.effects import (
    ChoiceVerdict,
    Demand,
    EffectVerdict,
    Verdicts,
    add_waits,
    as_believed,
    as_they_stand,
    decided_facts,
    not_off,
    of_believed,
    perhaps_gone,
    refusals,
    useful,
    verdicts_on_cameras,
    with_optional,
)
from posegaussian.stages.contract.declaration import Evidence, Stage
from posegaussian.stages.contract.facts import ESTIMATED, FEW_SOURCES, HELD_OUT, SINGLE_SOURCE, Facts
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.trust import CameraVerdict, asks
from posegaussian.stages.registry import ASSETS, PATHS, STAGES, TRUST, UNDISTORTED
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.files.names import check_camera_names
from posegaussian.storage.model.cameras import CameraPath, Rig, must_be_cameras
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.crop import captured_to_calibrated, unexplained_sizes
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.joint_sets import JOINT_SETS
from posegaussian.storage.model.roles import Roles, roles_in
from posegaussian.storage.model.splits import frames_of
from posegaussian.storage.model.timegrid import TimeGrid, late_frames, select


@dataclass(frozen=True)
class Context:
    """A sequence under its settings."""

    sequence: SequenceGroup
    """Where it is kept."""
    settings: Any
    """Validated settings of this sequence."""
    path_texts: tuple[str, ...]
    """Camera paths as written: in the settings, or asked for by an export."""
    noted: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By array, what sequence-wide stages noted for decisions, [S, ...] of the `asked_views`' sources where it has a
    view axis; empty before they ran."""
    asked_for: bool = False
    """Whether the paths were asked for by a command, instead of the settings' ones."""
    exported: frozenset[str] = frozenset()
    """Outputs of sequence-wide stages that an export reads."""
    named: frozenset[str] = frozenset()
    """Stages that a command names: they are made though nobody reads what they make."""
    memo: dict[Any, Any] = field(default_factory=dict, init=False, compare=False, repr=False)
    """What follows from the context and is asked for again and again: parts of fingerprints, reads of stages,
    evidence."""

    @cached_property
    def capture(self) -> Capture:
        """The registered capture, its cameras brought into step by `frames.time_offset`; where masks are used, without
        the pictures that lack one."""
        return self.sequence.capture.worked(self.late, self.masked)

    @property
    def masked(self) -> bool:
        """Whether masks that came with it are used."""
        return self.settings.frames.matte in ("auto", "given")

    @cached_property
    def late(self) -> tuple[int, ...]:
        """[V] whole frames by which each camera is late, from `frames.time_offset`. Raises ConfigError."""
        return late_frames(self.sequence.capture.rig.names, self.settings.frames.time_offset, self.sequence.name)

    def params(self, stage: Stage) -> Any:
        """Settings of one stage."""
        return getattr(self.settings, stage.name)

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names of the cameras that only metrics may look at."""
        return self._roles.held_out

    @cached_property
    def _roles(self) -> Roles:
        """Names of cameras by role, as set. Raises ConfigError."""
        views = self.settings.views
        return roles_in(self.capture, views.sources, views.held_out, self.sequence.name)

    @cached_property
    def asked_views(self) -> Views:
        """Roles of the cameras as they are set, before any of them is disbelieved. Raises ConfigError for names that
        the capture does not have or that play both roles."""
        names, roles = self.capture.rig.names, self._roles
        trusted = self.settings.views.trust if isinstance(self.settings.views.trust, list) else []
        must_be_cameras("views.trust", trusted, names, self.sequence.name)
        return Views(
            names,
            tuple(i for i, n in enumerate(names) if n in roles.sources),
            tuple(i for i, n in enumerate(names) if n in roles.held_out),
        )

    @cached_property
    def cameras(self) -> dict[str, CameraVerdict]:
        """What is known of every camera that may be a source, by name."""
        return verdicts_on_cameras(self.asked_views, self.settings.views.trust, self.noted)

    @property
    def cameras_undecided(self) -> bool:
        """Whether the survey must run before it is known which cameras are believed."""
        return any(v.state == "undecided" for v in self.cameras.values())

    @cached_property
    def views(self) -> Views:
        """Roles of the cameras: a source that contradicts the others is none; all are believed until the survey ran."""
        views = self.asked_views
        believed = tuple(v for v in views.sources if self.cameras[views.names[v]].state != "left out")
        return replace(views, sources=believed)

    def views_of(self, stage: Stage) -> Views:
        """Roles of the cameras as a stage sees them: the one that measures who is believed sees all that are asked."""
        return self.asked_views if stage.trust is not None else self.views

    @cached_property
    def active_views(self) -> tuple[int, ...]:
        """Views whose pictures are worked on: sources, believed or not, and held-out ones."""
        return tuple(sorted({*self.asked_views.sources, *self.asked_views.held_out}))

    @cached_property
    def rig(self) -> Rig:
        """Cameras of `frames/*`, as they stand."""
        return as_they_stand(self.calibrated_rig, self.effects, self.noted)

    @cached_property
    def calibrated_rig(self) -> Rig:
        """The same before effects turn them."""
        frames = stage_named("frames")
        return self._cameras(frames, self.source_rig)

    @cached_property
    def source_rig(self) -> Rig:
        """Cameras of the captured pictures, those turned that are believed so."""
        return as_believed(self.capture.rig, self.cameras)

    def rig_of(self, stage: Stage) -> Rig:
        """Cameras as a stage sees them: those of `frames/*`, or its own."""
        if stage.cameras is None or stage.name == "frames":
            return self.rig
        own = self._cameras(stage, self.source_rig if stage.trust is None else self.capture.rig)
        return own if stage.sequence_wide else as_they_stand(own, self.effects, self.noted)

    def _cameras(self, stage: Stage, source_rig: Rig) -> Rig:
        assert stage.cameras is not None
        rig, captured = stage.cameras(source_rig, self.params(stage)), np.array([s.size for s in self.capture.pictures])
        return UNDISTORTED(rig, source_rig, captured, self.captured_to_calibrated, not_off(self.settings.effects))

    @cached_property
    def captured_to_calibrated(self) -> np.ndarray:
        """[V, 3] (scale, dx, dy): `frames.crop`, else what the import found."""
        return captured_to_calibrated(self.capture.rig.names, {**self.capture.crops, **self.settings.frames.crop})

    @property
    def frame_range(self) -> str:
        """`frames.range` as start:stop:stride. Raises ConfigError for a protocol that the capture does not have."""
        capture = self.capture
        return frames_of(self.settings.frames.range, capture.splits, self.sequence.name, capture.layout)

    @cached_property
    def source_frames(self) -> np.ndarray:
        """[F] source frame numbers. Raises ConfigError when the range selects none."""
        numbers = self.capture.numbers
        chosen = select(numbers, self.frame_range)
        if not len(chosen):
            raise ConfigError(
                f"frames.range {self.frame_range!r} selects no frame of sequence {self.sequence.name}; its"
                f" source frames are {numbers[0]}..{numbers[-1]}"
            )
        return chosen

    @cached_property
    def time(self) -> np.ndarray:
        """[F] seconds."""
        return self.source_frames / self.capture.frame_rate

    @cached_property
    def valid(self) -> np.ndarray:
        """[F, V] whether a view has a picture of a frame."""
        return np.stack([np.isin(self.source_frames, s.numbers) for s in self.capture.pictures], axis=1)

    @cached_property
    def grid(self) -> TimeGrid:
        """Partitions along time."""
        return TimeGrid(len(self.source_frames), self.sequence.partition_frames)

    def with_noted(self, noted: Mapping[str, np.ndarray]) -> Context:
        """The same sequence with other notes; all that does not follow from them is taken over, not made again."""
        other, follows = replace(self, noted=noted), {"verdicts", "facts", "waits", "cameras", "views", "rig"}
        follows |= {"paths", "_made_paths", "source_rig", "calibrated_rig"}
        if (other.views, other.source_rig.digest) != (self.views, self.source_rig.digest):
            follows.add("_targets")
            if not self.asked_for and self.settings.rendering.paths is None:
                texts = (PATHS.default(other.calibrated_rig, other.views, self.settings),)
                other = replace(other, path_texts=texts)
        kept = {k: v for k, v in self.__dict__.items() if k not in {*(f.name for f in fields(self)), *follows}}
        other.__dict__.update(kept)
        return other

    @cached_property
    def capture_facts(self) -> Facts:
        """What the capture has, as far as it decides which stages and inputs count: the roles of its cameras, and what
        each stage tells of it, in the order of flow."""
        views = self.asked_views
        sources = len(views.sources)
        roles = {SINGLE_SOURCE: sources == 1, FEW_SOURCES: sources < 3, HELD_OUT: bool(views.held_out)}
        known = Facts(frozenset(name for name, holds in roles.items() if holds))
        for s in STAGES:
            known = known | set(s.facts(self.capture, views, self.params(s), known))
        return known

    def asset_settings(self, name: str) -> Any:
        """The settings that say which models or weights an asset is, `auto` resolved."""
        stage, asset = ASSETS[name]
        return asset.settled(self.params(stage), self.facts)

    def evidence(self, stage: str) -> Evidence:
        """What the effects of a stage are decided by."""
        key = ("evidence", stage)
        if key not in self.memo:
            self.memo[key] = self._evidence(stage)
        return self.memo[key]

    def _evidence(self, stage: str) -> Evidence:
        capture, sources = self.capture, self.views.sources
        worked, numbers = self.source_frames, capture.numbers
        stride = int(np.diff(worked).min()) // int(np.diff(numbers).min()) if len(worked) > 1 else 1
        return Evidence(
            self.params(stage_named(stage)),
            self.capture_facts,
            self.calibrated_rig,
            self.source_rig,
            np.array([s.size for s in capture.pictures]),
            self.captured_to_calibrated,
            sources,
            (
                sources
                if ESTIMATED in self.capture_facts
                else tuple(v for v in sources if capture.joints and capture.joints[v] is not None)
            ),
            max(1, stride),
            tuple(self._targets.values()),
            of_believed(self.noted, self.asked_views.sources, sources),
        )

    @cached_property
    def verdicts(self) -> Verdicts:
        """What is known of every effect, and of the choices that measures have a say in."""
        return useful(self.evidence, self.settings.effects, self.params, self.capture_facts, self._named)

    @property
    def _named(self) -> frozenset[str]:
        """Stages and outputs that are asked for by name."""
        return self.named | self.exported | {a for a, keep in self.settings.keep.items() if keep == "always"}

    @property
    def effects(self) -> dict[str, EffectVerdict]:
        """What is known of every effect."""
        return self.verdicts.effects

    @property
    def choices(self) -> dict[str, ChoiceVerdict]:
        """What is known of the choices that measures have a say in, by `stage.setting`."""
        return self.verdicts.choices

    @cached_property
    def facts(self) -> Facts:
        """What decides which stages, inputs and outputs count: of the capture, the effects that are on (undecided
        ones count as on), what choices came to, the optional stages that are needed, and those outputs of
        sequence-wide stages that are asked for."""
        known = with_optional(self.params, decided_facts(self.capture_facts, self.verdicts))
        gone = Demand.of(self.params, known, self._named).gone
        constants = {w.name for s in STAGES if s.sequence_wide for w in s.writes}
        trusting = set(TRUST.asks) if asks(TRUST, tuple(self.cameras), self.settings.views.trust) else set()
        known |= constants & (self.exported | self.verdicts.asked | trusting)
        for s in reversed(STAGES):  # a sequence-wide stage that is asked asks those before it
            asked = not s.sequence_wide or bool(known & {w.name for w in s.writes})
            if asked and s.name not in gone:
                known |= constants & {r.array for r in s.reads_for(self.params(s), known)}
        return known

    @cached_property
    def waits(self) -> dict[str, tuple[str, ...]]:
        """{stage: outputs of sequence-wide stages} that the stage waits for: those that decide which cameras are
        believed, and what is undecided about it. A sequence-wide stage that something undecided asks waits for the
        stages before it, which may settle that."""
        first = [a for a in TRUST.asks if a not in self.noted] if self.cameras_undecided else []
        found: dict[str, dict[str, None]] = {s.name: dict.fromkeys(first) for s in STAGES if first and s.trust is None}
        wide_ones = [s for s in STAGES if s.sequence_wide and s.unneeded(self.params(s), self.capture_facts) is None]
        add_waits(found, self.verdicts.open, wide_ones, self.noted)
        return {s: tuple(arrays) for s, arrays in found.items()}

    def effect_states(self, stage: Stage) -> dict[str, str]:
        """{effect: on | undecided} of a stage's effects, and what its choices came to by what was measured; what is
        off is as good as absent and leaves no trace."""
        states: dict[str, str] = {e.name: self.effects[e.name].state for e in stage.effects}
        states |= {name: v.state for name, v in self.choices.items() if stage.name in v.stages}
        return {name: state for name, state in states.items() if state != "off"}

    @cached_property
    def paths(self) -> dict[str, CameraPath]:
        """{`<kind>-<8 hex>`: cameras} of every path asked for."""
        return {path.name: path for path in self._made_paths.values()}

    @cached_property
    def _made_paths(self) -> dict[str, CameraPath]:
        """{text: cameras}. Raises CalibrationError."""
        return self._targets if self.rig is self.calibrated_rig else self._paths_among(self.rig)

    @cached_property
    def _targets(self) -> dict[str, CameraPath]:
        """The same among calibrated cameras, by which effects are decided. Raises CalibrationError."""
        return self._paths_among(self.calibrated_rig)

    def _paths_among(self, rig: Rig) -> dict[str, CameraPath]:
        made = {text: PATHS.make(text, rig, self.views, self.source_frames, self.settings) for text in self.path_texts}
        for path in made.values():
            check_camera_names(path.names)
        return made

    @cached_property
    def joint_set(self) -> str | None:
        """Id of the joint set of `pose/*`; None without joints."""
        told = [
            s.joint_set(self.capture, self.asked_views, self.params(s), self.capture_facts)
            for s in STAGES
            if s.joint_set
        ]
        return next((name for name in told if name is not None), None)

    @cached_property
    def _declared_lengths(self) -> dict[str, int]:
        """Lengths of dimensions that follow from settings, as the stages declare them."""
        lengths = {} if self.joint_set is None else {"joint": len(JOINT_SETS[self.joint_set].names)}
        for stage in STAGES:
            lengths |= stage.dimensions(self.params(stage), self.capture_facts)
        return lengths

    def shape(self, path: str | None = None) -> dict[str, int]:
        """Length of every dimension; of the cameras of one path where it is given."""
        captured, size = np.array([s.size for s in self.capture.pictures]), self.calibrated_rig.size
        shape = {
            "frame": len(self.source_frames),
            "moment": len(self.source_frames),
            "view": len(size),
            "one_view": len(size),
            "other_view": len(size),
            "y": int(size[:, 1].max()),
            "x": int(size[:, 0].max()),
            "source_y": int(captured[:, 1].max()),
            "source_x": int(captured[:, 0].max()),
            **self._declared_lengths,
        }
        if path is not None:
            size = self.paths[path].size
            shape |= {"camera": len(size), "camera_y": int(size[:, 1].max()), "camera_x": int(size[:, 0].max())}
        return shape

    def unneeded(self) -> dict[str, str]:
        """{stage: reason} of the stages this capture does not need: by their own word, or sequence-wide ones nobody
        reads."""
        if "unneeded" not in self.memo:
            self.memo["unneeded"] = self._unneeded()
        return self.memo["unneeded"]

    def _unneeded(self) -> dict[str, str]:
        reasons = Demand.of(self.params, self.facts, self._named).gone
        unread = [s for s in STAGES if s.sequence_wide and not self.facts & {w.name for w in s.writes}]
        return reasons | {
            s.name: "no stage needs its constants and no effect its measures under these settings" for s in unread
        }

    @property
    def perhaps_unneeded(self) -> frozenset[str]:
        """Stages that may prove unneeded."""
        return perhaps_gone(self.params, self.capture_facts, self.verdicts, self._named)

    def refusals(self) -> list[str]:
        """Sentences about settings this capture cannot serve."""
        gone = self.unneeded()
        own = [why for s in STAGES if s.name not in gone and (why := s.refusal(self.params(s), self.facts)) is not None]
        captured = [s.size for s in self.capture.pictures]
        cropped = {*self.capture.crops, *self.settings.frames.crop}
        sizes = unexplained_sizes(self.capture.rig.names, captured, self.capture.rig.size, cropped)
        return [*sizes, *own, *refusals(self.evidence, self.effects)]


def make_context(sequence: SequenceGroup, settings: Any, paths: tuple[str, ...] = ()) -> Context:
    """The context of a sequence; `paths` are rendered instead of the settings' ones.

    Raises ConfigError for settings that this capture cannot serve.
    """
    must_be_cameras("detection.box", settings.detection.box, sequence.capture.rig.names, sequence.name)
    context = Context(sequence, settings, paths or tuple(settings.rendering.paths or ()), asked_for=bool(paths))
    if not paths and settings.rendering.paths is None:
        context = replace(context, path_texts=(PATHS.default(context.calibrated_rig, context.views, settings),))
    refusals = context.refusals()
    if refusals:
        raise ConfigError("\n".join(refusals))
    return context
