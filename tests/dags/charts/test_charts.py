"""Charts: equal numbers give equal files, whatever matplotlib was told elsewhere, and names of points stay apart."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.transforms import Bbox

from posegaussian.dags.charts.style import chart, name_points
from posegaussian.dags.tradeoff.figure import draw
from posegaussian.dags.tradeoff.pareto import Level
from posegaussian.dags.training.figure import draw as draw_training
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.readers.images import read_picture

CROWDED = [
    *[(0.44, 23.2), (0.46, 25.7), (0.47, 23.8), (0.50, 26.8), (0.63, 23.3)],
    *[(0.65, 24.7), (0.67, 23.9), (0.71, 27.9), (0.83, 24.0)],
]
"""Seconds and decibels of a trade-off, some of them a few px apart."""


def plain(file: Path) -> bytes:
    with chart(file, 4, 3) as figure:
        axes = figure.subplots()
        axes.plot([1, 2, 4], [3, 1, 2], "o-", label="walk $1$")
        axes.legend()
    return file.read_bytes()


@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_equal_charts_are_equal_files_whatever_the_users_settings(
    tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = plain(tmp_path / f"a{ending}")
    own: dict[Any, Any] = {"lines.linewidth": 9.0, "savefig.dpi": 40, "savefig.bbox": "tight", "font.size": 20.0}
    for key, value in own.items():
        monkeypatch.setitem(matplotlib.rcParams, key, value)
    assert plain(tmp_path / f"b{ending}") == first
    assert matplotlib.rcParams["lines.linewidth"] == 9.0, "settings are as they were"


def test_files_bear_neither_date_nor_version(tmp_path: Path) -> None:
    assert b"Software" not in plain(tmp_path / "a.png")
    svg = plain(tmp_path / "a.svg").decode()
    assert "dc:date" not in svg
    assert matplotlib.__version__ not in svg
    assert ">walk $1$<" in svg, "words stay words, and a dollar is no formula"


def test_nothing_is_left_of_a_chart_that_fails(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    with pytest.raises(ZeroDivisionError), chart(tmp_path / "a.png", 4, 3):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
    assert dict(matplotlib.rcParams) == before


def test_charts_are_drawn_without_pyplot(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from posegaussian.dags.charts.style import chart\n"
        f"with chart(Path({str(tmp_path / 'a.svg')!r}), 4, 3) as figure: figure.subplots().plot([1, 2])\n"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    assert done.stdout.strip() == "False"


def test_names_hide_neither_points_nor_each_other(tmp_path: Path) -> None:
    boxes: list[Bbox] = []
    with chart(tmp_path / "a.png", 4, 4) as figure:
        axes = figure.subplots()
        axes.plot(*zip(*CROWDED, strict=True), "o")
        name_points(axes, CROWDED, [f"level {i}" for i in range(len(CROWDED))], ["black"] * len(CROWDED), size=8)
        at = axes.transData.transform(CROWDED)
        boxes = [t.get_window_extent() for t in axes.texts]
        frame = axes.bbox
    assert len(boxes) == len(CROWDED)
    for i, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:i]), i
        assert not any(box.contains(x, y) for x, y in at), i
        assert all(frame.contains(*corner) for corner in (box.min, box.max)), i
        assert np.hypot(*(np.mean([box.min, box.max], axis=0) - at[i])) < 120, "px: 0.8 inches at 150 dpi"


def test_a_line_leads_from_a_point_to_a_name_that_is_not_next_to_it(tmp_path: Path) -> None:
    with chart(tmp_path / "a.png", 4, 4) as figure:
        axes = figure.subplots()
        axes.plot(*zip(*CROWDED, strict=True), "o")
        name_points(axes, CROWDED, [f"level number {i}" for i in range(len(CROWDED))], ["black"] * len(CROWDED), size=8)
        at, boxes = axes.transData.transform(CROWDED), [t.get_window_extent() for t in axes.texts]
        ends = [line.get_transform().transform(line.get_xydata()) for line in figure.artists]
        gaps = [float(np.hypot(*(np.clip(p, b.min, b.max) - p))) for p, b in zip(at, boxes, strict=True)]
    led = {int(np.argmin(np.hypot(*(at - start).T))): (start, end) for start, end in ends}
    assert 0 < len(led) == len(ends) < len(CROWDED), "some names are next to their points and some are not"
    for i, (start, end) in led.items():
        np.testing.assert_allclose(start, at[i], atol=1e-6)
        assert np.hypot(*(np.clip(end, boxes[i].min, boxes[i].max) - end)) < 3, "px: it ends at its name"
    assert min(gaps[i] for i in led) > max(gap for i, gap in enumerate(gaps) if i not in led)


def levels(*measures: str, seconds: float = 1.0) -> list[Level]:
    """Three levels of which the last is on no front."""
    values = {"psnr box": (20.0, 24.0, 22.0), "ssim box": (0.8, 0.9, 0.85), "epe": (2.0, 1.0, 1.5)}
    costs = (1.0, 1.0 + seconds, 1.1 + seconds)
    found = []
    for i in range(3):
        knobs, quality = {"depth.method": f"way {i}", "frames.size": None}, {m: values[m][i] for m in measures}
        found.append(Level(knobs, None, {}, {"depth": costs[i]}, quality))  # type: ignore[arg-type]
    return found


def test_a_trade_off_has_a_panel_a_measure_and_a_line_a_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(
        "posegaussian.dags.tradeoff.figure.heading", lambda figure, text, *_, **__: seen.append((figure, text))
    )
    draw(tmp_path / "a.png", levels("psnr box", "ssim box", "epe", seconds=9.0), "walk", "here")
    figure = seen[0][0]
    *panels, lower = figure.get_axes()
    titles = ["PSNR in the mask's box", "SSIM in the mask's box", "EPE of the depth"]
    assert [p.get_title(loc="left") for p in panels] == titles
    words = ["PSNR, dB (higher is better)", "SSIM (higher is better)", "EPE, px (lower is better)"]
    assert [p.get_ylabel() for p in panels] == words
    assert {p.get_xscale() for p in panels} == {"log"}
    assert {p.get_xlabel() for p in panels} == {"seconds a frame, all stages (logarithmic)"}
    for p in panels:
        front, others = p.lines
        assert (len(front.get_xdata()), list(others.get_xdata())) == (2, [10.1])
        assert [t.get_text() for t in p.texts] == ["1", "2", "3"]
    cells = lower.tables[0].get_celld()
    line = [cells[2, c].get_text().get_text() for c in range(7)]
    assert line == ["2", "way 1", "full", "10.0", "24.00", "0.9000", "1.000"]
    weights = [cells[row, 4].get_text().get_weight() for row in (1, 2, 3)]
    assert weights == ["bold", "bold", "normal"], "on the front or not"


def test_a_measure_that_is_missing_has_no_panel_and_short_spans_are_linear(tmp_path: Path) -> None:
    draw(tmp_path / "a.png", levels("psnr box"), "walk", "here")
    draw(tmp_path / "b.png", levels("psnr box", "ssim box", "epe"), "walk", "here")
    narrow, wide = (read_picture(tmp_path / f"{n}.png").shape[1] for n in "ab")
    assert narrow < wide


def test_a_training_of_any_length_is_drawn(tmp_path: Path) -> None:
    config = TrainingConfig(depth_steps=6, joint_steps=6)
    steps: list[dict[str, Any]] = [
        {"kind": "step", "step": s, "loss": None if s == 3 else 1.0 / s} for s in range(1, 13)
    ]
    measured: dict[str, Any] = {"epe": 0.5, "epe start": 2.0, "confidence": 0.5, "name": "x"}
    checked: list[dict[str, Any]] = [{"kind": "validation", "step": s, **measured} for s in (6, 12)]
    heights = []
    for rows in (steps[:1], checked[:1], [*steps, *checked]):
        draw_training(tmp_path / "training.png", rows, config)
        heights.append(read_picture(tmp_path / "training.png").shape[0])
    assert heights == [450, 450, 900], "px: one, two and three panels, two beside each other"
