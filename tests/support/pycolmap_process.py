"""pycolmap in a process of its own: loaded beside OpenCV, its libraries take OpenCV's place, and writing a PNG aborts.

`ask(what, ...)` runs one of the functions below there; arguments and answers are JSON.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def ask(what: str, **arguments: Any) -> Any:
    """The answer of a function below; skips the test where pycolmap is not installed."""
    if importlib.util.find_spec("pycolmap") is None:
        pytest.skip("pycolmap (extra dev) is not installed")
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.pycolmap_process", what],
        input=json.dumps(arguments),
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def content(folder: str) -> dict[str, Any]:
    """Images with pose [3][4] and camera, and points, of a model."""
    import pycolmap

    model = pycolmap.Reconstruction(folder)
    return {
        "images": {
            i.name: {
                "pose": i.cam_from_world().matrix().tolist(),
                "params": i.camera.params.tolist(),
                "size": [i.camera.width, i.camera.height],
            }
            for i in model.images.values()
        },
        "points": {str(k): [*p.xyz.tolist(), *p.color.tolist()] for k, p in model.points3D.items()},
    }


def written(folder: str, text: str, binary: str) -> None:
    """Read a model and write it as text and binary."""
    import pycolmap

    model = pycolmap.Reconstruction(folder)
    model.write_text(text)
    model.write_binary(binary)


def models() -> dict[str, list[int]]:
    """{camera model: [number, parameters]}."""
    import pycolmap

    known = {n: v for n, v in pycolmap.CameraModelId.__members__.items() if n != "INVALID"}
    return {n: [int(v), len(pycolmap.Camera.create(1, v, 50.0, 64, 48).params)] for n, v in known.items()}


def projected(cameras: dict[str, list[float]], points: list[list[float]]) -> dict[str, list[list[float]]]:
    """{model: pixels} of points in a camera's frame."""
    import numpy as np
    import pycolmap

    return {
        model: pycolmap.Camera(model=model, width=64, height=48, params=params).img_from_cam(np.array(points)).tolist()
        for model, params in cameras.items()
    }


def rig(folder: str, form: str, names: list[str], params: list[list[float]], poses: list[list[list[float]]]) -> None:
    """Write a model of one rig over three frames: the first camera is the reference, the others are fixed to it."""
    import numpy as np
    import pycolmap

    model, one = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1)
    matrices = [np.array(p) for p in poses]
    placed = [pycolmap.Rigid3d(pycolmap.Rotation3d(m[:, :3]), m[:, 3]) for m in matrices]
    cameras = [
        pycolmap.Camera(camera_id=v + 1, model="OPENCV", width=64, height=48, params=p) for v, p in enumerate(params)
    ]
    for v, camera in enumerate(cameras):
        model.add_camera(camera)
        if v == 0:
            one.add_ref_sensor(camera.sensor_id)
        else:
            one.add_sensor(camera.sensor_id, placed[v] * placed[0].inverse())
    model.add_rig(one)
    for n in range(3):
        frame = pycolmap.Frame(frame_id=n + 1, rig_id=1)
        frame.rig_from_world = placed[0]
        images = []
        for v, camera in enumerate(cameras):
            name, number = f"{names[v]}/{n:06d}.png", len(cameras) * n + v + 1
            image = pycolmap.Image(image_id=number, name=name, camera_id=camera.camera_id)
            image.frame_id = n + 1
            frame.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
    (model.write_text if form == "text" else model.write_binary)(folder)


if __name__ == "__main__":
    functions = {f.__name__: f for f in (content, written, models, projected, rig)}
    print(json.dumps(functions[sys.argv[1]](**json.load(sys.stdin))))
