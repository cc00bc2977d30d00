"""Reading what a run made: arrays of finished partitions, against their receipts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.tasks import PRODUCERS
from posegaussian.storage.archive.receipts import Output
from posegaussian.storage.archive.shards import read_frames
from posegaussian.storage.model.errors import ShardMissing


class Results:
    """The finished outputs of one sequence."""

    def __init__(self, context: Context, book: Book | None = None) -> None:
        """Reads the receipts, unless a plan has them in its book; no data yet."""
        self.context = context
        self._outputs: dict[str, dict[tuple[int, int | None], Output]] = {}
        self._made_of: dict[tuple[str, int, int | None], list[int]] = {}
        """Source frames by (array, partition, view), of what is made partition by partition."""
        for task, receipt in (book or Book.open(context)).receipts.items():
            bounds = receipt.parts.get("bounds")
            for output in receipt.outputs:
                partition = task.partition if task.partition is not None else 0
                self._outputs.setdefault(output.array, {})[partition, output.view] = output
                if task.partition is not None and bounds:
                    self._made_of[output.array, partition, output.view] = bounds[0]

    def has(self, array: str) -> bool:
        """Whether any partition of an array is finished."""
        return array in self._outputs

    def views_of(self, array: str) -> list[int]:
        """Views of which any partition of an array is finished, ascending."""
        return sorted({view for _, view in self._outputs.get(array, {}) if view is not None})

    def paths_of(self, template: str) -> list[str]:
        """Names of the camera paths of which an array or a table, such as `metrics/{path}`, is finished, sorted."""
        before, after = template.split("{path}")
        made = (a for a in self._outputs if a.startswith(before) and a.endswith(after))
        return sorted(a.removeprefix(before).removesuffix(after) for a in made)

    def read(
        self,
        array: str,
        frames: range,
        view: int | None = None,
        first: int | None = None,
        cameras: range | None = None,
    ) -> np.ndarray:
        """[len(frames), ...] of one view; of a list the `first` so many entries, or all, of a path's cameras those of a
        range, or all. Raises ShardMissing where a partition is not finished, or was made of other source frames than
        the context's."""
        outputs = self._outputs.get(array)
        if outputs is None:
            raise ShardMissing(f"array {array} of sequence {self.context.sequence.name} was never made; run first")
        for p in self.context.grid.touched(frames):
            if (p, view) in outputs and outputs[p, view].dropped:
                raise ShardMissing(
                    f"array {array} of sequence {self.context.sequence.name}, partition {p}, was dropped to save space;"
                    f" set keep: {{{array}: always}} and `run --force` the stage that makes it"
                )
            self._refuse_other_frames(array, frames, p, view)
        return read_frames(self.context.sequence, array, outputs, self.context.grid, frames, view, first, cameras)

    def _refuse_other_frames(self, array: str, frames: range, partition: int, view: int | None) -> None:
        """Raise ShardMissing where a partition was made of other source frames than those of `frames` that are in it:
        what lies at their places is nothing, or another moment."""
        made, context = self._made_of.get((array, partition, view)), self.context
        own = context.grid.bounds(partition)
        asked = range(max(frames.start, own.start), min(frames.stop, own.stop))
        wanted = context.source_frames[asked.start : asked.stop].tolist()
        if made is None or made[asked.start - own.start :][: len(wanted)] == wanted:
            return
        raise ShardMissing(
            f"array {array} of sequence {context.sequence.name}, partition {partition}, was made of source frames"
            f" {_told(made)} only, not of {_told(wanted)}; run again with these settings, frames.range:"
            f" '{context.settings.frames.range}', to make it"
        )

    def iterate(self, array: str, cameras: range) -> Iterator[tuple[int, np.ndarray]]:
        """(frame index, [len(cameras), ...]) of all frames of some of a path's cameras, one partition in memory at a
        time."""
        for partition in self.context.grid.partitions:
            frames = self.context.grid.bounds(partition)
            yield from zip(frames, self.read(array, frames, cameras=cameras), strict=True)

    def table(self, template: str, path: str) -> list[dict[str, Any]]:
        """All rows of a table, with the partition's order kept."""
        assert template in PRODUCERS, f"no stage writes {template}"
        return self.rows(
            o for _, o in sorted(self._outputs.get(template.format(path=path), {}).items(), key=lambda kv: kv[0][0])
        )

    def rows(self, outputs: Iterable[Output]) -> list[dict[str, Any]]:
        """All rows of some outputs of a table, one after the other."""
        import pyarrow.parquet as pq

        return [
            row
            for o in outputs
            for f in o.files
            for row in pq.read_table(self.context.sequence.place(f.key)).to_pylist()
        ]


def _told(numbers: Sequence[int]) -> str:
    """`0..3`, or `0..6 (4 frames)` where some in between are not among them; `3` of a single one."""
    first, last = numbers[0], numbers[-1]
    counted = "" if len(numbers) == last - first + 1 else f" ({number(len(numbers), 'frame')})"
    return f"{first}{f'..{last}' if last != first else ''}{counted}"
