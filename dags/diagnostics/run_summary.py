"""What is said when a run has ended well: where the results lie, and what to type next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posegaussian.dags.humanize.text import next_command, number
from posegaussian.dags.planning.plan import READY, Plan
from posegaussian.dags.planning.selection import Selection

MOST = 3
"""Sequences whose results are named one by one; of more, one stands for all."""


RENDERING = "rendering"
"""The stage whose pictures are spoken of."""


def results_and_next(plans: Sequence[Plan], options: Sequence[str], selection: Selection) -> list[str]:
    """Sentences on finished plans; `options` are those of the command that lead to the same archive and settings.

    Nothing is said of pictures that `selection` left out and that were not there before.
    """
    done = [p for p in plans if RENDERING not in p.unneeded and _drawn(p, selection)]
    said = [line for p in done[:MOST] for line in _results(p)]
    if len(done) > MOST:
        said.append(f"... and of {number(len(done) - MOST, 'more sequence')} alike")
    if done and done[0].context.paths:
        said.append(_export_command(done[0], options))
    return said


def _drawn(plan: Plan, selection: Selection) -> bool:
    """Whether the pictures of a finished plan are there."""
    return selection.allows(RENDERING) or plan.counts(RENDERING).keys() <= set(READY)


def _results(plan: Plan) -> Iterator[str]:
    """Where the pictures of every camera path lie."""
    context = plan.context
    for name, path in context.paths.items():
        count = int(np.count_nonzero(path.served))
        yield (
            f"{context.sequence.name}: {number(count, 'picture')} of {context.paths[name].text!r} in"
            f" {context.sequence.root / RENDERING / name}"
        )


def _export_command(plan: Plan, options: Sequence[str]) -> str:
    """The line with the command that makes a video and a contact sheet of what was rendered."""
    context = plan.context
    name = context.sequence.name
    words = ["export", name, *options]
    if context.asked_for:
        words += ["--path", context.path_texts[0]]
    return next_command(*words, "--video", f"{name}.mp4", "--sheet", f"{name}.png")
