"""What `posegaussian ablate` found, in the paper's form: table 4, figure 5 and the stabilizer's rows of table 3."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from posegaussian.dags.ablation.paper_form import ABOUT, OURS, Groups, Table, encoders, loss, pose, temporal
from posegaussian.dags.ablation.tables import report
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.paper.printed import ablation
from posegaussian.dags.reproduction.page import Page, Part, printed, record
from posegaussian.dags.training.config import load_training
from posegaussian.storage.files.names import parse_json, read_file
from posegaussian.storage.model.errors import ConfigError

FILE = "ablation.json"
DEFAULT = Path("ablation-default")
"""Where `ablate` writes without options."""
MOST_BYTES = 2**26
"""Of its report: some thousand cells."""


def groups_of(folder: Path | None) -> tuple[Groups, bool]:
    """The groups by name, and whether any of it was run: of the folder of an ablation, by default the one that `ablate`
    writes where it is there, else rows without a number of ours. Raises ConfigError for a folder that holds none."""
    file = (folder or DEFAULT) / FILE
    if folder is None and not file.is_file():
        found: Any = report(load_training(None, []), Path("no ablation"), [0], {})
        return {g["name"]: g for g in found["groups"]}, False
    try:
        found = parse_json(read_file(file, MOST_BYTES))
        groups = {g["name"]: g for g in found["groups"]}
        for g in groups.values():
            _ = [(r["label"], r["measures"], r["paper"]) for r in g["rows"]], g["reference"]
    except (OSError, ValueError, KeyError, TypeError) as e:
        raise ConfigError(
            f"--ablation {folder or DEFAULT}: {file} is not what `posegaussian ablate` writes ({type(e).__name__}:"
            f" {e}); name the folder of its --output"
        ) from e
    if missing := ablation().keys() - groups.keys():
        raise ConfigError(f"{file} lacks the groups {', '.join(sorted(missing))}; run `posegaussian ablate` again")
    return groups, True


def stabilizer_rows(groups: Groups) -> list[list[str]]:
    """Rows of table 3: without our stabilizer, and with it."""
    return [row for row in temporal(groups)[1] if row[0].startswith("ours")]


def table4(groups: Groups, ran: bool) -> Page:
    """Loss hyperparameters."""
    return _page("table4", "Table 4, loss hyperparameters", groups, {"": (loss, ("beta_gamma", "lambda"))}, ran)


def fig5(groups: Groups, ran: bool) -> Page:
    """Where pose enters, and the encoders' variants, as the rows that the figure draws."""
    parts: Parts = {
        "Left, pose information": (pose, ("pose",)),
        "Right, encoder configurations": (encoders, ("encoders",)),
    }
    return _page("fig5", "Figure 5, pose information and encoder configurations", groups, parts, ran)


Parts = Mapping[str, tuple[Callable[[Groups], Table], tuple[str, ...]]]
"""{title: (its text of the groups, names of the groups)}."""


def _page(name: str, title: str, groups: Groups, parts: Parts, ran: bool) -> Page:
    found = [Part(heading, *make(groups), _records(groups, names)) for heading, (make, names) in parts.items()]
    used = [group for _, names in parts.values() for group in names]
    label = "; ".join(dict.fromkeys(ablation()[g].label for g in used))
    notes = [note for g in used for note in (*groups[g]["notes"], ablation()[g].note) if note]
    command = next_command("ablate", "--only", ",".join(used))
    how = [] if ran else [f"Rows are not run: `{command.removeprefix('next: ')}` trains and measures them."]
    return Page(name, title, label, found, [ABOUT, *how, *dict.fromkeys(notes)])


def _records(groups: Groups, names: Sequence[str]) -> list[dict[str, Any]]:
    """What the paper prints, and means over seeds of ours."""
    found = []
    columns = {measure: column for column, measure in OURS.items()}
    for name in names:
        for row in groups[name]["rows"]:
            found += printed(row["label"], ablation()[name].label, list(row["paper"]), row["paper"])
            for measure, value in row["measures"].items():
                if measure in columns:
                    told = f"{measure}, mean over {value['count']} seeds, standard error {value['error']}"
                    found.append(record(row["label"], columns[measure], f"{value['mean']:.4g}", told))
    return found
