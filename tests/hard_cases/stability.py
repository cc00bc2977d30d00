"""Run the catalogue of hard cases and write it as a page and a picture.

    python -m tests.hard_cases.stability

writes docs/measurements/stability.md and docs/measurements/stability.png, and fails where a bound does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from tests.hard_cases.catalogue import Case, Outcome, catalogue, holds, run

DOCS = Path(__file__).resolve().parents[2] / "docs/measurements"
PAGE, PICTURE = DOCS / "stability.md", DOCS / "stability.png"
PARTS = (
    (
        "Splatting",
        "S",
        (
            "Arithmetic is float32 of the compiled back end;"
            " what it is compared with is float64, or the answer worked out on paper."
        ),
    ),
    ("Cameras and their files", "K", "Paths between cameras, and what calibration files of other systems get wrong."),
    (
        "Rectified pairs",
        "R",
        "Two cameras 2 m from a person, 1024 x 1024. The naive version is OpenCV's, used as its documents show.",
    ),
    ("Depth", "D", "Depth maps, matching and masks."),
    ("Joints over time", "P", "What detectors get wrong, heatmaps, and their smoothing."),
    ("Measures and training", "L", "Measures of pictures and of depth; heads, losses and steps of the network."),
)
"""(title, first letter, a sentence)."""
HEAD = """# Stability

What breaks a renderer, a matcher or a measure is known: it has been reported for years, for one project after the
other. These are the cases, each run twice: in a **naive** version, the plain formula that anybody would write first,
and in ours. Both columns were measured; `make stability` measures them again on your machine and writes this page. The
tests hold ours to the **bound** and see to it that the naive version breaks it.

![Worst error against its bound, naive and ours; below, what some of it looks like](stability.png)

`NaN`: at least one value was no number. `raises`: the naive version ended with that error. "0.02 of its mass" is a
share, 2 %. A bound of 0 means exactly: not a bit, a pixel or a frame. Beside this page, `make extreme` draws ten
thousand random scenes of extreme scale, opacity, depth and camera, and no number drawn of them, nor a gradient, is
other than finite. What had to be left out because it was not finite is counted, and becomes a warning of the run: "3
Gaussians of frame 17 were not finite and were left out".
"""


def figure(value: float) -> str:
    """An error as the page shows it."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "NaN" if math.isnan(value) else "infinite"
    if 1e-3 <= value < 1e4:
        return f"{value:.3g}"
    digits, power = f"{value:.1e}".split("e")
    return f"{digits.removesuffix('.0')}e{int(power)}"


def seen(case: Case, outcome: Outcome) -> str:
    """What the naive version gave."""
    return f"raises {outcome.raised}" if outcome.raised else _with_unit(figure(outcome.naive), case.unit)


def _with_unit(text: str, unit: str) -> str:
    return text if text in ("NaN", "infinite", "0") else f"{text} {unit}"


def page(outcomes: Mapping[str, Outcome]) -> str:
    """The page; figures of cases without an outcome are left blank."""
    lines = [HEAD]
    for title, letter, words in PARTS:
        lines += [
            f"## {title}",
            "",
            words,
            "",
            "| | case | in a naive version | its worst error | bound | our worst error | why this bound |",
            "| --- | --- | --- | --- | --- | --- | --- |",
        ]
        for case in (c for c in catalogue() if c.name[0] == letter):
            found = outcomes.get(case.name)
            measured = (seen(case, found), _with_unit(figure(found.ours), case.unit)) if found else ("", "")
            lines.append(
                f"| {case.name} | {case.title} | {case.wrong} | {measured[0]} |"
                f" {_with_unit(figure(case.bound), case.unit)} | {measured[1]} | {case.reason} |"
            )
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    import torch

    from tests.hard_cases.stability_picture import draw

    torch.set_num_threads(1)
    outcomes = {}
    for case in catalogue():
        outcomes[case.name] = found = run(case)
        print(
            f"{case.name:4} naive {seen(case, found):24} bound {figure(case.bound):8} ours"
            f" {_with_unit(figure(found.ours), case.unit)}",
            flush=True,
        )
    PAGE.write_text(page(outcomes), encoding="utf-8")
    draw(PICTURE, [(c, outcomes[c.name]) for c in catalogue()])
    broken = [c.name for c in catalogue() if not holds(c)]
    if broken:
        raise SystemExit(f"the bound of {', '.join(broken)} does not hold, or its naive version keeps it")
    print(f"{len(outcomes)} cases hold; wrote {PAGE.relative_to(DOCS.parent)} and {PICTURE.relative_to(DOCS.parent)}")


if __name__ == "__main__":
    main()
