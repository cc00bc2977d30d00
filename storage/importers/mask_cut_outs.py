"""Masks that are pictures of the subject cut out: their colours are what it wears, and tell nothing of where it is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.masks import FOREGROUND, NEARLY_EMPTY
from posegaussian.storage.readers import images

_LOOKED_AT = 5
"""Masks of a camera that are looked at."""
_ENDS = 16
"""Values from black and from white within which a pixel of a mask is either."""
_MASK = 0.9
"""Share of a mask's pixels that are black or white at least; of a picture's never as many are."""
_FLAT = 0.5
"""Share of a picture's rim that has one colour at least, to the bit, where it is cut out before that."""
_OUTLINE = 0.01
"""Share of a mask's longer side that is left out along outlines, which are soft and where compression adds colours."""
_FEWEST = 64
"""Pixels of a subject, at least, by which a mask is judged."""
_UNEVEN = 0.6
"""Share of neighbouring pixels of a subject that differ at least: 0.87 and more of people, 0.02 at most of labels
of parts, and 0.4 at most where they were compressed as JPEG of 512 px."""
_COLOURS = 4.0
"""Levels by which a subject's colours lie off one line from the background's colour at least (root mean square): 5.8
and more of people, in white or black, too, 2.2 at most of a soft mask of one colour, compressed as JPEG or not."""

_Kind = tuple[int, ...] | str
"""How a mask is read: `_COLOUR`, `_ALPHA`, or as what is not the background's colour (red, green, blue)."""
_COLOUR, _ALPHA = "colour", "alpha"


def as_cut_out(names: Sequence[str], streams: Sequence[Stream]) -> tuple[list[Stream], list[str]]:
    """(streams of which those that hold the subject cut out are read by their alpha or by what is not the background's
    colour, notes), by a few of every view's masks, and where these tell nothing by the others'.

    Raises SourceError for a mask without alpha where its camera's are read by theirs.
    """
    seen = {n: Counter(_kinds(s)) for n, s in zip(names, streams, strict=True)}
    ((usual, _),) = sum(seen.values(), Counter[_Kind]()).most_common(1) or [(_COLOUR, 0)]
    kinds: dict[str, _Kind] = {}
    for name, stream in zip(names, streams, strict=True):
        told = seen[name].most_common(1)
        kinds[name] = told[0][0] if told else usual
        if kinds[name] == _ALPHA:
            without = [f.path for f in stream.files if not images.has_alpha(f.path)]
            if told and without:
                raise SourceError(
                    f"camera {name}: masks are read by their alpha, which varies, and {len(without)} have none, such as"
                    f" {without[0]}; write them with alpha, 0 throughout where the subject is not seen"
                )
            kinds[name] = _COLOUR if without else _ALPHA
    read = [replace(s, options={**s.options, **_option(k)}) for s, k in zip(streams, kinds.values(), strict=True)]
    return read, _notes(kinds)


def _option(kind: _Kind) -> dict[str, object]:
    """The option of a stream of masks, as `read_as_meant` has them."""
    if isinstance(kind, tuple):
        return {"background": list(kind)}
    return {"alpha": True} if kind == _ALPHA else {}


def _notes(kinds: dict[str, _Kind]) -> list[str]:
    """A sentence for every way in which masks are read that are no masks of one colour: {camera: kind}."""
    notes = []
    for kind in dict.fromkeys(kinds.values()):
        of = [n for n, k in kinds.items() if k == kind]
        masks = "masks" if len(of) == len(kinds) else f"masks of {', '.join(of)}"
        if kind == _ALPHA:
            notes.append(f"{masks} have an alpha that varies: it is read, and not their colours")
        elif isinstance(kind, tuple):
            colour = "#" + "".join(f"{c:02x}" for c in kind)
            notes.append(
                f"{masks} are pictures of the subject before {colour}: whatever is not of that colour is read as the"
                " subject, edges hard; what it has of that colour itself is lost, so give their alpha, or masks in"
                " white on black, where you have them"
            )
    return notes


def _kinds(stream: Stream) -> list[_Kind]:
    """How masks of a view are read, of a few those that tell it."""
    files = stream.files[:: max(1, len(stream.files) // _LOOKED_AT)]
    kinds = (_kind(*images.read_mask_channels(f.path)) for f in files)
    return [k for k in kinds if k is not None]


def _kind(colour: np.ndarray, alpha: np.ndarray | None) -> _Kind | None:
    """How a mask of colour [h, w, 1 or 3] and alpha [h, w] uint8 is read; None where nothing in it tells."""
    if alpha is not None and alpha.min() <= FOREGROUND < alpha.max():
        return _COLOUR if _is_mask(colour.max(axis=2)[alpha > 0]) else _ALPHA
    if alpha is not None and alpha.max() <= FOREGROUND:
        return None
    return _COLOUR if colour.shape[2] == 1 else _before_one_colour(colour)


def _is_mask(values: np.ndarray) -> bool:
    """Whether values [n] uint8 where an alpha shows any are a mask's by themselves, black and white: the alpha is then
    that of a picture which was moved or straightened, and of no subject."""
    black, white = (values < _ENDS).mean(), (values > 255 - _ENDS).mean()
    return bool(min(black, white) > NEARLY_EMPTY and black + white >= _MASK)


def _before_one_colour(colour: np.ndarray) -> _Kind | None:
    """How a mask [h, w, 3] uint8 without alpha is read; None where no subject is seen."""
    import cv2

    rim = np.concatenate([colour[0], colour[-1], colour[1:-1, 0], colour[1:-1, -1]])
    found, counts = np.unique(rim, axis=0, return_counts=True)
    if counts.max() < _FLAT * len(rim):
        return _COLOUR
    background = tuple(int(c) for c in found[counts.argmax()])
    reach = 2 * max(2, round(_OUTLINE * max(colour.shape))) + 1
    seen = images.apart(colour, background).astype(np.uint8)
    inside = cv2.erode(seen, np.ones((reach, reach), np.uint8)) > 0
    if inside.sum() < _FEWEST:
        return None
    pairs = inside[:, 1:] & inside[:, :-1]
    uneven = (colour[:, 1:] != colour[:, :-1]).any(axis=2)[pairs].mean()
    of = colour[inside].astype(float) - background
    smaller = np.linalg.eigvalsh(of.T @ of / len(of))[:2]  # squared distances from the line, across it
    if uneven >= _UNEVEN and smaller.sum() >= _COLOURS**2:
        return background
    return _COLOUR
