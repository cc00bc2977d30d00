"""The plan in a report: every stage has its line, every read its arc, and a failed stage is red."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from posegaussian.dags.diagnostics.plan_graph import COLORS, cards
from posegaussian.dags.planning.plan import State
from posegaussian.dags.report.flow import FAILED, flow
from posegaussian.stages.registry import STAGES
from tests.support.pipeline import Pipeline


def svg(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(re.search(r"<svg.*</svg>", text, re.DOTALL)[0])  # type: ignore[index]


def test_every_stage_has_a_line_and_every_read_an_arc(finished: Pipeline) -> None:
    drawn = cards([finished.plan()])
    picture = svg(flow(drawn, {"depth": 12.0}, ()))
    names = [t.text for t in picture.iter("tspan")]
    assert names == [s.name for s in STAGES]
    told = [t.text or "" for t in picture.iter("title")]
    arcs = {tuple(t.split(": ")[0].split(" → ")) for t in told if " → " in t}
    assert arcs == {(c.name, r) for c in drawn for a in c.arrays if a.total for r in a.readers}
    assert ("depth", "gaussians") in arcs
    assert "12.0 s" in [t.text for t in picture.iter("text")]
    down = [re.findall(r"-?\d+", p.get("d", "")) for p in picture.iter("path") if not p.get("class")]
    assert all(int(d[1]) < int(d[-1]) for d in down), "what is read lies above its reader"


def test_colours_say_what_became_of_a_stage(finished: Pipeline) -> None:
    drawn = cards([finished.plan()])
    colors = {
        n.text: c.get("stroke")
        for n, c in zip(*map(svg(flow(drawn, {}, {"depth"})).iter, ("tspan", "circle")), strict=True)
    }
    assert colors["depth"] == FAILED
    assert colors["frames"] == COLORS[State.FRESH]
    assert colors["network"] == COLORS[None]
    assert "failed" in flow(drawn, {}, {"depth"})
    assert "failed" not in flow(drawn, {}, ())
