"""The paper's account of a frame's time, in its five lines: what they take here, by the receipts that the ledger is
made of."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from posegaussian.dags.ablation.groups import FOOTAGE
from posegaussian.dags.compiling.warm_up import steady_seconds
from posegaussian.dags.evaluation.evaluate import PATHS
from posegaussian.dags.evaluation.spent import DRAWS, hosts, receipts, told
from posegaussian.dags.humanize.text import number
from posegaussian.dags.paper.printed import table
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.reproduction.page import HERE, Page, Part, printed, record
from posegaussian.dags.reproduction.people import Measured, Subject, Wanted
from posegaussian.stages.network.params import NETWORK
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.receipts import Receipt

SPLATTING, POSE, IMAGE, STABILIZER, REST, WHOLE = table("runtime").rows
"""The paper's lines, in its order, and their sum."""
SMOOTHING = "smoothing"
"""The stage that is the paper's Temporal Pose Stabilizer."""
WANTED = (Wanted("people8", FOOTAGE["cameras"]),)
ONCE = "once a sequence"
COMPARABLE = (
    "Comparable: which line is dear, here and there. Not comparable: milliseconds, which are of another machine, and of"
    " another work: here a frame is all source views from filmed pictures to Gaussians, and one picture drawn of them,"
    " with depth by matching and refinement, which the paper has not, in the rest; the paper's stabilizer is said to"
    f" adjust the blending of views, ours smooths heatmaps. What is made {ONCE}, whatever its frames, stands apart."
)


def runtime(found: Measured) -> Page:
    """A column a sequence."""
    its = table("runtime")
    subjects = [s for s, r in found.results if r.numbers]
    plans = [s.session.plan(s.name, Selection(), PATHS) for s in subjects]
    spent = [lines(receipts(p), p.context.grid.frames, _drawn(p)) for p in plans]
    heads = [f"{HERE}{s.name} ({s.data_set}), ms" for s in subjects]
    part = Part("", ["a frame's", "the paper, ms", *heads], [], [])
    for line in (*its.rows, *sorted({k for s in spent for k in s} - set(its.rows), key=_dearest(spent))):
        own = its.rows.get(line, {})
        part.body.append([line, own.get("ms", "-"), *(_text(s.get(line)) for s in spent)])
        part.records.extend(printed(line, its.label, ["ms"], own))
        for subject, plan, s in zip(subjects, plans, spent, strict=True):
            what = f"{told(receipts(plan))}; a picture's of what draws, else a frame's; on {'; '.join(hosts(plan))}"
            where = {"data_set": subject.data_set, "sequence": subject.name}
            part.records.append(record(line, "ms", _text(s.get(line)), what, **where))
    about = [f"The paper's milliseconds: {its.note}", COMPARABLE, *map(_about, subjects, plans)]
    failed = [f"{r.sequence} was not run: {r.why}." for _, r in found.results if not r.numbers]
    title = "Section 4, time of a frame"
    return Page("runtime", title, its.label, [part], [*about, *failed, *found.protocols], found.status)


def lines(of: Sequence[Receipt], frames: int, pictures: int) -> dict[str, float]:
    """{line: ms}: the paper's lines and their sum, then what the rest is made of, and what is made once, which is no
    part of the sum."""
    spent = dict.fromkeys((SPLATTING, POSE, IMAGE, STABILIZER, REST), 0.0)
    parts: defaultdict[str, float] = defaultdict(float)
    for r in of:
        ms = 1000 * steady_seconds(r.facts)
        if stage_named(r.stage).sequence_wide:
            parts[f"{ONCE}: {r.stage}"] += ms
            continue
        if r.stage == DRAWS:
            spent[SPLATTING] += ms / max(pictures, 1)
            continue
        ms /= frames
        if r.stage == SMOOTHING:
            spent[STABILIZER] += ms
            continue
        modules: Mapping[str, float] = r.facts.get("modules") or {}
        for line in (POSE, IMAGE):  # the network names its modules as the paper does
            own = 1000 * modules.get(line, 0.0) / frames if r.stage == NETWORK else 0.0
            spent[line] += own
            ms -= own
        spent[REST] += ms
        parts[f"of the rest: {r.stage}"] += ms
    return {**spent, WHOLE: sum(spent.values()), **parts}


def _dearest(spent: Sequence[Mapping[str, float]]) -> Callable[[str], tuple[bool, float]]:
    """What the rest is made of, dearest first, then what is made once."""
    return lambda line: (line.startswith(ONCE), -max(s.get(line, 0.0) for s in spent))


def _drawn(plan: Plan) -> int:
    return sum(int(np.count_nonzero(path.served)) for path in plan.context.paths.values())


def _text(ms: float | None) -> str:
    return "-" if ms is None else f"{ms:.3g}" if ms < 100 else f"{ms:.0f}"


def _about(subject: Subject, plan: Plan) -> str:
    c = plan.context
    sizes = ", ".join(dict.fromkeys(f"{w} x {h}" for w, h in c.rig.size[list(c.views.sources)].tolist()))
    network = "with the network" if NETWORK in c.facts else "without the network, so that its encoders took nothing"
    return (
        f"{subject.name}: {number(subject.cameras, 'source view')} of {sizes} px,"
        f" {number(subject.frames, 'frame')}, {network}; on {'; '.join(hosts(plan))}."
    )
