"""What the rows of the metrics stage come to: means over pictures, and how much pictures change from frame to frame."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posegaussian.stages.metrics.measures.registry import METRICS

REGIONS = ("full", "box", "mask")
"""In the order in which tables show them."""
MEAN, DEVIATION = "mean", "deviation"
"""Statistics."""


@dataclass(frozen=True)
class Number:
    """One number of one method on one sequence, with all it takes to compare it."""

    measure: str
    """`psnr`, `ms_a_frame`."""
    region: str
    """Of the picture; "" of what is none of a region."""
    statistic: str
    """`mean`, `deviation`."""
    value: float | None
    """None where there is nothing to say; the definition says why."""
    unit: str
    """"1" where there is none."""
    definition: str
    """What exactly it is."""
    count: int = 1
    """Values that it was taken of."""
    missing: int = 0
    """Pictures that have none, of a number that is of some."""
    why: str = ""
    """Why they have none."""
    hidden: int = 0
    """Of the values, those of pictures in which the subject stands behind something: what is hidden is left out."""

    @property
    def key(self) -> tuple[str, str, str]:
        """(measure, region, statistic)."""
        return self.measure, self.region, self.statistic

    @property
    def partly(self) -> str:
        """Of which pictures it is; "" where it is of all."""
        every = self.count + self.missing
        return f"of {self.count} of {every} pictures, the others: {self.why}" if self.missing else ""

    @property
    def told(self) -> str:
        """What exactly it is, of which pictures, and of what in them."""
        hidden = f"in {self.hidden} of {self.count} pictures hidden pixels are left out" if self.hidden else ""
        return "; ".join(filter(None, [self.definition, self.partly, hidden]))


def pictures(rows: Sequence[Mapping[str, Any]]) -> list[Number]:
    """Of rows of the metrics stage: the mean of every measure over pictures, by region; of changes the mean over the
    frames of each camera, then over cameras, and the deviation likewise.

    Rows without a value count for nothing; a measure that has none at all is a number without a value, whose
    definition says why. A deviation of a single change is none.
    """
    from posegaussian.stages.metrics.run import LEFT_OUT

    found: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        found[row["measure"], row["region"]].append(row)
    numbers = []
    for (measure, region), of in sorted(found.items(), key=lambda item: _place(*item[0])):
        valued = [row for row in of if row["value"] is not None]
        told = Counter(str(row["definition"]).removesuffix(LEFT_OUT) for row in valued or of)
        definition, unit = told.most_common(1)[0][0], METRICS[measure].unit
        if METRICS[measure].change_of is None:
            mean = float(np.mean([row["value"] for row in valued])) if valued else None
            made = [Number(measure, region, MEAN, mean, unit, definition, len(valued))]
        else:
            made = _changes(measure, region, valued, unit, definition)
        without = [str(row["definition"]) for row in of if row["value"] is None] if valued else []
        hidden = sum(str(row["definition"]).endswith(LEFT_OUT) for row in valued)
        why = "; ".join(dict.fromkeys(without))
        numbers += [replace(n, missing=len(without), why=why, hidden=hidden) for n in made]
    return numbers


def hidden_pictures(rows: Sequence[Mapping[str, Any]]) -> int:
    """Pictures of rows of the metrics stage in which the subject stands behind something."""
    from posegaussian.stages.metrics.run import LEFT_OUT

    return len({(row["camera"], row["frame"]) for row in rows if str(row["definition"]).endswith(LEFT_OUT)})


def _place(measure: str, region: str) -> tuple[int, int]:
    return list(METRICS).index(measure), REGIONS.index(region)


def _changes(measure: str, region: str, rows: Sequence[Mapping[str, Any]], unit: str, definition: str) -> list[Number]:
    """Mean and deviation over the frames of each camera, then over cameras."""
    by_camera: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        by_camera[row["camera"]].append(row["value"])
    several = [np.std(v) for v in by_camera.values() if len(v) > 1]
    mean = float(np.mean([np.mean(v) for v in by_camera.values()])) if by_camera else None
    deviation = float(np.mean(several)) if several else None
    over = "over the frames of each camera, then over cameras"
    spread = (
        f"standard deviation {over}; {definition}" if several else "not available: fewer than three frames in a row"
    )
    return [
        Number(measure, region, MEAN, mean, unit, f"mean {over}; {definition}", len(rows)),
        Number(measure, region, DEVIATION, deviation, unit, spread, len(rows)),
    ]
