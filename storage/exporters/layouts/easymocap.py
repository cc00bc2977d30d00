"""EasyMocap's layout, which EasyVolcap shares: `intri.yml` and `extri.yml` beside pictures and masks.

Pixel centres at integers, metres, world to camera; every number has 17 digits, where EasyMocap itself writes 6. The
layout holds neither a frame rate nor a cloud.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from posegaussian.storage.exporters.layouts.declaration import Layout, Recording
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.cameras import Rig, to_integer_centres
from posegaussian.storage.model.errors import UserError

KEY = re.compile(r"[A-Za-z0-9_\-]+")
"""What OpenCV takes as the rest of a key."""


def check(rig: Rig) -> None:
    """Raise UserError for a camera whose name OpenCV's files cannot hold."""
    for name in rig.names:
        if not KEY.fullmatch(name):
            raise UserError(
                f"export --to easymocap: camera {name!r} cannot be a key of OpenCV's YAML, which takes letters, digits,"
                " '_' and '-'; export to another layout, or rename the camera at its source"
            )


def write(folder: Path, recording: Recording) -> None:
    """Write intri.yml and extri.yml. Raises UserError for a camera whose name OpenCV's files cannot hold, and
    NotWritten."""
    import cv2

    rig = recording.rig
    check(rig)
    head = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{n}"\n' for n in rig.names)
    intri, extri = [head], [head]
    intrinsics = to_integer_centres(rig.intrinsics)
    for v, name in enumerate(rig.names):
        intri += [_matrix(f"K_{name}", intrinsics[v]), _matrix(f"dist_{name}", np.zeros((1, 5)))]
        intri += [f"H_{name}: {int(rig.size[v, 1])}\n", f"W_{name}: {int(rig.size[v, 0])}\n"]
        rotation, shift = rig.world_to_camera[v, :3, :3], rig.world_to_camera[v, :3, 3]
        extri += [_matrix(f"R_{name}", cv2.Rodrigues(rotation)[0]), _matrix(f"Rot_{name}", rotation)]
        extri.append(_matrix(f"T_{name}", shift[:, None]))
    write_atomically(folder / "intri.yml", "".join(intri).encode())
    write_atomically(folder / "extri.yml", "".join(extri).encode())


def _matrix(key: str, values: np.ndarray) -> str:
    rows, columns = values.shape
    data = ", ".join(repr(float(x)) for x in values.reshape(-1))
    return f"{key}: !!opencv-matrix\n  rows: {rows}\n  cols: {columns}\n  dt: d\n  data: [{data}]\n"


LAYOUT = Layout(
    "easymocap", "images, masks, intri.yml and extri.yml, for EasyMocap and EasyVolcap.", write, check=check
)
