"""What exported pictures stand on: black, one colour, a picture, or the background that the target camera itself
filmed.

Rendering keeps premultiplied colour and alpha, and metrics compare those; a background enters here, when files are
written. It enters in sRGB, color + (1 - alpha) background: Gaussians are blended in sRGB and premultiplied there, so a
pixel that the subject half covers holds half of its sRGB value. In linear light that half would count for more than it
is: along the outline of a simulated person before the capture's own plate, PSNR 24.5 and 20.6 dB in sRGB, 24.4 and
20.0 in linear light, which is too bright.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.stages.contract.facts import SEVERAL_FRAMES
from posegaussian.storage.model.cameras import CameraPath, camera_centre
from posegaussian.storage.model.errors import ConfigError

PLATE = "survey/plate"
SAME_PLACE = 1e-3
"""Metres between two cameras' centres up to which they see the same background:
0.3 px at 3 m and a focal length of 1000 px."""
MOST_KEPT = 16
"""Backgrounds in memory: cameras that stand still come again every frame, one that turns never does."""
ANSWERS = "none, plate, a colour such as '#30a040' (in quotes, a shell takes # for a comment), or a picture file"


@dataclass(frozen=True)
class Backdrop:
    """A background as asked for."""

    kind: Literal["none", "color", "file", "plate"]
    """Black, one colour, one picture for all cameras, or each camera's own background plate."""
    color: tuple[int, int, int] = (0, 0, 0)
    """sRGB, of `color`."""
    file: Path = Path()
    """The picture, of `file`."""
    cache: dict[tuple[object, ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)
    """Backgrounds made so far: a camera that stands still has one."""

    def __str__(self) -> str:
        """As the command takes it."""
        if self.kind == "color":
            return "#{:02x}{:02x}{:02x}".format(*self.color)
        return str(self.file) if self.kind == "file" else self.kind

    def behind(self, results: Results, path: CameraPath, frame: int, camera: int) -> np.ndarray | None:
        """[h, w, 3] uint8 sRGB behind one picture of a path, or None for black."""
        if self.kind == "none":
            return None
        width, height = (int(n) for n in path.size[camera])
        if self.kind == "color":
            return np.broadcast_to(np.array(self.color, np.uint8), (height, width, 3))
        k, pose = path.intrinsics[frame, camera], path.world_to_camera[frame, camera]
        key = (width, height) if self.kind == "file" else (width, height, k.tobytes(), pose.tobytes())
        if key not in self.cache:
            if len(self.cache) >= MOST_KEPT:
                self.cache.clear()
            self.cache[key] = (
                filling(_picture(self.file), (width, height))
                if self.kind == "file"
                else _plate(results, path, frame, camera)
            )
        return self.cache[key]


BLACK = Backdrop("none")
"""Nothing behind: pictures as they are stored."""


def parse(text: str) -> Backdrop:
    """`none`, `plate`, `#RRGGBB`, or a picture file. Raises ConfigError for anything else, and SourceError for a
    file that is no picture."""
    if text in ("none", "plate"):
        return Backdrop(text)  # type: ignore[arg-type]
    if text.startswith("#"):
        digits = text[1:]
        if len(digits) != 6 or not set(digits.lower()) <= set("0123456789abcdef"):
            raise ConfigError(
                f"export --background {text}: a colour is # and six hexadecimal digits, red, green and blue, for"
                " example '#30a040'"
            )
        return Backdrop("color", (int(digits[:2], 16), int(digits[2:4], 16), int(digits[4:], 16)))
    file = Path(text)
    if not file.is_file():
        raise ConfigError(f"export --background {text}: there is no such file; give {ANSWERS}")
    from posegaussian.storage.readers.images import picture_size

    picture_size(file)
    return Backdrop("file", file=file)


def needed(context: Context, backdrop: Backdrop) -> frozenset[Product]:
    """What the export reads beside rendered pictures.
    Raises ConfigError for a plate that this capture or path cannot have."""
    if backdrop.kind != "plate":
        return frozenset()
    if SEVERAL_FRAMES not in context.capture_facts:
        raise ConfigError(
            f"export --background plate: sequence {context.sequence.name} has a single frame, which shows no background"
            " behind the subject; give a colour or a picture file"
        )
    return frozenset(
        Product(PLATE, None, _filmed_from(context, p, int(f), int(c)))
        for p in context.paths.values()
        for f, c in np.argwhere(p.served)
    )


def _filmed_from(context: Context, path: CameraPath, frame: int, camera: int) -> int:
    """The view whose camera stands where a target camera does. Raises ConfigError where none does."""
    apart = np.linalg.norm(context.rig.centres - camera_centre(path.world_to_camera[frame, camera]), axis=1)
    near = [
        v for v in np.argsort(apart, kind="stable").tolist() if apart[v] <= SAME_PLACE and v in context.active_views
    ]
    if near:
        return near[0]
    where = (
        f"{apart.min():.2f} m from the nearest camera"
        if apart.min() > SAME_PLACE
        else "where only a camera stands that is neither a source nor held out"
    )
    raise ConfigError(
        f"export --background plate: camera {path.names[camera]} of path {path.text!r} stands {where}, and nobody"
        " filmed the background from there; "
        f'export --path held_out or "still CAM", or give a colour or a picture file'
    )


def _plate(results: Results, path: CameraPath, frame: int, camera: int) -> np.ndarray:
    """[h, w, 3] uint8: the plate of the camera that stands there, in the target's pixels; what that camera did not
    see is black."""
    from posegaussian.stages.imaging.camera_mapping import switched
    from posegaussian.stages.imaging.warp import Warp

    context = results.context
    view = _filmed_from(context, path, frame, camera)
    width, height = context.capture.pictures[view].size
    source_rig, crops = switched(context.capture.rig, context.captured_to_calibrated, context.facts)
    warp = Warp(view, (width, height), source_rig, context.rig, crops[view])
    plate = warp(np.ascontiguousarray(results.read(PLATE, range(1), view)[:height, :width]))
    target = (path.intrinsics[frame, camera], path.world_to_camera[frame, camera][:3, :3])
    return turned(
        plate,
        (context.rig.intrinsics[view], context.rig.rotations[view]),
        target,
        (int(path.size[camera, 0]), int(path.size[camera, 1])),
    )


def turned(
    picture: np.ndarray,
    camera: tuple[np.ndarray, np.ndarray],
    target: tuple[np.ndarray, np.ndarray],
    size: tuple[int, int],
) -> np.ndarray:
    """[h, w, 3] what a camera's picture shows to another of `size` (width, height) px in the same place; black where it
    ends.

    A camera is (intrinsics [3, 3], rotation [3, 3] from the world). Sampling is bilinear, of a picture averaged down
    first where the target samples more coarsely; the same camera gives the same bytes.
    """
    import cv2

    from posegaussian.stages.geometry.projection import pixel_centres
    from posegaussian.storage.model.cameras import points_to_integer_centres

    (k, r), (k_target, r_target) = camera, target
    shrunk = np.maximum(
        1, np.rint(np.array(picture.shape[1::-1]) * np.minimum(1.0, np.diag(k_target)[:2] / np.diag(k)[:2]))
    ).astype(int)
    k = np.diag([*(shrunk / picture.shape[1::-1]), 1.0]) @ k
    if (shrunk != picture.shape[1::-1]).any():
        picture = cv2.resize(picture, shrunk.tolist(), interpolation=cv2.INTER_AREA)
    ray = (
        np.concatenate([pixel_centres(size), np.ones((size[1], size[0], 1))], axis=-1)
        @ (k @ r @ r_target.T @ np.linalg.inv(k_target)).T
    )
    ahead = ray[..., 2] > 0
    at = np.where(ahead[..., None], ray[..., :2] / np.where(ahead, ray[..., 2], 1)[..., None], -1.0)
    inside = ((at >= 0) & (at <= shrunk)).all(axis=-1)
    at = points_to_integer_centres(at).astype(np.float32)
    return np.where(
        inside[..., None],
        cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.uint8(0),
    )


def _picture(file: Path) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of a picture file."""
    from posegaussian.stages.imaging.color import to_display
    from posegaussian.storage.readers.images import read_picture

    return to_display(read_picture(file))


def filling(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[h, w, 3] the middle of a picture, scaled so that it just fills `size` (width, height) px."""
    import cv2

    height, width = picture.shape[:2]
    scale = max(size[0] / width, size[1] / height)
    scaled = (max(size[0], round(width * scale)), max(size[1], round(height * scale)))
    if scaled != (width, height):
        picture = cv2.resize(picture, scaled, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    left, top = (scaled[0] - size[0]) // 2, (scaled[1] - size[1]) // 2
    return np.ascontiguousarray(picture[top : top + size[1], left : left + size[0]])


def over(color: np.ndarray, alpha: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """[h, w, 3] uint8: a premultiplied picture [h, w, 3] with its alpha [h, w] over a background [h, w, 3],
    all uint8 sRGB."""
    rest = behind * ((255 - alpha.astype(np.float32)) / np.float32(255))[..., None]
    return np.minimum(np.rint(color + rest), 255).astype(np.uint8)
