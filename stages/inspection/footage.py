"""What is looked at of a capture: its cameras, readers, and which frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import islice
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import JOINTS3D, Facts
from posegaussian.stages.contract.io import Inputs, TaskScope, Views
from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.imaging.camera_mapping import unreduced_size
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.inspection.joint_fit import joint_offsets, most_joints
from posegaussian.stages.silhouettes.presence import showing, shows_somebody
from posegaussian.stages.survey.algorithms.joints import RESIDUAL, SCORE, people, people_of, seen_joints
from posegaussian.stages.survey.algorithms.silhouettes import masks_of
from posegaussian.storage.model.cameras import Rig

PICTURES = 12
"""Pictures in which features are looked for, over all cameras: some seconds."""
PLACES = (0.5, 0.15, 0.85)
"""Where pictures are looked at, as shares of the frames: away from the ends, the middle one first."""
ASKED = (0.15, 0.85, 0.33, 0.67)
"""Where the estimator is asked for somebody, in this order."""
ASKED_VIEWS = 8
"""Cameras of whose pictures it is asked, one each a frame: they take seconds each."""
JOINT_FRAMES = 30
"""Frames whose joints are triangulated."""
RUN = 240
"""Consecutive frames whose joints are compared in time."""
LOOSE = 0.1
"""Share of the longer side within which cameras must agree on whom they see: one that is badly calibrated or out of
step is to be measured, not left out."""


class _ReaderInputs(Inputs):
    """What the survey's measures of pictures, masks and joints ask for: readers, and no arrays."""

    def __init__(self, scope: TaskScope, readers: Mapping[str, Any]) -> None:
        super().__init__(scope)
        self._readers = readers

    def source(self, kind: str) -> Any:
        """A reader."""
        return self._readers[kind]

    def span(self, array: str) -> range:
        """Raise: an inspection has no arrays."""
        raise KeyError(f"an inspection looks at files alone; there is no {array}")

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """Raise: an inspection has no arrays."""
        raise KeyError(f"an inspection looks at files alone; there is no {array}")

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """Raise: an inspection has no arrays."""
        raise KeyError(f"an inspection looks at files alone; there is no {array}")


def scope_of(rig: Rig, source_rig: Rig, captured_to_calibrated: np.ndarray, facts: Facts) -> TaskScope:
    """That of a whole capture whose cameras are all sources.

    `rig`: cameras of the pictures that are looked at, without lens, reduced; `captured_to_calibrated` [V, 3] (scale,
    dx, dy) as used; `facts`: joints2d, joints3d and masks, as far as there are any.
    """
    views = Views(rig.names, tuple(range(len(rig))), ())
    none, valid = np.zeros(0), np.zeros((0, len(rig)), bool)
    return TaskScope(
        partition=range(0),
        source_frames=none.astype(np.int64),
        time=none,
        valid=valid,
        views=views,
        view=None,
        rig=rig,
        source_rig=source_rig,
        captured_to_calibrated=captured_to_calibrated,
        path=None,
        facts=facts,
        joint_set=None,
    )


def inputs_of(scope: TaskScope, footage: Footage) -> Inputs:
    """For the survey's measures of pictures, masks and joints: a footage's files, seen by that scope."""
    return _ReaderInputs(scope, footage.readers)


def shared_numbers(numbers: Sequence[np.ndarray], views: Sequence[int]) -> np.ndarray:
    """Of source frame numbers by view, those that all of some views have, ascending."""
    return reduce(np.intersect1d, [numbers[v] for v in views])


def _spread(those: Sequence[int] | np.ndarray, places: Sequence[float] | np.ndarray) -> list[int]:
    """Those at some places, shares of all of them, each once."""
    return list(dict.fromkeys(int(those[round(float(p) * (len(those) - 1))]) for p in places))


