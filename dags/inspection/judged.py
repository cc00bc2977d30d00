"""What an inspection says of left-out views: the figure that the judge stage measured, where it ran."""

from __future__ import annotations

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import decided
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.stages.contract.judged import (
    CALIBRATION,
    DEPTH,
    EXPOSURE,
    MATTES,
    NONE,
    cannot_judge,
    drawn_at,
    mean_of_asked,
)
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.frames.facts import EXPOSURE_MATCHING
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION


def left_out_views(context: Context) -> str:
    """One sentence: PSNR, SSIM and coverage of left-out source views by the settings that were chosen, of what is in
    the archive; else what would measure it, or why nothing can."""
    cut_out = bool(context.capture_facts & set(MATTES.values()))
    why = cannot_judge(len(context.asked_views.sources), cut_out)
    if why is not None:
        return f"what left-out views would look like cannot be measured: {why}"
    context = decided(Book.open(context, frozenset()))
    method = resolve_method(context.settings.depth, context.facts).name
    switches = (CALIBRATION_CORRECTION.name, EXPOSURE_MATCHING)
    on = {e: context.effects[e].state == "on" for e in switches}
    chosen = {  # each is drawn with what was best of those before
        EXPOSURE: int(on[EXPOSURE_MATCHING]),
        DEPTH: BY_PICTURES.index(method) if method in BY_PICTURES else 0,
        CALIBRATION: int(on[CALIBRATION_CORRECTION.name]),
    }
    for array, candidate in chosen.items():
        means = mean_of_asked(context.noted[array]) if array in context.noted else None
        if means is not None and means[candidate, 0] != NONE:
            return (
                f"measured: left-out source views, drawn from the others by what a run chooses, have"
                f" {drawn_at(means, candidate)} and cover {means[candidate, 2]:.0%} of the subject"
            )
    return (
        "what left-out views look like was not measured; where a choice hangs on it, `posegaussian run --only survey"
        " --only judge` measures it"
    )
