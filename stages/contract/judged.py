"""Scores of pictures of left-out source views, candidate by candidate: how the judge stage lays them out, and how they
are compared. What decides imports this; what draws the pictures imports what decides."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import FEW_SOURCES, Facts, fact

DEPTH, EXPOSURE, LEARNED = "judge/depth", "judge/exposure", "judge/network"
POSE = "judge/pose"
CALIBRATION = "judge/calibration"
"""[picture, candidate, measure] of the depth methods, the worst quality level first, as far as asked; without and with
exposure gains; without the network and with the weights that ship, by name; without and with views weighed by their
joints; with the cameras as they are written down, and turned."""
SHARED_LIGHT = "judge/shared_light"
"""[V, V, point, 3] by how much cameras differ in brightness at points that both see."""
TURNS = "judge/turns"
"""[V, axis] rad by which cameras stand turned against what is written down, in their own axes."""
MEASURES = ("psnr", "ssim", "coverage")
"""PSNR in dB and SSIM in the person's box, each channel's light fitted to the photograph's; share of the person that is
covered."""
NONE = -1.0
"""Score of what was not drawn."""
GIVEN_MATTE, PERSON_MATTE, PLATE_MATTE = fact("given_matte"), fact("person_matte"), fact("plate_matte")
MATTES = {"given": GIVEN_MATTE, "person": PERSON_MATTE, "plate": PLATE_MATTE}
"""{what `frames.matte` comes to: the fact that tells it}: each says where the subject is in a few frames alone."""
NO_MATTE = "everything is foreground (frames.matte comes to none): nothing says who the subject is"
"""Why no picture of a left-out view is compared."""
FEWEST = 3
"""Source views of which one can be left out: two draw it."""


def may_judge(facts: Facts) -> bool:
    """Whether left-out views can be drawn, as far as the capture's facts tell."""
    return FEW_SOURCES not in facts and bool(facts & set(MATTES.values()))


def mean_scores(scores: np.ndarray) -> np.ndarray | None:
    """[candidate, measure] means over the pictures [picture, candidate, measure] that were drawn; None without any."""
    drawn = scores[(scores != NONE).all(axis=(1, 2))]
    return drawn.mean(axis=0) if len(drawn) else None


def mean_of_asked(scores: np.ndarray) -> np.ndarray | None:
    """The same of candidates of which some were not asked: no picture was drawn by them, and their means are `NONE`."""
    asked = (scores != NONE).any(axis=(0, 2))
    means = mean_scores(scores[:, asked]) if asked.any() else None
    if means is None:
        return None
    out = np.full(scores.shape[1:], NONE)
    out[asked] = means
    return out


def cannot_judge(sources: int, cut_out: bool) -> str | None:
    """Why no picture of a left-out view can be judged, or None.

    cut_out: whether one of the `MATTES` is among the facts."""
    if sources < FEWEST:
        return f"with {sources} source view{'s' if sources > 1 else ''} none can be left out and drawn from two others"
    if not cut_out:
        return NO_MATTE
    return None


def drawn_at(means: np.ndarray, candidate: int) -> str:
    """`24.66 dB / .922`: PSNR and SSIM of a candidate, from `mean_scores`."""
    psnr, ssim = means[candidate, :2]
    return f"{psnr:.2f} dB / {f'{ssim:.3f}'.removeprefix('0')}"
