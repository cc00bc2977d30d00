"""Videos that lie in a folder a camera, as action cameras' cards are copied: one video each, or the chapters of one."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from posegaussian.storage.importers.common import natural, subfolders, videos_in
from posegaussian.storage.model.errors import SourceError


def has_camera_folders(path: Path, known: Callable[[str], bool]) -> bool:
    """Whether a folder holds folders with videos that have known cameras' names."""
    return any(known(f.name) and videos_in(f) for f in subfolders(path))


def videos_of(path: Path, known: Callable[[str], bool]) -> dict[str, Path]:
    """{camera: video} of one folder in natural order: the videos in it, and the one video of each folder in it that has
    the name of a known camera which no video there has. Raises SourceError for two videos of one name, and for such a
    folder with several, with how chapters are joined."""
    out = videos_in(path)
    for folder in subfolders(path):
        if folder.name not in out and known(folder.name) and (found := videos_in(folder)):
            out[folder.name] = _only(folder, list(found.values()))
    return dict(sorted(out.items(), key=lambda item: natural(item[0])))


def _only(folder: Path, videos: list[Path]) -> Path:
    if len(videos) > 1:
        names = [v.name for v in videos]
        raise SourceError(
            f"camera {folder.name} has {len(videos)} videos in {folder}: {', '.join(names)}; take out all but one or,"
            " where they are chapters of one recording, join them in their order without encoding again:"
            f" cd {shlex.quote(str(folder))} && printf \"file '%s'\\n\" {shlex.join(names)} > chapters.txt &&"
            f" ffmpeg -f concat -safe 0 -i chapters.txt -c copy {shlex.quote(f'../{folder.name}.mp4')}"
        )
    return videos[0]
