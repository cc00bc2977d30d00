"""The first `pipeline.yaml` of a capture: what was found in it, and the few settings worth touching."""

from __future__ import annotations

import json

from posegaussian.dags.config.first_look import few_frames
from posegaussian.dags.humanize.text import number
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.crop import crop_settings

MODERATE = 960
"""px of the longest side above which a first run is quicker with smaller pictures."""
SPARED = 4
"""Cameras above which one can be held out and the others still see the subject from all its sides."""


def starter(source: str, capture: Capture) -> str:
    """The text of a partial configuration; everything that would change the result without being asked is commented
    out."""
    longest, numbers = int(capture.rig.size.max()), capture.numbers
    few = few_frames(numbers.tolist())
    enough = f'; "{few}" is enough for a first look' if few else ""
    counted = f"{number(len(numbers), 'frame')} ({numbers[0]}..{numbers[-1]})"
    named = json.dumps(source, ensure_ascii=False)
    return "\n".join(
        [
            f"# Settings of {named}, laid over the packaged ones; `posegaussian config` prints all that hold.",
            f"# Found: layout {capture.layout}, {counted} at {capture.frame_rate:g} a second,",
            f"# {number(len(capture.rig), 'camera')}: {_cameras(capture)}.",
            "",
            "frames:",
            f'  range: "::"          # all{enough} (start:stop:stride)',
            f"  # size: {min(longest, MODERATE)}          # longest side; as filmed, {longest} px{_smaller(longest)}",
            *_crops(capture),
            "",
            "views:",
            *_held_out(capture),
            "  trust: auto          # cameras that contradict the others are turned or left out; all: none is",
            "",
            "rendering:",
            "  paths: null          # the held-out cameras, else between the sources; or [between, orbit]",
            "",
            "# Seconds: `posegaussian plan` says what a run will take; `run --budget 3s/frame`, or `2h` for all of it,",
            "# takes the best settings for the time there is. What is set here stays as it is.",
            "",
            "run:",
            "  keep: everything     # as_declared: takes a fraction of the disk, what is dropped is computed again",
            "",
        ]
    )


def _cameras(capture: Capture) -> str:
    """`NAME (W x H px)` of each."""
    sizes = zip(capture.rig.names, capture.rig.size.tolist(), strict=True)
    return ", ".join(f"{json.dumps(n, ensure_ascii=False)} ({w} x {h} px)" for n, (w, h) in sizes)


def _smaller(longest: int) -> str:
    share = (MODERATE / longest) ** 2
    return f"; {MODERATE} takes about {share:.0%} of the time and disk" if longest > MODERATE else ""


def _crops(capture: Capture) -> list[str]:
    """The crops that the import worked out, to correct where they are wrong."""
    if not capture.crops:
        return []
    lines = crop_settings({n: [(c, "worked out")] for n, c in capture.crops.items()})
    return [
        "  # captured px -> calibrated px; the import works this out by itself, uncomment to overrule it",
        *(f"  # {line[2:].strip() if i == 0 else line[4:]}" for i, line in enumerate(lines[1:])),
    ]


def _held_out(capture: Capture) -> list[str]:
    """The choice of held-out cameras."""
    if capture.held_out:
        named = json.dumps(list(capture.held_out), ensure_ascii=False)
        return [f"  held_out: {named}  # as the capture says: only metrics look at them; []: reconstruct from all"]
    names = capture.rig.names
    if len(names) <= SPARED:
        return [f"  held_out: null       # none: each of {number(len(names), 'camera')} is needed to reconstruct from"]
    named = json.dumps([names[len(names) // 2]], ensure_ascii=False)
    return [f"  held_out: null       # none; {named} would be drawn and measured against what it filmed"]