@dataclass(eq=False)
class Footage:
    """A capture as an inspection sees it: all cameras that are believed are sources."""

    scope: TaskScope
    """Its cameras, who of them is believed, and what is known of it."""
    joint_crops: np.ndarray
    """[V, 3] the same for the pixels that joints refer to."""
    captured: np.ndarray
    """[V, 2] (width, height) px of the pictures."""
    numbers: list[np.ndarray]
    """Source frame numbers of each view, of those that are worked on."""
    frame_rate: float
    """Frames a second."""
    readers: Mapping[str, Any]
    """Readers by kind: pictures always; masks of all views, joints and joints3d where there are any; the estimator by
    which a run finds joints, where it does."""
    repeats: Mapping[int, Sequence[tuple[int, int]]] = field(default_factory=dict)
    """{view: runs (first, last) of frames throughout which its picture files are the same while most others' change} of
    cameras with a file a picture."""
    pictures: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)
    """(view, number) -> [h, w, 3] uint8 without lens, as far as they were read."""
    told: dict[tuple[str, int, int], bool] = field(default_factory=dict)
    """(reader, view, number) -> whether somebody is in that picture, as far as it was asked."""

    @property
    def rig(self) -> Rig:
        """Cameras of the pictures that are looked at."""
        return self.scope.rig

    @property
    def source_rig(self) -> Rig:
        """Cameras as calibrated."""
        return self.scope.source_rig

    @property
    def captured_to_calibrated(self) -> np.ndarray:
        """[V, 3] (scale, dx, dy) as used."""
        return self.scope.captured_to_calibrated

    @property
    def facts(self) -> Facts:
        """joints2d, joints3d and masks, as far as there are any."""
        return self.scope.facts

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return self.rig.names

    @property
    def believed(self) -> tuple[int, ...]:
        """Indices of the cameras that all others are compared with."""
        return self.scope.views.sources

    @cached_property
    def left_out(self) -> tuple[int, ...]:
        """Indices of the cameras that a run leaves out by itself."""
        return tuple(v for v in range(len(self.rig)) if v not in self.believed)

    def without(self, names: Sequence[str]) -> Footage:
        """The same footage, of which the cameras of these names are not believed."""
        believed = tuple(v for v in self.believed if self.names[v] not in names)
        views = replace(self.scope.views, sources=believed)
        return replace(self, scope=replace(self.scope, views=views)) if names else self

    def standing(self, turns: Mapping[str, np.ndarray]) -> Footage:
        """The same footage, cameras turned by [3] rad about their own axes, by name."""
        of_view = np.array([turns.get(name, np.zeros(3)) for name in self.names])
        scope = replace(self.scope, rig=turned(self.rig, of_view), source_rig=turned(self.source_rig, of_view))
        return replace(self, scope=scope)

    def source(self, kind: str) -> Any:
        """A reader."""
        return self.readers[kind]

    @cached_property
    def inputs(self) -> Inputs:
        """For the survey's measures of pictures and masks: of believed cameras."""
        return inputs_of(self.scope, self)

    @cached_property
    def _whole(self) -> TaskScope:
        """The scope with all cameras, believed or not."""
        return replace(self.scope, views=replace(self.scope.views, sources=tuple(range(len(self.rig)))))

    @cached_property
    def joint_inputs(self) -> Inputs:
        """Of all cameras, with the pixels that joints refer to."""
        return inputs_of(replace(self._whole, captured_to_calibrated=self.joint_crops), self)

    def masks(self, number: int) -> dict[int, np.ndarray]:
        """[h, w] uint8 masks of one source frame in pixels of `rig`, of all cameras that have a picture of it."""
        return masks_of(inputs_of(self._whole, self), number)

    @cached_property
    def px(self) -> np.ndarray:
        """[V] captured px per px of `rig`."""
        unreduced = unreduced_size(self.rig, self.source_rig)
        return np.asarray(unreduced[:, 0] / self.rig.size[:, 0] / self.captured_to_calibrated[:, 0])

    @cached_property
    def longest(self) -> np.ndarray:
        """[V] captured px that the longer side of `rig` stands for."""
        return np.asarray(self.rig.size.max(axis=1) * self.px)

    @cached_property
    def common(self) -> np.ndarray:
        """Source frame numbers that all believed cameras have; of the camera with most where there is none."""
        shared = shared_numbers(self.numbers, self.believed)
        return shared if len(shared) else max(self.numbers, key=len)

    @cached_property
    def looked_at(self) -> list[int]:
        """Frame numbers whose pictures are read, up to three, away from the ends, the middle one first; where nobody is
        in that one, of frames that show somebody, as far as any is found."""
        wanted = max(1, min(len(PLACES), PICTURES // len(self.rig)))
        usual = _spread(self.common, PLACES[:wanted])
        most = {"masks": (len(self.believed) + 1) // 2}  # where few see the subject as it comes in, little is measured
        if any(self._seeing(kind, self.middle) >= most.get(kind, 1) for kind in self.tellers):
            return usual
        for kind in self.tellers:
            if chosen := self._showing(kind, wanted):
                return usual if self.middle in chosen else _spread(chosen, PLACES[:wanted])
        return usual

    @property
    def middle(self) -> int:
        """Number of the middle frame."""
        return _spread(self.common, PLACES[:1])[0]

    @cached_property
    def tellers(self) -> tuple[str, ...]:
        """The readers that tell whether somebody is in a picture: of masks, where there are any, else of joints; an
        estimator tells nothing of what has joints in space, which may be no person."""
        of_joints = ("joints",) if JOINTS3D in self.facts else ("joints", "found")
        kinds = ("masks",) if "masks" in self.readers else of_joints
        return tuple(k for k in kinds if k in self.readers)

    @cached_property
    def asked_views(self) -> list[int]:
        """Believed cameras, up to `ASKED_VIEWS`, of whose pictures the estimator is asked."""
        return _spread(self.believed, np.linspace(0, 1, min(len(self.believed), ASKED_VIEWS)))

    def shows(self, kind: str, view: int, number: int) -> bool:
        """Whether somebody is in a picture that there is, by a reader of masks or joints."""
        key = kind, view, number
        if key not in self.told:
            reader = self.readers[kind]
            if kind == "masks":
                (mask,) = reader.read(view, [number])
                self.told[key] = shows_somebody(mask)
            else:
                self.told[key] = people(reader.read(view, number)) > 0
        return self.told[key]

    def _seeing(self, kind: str, number: int, views: Sequence[int] | None = None) -> int:
        """Believed cameras, of some alone, that show somebody in one frame."""
        of = self.believed if views is None else views
        return sum(self.shows(kind, v, number) for v in of if number in self.numbers[v])

    def _showing(self, kind: str, wanted: int) -> list[int]:
        """Frames that show somebody, ascending: of those looked through, those that half as many cameras as in the best
        one see at least; of those that the estimator is asked of the first that are `wanted`."""
        if kind == "found":
            seen = (n for n in _spread(self.common, ASKED) if self._seeing(kind, n, self.asked_views))
            return sorted(islice(seen, wanted))
        return [int(n) for n in showing(self.common, lambda n: self._seeing(kind, n))]

    @cached_property
    def warps(self) -> list[Warp]:
        """From captured pictures to those of `rig`."""
        return [
            Warp(v, tuple(self.captured[v]), self.source_rig, self.rig, self.captured_to_calibrated[v])
            for v in range(len(self.rig))
        ]

    def picture(self, view: int, number: int) -> np.ndarray | None:
        """[h, w, 3] uint8 of `rig`; None where the camera lacks that frame."""
        if number not in self.numbers[view]:
            return None
        if (view, number) not in self.pictures:
            self.pictures[view, number] = self.warps[view](self.raw(view, number))
        return self.pictures[view, number]

    def raw(self, view: int, number: int) -> np.ndarray:
        """[h, w, 3] uint8 as captured."""
        (given,) = self.source("pictures").read(view, [number])
        return to_display(given)

    @cached_property
    def joint_numbers(self) -> list[int]:
        """Frame numbers whose joints are triangulated: evenly, and those whose pictures are looked at."""
        index = np.rint(np.linspace(0, len(self.common) - 1, min(len(self.common), JOINT_FRAMES))).astype(int)
        return sorted({*(int(n) for n in self.common[index]), *self.looked_at})

    @cached_property
    def joints(self) -> tuple[np.ndarray, np.ndarray]:
        """Joints seen [F, V, 17, 3] px of `rig` and, by the believed cameras, in space [F, 17, 4] in
        `joint_numbers`."""
        seen = np.stack([seen_joints(self.joint_inputs, n, LOOSE) for n in self.joint_numbers])
        views = list(self.believed)
        rig = self.rig.subset(views)
        return seen, np.stack([triangulate(rig, s[views], SCORE, RESIDUAL) for s in seen])

    @cached_property
    def shown(self) -> np.ndarray:
        """[F, V] joints that a camera shows of whomever it shows most of, in `joint_numbers`."""
        views, inputs = range(len(self.rig)), self.joint_inputs
        return np.array([[most_joints(people_of(inputs, v, n)) for v in views] for n in self.joint_numbers])

    @cached_property
    def comparable(self) -> np.ndarray:
        """[V] of `shown`, all frames together: in those in which another camera shows somebody, too."""
        others = (self.shown > 0).sum(axis=1, keepdims=True) - (self.shown > 0)
        return np.asarray(np.where(others > 0, self.shown, 0).sum(axis=0))

    @cached_property
    def joint_offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets [F, V, 17, 2] px of `rig` from the projections, and which are known [F, V, 17]."""
        seen, space = self.joints
        return joint_offsets(self.rig, np.where(seen[..., 2:] >= SCORE, seen, 0.0), space)

    @cached_property
    def step(self) -> int:
        """Source frame numbers from one frame to the next."""
        every = np.unique(np.concatenate(self.numbers))
        return int(np.diff(every).min()) if len(every) > 1 else 1

    @cached_property
    def tracks(self) -> np.ndarray:
        """[F, V, 17, 3] joints of up to `RUN` consecutive frames from the middle, px of `rig`; score 0 where a
        camera lacks the frame or the joint."""
        every = np.unique(np.concatenate(self.numbers))
        step = self.step
        start = int(every[max(0, (len(every) - RUN) // 2)])
        found = [
            seen_joints(self.joint_inputs, n, LOOSE)
            for n in range(start, min(int(every[-1]), start + (RUN - 1) * step) + 1, step)
        ]
        out = np.stack(found)
        return np.where(out[..., 2:] >= SCORE, out, 0.0)
