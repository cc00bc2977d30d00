"""Records K1-K6: paths between cameras, and what calibration files of other systems get wrong."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.io import Views
from posegaussian.storage.importers.cameras import RawCamera, build_rig
from posegaussian.storage.importers.easymocap import _camera, read_opencv_yaml
from posegaussian.storage.importers.letterbox import fitted
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.readers.images import write_png
from tests.hard_cases.catalogue import Case, worst
from tests.support.known_geometry import camera, rig_of

SUBJECT = np.array([1.8, 0.3, 0.9])
ANGLES = (22.5, 45.0, 72.0, 120.0)


def two(degrees: float, subject: np.ndarray) -> Rig:
    """Cameras 2 m from a subject, `degrees` apart."""
    turns = np.radians([0, degrees])
    centres = subject + 2 * np.stack([np.cos(turns), np.sin(turns), np.zeros(2)], axis=1)
    return rig_of([camera(c, subject) for c in centres])


def arc(rig: Rig, steps: int = 9) -> CameraPath:
    return make_path("arc cam0 cam1", rig, Views(rig.names, (0, 1), ()), np.arange(steps))


def centres(path: CameraPath) -> np.ndarray:
    pose = path.world_to_camera[:, 0]
    return -np.einsum("fji,fj->fi", pose[:, :3, :3], pose[:, :3, 3])


def off_the_arc(found: np.ndarray, subject: np.ndarray) -> float:
    """Metres by which centres [..., 3] are not 2 m from the subject."""
    return float(np.abs(np.linalg.norm(found - subject, axis=-1) - 2).max())


def naive_middle(degrees: float) -> np.ndarray:
    """Half way: the rotation on the arc, the translation of world to camera in a straight line."""
    rig = two(degrees, SUBJECT)
    turned = arc(rig, 3).world_to_camera[1, 0, :3, :3]
    return -turned.T @ rig.world_to_camera[:, :3, 3].mean(axis=0)


def naive_slerp(degrees: float) -> np.ndarray:
    """Half way between two centres by spherical interpolation, sin(t a) / sin(a)."""
    a, b = two(degrees, np.zeros(3)).centres / 2
    angle = np.arccos(np.clip(a @ b, -1, 1))
    return 2 * (np.sin(angle / 2) * a + np.sin(angle / 2) * b) / np.sin(angle)


def half_turn_error() -> float:
    """Metres off the arc, and between the ways that turns a hair more or less than half take."""
    ways = [centres(arc(two(180.0 + h, np.zeros(3)), 3)) for h in (0.0, 1e-7, -1e-7)]
    return worst([*(off_the_arc(way, np.zeros(3)) for way in ways), *(np.abs(way - ways[0]).max() for way in ways)])


def easymocap(folder: Path, distortion: int) -> RawCamera:
    """A camera written as EasyVolcap's write_camera does: Rot and the vector beside it, T, D of so many numbers."""
    r = camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))

    def node(name: str, values: np.ndarray) -> str:
        m = np.atleast_2d(values.T if values.ndim == 1 else values)
        return (
            f"{name}: !!opencv-matrix\n   rows: {m.shape[0]}\n   cols: {m.shape[1]}\n   dt: d\n   data:"
            f" [{', '.join(repr(float(x)) for x in m.ravel())}]\n"
        )

    head = '%YAML:1.0\n---\nnames:\n   - "01"\n'
    (folder / "intri.yml").write_text(
        head
        + node("K_01", np.array([[800.0, 0, 511.5], [0, 800, 383.5], [0, 0, 1]]))
        + node("D_01", 0.01 * np.arange(1, distortion + 1))
    )
    (folder / "extri.yml").write_text(head + node("Rot_01", r[:3, :3]) + node("T_01", r[:3, 3]))
    return _camera("01", read_opencv_yaml(folder / "intri.yml"), read_opencv_yaml(folder / "extri.yml"))


def written(distortion: int) -> Rig:
    """What comes back of such a camera."""
    with tempfile.TemporaryDirectory() as folder:
        return build_rig([easymocap(Path(folder), distortion)], [(1024, 768)], half=False)


def naive_centre() -> float:
    """The rotation vector where the matrix belongs."""
    import cv2

    pose = camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))
    vector = cv2.Rodrigues(pose[:3, :3])[0]
    return float(np.linalg.norm(-vector.T @ pose[:3, 3] - [2.0, 0.5, 1.0]))


COUNTS = (4, 5, 8)


def naive_distortion(count: int) -> float:
    """D read as the five numbers that OpenCV's documents begin with."""
    d = 0.01 * np.arange(1, count + 1)
    return float(np.abs(d.reshape(5) - d).max())


