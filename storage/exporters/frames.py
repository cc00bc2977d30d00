"""Pictures out: one PNG a frame and camera, and a table of the frames."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from posegaussian.storage.files.names import check_camera_names
from posegaussian.storage.files.write import refusals, write_atomically
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png


def write_frames(
    folder: str | Path,
    cameras: Sequence[str],
    source_frames: Sequence[int] | np.ndarray,
    time: Sequence[float] | np.ndarray,
    pictures: Iterable[tuple[str, int, np.ndarray, np.ndarray | None]],
) -> int:
    """Write `<camera>/<frame:06d>.png` and `frames.csv`, and count the pictures.

    `source_frames` [F] and `time` [F] (seconds) are those of the whole sequence; a picture is (camera, source frame
    number, [h, w, 3] uint8 premultiplied on black, [h, w] uint8 alpha or None). With alpha the PNG holds straight
    colours, as PNG demands. `frames.csv` lists the frames written: `frame` (source frame number), `index` (the
    sequence's own), `time`; it is written last, and one of an earlier export is deleted first, so that none lies beside
    pictures of two exports. Raises ValueError for an unknown camera or frame, UserError for a folder with pictures of
    another export, and NotWritten.
    """
    root = Path(folder)
    listing = root / "frames.csv"
    index = {int(n): i for i, n in enumerate(source_frames)}
    written: set[int] = set()
    count = 0
    check_camera_names(cameras)
    refuse_strangers(root, cameras, source_frames)
    with refusals(listing):
        listing.unlink(missing_ok=True)
    for camera, number, picture, alpha in pictures:
        if camera not in cameras or int(number) not in index:
            raise ValueError(
                f"camera {camera!r}, frame {number}: not one of the cameras {list(cameras)} or of the sequence's"
                f" {len(index)} frames"
            )
        path = root / camera / f"{number:06d}.png"
        write_png(path, picture if alpha is None else _straight(picture, alpha))
        written.add(int(number))
        count += 1
    with io.StringIO(newline="") as text:
        table = csv.writer(text)
        table.writerow(["frame", "index", "time"])
        table.writerows([n, index[n], repr(float(time[index[n]]))] for n in sorted(written))
        write_atomically(listing, text.getvalue().encode())
    return count


def refuse_strangers(root: Path, cameras: Sequence[str], source_frames: Sequence[int] | np.ndarray) -> None:
    """Raise UserError when the folder holds pictures that an export of these cameras
    and frames would leave beside its own."""
    known = {int(n) for n in source_frames}
    found = sorted(root.glob("*/*.png"))
    others = [p for p in found if p.parent.name not in cameras or not p.stem.isdigit() or int(p.stem) not in known]
    if others:
        pictures = "1 picture" if len(others) == 1 else f"{len(others)} pictures"
        raise UserError(
            f"folder {root} holds {pictures} of something else, for example"
            f" {others[0].relative_to(root)}; empty it or name another folder"
        )


def _straight(picture: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """[h, w, 4] straight RGBA of a premultiplied picture."""
    a = alpha.astype(np.float32)[..., None]
    rgb = np.rint(np.clip(picture * np.float32(255) / np.maximum(a, 1), 0, 255)).astype(np.uint8)
    return np.concatenate([rgb, alpha[..., None]], axis=2)
