"""What is odd about the masks of a view, and what to do about it, by where they come from."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.frames.params import Matte
from posegaussian.storage.model.masks import ALL_AROUND, NEARLY_EMPTY, ROUND, foreground, rim_share

NEARLY_FULL = 0.7
MUCH = 0.3
"""Share of the subject's body behind somebody else from which on it is said."""
ADVICE: dict[Matte, str] = {
    "given": "the masks that came with the capture hold nothing there: is the subject seen by that camera? If not,"
    " leave it out with views.sources; if so, give it masks, or set frames.matte: person, which makes those of all",
    "person": "nobody was found there: is the subject seen by that camera? If so, set frames.matte: none, or import"
    " masks",
    "plate": "a subject that stays in its place becomes part of the background plate: set frames.matte: none, or import"
    " masks",
    "none": "everything is foreground where there is a picture: look at how far the recordings reach",
}

MARKED = (
    "they seem to mark the background, or to cut nothing out: if the subject is black in them, write them the other way"
    " round and import the capture again"
)


def goes_around(given: np.ndarray) -> bool:
    """Whether a mask [h, w] that came with the capture goes around its picture, and not a subject through it.

    One without any background is none of these: a camera so near that the subject fills its picture has such.
    """
    inside = foreground(given)
    return bool(not inside.all() and rim_share(inside) > ROUND)


def around_told(around: list[int], turned: list[int], count: int) -> tuple[str, ...]:
    """Sentences on the source frames of one view, of `count`, whose given masks go around the picture (`goes_around`),
    and on those that were read the other way round; none without any."""
    told = []
    if turned:
        told.append(
            f"masks of {_frames(turned)} are white along more than {ALL_AROUND:.0%} of the picture's rim, unlike the"
            " camera's others, and are read the other way round; the subject must be white: write them so and import"
            " the capture again"
        )
    if around:
        told.append(
            f"{len(around)} of {count} masks are white along more than {ROUND:.0%} of the picture's rim, those of"
            f" {_frames(around)}; {MARKED}"
        )
    return tuple(told)


def _frames(numbers: list[int]) -> str:
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def doubts(mask: np.ndarray, matte: Matte) -> tuple[str, ...]:
    """Sentences on masks [F, h, w] uint8 of one view that hold nobody or everything; `matte`: where they come from.

    A mask that came with the capture may be full, as of a camera that shows a part of the subject.
    """
    if not len(mask):
        return ()
    share = foreground(mask).mean(axis=(1, 2))
    empty, full = int((share < NEARLY_EMPTY).sum()), int((share > NEARLY_FULL).sum())
    told = []
    if 2 * empty > len(share):
        told.append(
            f"{empty} of {len(share)} masks hold less than {NEARLY_EMPTY:.1%} of the picture (frames without a picture"
            f" count too); {ADVICE[matte]}"
        )
    if full and matte in ("plate", "person"):
        told.append(
            f"{full} of {len(share)} masks hold more than {NEARLY_FULL:.0%} of the picture; the camera moves or the"
            " light changes and a background plate does not fit: set frames.matte: none, or import masks"
        )
    return tuple(told)


def hidden_told(frames: list[int]) -> tuple[str, ...]:
    """A sentence on the source frames of a view in which somebody hides much of the subject; none without any."""
    told = (
        f"somebody who stands nearer hides more than {MUCH:.0%} of the subject in frames"
        f" {', '.join(map(str, frames))}; its mask holds what is seen of it: keep others out of the way, or leave the"
        " camera out (views.sources)"
    )
    return (told,) if frames else ()


def dropped_told(frames: list[int]) -> tuple[str, ...]:
    """A sentence on the source frames of a view whose pictures show nothing; none without any."""
    told = (
        f"the pictures of {_frames(frames)} show nothing, they are of one brightness where the subject is: taken for"
        " frames that the recording dropped, and left out"
    )
    return (told,) if frames else ()
