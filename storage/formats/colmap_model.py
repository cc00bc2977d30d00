"""COLMAP's sparse model, text or binary: cameras, posed images with what they observed, and points.

Poses are world to camera, quaternions (w, x, y, z) of Hamilton's convention, OpenCV axes, a unit of their own; pixel
centres are ours, the first at (0.5, 0.5). Format: https://colmap.github.io/format.html and cameras.html. `rigs` and
`frames` of newer versions repeat the poses that `images` has, so they are not needed.

Own code in place of pycolmap 4.2.1: of 60 spoilt binary models 5 made it run for more than a minute, and loaded before
OpenCV it makes OpenCV abort when a PNG is written; it takes 0.7 s to import and 135 MB. Here every count is compared
with the bytes that are left before anything is made. Tests compare the two.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posegaussian.storage.model.documents import MEGABYTE, read_bytes, read_text, shortened, whole
from posegaussian.storage.model.errors import CalibrationError, SourceError

MODELS: Mapping[int, tuple[str, int]] = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
"""{number: (name, parameters)}, COLMAP's src/colmap/sensor/models.h."""
LARGEST = 256 * MEGABYTE
"""Bytes of a file of a model."""
LONGEST_NAME = 1000
"""Bytes of an image's name."""
OBSERVED = 500
"""Observations of an image that are kept: what tells whether points and poses fit."""
NO_POINT = 2**64 - 1
"""Stands in a binary model for the id of no point."""
FARTHEST_POINT = 1e9
"""Units from the origin at which a point may lie."""
UNIT = 1e-2
"""By which a quaternion's length may differ from 1."""


class ColmapCamera(NamedTuple):
    """One line of `cameras`."""

    model: str
    """Name of the camera model."""
    size: tuple[int, int]
    """(width, height) px."""
    params: tuple[float, ...]
    """As the model lists them."""


class ColmapImage(NamedTuple):
    """One entry of `images`."""

    name: str
    """Path below the folder of the images, with `/`."""
    camera: int
    """Id of its camera."""
    rotation: np.ndarray
    """[3, 3] world to camera."""
    translation: np.ndarray
    """[3] world to camera, units of the model."""
    pixels: np.ndarray
    """[n, 2] px, some of the observations of points."""
    points: np.ndarray
    """[n] int64 ids of these points."""


class ColmapModel(NamedTuple):
    """A whole model."""

    form: str
    """text or binary."""
    cameras: dict[int, ColmapCamera]
    """By id."""
    images: list[ColmapImage]
    """In the order of their names."""
    points: dict[int, np.ndarray]
    """{id: [3] place in the world} of the points that the images' observations name."""


def model_form(folder: Path) -> str | None:
    """The form of the model in a folder, binary or text; binary where it holds both, as COLMAP takes it."""
    for form, ending in (("binary", "bin"), ("text", "txt")):
        if all((folder / f"{part}.{ending}").is_file() for part in ("cameras", "images")):
            return form
    return None


def read_model(folder: Path) -> ColmapModel:
    """The model in a folder. Raises CalibrationError, naming the file and the place in it, for what is missing,
    malformed, cut off or contradicts itself."""
    form = model_form(folder)
    if form is None:
        raise CalibrationError(
            f"no COLMAP model in {folder}: expected cameras.txt and images.txt, or both as .bin; write it with `colmap"
            " mapper` or `colmap model_converter`"
        )
    ending = "bin" if form == "binary" else "txt"
    cameras_file, images_file, points_file = (folder / f"{part}.{ending}" for part in ("cameras", "images", "points3D"))
    binary = form == "binary"
    try:
        cameras: dict[int, ColmapCamera] = {}
        for where, key, camera in (_binary_cameras if binary else _text_cameras)(cameras_file):
            if key in cameras:
                raise SourceError(f"{where}: camera {key} is there twice; write the model again")
            cameras[key] = camera
        images: dict[str, ColmapImage] = {}
        for where, image in (_binary_images if binary else _text_images)(images_file):
            if image.name in images:
                raise SourceError(f"{where}: image {image.name!r} is there twice; write the model again")
            if image.camera not in cameras:
                raise SourceError(
                    f"{where}: image {image.name!r} is of camera {image.camera}, which {cameras_file.name} lacks; it"
                    f" has {shortened(sorted(cameras))}"
                )
            images[image.name] = image
        wanted = {int(p) for i in images.values() for p in i.points}
        points: dict[int, np.ndarray] = {}
        if points_file.is_file() and wanted:
            points = dict((_binary_points if binary else _text_points)(points_file, wanted))
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if not images:
        raise CalibrationError(f"{images_file} holds no image; no camera was placed")
    return ColmapModel(form, cameras, [images[n] for n in sorted(images)], points)


