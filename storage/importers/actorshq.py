"""ActorsHQ: one scale of a sequence, 160 cameras with pictures and masks.

`calibration.csv` has a row a camera: name, w, h, a rotation vector and a place (camera to world, metres, x right, y
down, z forward), and fx, fy, px, py in widths and heights of the picture. `rgbs/Cam001/Cam001_rgb000000.jpg` are
pictures whose background is black already, `masks/Cam001/Cam001_mask000000.png` masks. What a partial download lacks is
left out. Format: https://github.com/synthesiaresearch/humanrf, actorshq/dataset.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.cameras import DISTORTION, RawCamera
from posegaussian.storage.importers.common import ImportOptions, folder, numbered, subfolders
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.model.cameras import rotation_matrix
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_table, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.model.plausible import check_rotation_vector, check_size
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

ACTORSHQ = DataSet("actorshq", 25.0, "metres", "camera to world")
CALIBRATION = "calibration.csv"
COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")


class ActorsOptions(ImportOptions):
    """The layout leaves nothing else to choose."""


def find(source: Path, options: ActorsOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    cameras = _cameras(base / CALIBRATION)
    found = {f.name: n for f in subfolders(base / "rgbs") if (n := numbered(f, PICTURE_SUFFIXES))}
    if not found:
        raise SourceError(f"no pictures in {base / 'rgbs'}; give the folder of one scale, such as Sequence1/4x")
    unknown = [n for n in found if n not in cameras]
    if len(unknown) == len(found):
        raise CalibrationError(f"{base / CALIBRATION} names none of the cameras {', '.join(unknown[:6])} of rgbs")
    filmed = [
        Filmed(cameras[n], files, numbered(base / "masks" / n, PICTURE_SUFFIXES))
        for n, files in found.items()
        if n in cameras
    ]
    lacking = sum(n not in found for n in cameras)
    notes = [f"pictures of camera {n} have no calibration and are left out" for n in unknown]
    if lacking:
        notes.append(f"{lacking} of {len(cameras)} calibrated cameras have no pictures and are left out")
    return capture_of(ACTORSHQ, filmed, options, notes=notes)


def _cameras(path: Path) -> dict[str, RawCamera]:
    """{name: camera}."""
    try:
        columns, rows = read_table(path, "calibration")
        lacking = [c for c in COLUMNS if c not in [k.strip() for k in columns]]
        if lacking:
            raise CalibrationError(f"{path} lacks the columns {', '.join(lacking)}")
        out = {}
        for line, row in rows:
            camera = _camera({k.strip(): v for k, v in row.items() if isinstance(k, str)}, f"{path} line {line}")
            if camera.name in out:
                raise CalibrationError(f"{path} line {line}: camera {camera.name} is there twice")
            out[camera.name] = camera
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    return out


def _camera(row: Mapping[str, str | None], where: str) -> RawCamera:
    name = (row["name"] or "").strip()
    values = {}
    for column in COLUMNS[1:]:
        try:
            values[column] = float(row[column] or "")
        except ValueError:
            raise CalibrationError(f"{where}: {column} is {shortened(row[column])}; a number is expected") from None
    w, h = values["w"], values["h"]
    check_size(name, w, h)
    vector = np.array([values["rx"], values["ry"], values["rz"]])
    check_rotation_vector(name, vector)
    rotation = rotation_matrix(vector).T
    return RawCamera(
        name,
        np.array([[values["fx"] * w, 0, values["px"] * w], [0, values["fy"] * h, values["py"] * h], [0, 0, 1]]),
        np.zeros(DISTORTION),
        rotation,
        -rotation @ np.array([values["tx"], values["ty"], values["tz"]]),
        (int(w), int(h)),
    )


IMPORTER = Importer(
    "actorshq",
    "calibration.csv, rgbs and masks of one scale of a sequence, as ActorsHQ has them.",
    ActorsOptions,
    find,
    (
        Trait(CALIBRATION, lambda base: (base / CALIBRATION).is_file()),
        Trait("rgbs/Cam001", lambda base: bool(subfolders(base / "rgbs")), filmed=True),
    ),
)
