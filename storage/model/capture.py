"""A capture as an importer found it: cameras, and for every view which files hold what.

Files are referenced, not copied; each is known by its sha256, its size and its modification time. The capture is kept
as JSON in the sequence's attributes; `sources.py` makes lazy readers from it.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.documents import regular
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.plausible import check_rate
from posegaussian.storage.model.spec import digest
from posegaussian.storage.model.splits import Split

PER_VIEW = ("pictures", "masks", "joints", "depth", "depth_maps")
"""Kinds of sources with a stream a view; 3D joints have one for all."""


def _read(path: str) -> str:
    """Digest of a file, read piece by piece. Raises SourceError where it cannot be read."""
    try:
        with open(path, "rb") as f:
            return hashlib.file_digest(f, "sha256").hexdigest()
    except OSError as e:
        raise SourceError(f"cannot read {path}: {e.strerror}") from e


@cache
def _sha256(path: str, size: int, mtime_ns: int) -> str:
    return _read(path)


@dataclass(frozen=True)
class SourceFile:
    """One referenced file."""

    path: str
    """Absolute path."""
    sha256: str
    """Digest of the content at import."""
    size: int
    """Bytes."""
    mtime_ns: int
    """Modification time at import; while size and time are unchanged the file is not hashed again but by `damage`."""

    @classmethod
    def of(cls, path: str | Path) -> SourceFile:
        """Reference an existing file. Raises SourceError when it is missing or unreadable."""
        stat = regular(path)
        p = str(Path(path).resolve())
        return cls(p, _sha256(p, stat.st_size, stat.st_mtime_ns), stat.st_size, stat.st_mtime_ns)

    @property
    def touched(self) -> bool:
        """Whether the file is gone, or its size or time is not that of the import; its content is not read."""
        try:
            stat = os.stat(self.path)
        except OSError:
            return True
        return (stat.st_size, stat.st_mtime_ns) != (self.size, self.mtime_ns)

    def verify(self) -> None:
        """Raise SourceError when the file is gone or its content is not what was imported: it is read only where size
        or time changed."""
        p = Path(self.path)
        try:
            stat = p.stat()
        except OSError as e:
            raise SourceError(
                f"source file {p} cannot be read any more ({e.strerror}); put it back or import the capture again"
            ) from e
        if (stat.st_size, stat.st_mtime_ns) == (self.size, self.mtime_ns):
            return
        if (how := self._difference(stat.st_size, lambda: SourceFile.of(p).sha256)) is not None:
            raise SourceError(
                f"source file {p} changed since it was imported: {how};"
                " put the old one back or import the capture again"
            )

    def damage(self) -> str | None:
        """How the content is not what was imported, in words, or None: it is read again, whatever size and time say.
        Raises SourceError where it cannot be read."""
        return self._difference(regular(self.path).st_size, lambda: _read(self.path))

    def _difference(self, size: int, sha256: Callable[[], str]) -> str | None:
        if size != self.size:
            return f"it has {size} bytes, not {self.size}"
        return None if sha256() == self.sha256 else "it has the same size and another content"


ONE_FILE = ("video", "coco", "caliscope", "trc", "hdf5")
"""Kinds of streams whose one file holds all frames."""


@dataclass(frozen=True)
class Stream:
    """The files of one kind of one view: a video, or one file a frame."""

    kind: Literal["video", "images", "openpose", "coco", "easymocap", "caliscope", "trc", "hdf5", "bodies"]
    """video: one file, frames by 0-based index; images: one file a frame number; hdf5: one file with pictures, masks or
    joints, `options["data"]` is the path in it; bodies: one file a frame number of joints in space; the others: joint
    formats."""
    files: tuple[SourceFile, ...]
    """One file for the kinds of `ONE_FILE`; else one for every number."""
    numbers: tuple[int, ...]
    """Source frame numbers, ascending."""
    size: tuple[int, int] = (0, 0)
    """(width, height) in px of the captured pictures; (0, 0) where it does not apply."""
    options: dict[str, Any] = field(default_factory=dict)
    """What a reader of this format must know besides, for example a joint set or a person's id;
    `indices` as in `index_of`."""

    def index_of(self, number: int) -> int | None:
        """What the one file calls a source frame, such as the frame of a video: its entry in `options["indices"]`,
        which go with `numbers`.

        Without indices it is the number itself; with them, None for a number that the stream does not have.
        """
        return self._index_of.get(number) if "indices" in self.options else number

    def renumbered(self, new: Mapping[int, int]) -> Stream | None:
        """What it shows at number n as number `new[n]`, ascending as n does; numbers that have no new one are left
        out, and None stands for a stream of which nothing is left."""
        kept = [(i, n) for i, n in enumerate(self.numbers) if n in new]
        if not kept:
            return None
        numbers = tuple(new[n] for _, n in kept)
        if self.kind in ONE_FILE:
            return replace(
                self, numbers=numbers, options={**self.options, "indices": [self.index_of(n) for _, n in kept]}
            )
        return replace(self, numbers=numbers, files=tuple(self.files[i] for i, _ in kept))

    def digest(self, numbers: Sequence[int] | np.ndarray) -> str:
        """Digest of the files behind some frame numbers: of the whole file where one file holds all, and which of
        its frames these are."""
        held = sorted({int(n) for n in numbers} & self._file_of.keys())
        shas = [self.files[0].sha256] if len(self.files) == 1 else [self._file_of[n].sha256 for n in held]
        options = (
            {**self.options, "indices": [self._index_of[n] for n in held]}
            if "indices" in self.options
            else self.options
        )
        return digest([self.kind, shas, held, options])

    def shas(self, numbers: Sequence[int] | np.ndarray) -> dict[int, str]:
        """{frame number: digest of its file} of those frame numbers that have a file of their own, ascending."""
        if self.kind in ONE_FILE:
            return {}
        return {n: self._file_of[n].sha256 for n in sorted({int(n) for n in numbers} & self._file_of.keys())}

    @cached_property
    def _index_of(self) -> dict[int, int]:
        """{frame number: what the file calls it}, where these differ."""
        return dict(zip(self.numbers, self.options["indices"], strict=True))

    @cached_property
    def _file_of(self) -> dict[int, SourceFile]:
        """{frame number: the file that holds it}."""
        return dict(
            zip(self.numbers, self.files * len(self.numbers) if len(self.files) == 1 else self.files, strict=True)
        )


def _runs(own: Mapping[int, str], others: Sequence[Mapping[int, str]]) -> list[tuple[int, int]]:
    """Of `Capture.repeats`, by the digests {frame number: digest} of one view and of all others."""
    out: list[tuple[int, int]] = []
    for a, b in pairwise(own):
        changed = [o[a] != o[b] for o in others if a in o and b in o]
        if own[a] == own[b] and 2 * sum(changed) > len(changed):
            out = [*out[:-1], (out[-1][0], b)] if out and out[-1][1] == a else [*out, (a, b)]
    return out


@dataclass(frozen=True, eq=False)
class Capture:
    """Everything an importer found out about one capture."""

    layout: str
    """Name of the importer."""
    rig: Rig
    """Cameras as calibrated, in our pixel centres, one for every view."""
    frame_rate: float
    """Frames per second of the source; time = number / frame_rate."""
    pictures: tuple[Stream, ...]
    """[V] pictures of each view."""
    masks: tuple[Stream | None, ...] = ()
    """[V] masks of each view, or empty."""
    joints: tuple[Stream | None, ...] = ()
    """[V] 2D joints of each view, or empty; `options["joint_set"]` names their joint set."""
    joints3d: Stream | None = None
    """3D joints; `options["joint_set"]` names their joint set."""
    depth: tuple[Stream | None, ...] = ()
    """[V] true depth of each view of a simulated capture, or empty;
    nothing is reconstructed from it but on demand (`depth.method: truth`)."""
    depth_maps: tuple[Stream | None, ...] = ()
    """[V] depth of each view as the user gives it to reconstruct from, or empty; `options["scale"]` is metres per
    unit of its files."""
    crops: Mapping[str, Crop] = field(default_factory=dict)
    """By camera, how captured pixels become calibrated ones where that is no identity, as found or said at import;
    `frames.crop` overrules it."""
    held_out: tuple[str, ...] = ()
    """Cameras that only metrics may look at, where the capture says so; `views` of the settings overrules it."""
    splits: Mapping[str, Split] = field(default_factory=dict)
    """By name, the protocols of its data set, for `views.sources` and `frames.range`."""
    data_set: str = ""
    """Name of the published data set that it is of, where the layout does not say it, as of scans."""
    notes: tuple[str, ...] = ()
    """Sentences the user is shown after the import: what was found, chosen, left out."""

    def __post_init__(self) -> None:
        """Raise SourceError for a frame rate that no camera has."""
        check_rate(f"{self.layout} capture", self.frame_rate)

    @property
    def numbers(self) -> np.ndarray:
        """[N] ascending source frame numbers that at least one view has."""
        return np.unique(np.concatenate([np.asarray(s.numbers, dtype=np.int64) for s in self.pictures]))

    def in_step(self, late: Sequence[int]) -> Capture:
        """The capture with every view's files renumbered: picture, mask, joints and depth n of view v are those of
        number n + late[v].

        No frame is added: what would come before the first source frame or after the last one is left out. 3D joints
        stay. Raises ConfigError where that leaves a view without a picture.
        """
        if not any(late):
            return self
        first, last = int(self.numbers[0]), int(self.numbers[-1])

        def moved(kind: str) -> tuple[Stream | None, ...]:
            return tuple(
                s if s is None or not k else s.renumbered({n: n - k for n in s.numbers if first <= n - k <= last})
                for s, k in zip(self.streams(kind), late, strict=False)
            )

        for name, k, own, left in zip(self.rig.names, late, self.pictures, moved("pictures"), strict=True):
            if left is None:
                raise ConfigError(
                    f"frames.time_offset: {k} frames move all pictures of camera {name} ({own.numbers[0]} to"
                    f" {own.numbers[-1]}) out of the frames {first} to {last}; set fewer frames"
                )
        return replace(self, **{k: moved(k) for k in ("pictures", "masks", "joints", "depth")})  # type: ignore[arg-type]

    def worked(self, late: Sequence[int], masked: bool) -> Capture:
        """What is worked on: `in_step`, and with `masked` without pictures that lack a mask. Raises ConfigError."""
        capture = self.in_step(late)
        return capture.masked() if masked else capture

    def masked(self) -> Capture:
        """The capture, where every camera has masks, without the pictures that have none: nothing tells where the
        subject is in them, and a frame that a camera lacks is made of the others. A camera none of whose pictures has
        one keeps them."""
        if len(self.masks) != len(self.pictures) or None in self.masks:
            return self
        pictures = tuple(
            s if m is None or set(s.numbers) <= set(m.numbers) else s.renumbered({n: n for n in m.numbers}) or s
            for s, m in zip(self.pictures, self.masks, strict=True)
        )
        return self if pictures == self.pictures else replace(self, pictures=pictures)

    def repeats(self, worked: Sequence[int] | np.ndarray) -> list[list[tuple[int, int]]]:
        """[V] runs (first, last) of those source frames throughout which a view's picture files are the same, while
        those of most other views change; none of views whose pictures lie in one file."""
        shas = [s.shas(worked) for s in self.pictures]
        return [_runs(own, [o for o in shas if o is not own]) for own in shas]

    def streams(self, kind: str) -> tuple[Stream | None, ...]:
        """Streams of a source kind: one of PER_VIEW, or joints3d (one entry)."""
        return (self.joints3d,) if kind == "joints3d" else tuple(getattr(self, kind))

    @property
    def files(self) -> list[SourceFile]:
        """All files of all kinds, each once."""
        streams = [s for kind in (*PER_VIEW, "joints3d") for s in self.streams(kind)]
        return list(dict.fromkeys(f for s in streams if s is not None for f in s.files))

    def has(self, kind: str) -> bool:
        """Whether any view has a source of that kind."""
        return any(s is not None for s in self.streams(kind))

    def to_json(self, home: str = "") -> dict[str, Any]:
        """Plain JSON types; `from_json` with the same `home` is the inverse, or with another one, where this folder was
        moved to: files below it go by their path from there."""
        out: dict[str, Any] = {k: getattr(self, k) for k in ("layout", "frame_rate", "notes")}
        out["rig"] = {
            "names": list(self.rig.names),
            **{k: getattr(self.rig, k).tolist() for k in ("intrinsics", "distortion", "world_to_camera", "size")},
        }
        above = os.path.join(home, "") if home else None

        def stream(s: Stream | None) -> dict[str, Any] | None:
            if s is None:
                return None
            told = asdict(s)
            for f in told["files"]:
                if above is not None and f["path"].startswith(above):
                    f["path"] = f["path"].removeprefix(above)
            return told

        for kind in PER_VIEW:
            out[kind] = [stream(s) for s in self.streams(kind)]
        out["joints3d"] = stream(self.joints3d)
        out["crops"] = {name: crop.model_dump() for name, crop in self.crops.items()}
        out["held_out"] = self.held_out
        if self.data_set:
            out["data_set"] = self.data_set
        if self.splits:
            out["splits"] = {name: asdict(split) for name, split in self.splits.items()}
        return out

    @classmethod
    def from_json(cls, data: dict[str, Any], home: str = "") -> Capture:
        """The capture that `to_json` described, what lay below its `home` below this one."""

        def stream(s: dict[str, Any] | None) -> Stream | None:
            if s is None:
                return None
            return Stream(
                s["kind"],
                tuple(SourceFile(**{**f, "path": os.path.join(home, f["path"])}) for f in s["files"]),
                tuple(s["numbers"]),
                tuple(s["size"]),
                s["options"],
            )

        r = data["rig"]
        rig = Rig(
            tuple(r["names"]),
            np.array(r["intrinsics"], dtype=np.float64),
            np.array(r["distortion"], dtype=np.float64),
            np.array(r["world_to_camera"], dtype=np.float64),
            np.array(r["size"], dtype=np.int64),
        )
        kinds: dict[str, Any] = {k: tuple(stream(s) for s in data.get(k, ())) for k in PER_VIEW}
        # archives of older versions have none of these
        crops = {name: Crop.model_validate(c) for name, c in data.get("crops", {}).items()}
        return cls(
            data["layout"],
            rig,
            data["frame_rate"],
            joints3d=stream(data["joints3d"]),
            crops=crops,
            held_out=tuple(data.get("held_out", ())),
            splits={
                name: Split(tuple(s["sources"]), tuple(s["held_out"]), s["frames"])
                for name, s in data.get("splits", {}).items()
            },
            data_set=data.get("data_set", ""),
            notes=tuple(data["notes"]),
            **kinds,
        )
