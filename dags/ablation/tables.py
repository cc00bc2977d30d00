"""The tables of an ablation: means over seeds beside the paper's numbers, as JSON and as a page."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posegaussian.dags.ablation.cells import Cell, cell, seeds_found
from posegaussian.dags.ablation.groups import (
    DRAWN,
    ERROR,
    FOOTAGE,
    PICTURES,
    Group,
    Row,
    SimulatedFootage,
    groups,
)
from posegaussian.dags.ablation.paper_form import ENOUGH, NOT_RUN, paper_form
from posegaussian.dags.ablation.pipeline_runs import RunCell
from posegaussian.dags.ablation.trained_runs import picture_run, ring
from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.dags.humanize.text import number
from posegaussian.dags.paper.printed import ablation
from posegaussian.stages.simulator.subjects.splits import FIRST_VALIDATION_SEED
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.files.write import write_atomically

UNITS = {"epe": "px", "psnr": "dB", "depth": "mm", "joints": "mm", "jitter": "mm", "lag": "frames"}
"""Of measures, by their first word."""


def write(config: TrainingConfig, folder: Path, seeds: Sequence[int], failures: Mapping[str, str]) -> list[str]:
    """Write `ablation.json` and `ablation.md` from all that the folder holds; returns the page's lines."""
    every = sorted({*seeds, *seeds_found(folder)})
    found = report(config, folder, every, failures)
    write_atomically(folder / "ablation.json", (json.dumps(found, indent=1, allow_nan=False) + "\n").encode())
    lines = page(found)
    write_atomically(folder / "ablation.md", ("\n".join(lines) + "\n").encode())
    return lines


def report(config: TrainingConfig, folder: Path, seeds: Sequence[int], failures: Mapping[str, str]) -> dict[str, Any]:
    """Everything the tables say, plain."""
    return {
        "config": config.model_dump(mode="json", exclude={"seed"}),
        "phases": {"depth": config.depth_steps, "joint": config.joint_steps},
        "seeds": list(seeds),
        "groups": [_group(config, g, seeds, folder, failures) for g in groups(config)],
    }


def _group(
    config: TrainingConfig, group: Group, seeds: Sequence[int], folder: Path, failures: Mapping[str, str]
) -> dict[str, Any]:
    printed = ablation()[group.name]
    by_row = {row.label: _seeds(config, group, row, seeds, folder) for row in group.rows}
    rows = [_row(config, group, row, seeds, folder, by_row, failures) for row in group.rows]
    about = {
        "name": group.name,
        "title": group.title,
        "reference": group.reference,
        "paper": printed.label,
        "paper_note": printed.note,
        "paper_measures": printed.measures,
    }
    notes = [group.comparable]
    if group.joint and config.joint_steps == 0:
        notes.append(
            "There was no second phase, in which alone these settings matter: the rows differ by nothing but what the"
            " network's first weights are."
        )
    if group.footage is not None:
        notes += _footage_notes(group, rows, seeds)
    return {**about, "shown": list(group.shown), "compared": list(group.compared), "notes": notes, "rows": rows}


def _footage_notes(group: Group, rows: Sequence[Mapping[str, Any]], seeds: Sequence[int]) -> list[str]:
    """On what the rows were measured, and with which weights."""
    assert group.footage is not None
    said = [f"{_footage_text(group.footage)}."]
    used: dict[str, list[str]] = {}
    for seed in seeds:
        of_seed = dict.fromkeys(
            f"{c['weights']['name']} (sha256 {c['weights']['sha256'][:12]})"
            for r in rows
            for c in r["cells"]
            if c["seed"] == seed and c["weights"] is not None
        )
        for name in of_seed:
            used.setdefault(name, []).append(str(seed))
    return [
        *said,
        *(f"Weights {name}: {'seed' if len(of) == 1 else 'seeds'} {', '.join(of)}." for name, of in used.items()),
    ]


def _footage_text(f: SimulatedFootage) -> str:
    return (
        "Each seed is one simulated sequence that nothing was trained on, the seed counted from"
        f" {FIRST_VALIDATION_SEED}: {number(f.frames, 'frame')} at {f.frame_rate:g} a second,"
        f" {f.size} px, 2 held-out views"
    )


