"""Calibrations of bioCV: a text file `NAME.calib` a camera, or `NAME.mp4.calib`, world to camera, millimetres.

Lines of numbers: width, height, three rows of intrinsics, three or four rows of the pose, and OpenCV's distortion.
Pixel centres lie at integers.
"""

from __future__ import annotations

from pathlib import Path

from posegaussian.storage.importers.calibration_format import Calibration, CalibrationFormat, fixed
from posegaussian.storage.importers.cameras import RawCamera, numbers, whole_size
from posegaussian.storage.model.documents import read_text
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.video import VIDEO_SUFFIXES

LARGEST = 64 * 2**10
"""Bytes of a file; one has about 500."""
ROWS = ([1, 1, 3, 3, 3, 4, 4, 4], [1, 1, 3, 3, 3, 4, 4, 4, 4])
"""Numbers in each line before the distortion; the last row of a pose may be left out."""


def read(path: Path) -> Calibration:
    """The one camera of a file. Raises CalibrationError."""
    try:
        lines = [line.split() for line in read_text(path, "calibration", LARGEST).split("\n") if line.strip()]
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    name = path.name.removesuffix(".calib")
    name = Path(name).stem if Path(name).suffix.lower() in VIDEO_SUFFIXES else name
    if [len(line) for line in lines[:-1]] not in ROWS:
        raise CalibrationError(
            f"calibration {path} must hold width, height, 3 rows of intrinsics, 3 or 4 rows of the pose and a line of"
            f" distortion; its lines have {', '.join(str(len(line)) for line in lines[:12])} numbers"
        )
    pose = numbers(lines[5:8], name, "pose", [(3, 4)])
    camera = RawCamera(
        name,
        numbers(lines[2:5], name, "intrinsics", [(3, 3)]),
        numbers(lines[-1], name, "distortion", [(-1,)]),
        pose[:, :3],
        pose[:, 3],
        whole_size([lines[0][0], lines[1][0]], name),
    )
    return Calibration({name: fixed(camera)}, "world to camera", False, 1e-3, "as the format has it")


FORMAT = CalibrationFormat(
    "bioCV .calib", lambda p: p.name.lower().endswith(".calib") and p.is_file(), read, alone=True
)