def rotation_of(quaternion: Sequence[float] | np.ndarray, where: str) -> np.ndarray:
    """[3, 3] of a quaternion (w, x, y, z). Raises SourceError for one whose length is not 1."""
    q = np.asarray(quaternion, dtype=np.float64)
    length = float(np.linalg.norm(q)) if np.isfinite(q).all() and np.abs(q).max() < 1e9 else np.inf
    if not abs(length - 1) <= UNIT:
        raise SourceError(
            f"{where}: the quaternion {q.tolist()} has the length {length:g}, a rotation's is 1; the order is"
            " QW QX QY QZ TX TY TZ"
        )
    w, x, y, z = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _camera(where: str, model: str, size: tuple[int, int], params: Sequence[float]) -> ColmapCamera:
    counts = dict(MODELS.values())
    if model not in counts:
        raise SourceError(f"{where}: unknown camera model {model[:60]!r}; known are {', '.join(counts)}")
    if len(params) != counts[model]:
        raise SourceError(f"{where}: camera model {model} has {counts[model]} parameters, {len(params)} are given")
    return ColmapCamera(model, size, tuple(params))


def _image(where: str, pose: Sequence[float], camera: int, name: str, seen: np.ndarray, ids: np.ndarray) -> ColmapImage:
    if len(name.encode(errors="replace")) > LONGEST_NAME:
        raise SourceError(f"{where}: the image's name is longer than {LONGEST_NAME} bytes")
    return ColmapImage(name, camera, rotation_of(pose[:4], where), np.array(pose[4:], dtype=np.float64), seen, ids)


# text


def _lines(path: Path) -> Iterator[tuple[str, str]]:
    """(file and line for a sentence, line) of a text file."""
    for number, line in enumerate(read_text(path, "COLMAP model", LARGEST).split("\n"), start=1):
        yield f"{path}:{number}", line.strip()