def distortion_error(count: int) -> float:
    return float(np.abs(written(count).distortion[0] - [*(0.01 * np.arange(1, count + 1)), *np.zeros(8 - count)]).max())


DIGITS = (10, 6, 4)


def rounded(digits: int) -> np.ndarray:
    return np.round(camera(np.array([2.0, 0.5, 1.0]), np.zeros(3))[:3, :3], digits)


def off_rigid(r: np.ndarray) -> float:
    return float(np.abs(r @ r.T - np.eye(3)).max())


def read_back(r: np.ndarray) -> np.ndarray:
    return build_rig(
        [RawCamera("a", np.diag([800.0, 800, 1]), np.zeros(5), r, np.array([0, 0, 2.0]), (1024, 768))],
        [(1024, 768)],
        half=False,
    ).rotations[0]


def naive_doubled() -> float:
    """Intrinsics times two, because the training pictures were half as large; these pictures are not."""
    rig = rig_of([camera(np.array([2.0, 0, 0]), np.zeros(3))])
    k = rig.intrinsics[0].copy()
    k[:2] *= 2
    return float(np.abs(k[:2, 2] - rig.intrinsics[0, :2, 2]).max())


def as_captured(side: int) -> Capture:
    """A camera calibrated at 1024 px with pictures of another side, as the import takes it."""
    rig = rig_of([camera(np.array([2.0, 0, 0]), np.zeros(3))])
    with tempfile.TemporaryDirectory() as folder:
        write_png(f"{folder}/0.png", np.full((side, side, 3), 90, np.uint8))
        stream = Stream("images", (SourceFile.of(f"{folder}/0.png"),), (0,), (side, side), {})
        return fitted(Capture("images", rig, 30.0, (stream,)), {})


def doubled() -> float:
    """Px of the calibrated picture by which its corners are missed, by pictures of that size and of twice the size;
    the intrinsics stay."""
    same, larger = as_captured(1024), as_captured(2048)
    assert not same.crops
    crop = larger.crops["cam0"]
    return max(
        float(np.abs(crop.scale * corner + np.array(crop.offset) - corner / 2).max())
        for corner in np.array([[0.0, 0.0], [2048.0, 2048.0]])
    )


CASES = (
    Case(
        "K1",
        "a path between cameras, the subject away from the origin",
        "rotations turn, translations go straight: half way the camera stands nearer",
        "m",
        lambda: worst(off_the_arc(naive_middle(d), SUBJECT) for d in ANGLES),
        lambda: worst(off_the_arc(centres(arc(two(d, SUBJECT))), SUBJECT) for d in ANGLES),
        1e-3,
        "centres move on an arc about the point the cameras look at, which is known to a millimetre",
    ),
    Case(
        "K2",
        "a path over half a turn",
        "the sine of 180 degrees is divided by",
        "m",
        lambda: worst(off_the_arc(naive_slerp(180.0 + h), np.zeros(3)) for h in (0.0, 1e-7, -1e-7)),
        half_turn_error,
        1e-3,
        "the rig's up axis decides the way; as K1",
    ),
    Case(
        "K3",
        "a file whose camera centre was computed wrongly",
        "the centre from the rotation vector in the matrix's place",
        "m",
        naive_centre,
        lambda: float(np.abs(written(5).centres[0] - [2.0, 0.5, 1.0]).max()),
        1e-12,
        "centres follow from R and t; float64",
    ),
    Case(
        "K4",
        "lens distortion of 4, 5 or 8 numbers",
        "five are expected",
        "of a coefficient",
        lambda: worst(naive_distortion(c) for c in COUNTS),
        lambda: worst(distortion_error(c) for c in COUNTS),
        0.0,
        "padded with zeros",
    ),
    Case(
        "K5",
        "rotations rounded to 10, 6 or 4 digits in text",
        "the rounded matrix stretches and shears",
        "of a rotation",
        lambda: worst(off_rigid(rounded(d)) for d in DIGITS),
        lambda: worst(off_rigid(read_back(rounded(d))) for d in DIGITS),
        1e-14,
        "projected onto the nearest rotation; float64. Farther than 1e-3 off is refused",
    ),
    Case(
        "K6",
        "pictures of twice the calibrated size",
        "intrinsics are doubled behind everybody's back",
        "px",
        naive_doubled,
        doubled,
        0.0,
        "the same shape: the pictures are scaled, the calibration stays, and the import says so; another shape is"
        " refused unless black bars explain it",
    ),
)