def _found(config: TrainingConfig, group: Group, row: Row, seed: int, folder: Path) -> Cell | RunCell:
    return cell(config, row, seed, folder) if group.footage is None else RunCell(group, row, seed, folder)


def _seeds(
    config: TrainingConfig, group: Group, row: Row, seeds: Sequence[int], folder: Path
) -> dict[int, dict[str, float]]:
    """{seed: finite numbers} of what is finished."""
    found = {seed: _numbers(config, group, row, seed, folder) for seed in seeds}
    return {
        seed: {k: float(v) for k, v in numbers.items() if v is not None}
        for seed, numbers in found.items()
        if numbers is not None
    }


def _numbers(config: TrainingConfig, group: Group, row: Row, seed: int, folder: Path) -> dict[str, float | None] | None:
    """What a cell found; of a training, with what its pictures say, as soon as they are drawn."""
    numbers = _found(config, group, row, seed, folder).numbers(row)
    if numbers is None or group.footage is not None:
        return numbers
    pictures = picture_run(config, row, seed, folder)
    said = pictures.numbers(pictures.row) or {}
    return {**numbers, **{name: said[name] for name in DRAWN if name in said}}


def _row(
    config: TrainingConfig,
    group: Group,
    row: Row,
    seeds: Sequence[int],
    folder: Path,
    by_row: Mapping[str, dict[int, dict[str, float]]],
    failures: Mapping[str, str],
) -> dict[str, Any]:
    ours, reference = by_row[row.label], by_row[group.reference]
    names = list(dict.fromkeys(name for numbers in ours.values() for name in numbers))
    measures = {name: spread([n[name] for n in ours.values() if name in n]) for name in names}
    pairs = {
        name: [
            n[name] - reference[seed][name] for seed, n in ours.items() if name in n and name in reference.get(seed, {})
        ]
        for name in group.compared
    }
    cells = [_cell(config, group, row, seed, folder, seed in ours, failures) for seed in seeds]
    counts = {c["parameters"] for c in cells if c["parameters"] is not None}
    return {
        "label": row.label,
        "settings": {k: list(v) if isinstance(v, tuple) else v for k, v in row.settings.items()},
        "iterations": row.iterations,
        "pipeline": list(row.pipeline),
        "seeds": len(ours),
        "claim": len(ours) >= ENOUGH,
        "measures": measures,
        "against_reference": (
            {name: spread(values) for name, values in pairs.items() if values} if row.label != group.reference else {}
        ),
        "parameters": counts.pop() if counts else None,
        "cells": cells,
        "paper": dict(ablation()[group.name].rows.get(row.label, {})),
    }


def _cell(
    config: TrainingConfig, group: Group, row: Row, seed: int, folder: Path, known: bool, failures: Mapping[str, str]
) -> dict[str, Any]:
    found = _found(config, group, row, seed, folder)
    result = found.result()
    state = "done" if known else "trained, not measured" if result is not None else found.state()
    facts = {k: result.get(k) if result is not None else None for k in ("parameters", "minutes", "machine", "weights")}
    return {
        "seed": seed,
        "variant": found.variant,
        "state": state,
        "failure": failures.get(str(found)),
        "numbers": _numbers(config, group, row, seed, folder),
        **facts,
    }


def spread(values: Sequence[float]) -> dict[str, Any]:
    """Mean, its standard error (None for a single value) and the count, of at least one value."""
    error = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None
    return {"mean": statistics.fmean(values), "error": error, "count": len(values)}


