"""Networks of the user's own: tiny ones, written here, whose heatmaps and bins are the colours of the picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from posegaussian.stages.estimators.description import Description, read_description
from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.estimators.onnx import OnnxEstimator
from posegaussian.stages.estimators.outputs import _to_cells, _to_shares
from posegaussian.stages.imaging.regions import to_own, to_picture
from posegaussian.storage.model.errors import ConfigError
from tests.support.onnx_files import heatmap_network, simcc_network

REGION = np.array([150.3, 120.7, 160.0, 0.3])
DOTS = np.array([[150.0, 120.0], [131.4, 98.3], [165.7, 150.2]])
SPREAD = 6.0
HEATMAP = {
    "file": "net.onnx",
    "kind": "heatmap",
    "input": [96, 128],
    "outputs": ["maps"],
    "scale": 1 / 255,
    "joint_set": "coco17",
}
SIMCC = HEATMAP | {"kind": "simcc", "outputs": ["along_x", "along_y"]}


def dots(where: np.ndarray = DOTS) -> np.ndarray:
    """A picture with one Gaussian dot in each colour."""
    v, u = np.mgrid[:260, :300] + 0.5
    square = (u[..., None] - where[:, 0]) ** 2 + (v[..., None] - where[:, 1]) ** 2
    return np.rint(250 * np.exp(-square / (2 * SPREAD**2))).astype(np.uint8)


def described(folder: Path, settings: dict[str, Any]) -> Description:
    file = folder / "net.yaml"
    file.write_text(yaml.safe_dump(settings))
    return read_description(file)


def estimator(folder: Path, kind: str, **changes: Any) -> OnnxEstimator:
    if kind == "heatmap":
        heatmap_network(folder / "net.onnx", 96, 128, 4)
    else:
        simcc_network(folder / "net.onnx", 96, 128)
    return OnnxEstimator(described(folder, (HEATMAP if kind == "heatmap" else SIMCC) | changes))


@pytest.mark.parametrize("kind", ["heatmap", "simcc"])
def test_joints_come_out_where_the_dots_are(kind: str, tmp_path: Path) -> None:
    found = estimator(tmp_path, kind).look(dots(), REGION[None])
    truth = DOTS[np.arange(17) % 3]
    # a dot of 6 px in 8 bits, sampled bilinearly every 1.25 px (and every fourth of those): a tenth of a pixel
    assert np.abs(found.joints[0, :, :2] - truth).max() < 0.1
    assert np.abs(found.joints[0, :, 2] - 250 / 255).max() < 0.2
    assert np.allclose(found.region[0], REGION)
    assert not found.person.any()
    assert np.isclose(found.presence[0], found.joints[0, :, 2].mean())


@pytest.mark.parametrize("kind", ["heatmap", "simcc"])
def test_heatmaps_lie_over_the_region(kind: str, tmp_path: Path) -> None:
    found = estimator(tmp_path, kind).look(dots(), REGION[None])
    maps = found.heatmaps[0].astype(float)
    i, j = np.mgrid[:64, :64] + 0.5
    total = maps.sum((1, 2))
    centres = np.stack([(maps * j).sum((1, 2)), (maps * i).sum((1, 2))], 1) / total[:, None] / 64
    # half precision and the cut at the region's edge: a fifth of a cell
    assert np.abs(centres - to_own(DOTS[np.arange(17) % 3], REGION)).max() < 0.2 / 64
    assert np.abs(maps.max((1, 2)) - found.joints[0, :, 2]).max() < 1e-3


def test_the_order_of_colours_is_the_description_s(tmp_path: Path) -> None:
    found = estimator(tmp_path, "heatmap", channels="bgr").look(dots(), REGION[None])
    assert np.abs(found.joints[0, :3, :2] - DOTS[::-1]).max() < 0.1


def test_mean_and_std_are_applied_after_the_scale(tmp_path: Path) -> None:
    plain = estimator(tmp_path, "heatmap").look(dots(), REGION[None])
    shifted = estimator(tmp_path, "heatmap", mean=[-1.0, -1.0, -1.0], std=[2.0, 2.0, 2.0]).look(dots(), REGION[None])
    assert np.allclose(shifted.joints[0, :, 2], (plain.joints[0, :, 2] + 1) / 2, atol=1e-3)


def test_a_larger_margin_sees_more_and_finds_the_same(tmp_path: Path) -> None:
    near, far = (estimator(tmp_path, "heatmap", margin=m).look(dots(), REGION[None]) for m in (1.0, 1.4))
    assert np.abs(near.joints[..., :2] - far.joints[..., :2]).max() < 0.2


def test_a_joint_outside_the_picture_was_not_seen(tmp_path: Path) -> None:
    blank = np.zeros((260, 300, 3), np.uint8)
    found = estimator(tmp_path, "heatmap", scale=1.0, mean=[-1.0, -1.0, -1.0]).look(
        blank, np.array([[-200.0, 100.0, 100.0, 0.0]])
    )
    assert (found.joints[0, :, 2] == 0).all()


@pytest.mark.parametrize("cells", ["integer", "centre", "corners"])
def test_cells_and_shares_are_inverse(cells: str, tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"")
    d = described(tmp_path, HEATMAP | {"cells": cells})
    counts = np.array([24, 32])
    at = np.random.default_rng(0).uniform(0, 20, (9, 2))
    assert np.allclose(_to_cells(_to_shares(at, counts, d), counts, d), at)
    # the last cell: pixel 92 of 96 from the first's centre, the middle of the last of 24 parts,
    # or the last pixel's centre
    last = {"integer": 92.5 / 96, "centre": 23.5 / 24, "corners": 95.5 / 96}[cells]
    assert np.isclose(_to_shares(counts - 1.0, counts, d)[0], last)


class Finder:
    """Finds two regions in every picture."""

    joint_set = "coco17"

    def find(self, picture: np.ndarray, most: int) -> Found:
        return self.look(picture, np.stack([REGION, 1.1 * REGION])[:most])

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        n = len(regions)
        return Found(
            np.zeros((n, 17, 3), np.float32),
            regions.astype(np.float32),
            np.zeros((n, 17, 64, 64), np.float16),
            np.tile(np.rint(regions[:, 2])[:, None, None].astype(np.uint8), (256, 256)),
            np.ones(n, np.float32),
        )


def test_people_come_from_the_finder_or_from_the_whole_picture(tmp_path: Path) -> None:
    alone = estimator(tmp_path, "heatmap")
    assert "whole picture" in alone.where
    assert np.allclose(alone.find(dots(), 3).region, [[150, 130, 300, 0]])
    led = OnnxEstimator(described(tmp_path, HEATMAP), Finder())
    assert "Finder" in led.where
    assert len(led.find(dots(), 3)) == 2
    assert len(led.find(dots(), 1)) == 1


def test_who_finds_the_people_segments_them_too(tmp_path: Path) -> None:
    alone = estimator(tmp_path, "heatmap")
    assert not alone.find(dots(), 3).person.any()
    led = OnnxEstimator(described(tmp_path, HEATMAP), Finder())
    for found in (led.find(dots(), 3), led.look(dots(), np.stack([REGION, 1.1 * REGION]))):
        np.testing.assert_array_equal(found.person[:, 0, 0], np.rint(found.region[:, 2]))


def test_equal_pictures_give_equal_bytes(tmp_path: Path) -> None:
    e = estimator(tmp_path, "simcc")
    a, b = e.find(dots(), 1), e.find(dots(), 1)
    assert all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in ("joints", "region", "heatmaps", "presence"))


def test_outputs_of_another_shape_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        ConfigError, match=r"output maps has the shape \[17, 32, 24\]; a heatmap network of body_25 gives 25 joints"
    ):
        estimator(tmp_path, "heatmap", joint_set="body_25").look(dots(), REGION[None])


def test_a_file_that_is_no_network_is_named(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"this is no network")
    with pytest.raises(ConfigError, match=r"net\.onnx: OpenCV's DNN cannot read it"):
        OnnxEstimator(described(tmp_path, HEATMAP))


def test_a_missing_output_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"net\.onnx: OpenCV's DNN cannot run it for outputs nothing"):
        estimator(tmp_path, "heatmap", outputs=["nothing"]).look(dots(), REGION[None])


def test_places_follow_the_region_s_angle(tmp_path: Path) -> None:
    e = estimator(tmp_path, "heatmap")
    for angle in (0.0, -0.8, 2.0):
        region = np.array([150.0, 122.0, 200.0, angle])
        found = e.look(dots(), region[None])
        assert np.abs(found.joints[0, :3, :2] - DOTS).max() < 0.15
        assert np.allclose(to_picture(to_own(DOTS, region), region), DOTS)
