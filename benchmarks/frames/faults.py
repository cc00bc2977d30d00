"""What spoils a capture, and by how much: a simulated person whose pictures, masks or calibration something is wrong
with, run by default, against the same person unspoilt; box PSNR and SSIM at held-out cameras, which stay as they are.

    python -m benchmarks.frames.faults [--scenes plain:4:8 capture_like:101:own] [--only holes ...] [--size 384]
        [--without masks joints] [--frames 1] [--set network.weights=none ...]

A scene is KIND:SEED:CAMERAS, as `benchmarks.quality.cells` has them, of tuning seeds. Without masks it is a plain
video; of one frame nobody can tell who is in front.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.quality.cells import Cell, film_cell, pictures
from benchmarks.report import publish
from posegaussian.dags.simulation.simulated_run import ARCHIVE, CAPTURE, run_capture
from posegaussian.storage.model.masks import foreground

Change = Callable[[np.ndarray, int, np.random.Generator], np.ndarray]
"""(picture or mask as float32, number of the camera, random numbers) -> what it becomes, 0..255."""


@dataclass(frozen=True)
class Fault:
    """Something that is wrong with a capture."""

    told: str
    image: Change | None = None
    """Of every source picture."""
    mask: Change | None = None
    camera: Callable[[dict[str, Any], int, np.random.Generator], None] | None = None
    """Of every source camera's entry in cameras.json, by its number."""
    exchanged: tuple[int, int] | None = None
    """Numbers of two source cameras whose files are each other's."""


def only(*views: int) -> Callable[[Change], Change]:
    """A change of some cameras alone."""
    return lambda change: lambda a, v, random: change(a, v, random) if v in views else a


def _jpeg(picture: np.ndarray, _v: int, _random: np.random.Generator) -> np.ndarray:
    ok = cv2.imencode(".jpg", picture.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 50])[1]
    read = cv2.imdecode(ok, cv2.IMREAD_COLOR)
    assert read is not None
    return read.astype(np.float32)


def _vignetted(picture: np.ndarray, _v: int, _random: np.random.Generator) -> np.ndarray:
    y, x = (np.linspace(-1, 1, n) for n in picture.shape[:2])
    return picture * (1 - 0.25 * (y[:, None, None] ** 2 + x[None, :, None] ** 2))


def _bent(a: np.ndarray, _v: int, _random: np.random.Generator) -> np.ndarray:
    high, wide = a.shape[:2]
    k = np.array([[1.04 * wide, 0, wide / 2], [0, 1.04 * wide, high / 2], [0, 0, 1]])
    return np.asarray(cv2.undistort(a, k, np.array([0.05, 0, 0, 0])))


def _wobbling(mask: np.ndarray, _v: int, random: np.random.Generator) -> np.ndarray:
    noise = cv2.GaussianBlur(random.normal(0, 1, mask.shape).astype(np.float32), (0, 0), 8)
    inside = foreground(mask).astype(np.uint8)
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5)
    return np.asarray(255 * np.clip(distance + 2 * noise / noise.std() + 0.5, 0, 1))


def _holed(mask: np.ndarray, _v: int, random: np.random.Generator) -> np.ndarray:
    rows, columns = np.nonzero(foreground(mask))
    for k in random.integers(0, len(rows), 3):
        cv2.circle(mask, (int(columns[k]), int(rows[k])), _part(mask, 0.024), 0, -1)
    return mask


def _spotted(mask: np.ndarray, _v: int, random: np.random.Generator) -> np.ndarray:
    for at in random.integers(0, min(mask.shape), (2, 2)):
        cv2.circle(mask, tuple(int(n) for n in at), _part(mask, 0.036), 255, -1)
    return mask


def _cut(share: float) -> Change:
    def change(mask: np.ndarray, _v: int, _random: np.random.Generator) -> np.ndarray:
        rows = np.nonzero(foreground(mask).any(axis=1))[0]
        mask[int(rows[0] + share * (rows[-1] - rows[0])) :] = 0
        return mask

    return change


def _coarse(mask: np.ndarray, _v: int, _random: np.random.Generator) -> np.ndarray:
    small = cv2.resize(mask, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, mask.shape[1::-1], interpolation=cv2.INTER_CUBIC))


def _part(a: np.ndarray, share: float) -> int:
    """Px that are a share of the longer side."""
    return round(share * max(a.shape))