def _content(lines: Iterator[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    return ((where, line) for where, line in lines if line and not line.startswith("#"))


def _values(kind: Any, words: Sequence[str], where: str) -> list[Any]:
    try:
        return [kind(w) for w in words]
    except ValueError:
        wrong = next(w for w in words if not _is(kind, w))
        raise SourceError(
            f"{where}: {shortened(wrong)} is not a {'whole ' if kind is whole else ''}number; write the model again"
        ) from None


def _is(kind: Any, word: str) -> bool:
    try:
        kind(word)
    except ValueError:
        return False
    return True


def _text_cameras(path: Path) -> Iterator[tuple[str, int, ColmapCamera]]:
    for where, line in _content(_lines(path)):
        words = line.split()
        if len(words) < 4:
            raise SourceError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, got {shortened(line)}")
        key, width, height = _values(whole, [words[0], *words[2:4]], where)
        yield where, key, _camera(where, words[1], (width, height), _values(float, words[4:], where))


def _text_images(path: Path) -> Iterator[tuple[str, ColmapImage]]:
    lines = _lines(path)
    for where, line in _content(lines):
        words = line.split(None, 9)
        if len(words) < 10:
            raise SourceError(f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, got {shortened(line)}")
        camera = _values(whole, [words[8]], where)[0]
        below, observed = next(lines, (where, ""))  # every image has a second line, which may be empty
        flat = np.array(_values(float, observed.split(None, 3 * OBSERVED)[: 3 * OBSERVED], below))
        if flat.size % 3:
            raise SourceError(f"{below}: {flat.size} numbers are no triples X Y POINT3D_ID; write the model again")
        seen, ids = _kept(flat.reshape(-1, 3)[:, :2], flat.reshape(-1, 3)[:, 2], below)
        yield where, _image(where, _values(float, words[1:8], where), camera, words[9], seen, ids)


def _text_points(path: Path, wanted: set[int]) -> Iterator[tuple[int, np.ndarray]]:
    for where, line in _content(_lines(path)):
        words = line.split(None, 4)
        if len(words) < 4:
            raise SourceError(f"{where}: expected POINT3D_ID X Y Z R G B ERROR TRACK, got {shortened(line)}")
        key = _values(whole, words[:1], where)[0]
        if key in wanted:
            yield key, _place(_values(float, words[1:4], where), where)


def _place(values: Sequence[float], where: str) -> np.ndarray:
    place = np.array(values, dtype=np.float64)
    if not (np.abs(place) < FARTHEST_POINT).all():
        raise SourceError(
            f"{where}: the point {place.tolist()} must be finite and within {FARTHEST_POINT:g}; write the model again"
        )
    return place


def _kept(pixels: np.ndarray, ids: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Observations that name a point."""
    if not (np.isfinite(pixels).all() and np.isfinite(ids).all() and (np.abs(ids) < 2**53).all()):
        raise SourceError(f"{where}: an observation is not made of finite numbers; write the model again")
    named = ids >= 0
    return pixels[named], ids[named].astype(np.int64)


# binary, little endian


class _Bytes:
    """A file taken from front to back; nothing is made of more bytes than are left."""

    def __init__(self, path: Path) -> None:
        self.path, self.raw, self.at = path, read_bytes(path, "COLMAP model", LARGEST), 0

    @property
    def where(self) -> str:
        return f"{self.path}, byte {self.at}"

    def take(self, layout: str, what: str) -> tuple[Any, ...]:
        size = struct.calcsize(f"<{layout}")
        self.need(size, what)
        self.at += size
        return struct.unpack_from(f"<{layout}", self.raw, self.at - size)

    def need(self, size: int, what: str) -> None:
        if size > len(self.raw) - self.at:
            raise SourceError(
                f"{self.where}: {what} takes {size} bytes, {len(self.raw) - self.at} are left; the file is cut off or"
                " damaged, so write the model again"
            )

    def entries(self, what: str) -> Iterator[None]:
        """Once for each of the counted entries; afterwards the file must be at its end."""
        (count,) = self.take("Q", f"the number of {what}")
        if count > len(self.raw):
            raise SourceError(f"{self.path}: {count} {what} in {len(self.raw)} bytes; the file is damaged")
        for _ in range(count):
            yield
        if self.at != len(self.raw):
            raise SourceError(f"{self.where}: {len(self.raw) - self.at} bytes follow the last of {count} {what}")

    def skip(self, size: int, what: str) -> None:
        self.need(size, what)
        self.at += size

    def text(self, what: str) -> str:
        end = self.raw.find(b"\0", self.at, self.at + LONGEST_NAME + 1)
        if end < 0:
            raise SourceError(f"{self.where}: {what} does not end within {LONGEST_NAME} bytes; the file is damaged")
        found = self.raw[self.at : end]
        where, self.at = self.where, end + 1
        try:
            return found.decode()
        except UnicodeDecodeError:
            raise SourceError(f"{where}: {what} {shortened(found)} is not text in UTF-8") from None


def _binary_cameras(path: Path) -> Iterator[tuple[str, int, ColmapCamera]]:
    data = _Bytes(path)
    for _ in data.entries("cameras"):
        where = data.where
        key, number, width, height = data.take("IiQQ", "a camera")
        if number not in MODELS:
            raise SourceError(f"{where}: unknown camera model {number}; known are 0 to {max(MODELS)}")
        model, count = MODELS[number]
        yield where, key, _camera(where, model, (width, height), data.take(f"{count}d", f"parameters of {model}"))


def _binary_images(path: Path) -> Iterator[tuple[str, ColmapImage]]:
    data = _Bytes(path)
    observation = np.dtype([("pixel", "<f8", 2), ("point", "<u8")])
    for _ in data.entries("images"):
        where = data.where
        _, *pose, camera = data.take("I7dI", "an image")
        name = data.text("the image's name")
        (count,) = data.take("Q", "the number of observations")
        data.need(count * observation.itemsize, f"{count} observations")
        found = np.frombuffer(data.raw, observation, min(count, OBSERVED), data.at)
        data.skip(count * observation.itemsize, "observations")
        ids = np.where(found["point"] == NO_POINT, -1.0, found["point"].astype(np.float64))
        seen, ids = _kept(found["pixel"], ids, where)
        yield where, _image(where, pose, camera, name, seen, ids)


def _binary_points(path: Path, wanted: set[int]) -> Iterator[tuple[int, np.ndarray]]:
    data = _Bytes(path)
    for _ in data.entries("points"):
        at = data.at
        key, x, y, z, *_, length = data.take("Q3d3BdQ", "a point")
        data.skip(8 * length, "a point's track")
        if key in wanted:
            yield key, _place((x, y, z), f"{path}, byte {at}")
