"""Measures that a command asks for beside those of the settings, and the weights that are there for them."""

from __future__ import annotations

import json

from posegaussian.dags.assets import lpips
from posegaussian.stages.metrics.measures.lpips import FILES
from posegaussian.stages.metrics.params import MetricsParams


def asked(plain: MetricsParams, text: str) -> list[str]:
    """`stage.key=value` for the measures of the settings and those of a list with commas; with the weights of LPIPS
    that were fetched, where the settings name none."""
    every = list(dict.fromkeys([*plain.measures, *(m.strip() for m in text.split(","))]))
    weights = lpips.settings() if FILES.keys() & set(every) and not plain.lpips_weights else []
    return [f"metrics.measures={json.dumps(every)}", *weights]
