"""What is finished of a sequence at this moment, and its frames as a page plays them. Nothing is written."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from posegaussian.dags.export import page
from posegaussian.dags.export.background import parse
from posegaussian.dags.export.splats import chosen_views
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Product
from posegaussian.dags.session.session import Session
from posegaussian.storage.exporters.page.document import frame_texts, live_page
from posegaussian.storage.model.errors import ArchiveError

AGE_S = 1.0
"""Seconds for which what was found of a sequence is told again: pages ask more often than plans are worth making."""


class NotThere(ArchiveError):
    """A frame that is not finished, or is being made anew."""


@dataclass(frozen=True)
class Moment:
    """A sequence as it stands."""

    results: Results
    """What is read from."""
    views: tuple[int, ...]
    """Source views of the page."""
    keys: tuple[str | None, ...]
    """Of every frame a digest of what it is read from; None where some of it is not finished."""
    head: Mapping[str, Any]
    """What the page knows besides frames."""

    @property
    def state(self) -> dict[str, Any]:
        """What a page asks for again and again: `version` of the head, and `frames`, the keys."""
        return {"version": self.head["version"], "frames": list(self.keys)}


class LiveSequences:
    """The sequences of an archive, as they stand whenever they are asked for; several threads may ask at once."""

    def __init__(self, session: Session, names: tuple[str, ...]) -> None:
        """Of some sequences of the session's archive."""
        self.session, self.names = session, names
        self._lock = threading.Lock()
        self._found: dict[str, tuple[float, Moment]] = {}

    def moment(self, name: str, age: float = AGE_S) -> Moment:
        """What is finished of a sequence, found out `age` seconds ago at most. Raises UserError for one that cannot be
        read or shown."""
        with self._lock:
            at, found = self._found.get(name, (float("-inf"), None))
            if found is None or time.monotonic() - at > age:
                found = _look(self.session, name)
                self._found[name] = time.monotonic(), found
            return found

    def document(self, name: str) -> str:
        """The page of a sequence, without frames."""
        return live_page(name, self.moment(name).head)

    def frame(self, name: str, number: int) -> dict[str, str]:
        """One frame, coded as an exported page holds it: `key`, `coded`, `pictures`.

        Raises NotThere for one that is not finished, or that was made anew while it was read, and UserError where what
        it is read from is damaged.
        """
        moment = self.moment(name)
        if number >= len(moment.keys) or moment.keys[number] is None:
            raise NotThere(f"frame {number} of sequence {name} is not finished")
        try:
            coded, pictures = frame_texts(*page.coded_frame(moment.results, number, moment.views))
        finally:
            later = self.moment(name, age=0).keys
            if later[number : number + 1] != moment.keys[number : number + 1]:
                raise NotThere(f"frame {number} of sequence {name} is being made anew")
        return {"key": str(moment.keys[number]), "coded": coded, "pictures": pictures}


def _look(session: Session, name: str) -> Moment:
    plan = session.plan(name, Selection(), (), lambda context: page.needed(context, chosen_views(context, ())))
    context = plan.context
    page.check(context, (), None)
    views = chosen_views(context, ())
    head = page.page_head(context, views, None, parse("none"))
    version = hashlib.blake2b(json.dumps(head, sort_keys=True).encode(), digest_size=8).hexdigest()
    return Moment(Results(context, plan.book), views, _keys(plan, views), {**head, "version": version})


def _keys(plan: Plan, views: tuple[int, ...]) -> tuple[str | None, ...]:
    """Of every frame a digest of what it is read from, where all of that is there and as the settings ask for it."""
    there = {
        Product(output.array, task.partition, output.view): output.digest
        for task, receipt in plan.book.receipts.items()
        if task in plan.verdicts and plan.verdicts[task].state is State.FRESH
        for output in receipt.outputs
        if not output.dropped
    }
    read: dict[int | None, list[Product]] = {}
    for product in sorted(page.needed(plan.context, views), key=str):
        read.setdefault(product.partition, []).append(product)
    grid = plan.context.grid
    found: list[str | None] = [None] * grid.frames
    for partition in grid.partitions:
        digests = [there.get(product) for product in read[partition]]
        if all(digests):
            key = hashlib.blake2b("".join(map(str, digests)).encode(), digest_size=8).hexdigest()
            for frame in grid.bounds(partition):
                found[frame] = key
    return tuple(found)
