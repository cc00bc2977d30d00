"""Guards of P1-P8: joints, heatmaps and their smoothing."""

from __future__ import annotations

from tests.mutations.guard import guards_of

HEATMAPS, FILTERS, SMOOTHING = "stages/pose/heatmaps.py", "stages/smoothing/filters.py", "stages/smoothing/run.py"
TRACKING, BRIDGE = "stages/pose/tracking.py", "stages/pose/bridge.py"

GUARDS = (
    guards_of("P1")(FILTERS, "filtered = (omega < 1) & (total > 0)", "filtered = omega < 1"),
    guards_of("P2")(HEATMAPS, "score = np.where(inside, score, 0.0)", "score = score + 0.0"),
    guards_of("P2")(
        HEATMAPS,
        "return np.where(start < pixels, bell, 0.0)",
        "return np.where(start < pixels, bell, 0.0) / bell.max(axis=-1, keepdims=True)",
    ),
    guards_of("P3")(HEATMAPS, "narrow = np.maximum(sigma, MIN_SIGMA)", "narrow = sigma"),
    guards_of("P4")(SMOOTHING, "window = slice(max(0, at - past), at + 1)", "window = np.arange(at - past, at + 1)"),
    guards_of("P5")(
        "stages/pose/left_right_swaps.py",
        "exchange(here.joints, exchanged) if exchanged.any()",
        "exchange(here.joints, exchanged) if False",
    ),
    guards_of("P5")(SMOOTHING, 'if params.method == "adaptive" and len(heatmaps) == 2:', "if False:"),
    guards_of("P6")(SMOOTHING, "past = params.truncation if", "past = 9 * params.truncation if"),
    guards_of("P7")(FILTERS, "parts = weights * scores[::-1]", "parts = weights"),
    guards_of("P8")(TRACKING, "    if params.bridge:\n", "    if False:\n"),
)
