"""Camera tables of a TOML calibration, as Pose2Sim, anipose and Caliscope write them.

A table holds `matrix`, `distortions` (OpenCV order), `rotation` (Rodrigues vector or matrix), `translation` (metres,
world to camera) and, mostly, `size` and `name`. Pixel centres lie at integers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.model.documents import read_toml
from posegaussian.storage.model.errors import CalibrationError, SourceError


def toml_tables(path: Path) -> dict[str, Mapping[str, Any]]:
    """{key: table} of the cameras at the top of a file or one level below;
    empty when it holds none. Raises CalibrationError."""
    try:
        data = read_toml(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    nested = {f"{k}.{n}": t for k, v in data.items() if isinstance(v, dict) for n, t in v.items()}
    return {k: t for k, t in {**data, **nested}.items() if isinstance(t, dict) and "matrix" in t}


def table_camera(name: str, table: Mapping[str, Any]) -> RawCamera:
    """The camera a table describes. Raises CalibrationError, naming the camera,
    for what is missing, malformed or fisheye."""
    for key in ("rotation", "translation"):
        if table.get(key) is None:
            raise CalibrationError(
                f"camera {name}: its calibration has no {key}; calibrate the extrinsics or leave the camera out with"
                " the option cameras"
            )
    if table.get("fisheye"):
        raise CalibrationError(
            f"camera {name}: fisheye = true, but only OpenCV's rational model (k1 k2 p1 p2 k3 k4 k5 k6) is read;"
            " calibrate with it or leave the camera out"
        )
    size = None if table.get("size") is None else numbers(table["size"], name, "size", [(2,)])
    return RawCamera(
        name,
        numbers(table["matrix"], name, "matrix", [(3, 3)]),
        numbers(table.get("distortions", []), name, "distortions", [(-1,)]),
        numbers(table["rotation"], name, "rotation", [(3,), (3, 3)]),
        numbers(table["translation"], name, "translation", [(3,)]),
        None if size is None else _whole(size, name),
    )


def _whole(size: Any, name: str) -> tuple[int, int]:
    w, h = size.tolist()
    if not (w == w // 1 and h == h // 1 and w > 0 and h > 0):
        raise CalibrationError(
            f"camera {name}: size {size.tolist()} must be two positive whole numbers (width, height)"
        )
    return int(w), int(h)
