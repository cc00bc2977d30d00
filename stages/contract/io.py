"""What a kernel sees and what it gives back: arrays in, arrays out, no store and no scheduler.

A kernel is `run(inputs: Inputs, params) -> Iterator[Block]`. It reads lazily, view by view where it can, and yields one
block a shard, so that a partition of many views never lies in memory as a whole.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple, Protocol

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.storage.model.cameras import CameraPath, Rig


class Block(NamedTuple):
    """One shard of one output."""

    array: str
    """Name of the output as declared, with `{path}` left as it is."""
    data: Any
    """[frames of the partition, ...] without the view axis where `view` is given; a dict of columns for a table."""
    view: int | None = None
    """Index of the view, for arrays with a view axis."""
    notes: tuple[str, ...] = ()
    """What only the kernel knows and a user should: sentences that become warnings, as those of the stage's check."""


@dataclass(frozen=True)
class Views:
    """Which cameras give pictures to reconstruct from, and which are kept to measure against."""

    names: tuple[str, ...]
    """All cameras, in the order of the `view` axis."""
    sources: tuple[int, ...]
    """Indices of the views that may be reconstructed from."""
    held_out: tuple[int, ...]
    """Indices of the views that only metrics may look at."""


class PictureReader(Protocol):
    """Pictures as captured: no crop, no undistortion, one size a view."""

    def numbers(self, view: int) -> np.ndarray:
        """[n] int: the source frame numbers this view has, ascending."""

    def size(self, view: int) -> tuple[int, int]:
        """(width, height) of the captured pictures, px."""

    def identity(self, view: int, number: int) -> str:
        """A text that no other picture has."""

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w, 3] for each of the ascending frame numbers: uint8 sRGB, or float16 linear for HDR files."""


class MaskReader(Protocol):
    """Masks as given with the capture."""

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w] uint8, 0..255 soft foreground, in the captured picture's pixels, for each frame number."""

    def turned(self, view: int, numbers: Sequence[int]) -> list[int]:
        """Of frame numbers that were read, those whose masks marked the background and came the other way round."""


class JointReader(Protocol):
    """2D joints as given with the capture."""

    joint_set: str
    """Name of the joint set (`posegaussian.storage.model.joint_sets.JOINT_SETS`)."""

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] float64 (u, v, score) in the captured picture's pixels, our pixel centres; zero people is
        valid.

        A missing joint has score 0.
        """


class Joint3DReader(Protocol):
    """3D joints as given with the capture."""

    joint_set: str
    """Name of the joint set."""

    def read(self, number: int) -> np.ndarray:
        """[J, 4] float64 (x, y, z, score) in world metres; a missing joint has score 0."""


class DepthReader(Protocol):
    """True depth of a simulated capture."""

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w] float32 metres along the optical axis, 0 where there is no surface, in captured pixels."""


class DepthMapReader(DepthReader, Protocol):
    """Depth maps as the user gives them, of any resolution over the captured picture's field."""

    def numbers(self, view: int) -> np.ndarray:
        """[n] int: the source frame numbers with a map, ascending; none of a view without maps."""


@dataclass(frozen=True, eq=False)
class TaskScope:
    """What a task is about, apart from what it reads: frames, cameras, and what is known of the capture."""

    partition: range
    """Frame indices (of the sequence) this task produces; all of them for a task of the whole sequence, none for one
    that takes constants of a sample."""
    source_frames: np.ndarray
    """[len(partition)] int: source frame number of each frame of the partition."""
    time: np.ndarray
    """[len(partition)] float64 seconds."""
    valid: np.ndarray
    """[len(partition), V] bool: whether the view has a picture of that frame."""
    views: Views
    """Names and roles of the cameras."""
    view: int | None
    """The view of a task that runs over views."""
    rig: Rig
    """Cameras of `frames/*`: after crop, scale and undistortion (distortion is zero)."""
    source_rig: Rig
    """Cameras as calibrated, in our pixel centres."""
    captured_to_calibrated: np.ndarray
    """[V, 3] (scale, dx, dy): a captured pixel x is the calibrated pixel scale x + (dx, dy)."""
    path: CameraPath | None
    """Target cameras of the partition's frames, whatever halo is read, for a task over a path; over a halo they are
    asked for by array (`posegaussian.stages.contract.path_inputs`)."""
    facts: Facts
    """What the capture has, the names of the effects that are on and of the optional stages that are needed, and of a
    sequence-wide stage's outputs those that are asked for (`posegaussian.stages.contract.facts`)."""
    joint_set: str | None
    """Joint set of `pose/joints2d` and `pose/joints3d` (`posegaussian.storage.model.joint_sets`); None where the
    capture has no joints."""
    rate: float = 30.0
    """Source frames a second; only stages that are `timed` may use it."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of other stages, as far as the stage declares that it `sees` them."""


class Inputs(TaskScope, ABC):
    """Everything one task may see: its scope, and what it reads. Arrays are read through the store's digests, so what
    is read is what is fingerprinted."""

    def __init__(self, scope: TaskScope) -> None:
        """Of a task of that scope."""
        super().__init__(**{f.name: getattr(scope, f.name) for f in fields(TaskScope)})

    @abstractmethod
    def span(self, array: str) -> range:
        """Frame indices that `read(array)` covers: the partition and its halo, clipped to the sequence; of a source
        those that may be asked for."""

    @abstractmethod
    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """[len(span), ...]: one view's slice (the view axis removed), or the whole slice of an array without views.

        frames: indices within the span that are read instead of all of it, [len(frames), ...].
        first: how many entries of a list, its axis after the frame's, are read instead of all.
        """

    @abstractmethod
    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """(source frame numbers [n], whether each view has a picture of them [n, V]) of the frames `span(array)`, of
        an array or a source."""

    @abstractmethod
    def source(self, kind: str) -> Any:
        """The lazy reader of a source: "pictures", "masks", "joints", "joints3d", "depth" or "depth_maps"; or the
        pose "estimator"."""
