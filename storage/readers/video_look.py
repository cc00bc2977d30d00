"""What a second of a video's pictures shows of how it was filmed, which no container says: pictures that are the one
before once more, and rows that are two instants."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video import VideoFile

FRAMES = 24
"""Consecutive frames that are decoded, from a keyframe on: of 25 frames a second made 30 every sixth is a repeat."""
_PLACES = (0.5, 0.25, 0.75)
"""Shares of a video around which something is seen to move, else at the next."""
_COLUMNS = 2
"""So many are averaged into one: rows stay as they are."""
_BLOCK = 16
"""Px of the blocks in which change is averaged, so that noise does not count."""
_MOST = 99.5
"""Percentile of the blocks that stands for what moves: 1 in 200 changes as much."""
_MOVES = 16.0
"""Grey levels by which that must change, or nothing is told: of who moves slowly, whom codecs pass over in every other
frame, repeats cost nothing. The eight filmed cameras below have 24 to 86."""
_AGAIN, _CLEAR = 0.12, 0.22
"""Shares of the usual change: up to the first a picture is the one before once more, and none may lie between the two.
Repeats, written in H.264 and MPEG-4 up to CRF 35, have up to 0.09; 24 frames of each of eight filmed cameras, of people
who move more and less, 0.22 to 1.6."""
_FEWEST, _LONGEST = 3, 3
"""Repeats, each after a picture that was new, and in a row: more are somebody who stands still."""
_STEP = 12
"""Grey levels by which a pixel must change to belong to what moves."""
_COMBED = 1.3
"""Times by which a row of what moves may differ more from its neighbours than from the next but one: 0.4 to 0.6 of
filmed cameras, 2.6 and 3.5 of two instants a thirtieth and a sixtieth of a second apart."""
_PIXELS = 1000
"""Moving pixels, of all frames looked at, that tell."""


@dataclass(frozen=True)
class Seen:
    """What was seen of a video."""

    frames: range
    """Which frames were looked at."""
    repeats: tuple[int, ...]
    """Of these, those that show the picture before once more."""
    combed: bool
    """Whether odd and even rows of what moves are two instants."""

    @property
    def every(self) -> range | None:
        """The frames looked at whose picture is new, where these are evenly spaced; else None."""
        new = [n for n in self.frames[1:] if n not in self.repeats]
        steps = set(np.diff(new).tolist())
        return range(new[0], new[-1] + 1, *steps) if len(steps) == 1 else None


def seen_in(video: VideoFile) -> Seen | None:
    """What some consecutive frames show, of a video that shows something move; None where nothing does, or where they
    cannot be decoded, which is found where they are needed."""
    for first in dict.fromkeys(_before(video, round(place * (video.count - FRAMES))) for place in _PLACES):
        frames = range(first, min(first + FRAMES, video.count))
        try:
            if seen := _seen(frames, video.stored_grey(frames)):
                return seen
        except SourceError:
            return None
    return None


def _before(video: VideoFile, frame: int) -> int:
    """The last frame up to this one from which decoding can begin, or the first."""
    return max((k for k in video.keyframes if k <= frame), default=0)


def _seen(frames: range, pictures: Iterable[np.ndarray]) -> Seen | None:
    import cv2

    before: np.ndarray | None = None
    changes, combed = [], np.zeros(3)
    for picture in pictures:
        height, width = picture.shape
        grey = cv2.resize(picture, (max(1, width // _COLUMNS), height), interpolation=cv2.INTER_AREA)
        if before is not None:
            change = cv2.absdiff(grey, before)
            blocks = max(1, width // _BLOCK), max(1, height // _BLOCK)
            mean = cv2.resize(change.astype(np.float32), blocks, interpolation=cv2.INTER_AREA)
            changes.append(float(np.percentile(mean, _MOST)))
            combed += _rows_apart(grey, change >= _STEP)
        before = grey
    usual = float(np.percentile(changes, 75)) if changes else 0.0
    if usual < _MOVES:
        return None
    near, far, told = combed
    again = _again(np.array(changes) / usual)
    return Seen(frames, tuple(frames[i + 1] for i in again), bool(told >= _PIXELS and near > _COMBED * far))


def _rows_apart(grey: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """[3] grey levels by which pixels of a picture [h, w] that move differ from the mean of both neighbours in their
    column, from that of the next but one, and how many there are."""
    y, x = np.nonzero(moves[2:-2])
    at = [grey[y + k, x].astype(np.int32) for k in range(5)]
    near, far = (np.abs(2 * at[2] - at[2 - k] - at[2 + k]).sum() for k in (1, 2))
    return np.array([near, far, len(y)], dtype=np.float64)


def _again(shares: np.ndarray) -> list[int]:
    """Which of some changes, as shares of the usual one, are none: those of pictures that are repeated, each time after
    something new; none where somebody may just have stood still."""
    again = shares <= _AGAIN
    doubtful = ((shares > _AGAIN) & (shares < _CLEAR)).any()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], again, [False]]).astype(np.int8)))
    lengths = edges[1::2] - edges[::2]
    if doubtful or len(lengths) < _FEWEST or lengths.max() > _LONGEST:
        return []
    return np.flatnonzero(again).tolist()