def page(found: Mapping[str, Any]) -> list[str]:
    """The report as Markdown lines."""
    config = TrainingConfig.model_validate(found["config"])
    phases = f"{config.depth_steps} of depth and {config.joint_steps} of everything through the renderer"
    about = (
        f"Preset {config.preset}, {number(config.steps, 'step')} a cell ({phases}), seeds"
        f" {', '.join(map(str, found['seeds']))}. Trainings are measured on"
        f" {number(config.validation.count, 'simulated scene')} at {config.size} px that show people and motions no"
        f" training shows, and their pictures on held-out views between {ring(config)} cameras:"
        f" {_footage_text(FOOTAGE[PICTURES])}."
        " Ours: mean and standard error over the seeds; `against` is the difference to the reference"
        f" of the table, seed by seed. Fewer than {ENOUGH} seeds are no claim, and"
        " neither is a difference within twice its standard error."
    )
    lines = ["# Ablation", "", about]
    for group in found["groups"]:
        lines += ["", f"## {group['title']}", "", *_table(group), "", *_notes(group)]
    return [*lines, *paper_form({group["name"]: group for group in found["groups"]})]


def _table(group: Mapping[str, Any]) -> list[str]:
    rows = group["rows"]
    known = list(dict.fromkeys(name for row in rows for name in row["measures"]))
    names = [n for n in group["shown"] if n in known] or [ERROR]
    alone = len(names) == 1
    sizes = len({row["parameters"] for row in rows if row["parameters"] is not None}) > 1
    reference = [f"against {group['reference']}"] if alone else []
    head = [
        "",
        *(_headed(n) for n in names),
        *reference,
        *(["parameters"] if sizes else []),
        "seeds",
        *(f"paper: {m}" for m in group["paper_measures"]),
    ]
    body = []
    for row in rows:
        ran = row["seeds"] > 0
        ours = [_pm(row["measures"].get(n), NOT_RUN if n in DRAWN else "-") if ran else NOT_RUN for n in names]
        against = [_against(row, group, names[0])] if alone else []
        size = [f"{row['parameters'] / 1e6:.2f} M" if row["parameters"] is not None else NOT_RUN] if sizes else []
        body.append(
            [
                row["label"],
                *ours,
                *against,
                *size,
                _seeds_text(row, group),
                *(row["paper"].get(m, "-") for m in group["paper_measures"]),
            ]
        )
    others = [row for row in rows if row["label"] != group["reference"]]
    if alone or not any(row["against_reference"] for row in others):
        return markdown_table(head, body)
    differences = [[row["label"], *(_against(row, group, n) for n in names)] for row in others]
    return [
        *markdown_table(head, body),
        "",
        *markdown_table([f"against {group['reference']}", *(_headed(n) for n in names)], differences),
    ]


def _against(row: Mapping[str, Any], group: Mapping[str, Any], name: str) -> str:
    if row["seeds"] == 0:
        return NOT_RUN
    return (
        "reference" if row["label"] == group["reference"] else _pm(row["against_reference"].get(name), "-", signed=True)
    )


def _notes(group: Mapping[str, Any]) -> list[str]:
    notes = [*group["notes"], f"The paper: {group['paper']}."]
    if group["paper_note"]:
        notes.append(group["paper_note"])
    if not group["paper_measures"]:
        notes.append("It prints no numbers for these rows.")
    failed = {
        f"{c['variant']}, seed {c['seed']}": c["failure"] for row in group["rows"] for c in row["cells"] if c["failure"]
    }
    return [" ".join(notes), *(f"\nFailed: {name}: {why}" for name, why in failed.items())]


def _seeds_text(row: Mapping[str, Any], group: Mapping[str, Any]) -> str:
    """`3`, `2, no claim`, or what there is of a row that has none."""
    if row["seeds"]:
        return str(row["seeds"]) if row["claim"] else f"{row['seeds']}, no claim"
    begun = [c["state"] for c in row["cells"] if c["state"] != NOT_RUN]
    return f"0 ({begun[0]})" if begun else "0"


def _headed(name: str) -> str:
    unit = UNITS.get(name.split(" ")[0].lower())
    return f"{name}, {unit}" if unit else name


def _pm(value: Mapping[str, Any] | None, none: str, signed: bool = False) -> str:
    """`0.812 ± 0.011`, or the mean alone."""
    if value is None:
        return none
    mean = f"{value['mean']:{'+' if signed else ''}.4g}"
    return mean if value["error"] is None else f"{mean} ± {value['error']:.2g}"