def _turn(camera: dict[str, Any], degrees: np.ndarray) -> None:
    """By a rotation vector [3] in the camera's axes: right, down, ahead."""
    turn = cv2.Rodrigues(np.radians(degrees))[0]
    camera["R"], camera["t"] = (turn @ np.array(camera["R"])).tolist(), (turn @ np.array(camera["t"])).tolist()


def _moved(camera: dict[str, Any], metres: np.ndarray) -> None:
    """Along its axes."""
    camera["t"] = (np.array(camera["t"]) + metres).tolist()


def _turned(camera: dict[str, Any], _v: int, random: np.random.Generator) -> None:
    _turn(camera, 0.12 * random.normal(size=3) / np.sqrt(3))
    _moved(camera, 0.003 * random.normal(size=3))


def of_some(change: Callable[[dict[str, Any], np.ndarray], None], *by: tuple[int, tuple[float, float, float]]) -> Any:
    """A change of some cameras alone, each by so much."""

    def camera_change(camera: dict[str, Any], v: int, _random: np.random.Generator) -> None:
        for view, much in by:
            if v == view:
                change(camera, np.array(much))

    return camera_change


def _zoomed(camera: dict[str, Any], _v: int, random: np.random.Generator) -> None:
    by = 1 + random.normal(0, 0.01)
    camera["K"][0][0] *= by
    camera["K"][1][1] *= by


def _shifted(camera: dict[str, Any], _v: int, random: np.random.Generator) -> None:
    for row in (0, 1):
        camera["K"][row][2] += random.normal(0, 2)


FAULTS = {
    "none": Fault("nothing"),
    "jpeg": Fault("JPEG of quality 50", image=_jpeg),
    "blur": Fault("blur of 1.2 px in all cameras", image=lambda a, _v, _r: cv2.GaussianBlur(a, (0, 0), 1.2)),
    "blur_one": Fault("blur of 2.5 px in one", image=only(2)(lambda a, _v, _r: cv2.GaussianBlur(a, (0, 0), 2.5))),
    "noise": Fault("noise of 8 grey levels", image=lambda a, _v, random: a + random.normal(0, 8, a.shape)),
    "white_balance": Fault("channels off by up to 12 %", image=lambda a, _v, random: a * random.uniform(0.88, 1.12, 3)),
    "tone": Fault("gamma of 0.8 to 1.25", image=lambda a, _v, random: 255 * (a / 255) ** random.uniform(0.8, 1.25)),
    "vignetting": Fault("corners darker by half", image=_vignetted),
    "black": Fault("one camera's pictures are black", image=only(4)(lambda a, _v, _r: 0 * a)),
    "white": Fault("one camera's pictures are white", image=only(4)(lambda a, _v, _r: 0 * a + 255)),
    "wide": Fault("masks 3 px too wide", mask=lambda m, _v, _r: cv2.dilate(m, np.ones((7, 7)))),
    "narrow": Fault("masks 2 px too narrow", mask=lambda m, _v, _r: cv2.erode(m, np.ones((5, 5)))),
    "coarse": Fault("masks of a quarter of the size", mask=_coarse),
    "wobbling": Fault("outlines that wobble by 2 px", mask=_wobbling),
    "holes": Fault("three holes a mask, each 5 % of the picture across", mask=_holed),
    "spots": Fault("two spots a mask, each 7 % of the picture across", mask=_spotted),
    "empty": Fault("one camera's mask is empty", mask=only(2)(lambda m, _v, _r: 0 * m)),
    "whole": Fault("one camera's mask is the whole picture", mask=only(2)(lambda m, _v, _r: 0 * m + 255)),
    "inverted": Fault("one camera's mask marks the background", mask=only(2)(lambda m, _v, _r: 255 - m)),
    "half": Fault("one camera's mask lacks the lower half", mask=only(2)(_cut(0.5))),
    "legs": Fault("two cameras' masks lack the lower legs", mask=only(1, 5)(_cut(0.75))),
    "turned": Fault("cameras turned by 0.12 degrees, moved by 3 mm", camera=_turned),
    "pan": Fault("one camera turned sideways by 0.5 degrees", camera=of_some(_turn, (2, (0, 0.5, 0)))),
    "pan_far": Fault("one camera turned sideways by 5 degrees", camera=of_some(_turn, (2, (0, 5, 0)))),
    "tilt": Fault("one camera tilted by 1 degree", camera=of_some(_turn, (2, (1, 0, 0)))),
    "two_pans": Fault(
        "two cameras turned sideways by 2 degrees", camera=of_some(_turn, (1, (0, 2, 0)), (4, (0, -2, 0)))
    ),
    "two_rolls": Fault("two cameras rolled by 3 degrees", camera=of_some(_turn, (1, (0, 0, 3)), (4, (0, 0, -3)))),
    "aside": Fault("one camera 5 cm aside", camera=of_some(_moved, (2, (0.05, 0, 0)))),
    "behind": Fault("one camera 30 cm farther back", camera=of_some(_moved, (2, (0, 0, 0.3)))),
    "exchanged": Fault("two cameras' files exchanged", exchanged=(1, 3)),
    "focal": Fault("focal lengths off by 1 %", camera=_zoomed),
    "shifted": Fault("principal points off by 2 px", camera=_shifted),
    "lens": Fault("a lens that nobody wrote down (k1 = 0.05)", image=_bent, mask=_bent),
}


