"""Which layout a folder has, by the files in it and what they hold,
and the sentences for one that was named wrongly."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from posegaussian.storage.importers.caliscope import CALIBRATION, calibration_files, recordings
from posegaussian.storage.importers.common import folder, natural, subfolders, videos_in
from posegaussian.storage.importers.qualisys import is_qualisys
from posegaussian.storage.importers.toml_cameras import toml_tables
from posegaussian.storage.model.documents import read_json
from posegaussian.storage.model.errors import SourceError, UserError
from posegaussian.storage.readers import images

SHOWN = 6
"""Entries of a folder that a sentence names."""


class Trait(NamedTuple):
    """What a layout cannot do without."""

    expected: str
    """As a sentence names it."""
    found: Callable[[Path], bool]
    """Whether a folder has it."""


def _has_cameras_json(base: Path) -> bool:
    if not (base / "cameras.json").is_file():
        return False
    data: Any = read_json(base / "cameras.json")
    return isinstance(data, dict) and "cameras" in data


def _has_images(base: Path) -> bool:
    return any(
        p.suffix.lower() in images.PICTURE_SUFFIXES for camera in subfolders(base / "images") for p in camera.iterdir()
    )


def _has_camera_tables(base: Path) -> bool:
    """A TOML file that cannot be read counts: what is wrong with it is said when it is read for good."""
    return any(
        is_qualisys(p) or (p.suffix == ".toml" and _or_broken(partial(toml_tables, p)))
        for p in base.rglob("*")
        if p.is_file()
    )


def _or_broken(look: Callable[[], object]) -> bool:
    try:
        return bool(look())
    except UserError:
        return True


LAYOUTS: Mapping[str, tuple[Trait, ...]] = {
    "images": (
        Trait("cameras.json that lists cameras", lambda b: _or_broken(partial(_has_cameras_json, b))),
        Trait("pictures images/NAME/<number>.png, .jpg or .exr", _has_images),
    ),
    "easymocap": (
        Trait("intri.yml", lambda b: (b / "intri.yml").is_file()),
        Trait("extri.yml", lambda b: (b / "extri.yml").is_file()),
        Trait(
            "images/NAME/000000.jpg or videos/NAME.mp4",
            lambda b: _has_images(b) or _or_broken(partial(videos_in, b / "videos")),
        ),
    ),
    "caliscope": (
        Trait("videos cam_N.mp4", lambda b: _or_broken(partial(recordings, b))),
        Trait(f"{CALIBRATION} beside them, below, or in the workspace", lambda b: bool(calibration_files(b))),
    ),
    "pose2sim": (
        Trait("calibration *.toml with a camera's matrix, or *.qca.txt of Qualisys", _has_camera_tables),
        Trait(
            "videos in the folder or below",
            lambda b: _or_broken(lambda: any(videos_in(f) for f in (b, *(p for p in b.rglob("*") if p.is_dir())))),
        ),
    ),
}
"""What each layout needs, the particular ones first: what Caliscope leaves, Pose2Sim's importer could read, too."""
GENERAL = "pose2sim"
"""The layout that counts only where no other one fits."""


def fitting(base: Path) -> list[str]:
    """Layouts that a folder has everything of; the general one only by itself."""
    found = [name for name, traits in LAYOUTS.items() if base.is_dir() and all(t.found(base) for t in traits)]
    return [n for n in found if n != GENERAL] or found


def recognised(base: Path) -> str:
    """The one layout of a folder. Raises SourceError, with what each layout lacks, where none fits or several do."""
    found = fitting(folder(base))
    if len(found) > 1:
        raise SourceError(f"{base} fits the layouts {' and '.join(found)}; name the one that is meant in place of auto")
    if not found:
        raise SourceError(
            "\n".join(
                [
                    f"{base} has no layout that is read; it holds {held(base)}",
                    *(f"for the layout {name} it lacks {'; '.join(_lacking(base, name))}" for name in LAYOUTS),
                ]
            )
        )
    return found[0]


def explained(layout: str, base: Path) -> str:
    """What a layout expects that a folder lacks, what is there instead, and the layout that fits;
    empty where it lacks nothing."""
    lacking = _lacking(base, layout) if base.is_dir() else []
    if not lacking:
        return ""
    other = [n for n in fitting(base) if n != layout]
    fits = (
        f"that is the layout {' or '.join(other)}: posegaussian import {other[0]} {shlex.quote(str(base))}"
        if other
        else "no other layout fits it either"
    )
    expected = [t.expected for t in LAYOUTS[layout]]
    missing = "nothing of this" if len(lacking) == len(expected) else f"no {'; no '.join(lacking)}"
    return f"the layout {layout} expects {'; '.join(expected)}: {base} has {missing}. It holds {held(base)}; {fits}"


def held(base: Path) -> str:
    """What a folder holds, for a sentence."""
    entries = sorted(base.iterdir(), key=lambda p: (p.is_file(), natural(p.name)))
    named = [p.name + ("/" if p.is_dir() else "") for p in entries[:SHOWN]]
    return ", ".join(named) + (f" and {len(entries) - SHOWN} more" if len(entries) > SHOWN else "")


def _lacking(base: Path, layout: str) -> list[str]:
    return [t.expected for t in LAYOUTS[layout] if not t.found(base)]
