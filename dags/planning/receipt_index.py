"""The receipts of one sequence by task, and what they prove."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.tasks import Product, Task, inputs, producer
from posegaussian.storage.archive.receipts import Output, Receipt, missing_files, scan_receipts
from posegaussian.storage.files.names import FileSizes


@dataclass
class Book:
    """The receipts of one sequence, and what they prove: outputs that are whole."""

    context: Context
    """The sequence."""
    receipts: dict[Task, Receipt] = field(default_factory=dict)
    """By task."""
    problems: dict[Task, str] = field(default_factory=dict)
    """Receipts whose files are gone or of another size."""
    held: frozenset[Product] = frozenset()
    """Products that must be there when the run is over, because an export reads them: made again where they were
    dropped."""
    needed: dict[Task, str] = field(default_factory=dict)
    """Tasks whose dropped output must be made again, and for whom."""
    kept: dict[Task, Receipt] = field(default_factory=dict)
    """Receipts that were put aside and that a run will take over."""

    @classmethod
    def open(cls, context: Context, held: frozenset[Product] = frozenset()) -> Book:
        """Scan the receipts of a sequence."""
        book = cls(context, held=held)
        name, look = context.sequence.name, FileSizes(context.sequence.root)
        for r in scan_receipts(context.sequence):
            task = Task(name, r.stage, r.partition, r.view, r.path)
            book.receipts[task] = r
            bad = missing_files(context.sequence, r, look)
            if bad:
                book.problems[task] = f"shard {bad[0]} is missing or of another size" + (
                    f", and {len(bad) - 1} more" if len(bad) > 1 else ""
                )
            if held and any(o.dropped and Product(o.array, r.partition, o.view) in held for o in r.outputs):
                book.call_back(task, "the export")
        return book

    def add(self, task: Task, receipt: Receipt) -> None:
        """Note a task that just finished."""
        self.receipts[task] = receipt
        self.problems.pop(task, None)
        self.needed.pop(task, None)

    def call_back(self, task: Task, reader: str) -> None:
        """Have a task's dropped output made again for a reader: a stage, or what else needs it."""
        self.needed[task] = f"its output was dropped and is needed by {reader}"

    @property
    def has_dropped(self) -> bool:
        """Whether any output was dropped."""
        known = chain(self.receipts.values(), self.kept.values())
        return any(o.dropped for r in known for o in r.outputs)

    def dropped_inputs(self, task: Task) -> tuple[Task, ...]:
        """Tasks that made what this one reads and what was dropped since, each once."""
        found: dict[Task, None] = {}
        for i in inputs(self.context, task):
            for p in i.products:
                output = self.output(p, task)
                if output is not None and output.dropped:
                    found[producer(p, task)] = None
        return tuple(found)

    def expected(self, task: Task) -> Receipt | None:
        """A task's receipt, that which will be taken over before that which is there."""
        return self.kept.get(task) or self.receipts.get(task)

    def output(self, product: Product, reader: Task) -> Output | None:
        """What the producer's receipt says of a product."""
        receipt = self.expected(producer(product, reader))
        if receipt is None:
            return None
        return next((o for o in receipt.outputs if (o.array, o.view) == (product.array, product.view)), None)

    def digests(self, task: Task) -> dict[Product, str] | None:
        """Content digests of everything a task reads; None when something is not there."""
        found = {}
        for i in inputs(self.context, task):
            for p in i.products:
                output = self.output(p, task)
                if output is None:
                    return None
                found[p] = output.digest
        return found
