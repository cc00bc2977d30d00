"""A measured stereo pair with published disparity (Middlebury 2014, Motorcycle, a quarter of its size): the open sweep
beside OpenCV's SGBM.

    python -m benchmarks.depth.motorcycle

The folder reference/motorcycle is looked for in POSEGAUSSIAN_CAPTURES, by default ../shared. Both matchers see the pair
alone and search the same disparities. Density is the share of the pixels with published disparity that a matcher
answers, its surest ones first where there is a choice; bad-2px is the share of those answers that are off by more than
2 px.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.report import publish
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry
from posegaussian.stages.depth.algorithms.sweeping import sweep_open
from posegaussian.stages.depth.params import DepthParams
from posegaussian.storage.model.cameras import Rig, from_integer_centres
from posegaussian.storage.readers.images import read_picture

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "motorcycle"
FOCAL, CENTRE, SHIFT, BASELINE = 994.978, (311.193, 254.877), 31.086, 0.193001
"""px, integer-centre px, px by which the right picture's centre lies farther right, metres: the data set's
calibration at this size."""
SEARCHED = 80
"""Disparities searched, px; the published ones are 7 to 60."""
DENSITIES = (0.75, 0.8, 0.85, 0.9)


@dataclass(frozen=True, eq=False)
class Pair:
    """The two pictures and what is known of them."""

    left: np.ndarray
    """[h, w, 3] uint8."""
    right: np.ndarray
    """[h, w, 3] uint8."""
    disparity: np.ndarray
    """[h, w] float32 px of the left picture, infinite where unknown."""

    @property
    def rig(self) -> Rig:
        """Two parallel cameras."""
        height, width = self.disparity.shape
        k = np.tile(np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1]]), (2, 1, 1))
        k[1, 0, 2] += SHIFT
        pose = np.tile(np.eye(4), (2, 1, 1))
        pose[1, 0, 3] = -BASELINE
        return Rig(("left", "right"), from_integer_centres(k), np.zeros((2, 8)), pose, np.tile([width, height], (2, 1)))


def load(folder: Path = FOLDER) -> Pair:
    """The pair of the folder; FileNotFoundError where it is missing."""
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder} is missing; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/motorcycle"
        )
    left, right = (read_picture(folder / f"motorcycle_{side}.png") for side in ("left", "right"))
    return Pair(left, right, np.load(folder / "motorcycle_disp.npz")["arr_0"])


def by_sweep(pair: Pair) -> tuple[np.ndarray, np.ndarray]:
    """Disparity [h, w] px of the left picture, NaN where there is none,
    and confidence [h, w], of the open sweep of the pair."""
    near, far = (FOCAL * BASELINE / (d + SHIFT) for d in (SEARCHED, 0))
    params, rig = DepthParams(method="sweep", depth_range=(near, far)), pair.rig
    everything = np.full(pair.disparity.shape, 255, np.uint8)
    depth, confidence = sweep_open(
        Geometry.of(rig, (0, 1), params), Frame({0: pair.left, 1: pair.right}, {0: everything, 1: everything}), params
    )[0]
    return np.where(depth > 0, FOCAL * BASELINE / np.where(depth > 0, depth, 1) - SHIFT, np.nan), confidence


def by_sgbm(pair: Pair, block: int = 5) -> np.ndarray:
    """Disparity [h, w] px of OpenCV's SGBM with the settings of its own sample, NaN where it says nothing."""
    elements = 3 * block * block
    matcher = cv2.StereoSGBM.create(
        0,
        SEARCHED,
        block,
        P1=8 * elements,
        P2=32 * elements,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
    )
    found = matcher.compute(pair.left, pair.right) / 16
    return np.where(found > 0, found, np.nan)


def bad(
    pair: Pair, disparity: np.ndarray, confidence: np.ndarray | None = None, density: float = 1.0
) -> tuple[float, float]:
    """(density, share of answers off by more than 2 px) of the surest answers up to a density,
    over pixels of known disparity."""
    known = np.isfinite(pair.disparity)
    off = np.abs(disparity - pair.disparity)[known]
    given = np.isfinite(off)
    order = np.argsort(-np.where(given, 1.0 if confidence is None else confidence[known], -1.0), kind="stable")
    kept = order[: min(int(density * known.sum()), int(given.sum()))]
    return len(kept) / int(known.sum()), float((off[kept] > 2).mean())


def main() -> None:
    """Match with both, publish the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    cv2.setNumThreads(1)
    pair, rows = load(), []
    by_sweep(pair)  # compiles
    start = time.perf_counter()
    disparity, confidence = by_sweep(pair)
    seconds = time.perf_counter() - start
    for density in (*DENSITIES, 1.0):
        reached, wrong = bad(pair, disparity, confidence, density)
        rows.append(row("sweep, both directions", reached, wrong, seconds))
    for block in (3, 5, 7):
        start = time.perf_counter()
        found = by_sgbm(pair, block)
        rows.append(row(f"OpenCV SGBM, block {block}", *bad(pair, found), time.perf_counter() - start))
    publish("motorcycle", rows, {"disparities": SEARCHED})


def row(name: str, density: float, wrong: float, seconds: float) -> dict[str, Any]:
    return {"matcher": name, "density %": 100 * density, "bad-2px %": 100 * wrong, "seconds": seconds}


if __name__ == "__main__":
    main()
