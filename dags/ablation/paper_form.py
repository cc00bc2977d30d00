"""The paper's own tables, in its rows and columns, with what was found here and what it prints in brackets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.dags.paper.printed import OURS as ITS_OWN
from posegaussian.dags.paper.printed import table

NOT_RUN = "not run"
ENOUGH = 3
"""Seeds from which on a number may be claimed."""
OURS = {
    "PSNR": "psnr full",
    "SSIM": "ssim full",
    "LPIPS": "lpips full",
    "EPE": "epe",
    "1px": "1px",
    "µ(ΔSSIM)": "change of ssim",
    "σ(ΔSSIM)": "its deviation",
}
"""{the paper's column: our measure}."""
PICTURE = ("PSNR", "SSIM", "LPIPS")
CHANGES = {"µ(ΔSSIM)": "mean change of SSIM", "σ(ΔSSIM)": "its deviation"}
"""{column: as its group calls it}."""
REPORTED = "pairwise"
"""The stabilizer of the paper's equation."""
ABOUT = (
    "Here: mean and standard error over the seeds, on simulated people, pictures measured as a whole; in brackets what"
    f" the paper prints, on other people. * is of fewer than {ENOUGH} seeds and no claim. Values do not compare across"
    " the brackets; whether rows differ alike does."
)

Groups = Mapping[str, Mapping[str, Any]]
"""The groups of a report by name."""
Table: TypeAlias = tuple[list[str], list[list[str]]]
"""Heading and rows."""


def paper_form(groups: Groups) -> list[str]:
    """All of them as Markdown lines, each with its title."""
    tables = (
        ("Table 1, each data set", _data_sets()),
        ("Table 2, THuman2.0 with 6 and 8 cameras", _cameras(groups)),
        ("Table 3, temporal coherence", temporal(groups)),
        ("Section 4.2, fusion strategies", _fusion(groups)),
        ("Table 4, loss hyperparameters", loss(groups)),
        ("Figure 5 left, pose information", pose(groups)),
        ("Figure 5 right, encoder configurations", encoders(groups)),
    )
    lines = ["", "# In the paper's form", "", ABOUT]
    for title, (head, body) in tables:
        lines += ["", f"## {title}", "", *markdown_table(head, body)]
    return lines


def temporal(groups: Groups) -> Table:
    """Table 3: with our stabilizer and without it, after the paper's other methods."""
    group = groups["tps"]
    body = [[name, *(_said(None, row.get(c)) for c in CHANGES)] for name, row in _foreign("table3")]
    for label, name in ((group["reference"], "ours without the stabilizer"), (REPORTED, "ours")):
        row = _row(group, label)
        body.append(
            [name, *(_said(row["measures"].get(OURS[c]), row["paper"].get(said)) for c, said in CHANGES.items())]
        )
    return ["method", *CHANGES], body


def loss(groups: Groups) -> Table:
    """Table 4: rows of two groups; those that both have are one training and stand once."""
    rows = {row["label"]: row for name in ("beta_gamma", "lambda") for row in groups[name]["rows"]}
    body = []
    for label, row in rows.items():
        weights = [part.split()[1] for part in label.split(", ")]
        body.append([*weights, *_cells(row, PICTURE)])
    return ["β", "γ", "λ", *PICTURE], body


def pose(groups: Groups) -> Table:
    """Figure 5, left."""
    return _rows(groups["pose"], "pose in")


def encoders(groups: Groups) -> Table:
    """Figure 5, right."""
    return _rows(groups["encoders"], "encoders")


def _data_sets() -> Table:
    found = {name: methods[ITS_OWN] for name, methods in table("table1").rows.items()}
    return ["data set", *PICTURE], [[name, *(_said(None, row.get(c)) for c in PICTURE)] for name, row in found.items()]


def _cameras(groups: Groups) -> Table:
    columns = [f"{n} {measure}" for n in (6, 8) for measure in PICTURE]
    own = {f"{n} cameras": _row(groups["cameras"], f"{n} cameras") for n in (6, 8)}
    body = []
    for name, by_rig in _foreign("table2"):
        if by_rig.keys() & own.keys():
            printed = {f"{rig[0]} {measure}": by_rig.get(rig, {}).get(measure) for rig in own for measure in PICTURE}
            body.append([name, *(_said(None, printed[c]) for c in columns)])
    ours = []
    for column in columns:
        n, measure = column.split()
        row = own[f"{n} cameras"]
        ours.append(_said(row["measures"].get(OURS[measure]), row["paper"].get(measure)))
    return ["method", *columns], [*body, ["ours", *ours]]


def _fusion(groups: Groups) -> Table:
    body = []
    for row in groups["fusion"]["rows"]:
        size = row["parameters"]
        told = NOT_RUN if size is None else f"{size / 1e6:.2f} M"
        body.append([row["label"], *_cells(row, ("EPE", "1px")), _beside(told, row["paper"].get("parameters"))])
    return ["strategy", "EPE", "1px", "parameters"], body


def _rows(group: Mapping[str, Any], first: str) -> Table:
    return [first, *PICTURE], [[row["label"], *_cells(row, PICTURE)] for row in group["rows"]]


def _cells(row: Mapping[str, Any], columns: Iterable[str]) -> list[str]:
    return [_said(row["measures"].get(OURS[c]), row["paper"].get(c), percent=c == "1px") for c in columns]


def _foreign(name: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Rows of a table of the paper but its own."""
    return [(method, row) for method, row in table(name).rows.items() if method != ITS_OWN]


def _said(value: Mapping[str, Any] | None, printed: str | None, percent: bool = False) -> str:
    """`24.1 ± 0.2 (24.9)`: a mean over seeds, and what the paper prints."""
    if value is None:
        return _beside(NOT_RUN, printed)
    unit, factor = (" %", 100.0) if percent else ("", 1.0)
    mean = f"{factor * value['mean']:.4g}"
    error = "" if value["error"] is None else f" ± {factor * value['error']:.2g}"
    return _beside(f"{mean}{error}{unit}{'' if value['count'] >= ENOUGH else '*'}", printed)


def _beside(ours: str, printed: str | None) -> str:
    return ours if printed is None else f"{ours} ({printed})"


def _row(group: Mapping[str, Any], label: str) -> Mapping[str, Any]:
    return next(row for row in group["rows"] if row["label"] == label)
