"""Lazy readers over the files that a capture refers to: what a kernel gets from `inputs.source(kind)`.

Each file is compared with what was imported when a reader first touches it; one that is gone or changed raises
SourceError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from posegaussian.storage.formats.body_scenes import read_bodies
from posegaussian.storage.formats.joint_files import (
    Detections,
    TrcFile,
    no_people,
    read_caliscope,
    read_coco,
    read_easymocap,
    read_openpose,
    read_trc,
)
from posegaussian.storage.formats.plain_hdf5 import Hdf5File
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import joint_set
from posegaussian.storage.model.masks import foreground, marks_background, without_blocks
from posegaussian.storage.readers import hdf5, images
from posegaussian.storage.readers.mask_options import read_as_meant
from posegaussian.storage.readers.video import VideoFile

TABLES = 32
"""Files of all frames' joints that a process remembers, parsed: those of as many cameras. A task reads a few frames of
each, and parsing them takes half a second for a thousand frames."""


class _Source:
    """Streams of one kind, file by file verified."""

    def __init__(self, capture: Capture, kind: str) -> None:
        self._names = capture.rig.names
        self._kind = kind.replace("_", " ")
        self._streams = capture.streams(kind)
        self._verified: set[str] = set()
        self._opened: dict[str, Hdf5File] = {}

    def _path(self, file: SourceFile) -> str:
        if file.path not in self._verified:
            file.verify()
            self._verified.add(file.path)
        return file.path

    def _stream(self, view: int) -> Stream:
        stream = self._streams[view]
        if stream is None:
            raise SourceError(
                f"camera {self._names[view]} has no {self._kind}; add them to the capture and import it again"
            )
        return stream

    def _files(self, view: int, numbers: Sequence[int]) -> Iterator[str]:
        stream = self._stream(view)
        files = dict(zip(stream.numbers, stream.files, strict=True))
        for n in numbers:
            if int(n) not in files:
                raise SourceError(
                    f"camera {self._names[view]} has no {self._kind} of frame {int(n)};"
                    " add the file and import the capture again"
                )
            yield self._path(files[int(n)])

    def _indices(self, view: int, numbers: Sequence[int]) -> list[int]:
        """What a view's one file calls the given source frames."""
        indices = []
        for n in numbers:
            index = self._stream(view).index_of(int(n))
            if index is None:
                raise SourceError(
                    f"camera {self._names[view]} has no {self._kind.removesuffix('s')} of frame {int(n)}: its file"
                    " lacks that instant; leave the frame out with frames.range"
                )
            indices.append(index)
        return indices

    def _hdf5(self, file: SourceFile) -> Hdf5File:
        path = self._path(file)
        if path not in self._opened:
            self._opened[path] = Hdf5File(path, "file")
        return self._opened[path]

    def _sized(self, view: int, number: int, picture: np.ndarray) -> np.ndarray:
        size = self._stream(view).size
        if (picture.shape[1], picture.shape[0]) != tuple(size):
            raise SourceError(
                f"{self._kind} of camera {self._names[view]}, frame {number}: {picture.shape[1]}x{picture.shape[0]} px,"
                f" the first one has {size[0]}x{size[1]} px"
            )
        return picture


