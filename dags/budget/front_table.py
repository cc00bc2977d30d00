"""The front that `tradeoff` measured on a sequence, as points that a budget can buy."""

from __future__ import annotations

import math
from pathlib import Path

from posegaussian.dags.budget.points import Point
from posegaussian.dags.config.yaml_source import parse_value
from posegaussian.storage.model.errors import ConfigError

SECONDS, QUALITY = " s/frame", "psnr box dB"


def front_points(file: Path) -> tuple[Point, ...]:
    """The settings on the front of seconds against box PSNR of a `tradeoff.parquet`, cheapest first. Raises ConfigError
    for a file that is none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    wanted = f"--front {file}: a tradeoff.parquet is expected, as `posegaussian tradeoff --search` writes it"
    try:
        table = pq.read_table(file)
    except (OSError, pa.ArrowException) as e:
        raise ConfigError(f"{wanted}: {e}") from e
    names, sequence = table.column_names, (table.schema.metadata or {}).get(b"sequence")
    first = next((i for i, name in enumerate(names) if name.endswith(SECONDS)), 0)
    if sequence is None or not first or not {f"total{SECONDS}", QUALITY, "front"} <= {*names}:
        raise ConfigError(f"{wanted}; its columns are {', '.join(names)}")
    knobs = [name for name in names[:first] if not name.startswith("metrics.")]  # these change no picture
    lines = [(i, r) for i, r in enumerate(table.to_pylist(), 1) if r["front"] and _is_number(r[QUALITY])]
    if not lines:
        raise ConfigError(f"{wanted}; no line of it is on the front with a number of {QUALITY}")
    lines.sort(key=lambda line: float(line[1][f"total{SECONDS}"]))
    best = lines[-1][1][QUALITY]
    return tuple(
        Point(
            f"line {i} of {file.name}",
            ", ".join(f"{knob} {row[knob]}" for knob in knobs),
            row[QUALITY] - best,
            float(row[f"total{SECONDS}"]),
            {knob: None if row[knob] == "full" else parse_value(str(row[knob])) for knob in knobs},
            measured=f"{row[QUALITY]:.2f} dB on held-out cameras of {sequence.decode()}",
            reached=row[QUALITY],
        )
        for i, row in lines
    )


def _is_number(value: object) -> bool:
    """Whether a cell holds one."""
    return isinstance(value, int | float) and math.isfinite(value)
