"""The front that `tradeoff` measured on a sequence, as points that a budget can buy."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from posegaussian.dags.budget.points import Point
from posegaussian.dags.config.yaml_source import parse_value
from posegaussian.dags.planning.context import Context
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.spec import digest

SECONDS, QUALITY = " s/frame", "psnr box dB"
SETTINGS, HELD_OUT = "settings", "held_out"
"""Keys of the file's metadata."""
MEASURES = "metrics"
"""The stage that changes no picture."""


def measured_under(context: Context, knobs: Iterable[str]) -> dict[str, str]:
    """What a front says of the settings that its lines have in common: a digest of all that can change a picture but
    its {stage.key}, and which cameras were held out."""
    settings = context.settings
    parts = {s.name: getattr(settings, s.name).hashed() for s in STAGES if s.name != MEASURES}
    parts |= {"effects": settings.effects.model_dump(), "views": settings.views.hashed()}
    for stage, _, key in (knob.partition(".") for knob in [*knobs, "views.held_out"]):
        parts.get(stage, {}).pop(key, None)
    return {SETTINGS: digest(parts), HELD_OUT: json.dumps(sorted(context.held_out))}


def _alike(about: Mapping[bytes, bytes], context: Context, knobs: Iterable[str]) -> bool:
    """Whether a sequence is drawn with the settings that a front was measured with, and looked at by the same cameras;
    where it keeps none aside there is nothing else to go by. A file that does not say was measured with others."""
    own = measured_under(context, knobs)
    same = {key for key, value in own.items() if about.get(key.encode()) == value.encode()}
    return SETTINGS in same and (HELD_OUT in same or not context.held_out)


def front_points(file: Path, contexts: Sequence[Context]) -> tuple[Point, ...]:
    """The settings on the front of seconds against box PSNR of a `tradeoff.parquet`, cheapest first; what they reach is
    known where all else is set for these sequences as it was measured with. Raises ConfigError for a file that is
    none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    wanted = f"--front {file}: a tradeoff.parquet is expected, as `posegaussian tradeoff --search` writes it"
    try:
        table = pq.read_table(file)
    except (OSError, pa.ArrowException) as e:
        raise ConfigError(f"{wanted}: {e}") from e
    about = table.schema.metadata or {}
    names, sequence = table.column_names, about.get(b"sequence")
    first = next((i for i, name in enumerate(names) if name.endswith(SECONDS)), 0)
    if sequence is None or not first or not {f"total{SECONDS}", QUALITY, "front"} <= {*names}:
        raise ConfigError(f"{wanted}; its columns are {', '.join(names)}")
    knobs = [name for name in names[:first] if not name.startswith("metrics.")]  # these change no picture
    lines = [(i, r) for i, r in enumerate(table.to_pylist(), 1) if r["front"] and _is_number(r[QUALITY])]
    if not lines:
        raise ConfigError(f"{wanted}; no line of it is on the front with a number of {QUALITY}")
    lines.sort(key=lambda line: float(line[1][f"total{SECONDS}"]))
    best = lines[-1][1][QUALITY]
    known = all(_alike(about, context, knobs) for context in contexts)
    under = "" if known else ", with other settings"
    return tuple(
        Point(
            f"line {i} of {file.name}",
            ", ".join(f"{knob} {row[knob]}" for knob in knobs),
            row[QUALITY] - best,
            float(row[f"total{SECONDS}"]),
            {knob: None if row[knob] == "full" else parse_value(str(row[knob])) for knob in knobs},
            measured=f"{row[QUALITY]:.2f} dB on held-out cameras of {sequence.decode()}{under}",
            reached=row[QUALITY] if known else None,
        )
        for i, row in lines
    )


def _is_number(value: object) -> bool:
    """Whether a cell holds one."""
    return isinstance(value, int | float) and math.isfinite(value)
