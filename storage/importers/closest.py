"""What a folder that no layout fits is told: what it holds, which layouts are closest, and what they lack."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from posegaussian.storage.importers.common import entries, subfolders
from posegaussian.storage.importers.declaration import Trait
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.readers.images import PICTURE_SUFFIXES
from posegaussian.storage.readers.video import VIDEO_SUFFIXES

_SHOWN = 6
"""Entries of a folder that a sentence names."""
_CALIBRATIONS = (".toml", ".json", ".yaml", ".yml", ".xml", ".csv", ".txt", ".npy", ".npz", ".pkl", ".calib", ".xcp")
"""Endings of files that may be meant as a calibration."""
_MISSING = {True: "no videos or pictures where a layout has them", False: "no calibration of the cameras"}
"""By whether what is lacking is filmed."""
_PLACES = (
    "videos are looked for in the folder itself or in videos, pictures as images/CAMERA/000000.jpg, and a calibration"
    " of the cameras beside them"
)
"""What is said where no layout is close."""


def lacking(base: Path, layout: str) -> list[Trait]:
    """What a layout cannot do without and a folder has not."""
    return [t for t in IMPORTERS[layout].traits if not t.found(base)]


def held(base: Path) -> str:
    """What a folder holds, for a sentence."""
    names = [p.name + ("/" if p.is_dir() else "") for p in _folders_first(base)]
    return _named(names, _SHOWN) or "hidden files alone"


def unrecognised(base: Path) -> list[str]:
    """The sentences about a folder that no layout fits, what matters first."""
    filmed = _filmed(base)
    near = _closest(base)
    kinds = {t.filmed for lacks in near.values() for t in lacks}
    if near:
        missing = "not all that a layout needs" if len(kinds) > 1 else _MISSING[min(kinds)]
    else:
        missing = "not where a layout has them" if filmed else "no videos and no pictures"
    other = ", ".join(n for n in IMPORTERS if n not in near)
    return [
        f"{base} has no layout that is read; it holds {filmed or held(base)}, but {missing}",
        *(f"for the layout {name} add {' and '.join(t.expected for t in lacks)}" for name, lacks in near.items()),
        *([] if near else [_PLACES]),
        *(_passed_over(base, near) if False in kinds else []),
        *_next(base, near, kinds == {False}),
        f"what another layout lacks: posegaussian import LAYOUT {shlex.quote(str(base))}, LAYOUT being one of {other}",
    ]


def _closest(base: Path) -> dict[str, list[Trait]]:
    """The layouts of which a folder has something and lacks the smallest share, with what it lacks."""
    lacks = {n: lacking(base, n) for n in IMPORTERS}
    shares = {n: len(some) / len(IMPORTERS[n].traits) for n, some in lacks.items()}
    least = min(shares.values())
    return {n: lacks[n] for n, share in shares.items() if share == least < 1}


def _filmed(base: Path) -> str:
    """The videos and pictures of a folder, for a sentence; empty where there are none."""
    inside = [base, *subfolders(base), *(f for s in subfolders(base) for f in subfolders(s))]
    said = []
    for noun, suffixes in (("video", VIDEO_SUFFIXES), ("picture", PICTURE_SUFFIXES)):
        counts = {f: n for f in inside if (n := sum(p.suffix.lower() in suffixes for p in entries(f)))}
        places = [str(f.relative_to(base)) for f in counts if f != base]
        if total := sum(counts.values()):
            said.append(f"{total} {noun}{'s' * (total > 1)}{f' (in {_named(places, 2)})' if places else ''}")
    return " and ".join(said)


def _passed_over(base: Path, near: dict[str, list[Trait]]) -> list[str]:
    """The sentence about files that may be meant as the calibration which is lacking."""
    good = {t.expected for name in near for t in IMPORTERS[name].traits}  # such as intri.yml where extri.yml lacks
    found = [p.name for p in _folders_first(base) if p.suffix.lower() in _CALIBRATIONS and p.name not in good]
    there = f"{_named(found, _SHOWN)} {'is' if len(found) == 1 else 'are'} there"
    return [f"{there}, but by name or content none of these"] if found else []


def _next(base: Path, near: dict[str, list[Trait]], only_cameras: bool) -> list[str]:
    """The sentences with the commands; where only a calibration is lacking, also for one that has another name or lies
    elsewhere, and what makes one."""
    command = f"posegaussian import {{}} {shlex.quote(str(base))}"
    said = [f"then: {command.format('auto')}"] if near else []
    if only_cameras:
        said.insert(0, "no command here calibrates cameras: COLMAP, Caliscope, Pose2Sim or FreeMoCap do")
    if only_cameras and (apart := [n for n in near if "calibration" in IMPORTERS[n].options.model_fields]):
        others = f", or {' or '.join(apart[1:])} in place of {apart[0]}" if len(apart) > 1 else ""
        named = f"{command.format(apart[0])} --option calibration=FILE{others}"
        said.append(f"for a calibration of another name or in another folder: {named}")
    return said


def _folders_first(base: Path) -> list[Path]:
    """What a capture has in a folder, folders first."""
    return sorted(entries(base), key=lambda p: p.is_file())


def _named(names: Sequence[str], most: int) -> str:
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