class Pictures(_Source):
    """Pictures as captured (`posegaussian.stages.contract.io.PictureReader`)."""

    def numbers(self, view: int) -> np.ndarray:
        """[n] int source frame numbers of a view, ascending."""
        return np.asarray(self._stream(view).numbers, dtype=np.int64)

    def size(self, view: int) -> tuple[int, int]:
        """(width, height) of a view's pictures, px."""
        width, height = self._stream(view).size
        return width, height

    def identity(self, view: int, number: int) -> str:
        """Digest of the file and the frame's number: no other picture has it."""
        return self._stream(view).digest([number])

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w, 3] uint8 sRGB or float16 linear for each of the ascending frame numbers. Raises SourceError."""
        stream = self._stream(view)
        if stream.kind == "video":
            pictures = VideoFile(self._path(stream.files[0])).read(self._indices(view, numbers))
        elif stream.kind == "hdf5":
            file = self._hdf5(stream.files[0])
            pictures = (hdf5.read_picture(file, stream.options["data"], i) for i in self._indices(view, numbers))
        else:
            pictures = (images.read_picture(p) for p in self._files(view, numbers))
        for n, picture in zip(numbers, pictures, strict=True):
            yield self._sized(view, int(n), picture)


class Masks(_Source):
    """Masks as given, files of their own or the alpha of pictures (`posegaussian.stages.contract.io.MaskReader`)."""

    def __init__(self, capture: Capture, kind: str) -> None:
        super().__init__(capture, kind)
        self._shown = [s.size for s in capture.pictures]
        self._turned: set[tuple[int, int]] = set()

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w] uint8, 0..255 foreground, for each frame number, in pixels of its picture, whatever the mask's own
        are, and as the import found that they are meant (`read_as_meant`). One that marks the background, of a camera
        whose masks mostly hold less than half of the picture, is read the other way round. Raises SourceError."""
        for mask in self._given(view, numbers):
            yield images.resized(without_blocks(mask), self._shown[view])

    def turned(self, view: int, numbers: Sequence[int]) -> list[int]:
        """Of frame numbers that were read, those whose masks were read the other way round."""
        return [int(n) for n in numbers if (view, int(n)) in self._turned]

    def _given(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """The same in the mask's own pixels."""
        stream = self._stream(view)
        if stream.kind == "hdf5":
            file = self._hdf5(stream.files[0])
            for n, index in zip(numbers, self._indices(view, numbers), strict=True):
                yield self._sized(view, int(n), hdf5.read_mask(file, stream.options["data"], index))
            return
        for n, path in zip(numbers, self._files(view, numbers), strict=True):
            mask = self._sized(view, int(n), read_as_meant(path, stream.options))
            if stream.options.get("mostly_black") and marks_background(foreground(mask)):
                self._turned.add((view, int(n)))
                mask = np.uint8(255) - mask
            yield mask


class Depth(_Source):
    """True depth of a simulated capture (`posegaussian.stages.contract.io.DepthReader`)."""

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w] float32 metres along the optical axis, 0 = no surface, for each frame number. Raises SourceError."""
        for n, path in zip(numbers, self._files(view, numbers), strict=True):
            depth = images.read_depth(path) * np.float32(self._stream(view).options.get("scale", 1.0))
            yield self._sized(view, int(n), depth)


class DepthMaps(_Source):
    """Depth as the user gives it (`posegaussian.stages.contract.io.DepthMapReader`)."""

    def numbers(self, view: int) -> np.ndarray:
        """[n] int source frame numbers that have a map, ascending; none of a view without maps."""
        stream = self._streams[view]
        return np.asarray(() if stream is None else stream.numbers, dtype=np.int64)

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        """[h, w] float32 metres along the optical axis, 0 = no surface, for each frame number. Raises SourceError."""
        options = self._stream(view).options
        scale, inverse = float(options["scale"]), bool(options.get("inverse"))
        for n, path in zip(numbers, self._files(view, numbers), strict=True):
            yield self._sized(view, int(n), images.read_depth_map(path, scale, inverse))


_ONE_PICTURE: dict[str, Callable[[str], Detections]] = {"openpose": read_openpose, "easymocap": read_easymocap}


@lru_cache(maxsize=TABLES)
def _table(kind: str, file: SourceFile, camera: Any, joints: int) -> dict[Any, Detections]:
    """People of one camera by its frames, not to be written to, of a file that holds all frames and is what was
    imported."""
    found: dict[Any, Detections] = (
        read_coco(file.path, camera) if kind == "coco" else read_caliscope(file.path, camera, joints)
    )
    for detections in found.values():
        detections.joints.flags.writeable = detections.boxes.flags.writeable = False
    return found


@lru_cache(maxsize=1)
def _markers(file: SourceFile) -> TrcFile:
    """Of a file that is what was imported."""
    return read_trc(file.path)


class Joints(_Source):
    """2D joints as given (`posegaussian.stages.contract.io.JointReader`)."""

    def __init__(self, capture: Capture, kind: str) -> None:
        super().__init__(capture, kind)
        self.joint_set: str = next(s.options["joint_set"] for s in self._streams if s is not None)
        self._count = len(joint_set(self.joint_set))

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] float64 (u, v, score) in captured pixels, our centres;
        a frame without a file has zero people."""
        return self._detections(view, int(number)).joints

    def boxes(self, view: int, number: int) -> np.ndarray:
        """[people, 5] float64 (left, top, right, bottom, score) in captured pixels, our centres;
        score 0 where none is given."""
        return self._detections(view, int(number)).boxes

    def _detections(self, view: int, number: int) -> Detections:
        stream = self._streams[view]
        if stream is None or number not in stream.numbers:
            return no_people(self._count)
        if stream.kind in ("coco", "caliscope"):
            path = self._path(stream.files[0])
            named = stream.options.get("view") if stream.kind == "coco" else stream.options["camera"]
            table = _table(stream.kind, stream.files[0], named, self._count)
            found = table.get(stream.index_of(number), no_people(self._count))
        elif stream.kind == "hdf5":
            path, (index,) = stream.files[0].path, self._indices(view, [number])
            options = stream.options
            found = hdf5.read_joints(self._hdf5(stream.files[0]), options["data"], index, options["picked"])
        else:
            path = next(self._files(view, [number]))
            found = _ONE_PICTURE[stream.kind](path)
        if len(found.joints) == 0:
            return no_people(self._count)
        if found.joints.shape[1] != self._count:
            raise SourceError(
                f"{path} holds {found.joints.shape[1]} joints a person, {self.joint_set} has {self._count}; set"
                " joint_set at import"
            )
        return found


class Joints3D(_Source):
    """3D joints as given (`posegaussian.stages.contract.io.Joint3DReader`)."""

    def __init__(self, capture: Capture, kind: str) -> None:
        super().__init__(capture, kind)
        self.joint_set: str = self._stream(0).options["joint_set"]
        self._joints: Mapping[int, np.ndarray] | None = None

    def read(self, number: int) -> np.ndarray:
        """[J, 4] float64 (x, y, z, score) in world metres; a frame that the file lacks has score 0 throughout."""
        stream, names = self._stream(0), joint_set(self.joint_set).names
        if stream.kind == "bodies":
            found = read_bodies(next(self._files(0, [int(number)]))) if int(number) in stream.numbers else {}
            return found.get(stream.options["person"], np.zeros((len(names), 4)))
        if self._joints is None:
            self._path(stream.files[0])
            self._joints = _markers(stream.files[0]).joints(names, stream.options["axes"])
        return self._joints.get(int(number), np.zeros((len(names), 4)))


_READERS: dict[str, Callable[[Capture, str], Any]] = {
    "pictures": Pictures,
    "masks": Masks,
    "joints": Joints,
    "joints3d": Joints3D,
    "depth": Depth,
    "depth_maps": DepthMaps,
}


def open_source(capture: Capture, kind: str) -> Any:
    """The reader of a source kind: pictures, masks, joints, joints3d, depth or depth_maps (the protocols of
    `stages/contract/io.py`).

    Raises SourceError when the capture has no such source.
    """
    if not capture.has(kind):
        raise SourceError(f"the capture has no {kind.replace('_', ' ')}; import one that has them")
    return _READERS[kind](capture, kind)
