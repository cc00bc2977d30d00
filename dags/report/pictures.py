"""Pictures of a sequence small enough for a page of a hundred: a strip that plays, pairs beside the truth, a sheet,
what effects change.

Read from what a run left; what was not made, or was dropped to save space, is left out.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posegaussian.dags.export.pictures import filled_sheet, held_out_picture, spread
from posegaussian.dags.planning.results import Results
from posegaussian.dags.report.changes import Change
from posegaussian.storage.model.cameras import CameraPath
from posegaussian.storage.model.errors import ShardMissing, UserError

PAGE_BYTES = 28_000_000
"""Bytes of all pictures of a page, as they stand in it: with text a page of many sequences stays under 30 MB."""
MOST_BYTES = 270_000
"""Bytes of a sequence's pictures, as they stand in the page: enough that none looks coarse on a screen."""
SHARES = {"strip": 0.32, "pair": 0.18, "sheet": 0.25, "change": 0.25}
"""Of a sequence's bytes, by kind of picture; rows of changes share theirs."""
CHANGE = 2_500
"""Bytes of a row of changes below which nothing is seen on it: as many rows are shown as have so many."""
FRAMES, STRIP = 12, 180
"""Frames of the strip that plays, and their height, px: a person's motion is seen, a list of a hundred is light."""
PAIR = 320
"""Height of a novel view beside the held-out picture, px."""
SHEET = 1120
"""Width of the contact sheet, px: half of its own."""
QUALITIES = (82, 65, 45, 28)
"""Of JPEG, best first; what is too large at the last one is halved in size."""


@dataclass(frozen=True)
class Drawn:
    """A picture for the page."""

    kind: str
    """strip, pair, sheet or change."""
    caption: str
    """What it shows."""
    uri: str
    """`data:image/jpeg;base64,...`."""
    width: int
    """Of one frame, px."""
    height: int
    """Of one frame, px."""
    frames: int = 1
    """One above the other."""


def bytes_each(sequences: int) -> int:
    """Bytes that each of some sequences may take in the page for its pictures."""
    return min(MOST_BYTES, PAGE_BYTES // max(1, sequences))


def most_changes(most: int) -> int:
    """Rows of changes that a sequence whose pictures take `most` bytes has place for."""
    return int(most * SHARES["change"]) // CHANGE


def pictures_of(results: Results, changes: Sequence[Change], most: int) -> list[Drawn]:
    """Of every kind that can be drawn, of the first camera path that was rendered, and changes: at most `most` bytes
    together."""
    each = int(most * SHARES["change"]) // max(1, len(changes))
    rows = [_encoded("change", f"{', '.join(c.names)}: {c.caption}", [c.picture], each) for c in changes]
    return _rendered(results, most) + rows


def _rendered(results: Results, most: int) -> list[Drawn]:
    from posegaussian.storage.exporters.contact_sheet import drawn

    path = next((p for name, p in results.context.paths.items() if results.has(f"rendering/{name}/color")), None)
    drawings: list[tuple[str, str, Callable[[], list[np.ndarray]]]]
    if path is None:
        drawings = [("strip", "a source view, the subject cut out", lambda: _filmed(results))]
    else:
        told = path.text
        drawings = [
            ("strip", f"along {told}", lambda: _strip(results, path)),
            ("pair", "novel view, held-out picture", lambda: _pair(results, path)),
            ("sheet", "contact sheet", lambda: [drawn(filled_sheet(results, path))]),
        ]
    found: list[Drawn] = []
    for kind, caption, draw in drawings:
        try:
            shown = draw()
        except UserError:
            continue  # unfinished or dropped: the table of stages says so
        if shown:
            found.append(_encoded(kind, caption, shown, int(most * SHARES[kind])))
    return found


def _filmed(results: Results) -> list[np.ndarray]:
    """Frames of the first source view over time, the subject alone: of a sequence that nothing is rendered of yet."""
    context = results.context
    view = context.views.sources[0]
    width, height = context.rig.size[view]
    pictures = []
    for i in spread(np.flatnonzero(context.valid[:, view]), FRAMES):
        try:
            color, mask = (results.read(f"frames/{a}", range(i, i + 1), view)[0] for a in ("color", "mask"))
        except ShardMissing:
            continue  # a run that is not done has the frames it has
        cut = (color * (mask[..., None] / 255.0)).astype(np.uint8)
        pictures.append(_scaled(cut[:height, :width], STRIP))
    return pictures


def _strip(results: Results, path: CameraPath) -> list[np.ndarray]:
    """Frames that play: over time, or along the path where it shows a single moment; all of one size."""
    over_time = len(path.served) > 1
    camera = int(path.served.sum(axis=0).argmax()) if over_time else 0
    shown = np.flatnonzero(path.served[:, camera] if over_time else path.served[0])
    pictures = []
    for i in spread(shown, FRAMES):
        frame, c = (i, camera) if over_time else (0, i)
        width, height = path.size[c]
        try:
            color = results.read(f"rendering/{path.name}/color", range(frame, frame + 1))[0][c, :height, :width]
        except ShardMissing:
            continue  # a partition that failed leaves a gap, not a sequence without a picture
        pictures.append(_scaled(color, STRIP))
    return [p for p in pictures if p.shape == pictures[0].shape]


def _pair(results: Results, path: CameraPath) -> list[np.ndarray]:
    """The middle frame of a path with truth, rendered and filmed side by side."""
    if path.kind != "held_out" or not path.served.any():
        return []
    frames = np.flatnonzero(path.served.any(axis=1))
    frame = int(frames[len(frames) // 2])
    camera = int(np.flatnonzero(path.served[frame])[0])
    width, height = path.size[camera]
    one = range(frame, frame + 1)
    color = results.read(f"rendering/{path.name}/color", one)[0][camera, :height, :width]
    truth = held_out_picture(results, path, camera, one)
    assert truth is not None, "a held-out path has its truth"
    return [np.concatenate([_scaled(color, PAIR), _scaled(truth, PAIR)], axis=1)]


def _scaled(picture: np.ndarray, height: int) -> np.ndarray:
    """A picture [h, w, 3] of at most this height; a smaller one stays as it is."""
    import cv2

    if picture.shape[0] <= height:
        return picture
    width = max(1, round(picture.shape[1] * height / picture.shape[0]))
    return cv2.resize(np.ascontiguousarray(picture), (width, height), interpolation=cv2.INTER_AREA)


def _encoded(kind: str, caption: str, frames: list[np.ndarray], most: int) -> Drawn:
    """Frames one above the other as one JPEG of at most `most` bytes in the page."""
    import cv2

    if kind == "sheet" and frames[0].shape[1] > SHEET:
        frames = [_scaled(frames[0], round(frames[0].shape[0] * SHEET / frames[0].shape[1]))]
    while True:
        height, width = frames[0].shape[:2]
        stacked = np.ascontiguousarray(np.concatenate(frames)[..., ::-1])
        for quality in QUALITIES:
            coded = cv2.imencode(".jpg", stacked, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
            # base64 makes four bytes of three
            if len(coded) * 4 <= most * 3 or min(height, width) < 16:
                uri = f"data:image/jpeg;base64,{b64encode(coded).decode('ascii')}"
                return Drawn(kind, caption, uri, width, height, len(frames))
            if len(coded) > most * 3:
                break  # far too large: a better use of the time is to halve it
        frames = [_scaled(f, height // 2) for f in frames]