def spoil(capture: Path, held_out: set[str], fault: Fault) -> None:
    """Change the files of a capture in place, but those of the held-out cameras."""
    random = np.random.default_rng(7)
    for kind, change in (("images", fault.image), ("masks", fault.mask)):
        folders = [f for f in sorted((capture / kind).iterdir()) if f.name not in held_out] if change else []
        for v, folder in enumerate(folders):
            for file in sorted(folder.iterdir()):
                read = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
                assert change is not None
                assert read is not None, file
                out = change(read.astype(np.float32), v, random)
                cv2.imwrite(str(file), np.clip(np.rint(out), 0, 255).astype(np.uint8))
    if fault.camera:
        file = capture / "cameras.json"
        written = json.loads(file.read_text())
        for v, camera in enumerate(c for c in written["cameras"] if c["name"] not in held_out):
            fault.camera(camera, v, random)
        file.write_text(json.dumps(written))
    for kind in ("images", "masks", "joints") if fault.exchanged else ():
        files = [f for f in sorted((capture / kind).iterdir()) if f.stem not in held_out]
        one, other = (files[v] for v in fault.exchanged or ())
        one.rename(aside := capture / kind / "aside")
        other.rename(one)
        aside.rename(other)


def rows(
    cell: Cell, faults: Sequence[str], without: Sequence[str], settings: tuple[str, ...]
) -> Iterator[dict[str, Any]]:
    """A row a fault of one scene. Raises RunFailed when a task fails."""
    with tempfile.TemporaryDirectory() as name:
        filmed = Path(name) / "filmed"
        filmed.mkdir()
        _, held_out = film_cell(cell, filmed)
        names = set(json.loads(held_out.split("=", 1)[1]))
        for fault in faults:
            folder = Path(name) / fault
            shutil.copytree(filmed / CAPTURE, folder / CAPTURE)
            spoil(folder / CAPTURE, names, FAULTS[fault])
            for kind in without:
                shutil.rmtree(folder / CAPTURE / kind)
            results, _ = run_capture(folder, (held_out, *settings))
            found = pictures(results, cell, filmed / CAPTURE if "masks" in without else None)
            shutil.rmtree(folder / ARCHIVE)
            yield {
                "scene": f"{cell.scenes} {cell.seed}",
                "cameras": cell.scene.rig.cameras,
                "fault": FAULTS[fault].told,
                "box psnr": found["box psnr"],
                "box ssim": found["box ssim"],
            }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and keep it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument(
        "--scenes", nargs="+", default=["plain:4:8", "capture_like:101:own"], metavar="KIND:SEED:CAMERAS"
    )
    parser.add_argument("--only", nargs="+", default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument("--size", type=int, default=384, help="px")
    parser.add_argument("--without", nargs="*", default=[], choices=["masks", "joints"])
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    given = parser.parse_args(arguments)
    found = []
    for scene in given.scenes:
        kind, seed, cameras = scene.split(":")
        count = None if cameras == "own" else int(cameras)
        cell = Cell(int(seed), count, size=given.size, frames=given.frames, scenes=kind)
        for row in rows(cell, given.only, given.without, tuple(given.set)):
            print(*row.values(), flush=True)
            found.append(row)
    publish("faults", found, {k: v if isinstance(v, int) else " ".join(v) for k, v in vars(given).items()})


if __name__ == "__main__":
    main()
