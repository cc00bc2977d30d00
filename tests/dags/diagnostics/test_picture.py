"""The picture of a plan: everything is on it, with its counts and its readers."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from posegaussian.dags.diagnostics.plan_graph import StageCard, cards, size_text, write_picture
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.stages.registry import STAGES
from tests.support.pipeline import Pipeline

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def plan(finished: Pipeline) -> Plan:
    """Gaussians are stale, what follows is undecided, the rest is fresh."""
    return finished.with_settings("gaussians.footprint=0.6").plan()


def of(plan: Plan, name: str) -> StageCard:
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


def test_the_svg_names_every_stage_and_array_and_is_well_formed(plan: Plan, tmp_path: Path) -> None:
    root = ET.parse(write_picture([plan], tmp_path / "dag.svg")).getroot()
    texts = [t.text for t in root.iter(f"{SVG}text")]
    for stage in STAGES:
        assert texts.count(stage.name) == 2, "its line and its column"
        for spec in stage.writes:
            assert texts.count(spec.name) == 1
    assert "21/21" in " ".join(t or "" for t in texts)


def test_the_svg_has_a_dot_in_the_column_of_every_reader(plan: Plan, tmp_path: Path) -> None:
    root = ET.parse(write_picture([plan], tmp_path / "dag.svg")).getroot()
    dots = {g.get("id"): [float(u.get("x", 0)) for u in g.iter(f"{SVG}use")] for g in root.iter(f"{SVG}g")}
    columns: dict[str, set[float]] = {}
    for c in cards([plan]):
        for a in c.arrays:
            drawn = dots.get(f"readers of {a.name}", [])
            assert len(drawn) == len(a.readers), a.name
            for reader, x in zip(a.readers, drawn, strict=True):
                columns.setdefault(reader, set()).add(x)
    assert all(len(x) == 1 for x in columns.values()), "one column a stage"
    order = [min(columns[s.name]) for s in STAGES if s.name in columns]
    assert order == sorted(set(order)), "columns in the order of flow"


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
