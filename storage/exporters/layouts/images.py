"""The project's own layout: `cameras.json` beside pictures and masks."""

from __future__ import annotations

from pathlib import Path

from posegaussian.storage.exporters.images_layout import write_capture
from posegaussian.storage.exporters.layouts.declaration import Layout, Recording


def write(folder: Path, recording: Recording) -> None:
    """Write cameras.json. Raises NotWritten."""
    write_capture(folder, recording.rig, None, frame_rate=recording.frame_rate, held_out=recording.held_out)


LAYOUT = Layout("images", "images, masks and cameras.json, which keeps frame rate and held-out cameras.", write)
