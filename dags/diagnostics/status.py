"""How a sequence stands: done, failed, blocked, stale by stage; remembered as long as nothing it follows from changed.

A status follows from the settings, the capture's record, the code, the receipts and the presence of the shards. Making
a plan of ten thousand receipts takes seconds; looking whether any file is another one takes a tenth of that. So the
numbers are kept in `_cache/status/<sequence>.json`, with a digest of all they follow from, and the sizes of the shards.
Deleting the folder costs one slower status.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Protocol

from posegaussian.dags.config.settings import Configuration
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task, dependencies
from posegaussian.dags.provenance.code_digest import FOLDERS, ROOT
from posegaussian.dags.provenance.once import once, one_moment
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.files.names import parse_json, read_file
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import UserError

CACHE = "_cache/status"
"""Folder of what is remembered, below the archive's."""

MOST_BYTES = 2**30
"""Bytes of what is remembered of a sequence: a line a shard."""


class Planner(Protocol):
    """Who makes plans: settings, an archive, and the plan of a sequence, as `Session` has them."""

    @property
    def configuration(self) -> Configuration:
        """The settings."""

    @property
    def archive(self) -> Archive:
        """Where the sequences are."""

    def plan(self, name: str, selection: Selection, paths: tuple[str, ...] = ()) -> Plan:
        """The plan of one sequence."""


COUNTS = {"all", "done", "failed", "blocked", "warned", "stale", "undecided", "dropped"}
"""What is counted of a stage."""

Numbers = dict[str, dict[str, int]]
"""{stage: {all, done, failed, blocked, warned, stale, undecided, dropped: how many tasks}};
{} for a stage that is not needed."""


def standing(planner: Planner, name: str, failed: Iterable[tuple[Any, ...]] = ()) -> Numbers:
    """The numbers of one sequence. Raises UserError when it cannot be planned.

    `failed`: keys of the tasks that failed and were not finished since.
    """
    own = sorted((key for key in failed if key[0] == name), key=str)
    sequence = planner.archive.sequence(name)
    file = planner.archive.place(f"{CACHE}/{name}.json")
    basis = _basis(planner, sequence, own)
    known = _remembered(file, basis, sequence)
    if known is not None:
        return known
    plan = planner.plan(name, Selection())
    if texts := rendered_instead(plan):
        plan = planner.plan(name, Selection(), texts)
    found = numbers(plan, frozenset(Task(*key) for key in own))
    if not plan.book.problems:
        shards = {
            f.key: f.size for r in plan.book.receipts.values() for o in r.outputs if not o.dropped for f in o.files
        }
        _remember(file, {"basis": basis, "numbers": found, "shards": shards})
    return found


def rendered_instead(plan: Plan) -> tuple[str, ...]:
    """Camera paths, as they were asked for,
    that the last run rendered where none of the plan's own was rendered; else ()."""
    rendered = [r for t, r in plan.book.receipts.items() if t.stage == "rendering"]
    if any(r.path in plan.context.paths for r in rendered):
        return ()
    asked = [r for r in rendered if "path_text" in r.facts]
    latest = max(asked, key=lambda r: str(r.facts.get("started", "")), default=None)
    texts = {
        str(r.facts["path_text"]) for r in asked if latest is not None and r.facts.get("run") == latest.facts.get("run")
    }
    return tuple(sorted(texts))


def numbers(plan: Plan, failed: frozenset[Task] = frozenset()) -> Numbers:
    """Count the tasks of a plan by stage."""
    found: Numbers = {}
    failed = frozenset(t for t in failed if t in plan.verdicts and plan.verdicts[t].state is not State.FRESH)
    blocked = _blocked(plan, failed)
    for stage in STAGES:
        verdicts = [v for v in plan.verdicts.values() if v.task.stage == stage.name and stage.name not in plan.unneeded]
        waiting = [v for v in verdicts if v.state is not State.FRESH and v.task not in failed and v.task not in blocked]
        counted = {
            "all": len(verdicts),
            "done": sum(v.state is State.FRESH for v in verdicts),
            "failed": sum(v.task in failed for v in verdicts),
            "blocked": sum(v.task in blocked for v in verdicts),
            "warned": sum(v.state is State.FRESH and bool(plan.book.receipts[v.task].warnings) for v in verdicts),
            "stale": sum(v.state in (State.STALE, State.KEPT) for v in waiting),
            "undecided": sum(v.state is State.UNDECIDED for v in waiting),
            "dropped": plan.dropped(stage.name),
        }
        found[stage.name] = counted if verdicts else {}
    return found


