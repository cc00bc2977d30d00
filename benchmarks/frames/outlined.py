"""Pictures of captures that were outlined by hand (`outlines/CAPTURE.json`), as mattes of frames/*."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.stages.imaging.camera_mapping import frames_positions, switched

FOLDER = Path(__file__).with_name("outlines")
SUBPIXEL = 8
"""Parts of a pixel's side in which polygons are filled."""


def outlines(context: Context, capture: str) -> dict[tuple[int, int], np.ndarray]:
    """{(frame, view): coverage [h, w] uint8} of the hand's polygons in frames pixels, carried there exactly, lens and
    crop included, of the frames that are worked on; nothing of a capture that nobody outlined."""
    file = FOLDER / f"{capture}.json"
    given = json.loads(file.read_text()) if file.exists() else {}
    source_rig, crops = switched(context.capture.rig, context.captured_to_calibrated, context.facts)
    numbers, out = [int(n) for n in context.source_frames], {}
    for v, name in enumerate(context.rig.names):
        for number, shape in given.get(name, {}).items():
            if int(number) not in numbers:
                continue
            width, height = (int(n) for n in context.rig.size[v])
            fine = np.zeros((height * SUBPIXEL, width * SUBPIXEL), np.uint8)
            for polygons, value in ((shape["outer"], 255), (shape["holes"], 0)):
                for polygon in polygons:
                    at = frames_positions(
                        np.array(polygon, dtype=np.float64),
                        context.rig.intrinsics[v],
                        source_rig.intrinsics[v],
                        source_rig.distortion[v],
                        crops[v],
                    )
                    cv2.fillPoly(fine, [np.rint(16 * (SUBPIXEL * at - 0.5)).astype(np.int32)], value, shift=4)
            out[numbers.index(int(number)), v] = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    return out
