"""Measures that a command asks for beside those of the settings, and the weights that are there for them."""

from __future__ import annotations

import json
from collections.abc import Sequence

from posegaussian.dags.assets import lpips
from posegaussian.dags.config.settings import Configuration, merge
from posegaussian.stages.metrics.measures.lpips import FILES


def asked(configuration: Configuration, text: str) -> list[str]:
    """`stage.key=value` for the measures of the settings, those that some sequences have of their own among them, and
    those of a list with commas; with the weights of LPIPS that were fetched, where the settings name none."""
    more, plain = [m.strip() for m in text.split(",")], configuration.default.metrics
    every = _with(plain.measures, more)
    weights = lpips.settings() if FILES.keys() & set(every) and not plain.lpips_weights else []
    own = {
        glob: {"metrics": {"measures": _with(values["metrics"]["measures"], more)}}
        for glob, values in configuration.overrides.items()
        if "measures" in (values.get("metrics") or {})
    }
    # an assignment to `sequences` takes the place of one before it
    overrides = [f"sequences={json.dumps(merge(configuration.overrides, own))}"] if own else []
    return [f"metrics.measures={json.dumps(every)}", *overrides, *weights]


def _with(measures: Sequence[str], more: Sequence[str]) -> list[str]:
    return list(dict.fromkeys([*measures, *more]))