def _blocked(plan: Plan, failed: frozenset[Task]) -> set[Task]:
    """Tasks that wait for one that failed."""
    blocked: set[Task] = set()
    for task, verdict in plan.verdicts.items() if failed else ():
        if (
            verdict.state is not State.FRESH
            and task not in failed
            and any(d in failed or d in blocked for d in dependencies(plan.context, task))
        ):
            blocked.add(task)
    return blocked


def _basis(planner: Planner, sequence: SequenceGroup, failed: list[tuple[Any, ...]]) -> str:
    """Digest of everything the numbers follow from but the shards: a replaced file has another inode, size or time."""
    settings = planner.configuration.for_sequence(sequence.name)
    files = [sequence.root / "zarr.json", *(Path(p) for p in settings.rendering.paths or () if p.endswith(".json"))]
    code = once("stamps of the code", lambda: "".join(map(_stamp, map(str, _code()))))
    told = hashlib.blake2b(json.dumps([sys.version, settings.model_dump(mode="json"), failed]).encode(), digest_size=16)
    for line in (code, *map(_stamp, map(str, files)), *_listing(str(sequence.receipts))):
        told.update(line.encode())
    return told.hexdigest()


def _code() -> Iterator[Path]:
    """Every source file of the program: what a plan says follows from all of them."""
    for package in (*FOLDERS, "dags"):
        yield from sorted((ROOT / package).rglob("*.py"))


def _stamp(file: str) -> str:
    try:
        s = os.stat(file)
    except OSError:
        return f"{file} is gone\n"
    return f"{file} {s.st_ino} {s.st_size} {s.st_mtime_ns}\n"


def _listing(folder: str) -> Iterator[str]:
    """A line for every receipt below a folder."""
    try:
        entries = sorted(os.scandir(folder), key=lambda e: e.name)
    except FileNotFoundError:
        return
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _listing(entry.path)
        elif entry.name.endswith(".json"):
            yield _stamp(entry.path)


def _remembered(file: Path, basis: str, sequence: SequenceGroup) -> Numbers | None:
    """The numbers kept for this basis, if every shard is there with its size."""
    try:
        kept = parse_json(read_file(file, MOST_BYTES))
        if kept["basis"] != basis:
            return None
        root = str(sequence.root)
        whole = all(os.stat(f"{root}/{key}").st_size == size for key, size in kept["shards"].items())
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return kept["numbers"] if whole and _are_numbers(kept["numbers"]) else None


def _are_numbers(kept: Any) -> bool:
    """Whether what was remembered are counts by stage: the file came with the archive."""
    return isinstance(kept, dict) and all(
        isinstance(stage, dict)
        and (not stage or stage.keys() == COUNTS)
        and all(type(n) is int for n in stage.values())
        for stage in kept.values()
    )


def _remember(file: Path, kept: dict[str, Any]) -> None:
    try:
        write_atomically(file, json.dumps(kept).encode())
    except OSError:
        return  # an archive that can only be read has its status worked out every time


@one_moment()
def every_standing(planner: Planner, names: Iterable[str]) -> tuple[dict[str, Numbers], list[str]]:
    """({sequence: numbers}, a sentence for each that cannot be planned)."""
    from posegaussian.storage.archive import ledger

    failed = ledger.failed(planner.archive)
    found: dict[str, Numbers] = {}
    errors = []
    for name in names:
        try:
            found[name] = standing(planner, name, failed)
        except UserError as e:
            errors.append(f"{name}: {e}")
    return found, errors
