"""One sequence as a plan sees it: capture, settings, roles, time, shape and camera paths. No data is read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stages.contract import Facts, Stage
from stages.frames.layout import captured_to_calibrated, frames_rig
from stages.geometry.paths import make_path
from stages.io import Views
from stages.registry import STAGES
from storage.archive import Sequence
from storage.capture import Capture
from storage.errors import ConfigError
from storage.joints import JOINT_SETS
from storage.rig import CameraPath, Rig
from storage.timegrid import TimeGrid, select


@dataclass(frozen=True)
class Context:
    """A sequence under its settings."""

    sequence: Sequence
    """Where it is kept."""
    settings: Any
    """Validated settings of this sequence."""
    path_texts: tuple[str, ...]
    """Camera paths as written: in the settings, or asked for by an export."""

    @cached_property
    def capture(self) -> Capture:
        """The registered capture."""
        return self.sequence.capture

    def params(self, stage: Stage) -> Any:
        """Settings of one stage."""
        return getattr(self.settings, stage.name)

    @cached_property
    def views(self) -> Views:
        """Roles of the cameras. Raises ConfigError for names that the capture does not have or that play both roles."""
        names = self.capture.rig.names
        roles = self.settings.views
        for key, chosen in (("sources", roles.sources or []), ("held_out", roles.held_out)):
            for name in chosen:
                if name not in names:
                    raise ConfigError(f"views.{key}: sequence {self.sequence.name} has no camera {name!r}; it has {', '.join(names)}")
        sources = roles.sources if roles.sources is not None else [n for n in names if n not in roles.held_out]
        both = sorted(set(sources) & set(roles.held_out))
        if both:
            raise ConfigError(f"views: {', '.join(both)} cannot be a source and held out at once")
        if not sources:
            raise ConfigError(f"views: no camera of sequence {self.sequence.name} is left as a source; shorten views.held_out")
        return Views(names, tuple(i for i, n in enumerate(names) if n in sources), tuple(i for i, n in enumerate(names) if n in roles.held_out))

    @cached_property
    def active_views(self) -> tuple[int, ...]:
        """Views whose pictures are worked on: sources and held-out ones."""
        return tuple(sorted({*self.views.sources, *self.views.held_out}))

    @cached_property
    def rig(self) -> Rig:
        """Cameras of `frames/*`."""
        return frames_rig(self.capture.rig, self.settings.frames)

    @cached_property
    def captured_to_calibrated(self) -> np.ndarray:
        """[V, 3] (scale, dx, dy) of `frames.crop`."""
        return captured_to_calibrated(self.capture.rig, self.settings.frames)

    @cached_property
    def source_frames(self) -> np.ndarray:
        """[F] source frame numbers. Raises ConfigError when the range selects none."""
        numbers = self.capture.numbers
        chosen = select(numbers, self.settings.frames.range)
        if not len(chosen):
            raise ConfigError(f"frames.range {self.settings.frames.range!r} selects no frame of sequence {self.sequence.name}; its source frames are {numbers[0]}..{numbers[-1]}")
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

    @cached_property
    def facts(self) -> Facts:
        """What the capture has, as far as it decides which stages and inputs count."""
        capture, sources = self.capture, self.views.sources

        def every(kind: str) -> bool:
            streams = capture.streams(kind)
            return bool(streams) and all(streams[v] is not None for v in self.active_views)

        streams = capture.joints
        facts = {
            "joints2d": any(streams[v] is not None for v in sources) if streams else False,
            "joints3d": capture.joints3d is not None,
            "masks": every("masks"),
            "truth_depth": every("depth"),
            "held_out": bool(self.views.held_out),
            "several_frames": len(capture.numbers) > 1,
        }
        return frozenset(k for k, present in facts.items() if present)

    @cached_property
    def paths(self) -> dict[str, CameraPath]:
        """{`<kind>-<8 hex>`: cameras} of every path asked for."""
        made = [make_path(t, self.rig, self.views, self.source_frames) for t in self.path_texts]
        return {p.name: p for p in made}

    @cached_property
    def joint_set(self) -> str | None:
        """Joint set of `pose/*`: of the source views' 2D joints, else of the 3D joints; None without either."""
        kind = "joints2d" if "joints2d" in self.facts else "joints3d"
        streams = [self.capture.joints[v] for v in self.views.sources] if kind == "joints2d" else [self.capture.joints3d]
        return next((s.options["joint_set"] for s in streams if s is not None), None)

    def shape(self, path: str | None = None) -> dict[str, int]:
        """Length of every dimension; of the cameras of one path where it is given."""
        captured = np.array([s.size for s in self.capture.pictures])
        shape = {
            "frame": len(self.source_frames),
            "view": len(self.rig),
            "y": int(self.rig.size[:, 1].max()),
            "x": int(self.rig.size[:, 0].max()),
            "source_y": int(captured[:, 1].max()),
            "source_x": int(captured[:, 0].max()),
            "sample": self.settings.survey.sample,
        }
        if self.joint_set is not None:
            shape["joint"] = len(JOINT_SETS[self.joint_set].names)
        if path is not None:
            size = self.paths[path].size
            shape |= {"camera": len(size), "camera_y": int(size[:, 1].max()), "camera_x": int(size[:, 0].max())}
        return shape

    def unneeded(self) -> dict[str, str]:
        """{stage: reason} of the stages this capture does not need: by their own word, or sequence-wide ones nobody reads."""
        reasons = {s.name: why for s in STAGES if (why := s.unneeded(self.params(s), self.facts)) is not None}
        read = {r.array for s in STAGES if s.name not in reasons for r in s.reads_for(self.params(s), self.facts)}
        unread = [s for s in STAGES if s.sequence_wide and not read & {w.name for w in s.writes}]
        return reasons | {s.name: "no stage needs its constants under these settings" for s in unread}

    def refusals(self) -> list[str]:
        """Sentences about settings this capture cannot serve."""
        gone = self.unneeded()
        return [why for s in STAGES if s.name not in gone and (why := s.refusal(self.params(s), self.facts)) is not None]


def make_context(sequence: Sequence, settings: Any, paths: tuple[str, ...] = ()) -> Context:
    """The context of a sequence; `paths` are rendered instead of the settings' ones.

    Raises ConfigError when a stage refuses its settings for this capture.
    """
    default = ("held_out",) if settings.views.held_out else ("orbit",)
    texts = paths or tuple(settings.rendering.paths if settings.rendering.paths is not None else default)
    context = Context(sequence, settings, texts)
    refusals = context.refusals()
    if refusals:
        raise ConfigError("\n".join(refusals))
    return context
