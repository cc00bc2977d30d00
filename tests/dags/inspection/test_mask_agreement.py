"""Masks that do not fit each other: the one that is wrong is blamed, and the frame is named."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tests.dags.inspection.test_inspecting import bad_cameras, context_of, found, report_of
from tests.support.pipeline import film


def test_a_mask_that_lacks_half_of_the_person_in_a_frame_is_blamed_and_not_those_that_it_contradicts(
    tmp_path: Path,
) -> None:
    """Its own outline is contradicted by nobody."""
    folder = tmp_path / "capture"
    film(folder, views=5, size=96, frames=3, held_out=0, depth=False)
    file = sorted((folder / "masks" / "cam02").iterdir())[1]
    mask = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    rows = np.nonzero(mask.any(axis=1))[0]
    mask[rows[len(rows) // 2] :] = 0
    cv2.imwrite(str(file), mask)
    report = report_of(context_of(folder, tmp_path / "archive"))
    assert bad_cameras(report, "mask agreement") == {"cam02"}
    assert found(report, "mask agreement", "cam02").sentence.startswith("in frame 1 it leaves ")
