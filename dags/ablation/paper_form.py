"""The paper's own tables, in its rows and columns, with what was found here and what it prints in brackets."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.storage.model.yaml_documents import read_yaml

OTHERS = Path(__file__).with_name("paper_form.yaml")
"""What the paper prints that no group of rows is about."""
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
"""{column: as `paper.yaml` calls it}."""
REPORTED = "pairwise"
"""The stabilizer of the paper's equation."""
ABOUT = (
    "Here: mean and standard error over the seeds, on simulated people, pictures measured as a whole; in brackets what"
    f" the paper prints, on other people. * is of fewer than {ENOUGH} seeds and no claim. Values do not compare across"
    " the brackets; whether rows differ alike does."
)

Groups = Mapping[str, Mapping[str, Any]]
"""The groups of a report by name."""


def paper_form(groups: Groups) -> list[str]:
    """All of them as Markdown lines, each with its title."""
    tables = (
        ("Table 1, each data set", _data_sets()),
        ("Table 2, THuman2.0 with 6 and 8 cameras", _cameras(groups)),
        ("Table 3, temporal coherence", _temporal(groups)),
        ("Section 4.2, fusion strategies", _fusion(groups)),
        ("Table 4, loss hyperparameters", _loss(groups)),
        ("Figure 5 left, pose information", _rows(groups["pose"], "pose in", PICTURE)),
        ("Figure 5 right, encoder configurations", _rows(groups["encoders"], "encoders", PICTURE)),
    )
    lines = ["", "# In the paper's form", "", ABOUT]
    for title, table in tables:
        lines += ["", f"## {title}", "", *table]
    return lines


def _data_sets() -> list[str]:
    found = _others()["data_sets"]
    return markdown_table(
        ["data set", *PICTURE], [[name, *(_said(None, row.get(c)) for c in PICTURE)] for name, row in found.items()]
    )


def _cameras(groups: Groups) -> list[str]:
    columns = [f"{n} {measure}" for n in (6, 8) for measure in PICTURE]
    own = {f"{n} cameras": _row(groups["cameras"], f"{n} cameras") for n in (6, 8)}
    ours = []
    for column in columns:
        n, measure = column.split()
        row = own[f"{n} cameras"]
        ours.append(_said(row["measures"].get(OURS[measure]), row["paper"].get(measure)))
    return markdown_table(["method", *columns], [*_foreign("cameras", columns), ["ours", *ours]])


def _temporal(groups: Groups) -> list[str]:
    group = groups["tps"]
    body = _foreign("temporal", list(CHANGES))
    for label, name in ((group["reference"], "ours without the stabilizer"), (REPORTED, "ours")):
        row = _row(group, label)
        body.append(
            [name, *(_said(row["measures"].get(OURS[c]), row["paper"].get(said)) for c, said in CHANGES.items())]
        )
    return markdown_table(["method", *CHANGES], body)


def _fusion(groups: Groups) -> list[str]:
    body = []
    for row in groups["fusion"]["rows"]:
        size = row["parameters"]
        told = NOT_RUN if size is None else f"{size / 1e6:.2f} M"
        body.append([row["label"], *_cells(row, ("EPE", "1px")), _beside(told, row["paper"].get("parameters"))])
    return markdown_table(["strategy", "EPE", "1px", "parameters"], body)


def _loss(groups: Groups) -> list[str]:
    """Rows of two groups; those that both have are one training and stand once."""
    rows = {row["label"]: row for name in ("beta_gamma", "lambda") for row in groups[name]["rows"]}
    body = []
    for label, row in rows.items():
        weights = [part.split()[1] for part in label.split(", ")]
        body.append([*weights, *_cells(row, PICTURE)])
    return markdown_table(["β", "γ", "λ", *PICTURE], body)


def _rows(group: Mapping[str, Any], first: str, columns: Sequence[str]) -> list[str]:
    return markdown_table([first, *columns], [[row["label"], *_cells(row, columns)] for row in group["rows"]])


def _cells(row: Mapping[str, Any], columns: Iterable[str]) -> list[str]:
    return [_said(row["measures"].get(OURS[c]), row["paper"].get(c), percent=c == "1px") for c in columns]


def _foreign(table: str, columns: Sequence[str]) -> list[list[str]]:
    return [[name, *(_said(None, row.get(c)) for c in columns)] for name, row in _others()[table].items()]


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


@lru_cache(maxsize=1)
def _others() -> Mapping[str, Mapping[str, Mapping[str, str]]]:
    found: Mapping[str, Mapping[str, Mapping[str, str]]] = read_yaml(OTHERS)
    return found
