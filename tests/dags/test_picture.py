"""The picture of a plan: everything is on it once, with its counts, and no line runs behind a card."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from posegaussian.dags.diagnostics.plan_graph import CARD, HEAD, ROW, Card, cards, size_text, write_picture
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.stages.registry import STAGES
from tests.support.pipeline import Pipeline

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def plan(finished: Pipeline) -> Plan:
    """Gaussians are stale, what follows is undecided, the rest is fresh."""
    return finished.with_settings("gaussians.footprint=0.6").plan()


def of(plan: Plan, name: str) -> Card:
    return next(c for c in cards([plan]) if c.name == name)


def test_stages_carry_the_plans_states_and_arrays_their_shards(plan: Plan) -> None:
    assert [of(plan, s).state for s in ("frames", "gaussians", "rendering", "survey")] == [
        State.FRESH,
        State.STALE,
        State.UNDECIDED,
        None,
    ]
    assert of(plan, "gaussians").note() == "3 stale"
    assert "not needed" in of(plan, "survey").note()
    color = of(plan, "frames").arrays[0]
    assert (color.name, color.there, color.total, color.dropped) == ("frames/color", 21, 21, 0)
    assert color.size > 1000
    assert of(plan, "frames").sources == ["pictures", "masks", "depth"]


def test_edges_are_the_reads_that_count_under_the_settings(plan: Plan, finished: Pipeline) -> None:
    assert of(plan, "frames").arrays[0].readers == ["depth", "rendering", "metrics"]
    hull = finished.with_settings("depth.method=hull").plan()
    assert "depth" not in of(hull, "frames").arrays[0].readers, "the hull looks at masks alone"


def test_the_counts_of_several_sequences_are_added(plan: Plan) -> None:
    twice = cards([plan, plan])
    assert [c.counts.total() for c in twice] == [2 * c.counts.total() for c in cards([plan])]


def test_the_svg_names_every_stage_and_array_once_and_is_well_formed(plan: Plan, tmp_path: Path) -> None:
    root = ET.parse(write_picture([plan], tmp_path / "dag.svg")).getroot()
    texts = [t.text for t in root.iter(f"{SVG}text")]
    for stage in STAGES:
        assert texts.count(stage.name) == 1
        for spec in stage.writes:
            assert texts.count(spec.name) == 1
    assert "21/21" in " ".join(t or "" for t in texts)


def test_no_line_runs_behind_a_card(plan: Plan, tmp_path: Path) -> None:
    root = ET.parse(write_picture([plan], tmp_path / "dag.svg")).getroot()
    boxes = [
        (float(r.get("x", 0)), float(r.get("y", 0)), float(r.get("height", 0)))
        for r in root.iter(f"{SVG}rect")
        if r.get("width") == str(CARD)
    ]
    assert len(boxes) == len(STAGES)
    for path in [p.get("d", "") for p in root.iter(f"{SVG}path") if "Z" not in p.get("d", "")]:
        x, y, end = (float(v) for v in re.fullmatch(r"M([\d.]+) ([\d.]+)[VH]([\d.]+)", path).groups())  # type: ignore[union-attr]
        (x0, x1), (y0, y1) = ((x, x), sorted((y, end))) if "V" in path else (sorted((x, end)), (y, y))
        for left, top, height in boxes:
            assert x1 <= left or x0 >= left + CARD or y1 <= top or y0 >= top + height, path
    assert min(h for _, _, h in boxes) >= HEAD + ROW


def test_mermaid_has_every_edge(plan: Plan, tmp_path: Path) -> None:
    text = write_picture([plan], tmp_path / "dag.md").read_text()
    assert text.startswith("```mermaid\n")
    assert text.rstrip().endswith("```")
    for c in cards([plan]):
        for a in c.arrays:
            for reader in a.readers:
                assert f"  {a.name.replace('/', '_').replace('{path}', 'path')} --> {reader}\n" in text
    assert "gaussians[" in text
    assert ":::stale" in text


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 B"), (999, "999 B"), (1000, "1 kB"), (46123, "46.1 kB"), (3 * 10**13, "30 TB"), (3 * 10**16, "3e+04 TB")],
)
def test_bytes_in_the_largest_unit_that_fits(size: int, text: str) -> None:
    assert size_text(size) == text
