"""A capture in a folder: by the layout that is named, or by the one that fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from posegaussian.storage.importers.account import accounted
from posegaussian.storage.importers.cameras import without_skew
from posegaussian.storage.importers.films import are_counted, as_filmed, with_dropped
from posegaussian.storage.importers.letterbox import fitted
from posegaussian.storage.importers.mask_files import without_masks
from posegaussian.storage.importers.recognise import explained, fitting, recognised
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.importers.timecode import as_files_begin, in_step
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import SourceError, UserError

AUTO = "auto"
"""In place of a layout's name: the one that fits the folder."""


def find_capture(layout: str, source: str | Path, options: Mapping[str, Any]) -> Capture:
    """Find a capture with options as plain values.

    Raises SourceError for an unknown layout or option, and what `find` raises, with the layout that fits where this one
    does not.
    """
    base = Path(source).resolve()
    if layout != AUTO and layout not in IMPORTERS:
        fits = fitting(base)
        raise SourceError(
            f"unknown layout {layout!r}; known are {', '.join(IMPORTERS)}, and {AUTO}, which takes the one that fits"
            + (f": here {fits[0]}" if fits else "")
        )
    importer = IMPORTERS[recognised(base) if layout == AUTO else layout]
    try:
        checked = importer.options.model_validate(dict(options))
    except ValidationError as e:
        faults = [f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in e.errors()]
        raise SourceError(
            f"options of {importer.name}: {'; '.join(faults)}; known are {', '.join(importer.options.model_fields)}"
        ) from e
    try:
        capture = importer.find(base, checked)
    except UserError as e:
        if why := explained(importer.name, base):
            raise type(e)(f"{e}\n{why}") from e
        raise
    if not capture.has("masks"):
        capture = replace(capture, notes=(*capture.notes, *without_masks(base, capture, importer.masked)))
    if layout == AUTO:
        capture = replace(capture, notes=(f"layout: {importer.name}", *capture.notes))
    rig, said = without_skew(capture.rig)
    known = fitted(replace(capture, rig=rig, notes=(*capture.notes, *said)), checked.crops)
    known = replace(known, notes=(*known.notes, *as_filmed(known)))
    if are_counted(known):
        ignored = checked.timecode == "ignore"
        if not importer.timed:
            known = with_dropped(known)
            known = known if ignored else as_files_begin(known)
        known = in_step(known, ignored)
    return _with_roles(accounted(known, importer.by_definition), checked.held_out)


def _with_roles(capture: Capture, held_out: tuple[str, ...] | None) -> Capture:
    """The capture with the cameras held out that the option names, else those that the layout marks. Raises
    SourceError."""
    names = capture.rig.names
    for name in held_out or ():
        if name not in names:
            raise SourceError(f"option held_out: there is no camera {name}; there are {', '.join(names)}")
    chosen = tuple(n for n in names if n in (capture.held_out if held_out is None else held_out))
    if len(chosen) == len(names):
        raise SourceError("option held_out: no camera is left as a source; hold fewer out")
    notes = [f"held out, for metrics alone: {', '.join(chosen)}; views.held_out overrules it"] if chosen else []
    return replace(capture, held_out=chosen, notes=(*capture.notes, *notes))
