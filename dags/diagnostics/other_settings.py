"""Whether the last run of a sequence was made with other settings than those that are asked for now."""

from __future__ import annotations

import shlex
from functools import lru_cache
from pathlib import Path
from typing import Any

from posegaussian.dags.config.settings import GLOBAL, Configuration, load_configuration
from posegaussian.dags.diagnostics.run_log import SETTINGS
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.explain import differences
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.storage.archive.ledger import RUNS
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError

APART = {*GLOBAL, "keep"}
"""Sections in which commands of one and the same result may differ."""
MOST = 4
"""Differences that are told; the rest is counted."""


def made_otherwise(archive: Archive, plan: Plan) -> list[str]:
    """One sentence where something of the plan is not up to date and the last run of its sequence had other settings:
    which, how much is not as it is asked for now, and the option that asks for what that run made; else none."""
    context = plan.context
    old = sum(v.state is not State.FRESH for v in plan.verdicts.values())
    latest = max(plan.book.receipts.values(), key=lambda r: str(r.facts.get("started", "")), default=None)
    if not old or latest is None:
        return []
    file = archive.place(f"{RUNS}/{latest.facts.get('run')}/{SETTINGS}")
    if not file.is_file():
        return []
    try:
        before = _settings(file, file.stat().st_mtime_ns).for_sequence(context.sequence.name)
    except ConfigError:  # of another version of the program
        return []
    was, now = (_deciding(s.model_dump(mode="json")) for s in (before, context.settings))
    changed = list(differences(was, now))
    if not changed:
        return []
    told = ", ".join(changed[:MOST]) + (f" and {len(changed) - MOST} more" if len(changed) > MOST else "")
    tasks = number(len(plan.verdicts), "task")
    sentence = (
        f"the last run of {context.sequence.name} had other settings: {told}; {old} of {tasks} are not as they are"
        f" asked for now. What that run made: --config {shlex.quote(str(file))}"
    )
    return [sentence]


@lru_cache(maxsize=4)
def _settings(file: Path, stamp: int) -> Configuration:
    """The settings of a run, read once for all sequences that it worked on; `stamp`: of the file. Raises
    ConfigError."""
    return load_configuration(file)


def _deciding(settings: dict[str, Any]) -> dict[str, Any]:
    """What of settings may change a result, by section."""
    found = {section: values for section, values in settings.items() if section not in APART}
    return found | {"rendering": {k: v for k, v in found["rendering"].items() if k != "paths"}}
