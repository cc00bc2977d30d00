"""The contact sheet shows novel views large and loses nothing of them but black."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.exporters.contact_sheet import COMPARED, LABEL, NOVEL, SOURCE, Sheet, write_sheet
from posegaussian.storage.readers.images import read_picture


@pytest.mark.parametrize("seed", range(5))
def test_what_is_cut_off_is_black(seed: int) -> None:
    random = np.random.default_rng(seed)
    picture = np.zeros((60, 90, 3), np.uint8)
    top, left = random.integers(0, 30, 2)
    picture[top : top + 20, left : left + 30] = random.integers(0, 256, (20, 30, 3))
    sheet = Sheet(None)
    sheet.begin()
    sheet.add_novel("cam", picture, None)
    ((_, [(_, shown)]),) = sheet.sections[0]
    assert shown.sum() == picture.sum()
    assert shown.shape[0] < 30
    assert shown.shape[1] < 40


def test_truth_and_picture_are_cut_alike() -> None:
    picture, truth = np.zeros((2, 40, 40, 3), np.uint8)
    picture[10:20, 10:20], truth[15:30, 5:20] = 200, 100
    sheet = Sheet(None)
    sheet.begin()
    sheet.add_novel("cam", picture, truth)
    ((height, strip),) = sheet.sections[0]
    assert height == COMPARED
    assert len({shown.shape for _, shown in strip}) == 1
    assert [int(shown.sum()) for _, shown in strip[:2]] == [int(picture.sum()), int(truth.sum())]


def test_a_black_picture_is_shown_whole() -> None:
    sheet = Sheet(None)
    sheet.begin()
    sheet.add_novel("cam", np.zeros((40, 30, 3), np.uint8), None)
    assert sheet.sections[0][0][1][0][1].shape == (40, 30, 3)


def test_novel_views_are_the_large_ones_and_come_first(tmp_path: Path) -> None:
    assert NOVEL > COMPARED > SOURCE
    sheet = Sheet(None)
    sheet.begin()
    sheet.add_novel("cam", np.full((50, 50, 3), 255, np.uint8), None)
    sheet.begin()
    sheet.add_source(
        "cam", *(np.full(s, 90, np.uint8) for s in ((50, 50, 3), (50, 50))), None, np.ones((50, 50), np.float32)
    )
    write_sheet(tmp_path / "sheet.png", sheet)
    drawn = read_picture(tmp_path / "sheet.png")
    white = (drawn == 255).all(axis=2)
    assert white[: LABEL + NOVEL].sum() >= NOVEL * NOVEL
