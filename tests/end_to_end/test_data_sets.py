"""Captures laid out as data sets are go all the way: imported, run and exported as a video, from the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.readers.images import read_picture

FRAMES = 3
VIEWS = 4
LABEL = 5
"""Of a part of the body, in masks that hold labels."""


def encoded(ending: str, picture: np.ndarray) -> np.ndarray:
    """The bytes of a picture [h, w] or [h, w, 3] RGB, as a file of that ending has them."""
    return np.asarray(cv2.imencode(ending, picture[..., ::-1] if picture.ndim == 3 else picture)[1]).ravel()


def corner_free(person: PersonCapture, v: int) -> np.ndarray:
    """[3, 3] px, pixel centres at integers."""
    return person.rig.intrinsics[v] - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]


def zju_mocap(person: PersonCapture, base: Path) -> None:
    """annots.npy with millimetres, labels of parts as masks."""
    names = [f"Camera_B{v + 1}" for v in range(VIEWS)]
    poses = person.rig.world_to_camera
    cams = {
        "K": [corner_free(person, v) for v in range(VIEWS)],
        "D": [np.zeros((5, 1))] * VIEWS,
        "R": [m[:3, :3] for m in poses],
        "T": [1000 * m[:3, 3:] for m in poses],
    }
    listed = [{"ims": [f"{c}/{n:06d}.jpg" for c in names]} for n in range(FRAMES)]
    for n in range(FRAMES):
        for v, place in enumerate(listed[n]["ims"]):
            labels = np.where(person.mask[n, v] > 127, LABEL, 0).astype(np.uint8)
            for path, content in (
                (base / place, encoded(".jpg", person.color[n, v])),
                ((base / "mask_cihp" / place).with_suffix(".png"), encoded(".png", labels)),
            ):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content.tobytes())
    np.save(base / "annots.npy", {"cams": cams, "ims": listed}, allow_pickle=True)


def dna_rendering(person: PersonCapture, base: Path) -> None:
    """Two HDF5 files, poses camera to world, masks of three channels."""
    base.mkdir()
    with h5py.File(base / "0012_01.smc", "w") as main, h5py.File(base / "0012_01_annots.smc", "w") as annots:
        for v in range(VIEWS):
            for n in range(FRAMES):
                main[f"Camera_5mp/{v}/color/{n}"] = encoded(".jpg", person.color[n, v])
                annots[f"Mask/{v}/mask/{n}"] = encoded(".png", np.repeat(person.mask[n, v][..., None], 3, axis=2))
            of = f"Camera_Parameter/{v:02d}"
            annots[f"{of}/K"], annots[f"{of}/D"] = corner_free(person, v), np.zeros(5)
            annots[f"{of}/RT"] = np.linalg.inv(person.rig.world_to_camera[v])
            annots[f"{of}/Color_Calibration"] = np.eye(3)


@pytest.mark.parametrize("write", [zju_mocap, dna_rendering])
def test_a_capture_of_a_data_set_becomes_a_video(write: Callable[[PersonCapture, Path], None], tmp_path: Path) -> None:
    person = capture_person(views=VIEWS, size=48, frames=FRAMES, held_out=0)
    write(person, tmp_path / "capture")
    settings = [
        "run.scheduler=serial", "depth.method=hull", "network.weights=none", "views.held_out=[]", "views.trust=all",
    ]  # fmt: skip
    archive = ["--archive", str(tmp_path / "archive"), *(word for s in settings for word in ("--set", s))]
    out = tmp_path / "out"
    for words in (
        ["import", "auto", str(tmp_path / "capture"), "--sequence", "walk"],
        ["run", "--sequence", "walk", "--path", "orbit"],
        ["export", "walk", "--path", "orbit", "--video", f"{out}.mp4", "--frames", str(out)],
    ):
        done = CliRunner().invoke(app, [*words, *archive])
        assert done.exit_code == 0, done.output
        assert words[0] != "import" or write.__name__ in done.output
    pictures = [read_picture(p) for p in sorted(out.rglob("*.png"))]
    assert len(pictures) == FRAMES
    for picture in pictures:
        seen = (picture.max(axis=-1) > 50).mean()
        assert 0.02 < seen < 0.6, "a person before black fills some of the picture and not most of it"
    video = cv2.VideoCapture(f"{out}.mp4")
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == FRAMES
