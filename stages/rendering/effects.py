"""What rendering does only where it is called for: detail from the source pictures, clipping by the silhouettes,
filling of holes, evening of outlines, anti-aliasing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import JOINTS2D, MASKS, SEGMENTED
from posegaussian.stages.contract.judged import MATTES, POSE, cannot_judge, drawn_at, mean_scores
from posegaussian.stages.depth.facts import LIMB_BOUNDS
from posegaussian.stages.frames.effects import worked_noise
from posegaussian.stages.frames.facts import OUTLINE_REDRAWING
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.rendering import facts
from posegaussian.stages.rendering.params import GAUSSIANS
from posegaussian.stages.survey.trust import outlines_agree
from posegaussian.storage.model.cameras import Rig

NOISE = "survey/noise"
"""What the survey measures for `source_detail`."""
SCORES = "survey/joint_scores"
"""What the survey measures for `pose_blending`."""
AGREEMENT = "survey/agreement"
"""What the survey measures for `silhouette_clipping` and `hole_filling`."""
WORTH = 0.05
"""dB that weighing views by their joints must gain on left-out views."""
TRUSTED = 0.5
"""Share of the pairs of cameras whose outlines must agree: of less no hull can be told. Where a single mask contradicts
the others, its place alone is given up (`posegaussian.stages.silhouettes.places`)."""


def _trusted(evidence: Evidence, bound: float) -> Decision | None:
    if AGREEMENT not in evidence.noted:
        return None
    share, pairs = outlines_agree(evidence.noted[AGREEMENT][:, list(evidence.sources)])
    if share is None:
        return Decision(False, None, bound, "no two masks of the sample have outlines that can be compared")
    told = f"the outlines of masks agree in {share:.0%} of {pairs} pairs of cameras"
    return Decision(bool(share > bound), share, bound, f"{told}; where one contradicts the others it has no say")


def _clipping(evidence: Evidence, bound: float) -> Decision | None:
    if MASKS not in evidence.facts:
        return Decision(
            True,
            None,
            bound,
            "the person is segmented in the source views: what lies farther beyond the masks' hull than such masks are"
            " wrong is a stray piece",
        )
    return _trusted(evidence, bound)


def _filling(evidence: Evidence, bound: float) -> Decision | None:
    if MASKS not in evidence.facts:
        return Decision(
            True,
            None,
            bound,
            "the person is segmented in the source views: a small hole within all outlines is the person's",
        )
    return _trusted(evidence, bound)


def _evening(evidence: Evidence, bound: float) -> Decision | None:
    if MASKS not in evidence.facts:
        return Decision(
            False, None, bound, "the masks are estimated: how smooth and soft an outline is they do not show"
        )
    if AGREEMENT in evidence.noted and OUTLINE_REDRAWING in evidence.facts:
        told = "the masks' outlines are redrawn (outline_redrawing): as smooth and as sharp as the pictures' edges"
        return Decision(True, None, bound, told)
    return _trusted(evidence, bound)


def _no_masks(evidence: Evidence) -> str | None:
    """Why nothing tells where the background is."""
    if not {MASKS, SEGMENTED} & evidence.facts:
        return "the capture came without masks, and nobody segments the person: the background's shape is a guess"
    return None if len(evidence.sources) > 1 else "there is a single source view"


def _few_masks(evidence: Evidence) -> str | None:
    """Why nothing tells where the subject is: what two masks leave holds much that is nobody's."""
    few = None if len(evidence.sources) > 2 else "fewer than three source views have masks to compare"
    return _no_masks(evidence) or few


def coarseness(evidence: Evidence) -> float:
    """Size of a pixel at the subject in the coarsest target camera, over that in the finest source view;
    0 without any target."""
    rig = evidence.rig.subset(list(evidence.sources))
    subject = look_at_point(rig)
    found = [0.0]
    for path in evidence.targets:
        k, pose = path.intrinsics[path.served], path.world_to_camera[path.served]  # [N, 3, 3], [N, 4, 4]
        away = np.linalg.norm(pose[:, :3, :3] @ subject + pose[:, :3, 3], axis=1)
        found += (away / k[:, [0, 1], [0, 1]].mean(axis=1)).tolist()
    return float(
        max(found)
        / (np.linalg.norm(rig.centres - subject, axis=1) / rig.intrinsics[:, [0, 1], [0, 1]].mean(axis=1)).min()
    )


def _aliases(evidence: Evidence, bound: float) -> Decision:
    ratio = coarseness(evidence)
    if not ratio:
        return Decision(False, None, bound, "no picture is rendered")
    return Decision(
        bool(ratio > bound),
        ratio,
        bound,
        f"a pixel of the coarsest target camera covers {ratio:.2f} of the finest source's at the subject",
    )


def _tells_detail(evidence: Evidence, bound: float) -> Decision | None:
    if NOISE not in evidence.noted:
        return None
    noise = worked_noise(evidence, NOISE)
    return Decision(
        bool(noise <= bound),
        noise,
        bound,
        f"source pictures have noise of {noise:.1f}/255: what Gaussians blur of them is"
        + (" detail" if noise <= bound else " noise"),
    )


def _nothing_weighed(evidence: Evidence) -> str | None:
    """Why no view can be surer of a joint than another."""
    if JOINTS2D not in evidence.facts:
        return "no view says how sure it is of joints"
    if evidence.params.sources < 2:
        return "rendering.sources is 1: a picture is made of one source view"
    return None if len(evidence.sources) > 1 else "there is a single source view"


def _views_doubt(evidence: Evidence, bound: float) -> Decision | None:
    if SCORES not in evidence.noted:
        return None
    scores = evidence.noted[SCORES]  # of the source views alone
    doubt = float(np.mean(scores.max(axis=0) - scores.min(axis=0)))
    told = f"source views differ by {doubt:.2f} in how sure they are of a joint"
    if doubt <= bound:
        return Decision(False, doubt, bound, told)
    blind = cannot_judge(len(evidence.sources), bool(evidence.facts & set(MATTES.values())))
    if blind is None and POSE not in evidence.noted:
        return None
    means = None if blind is not None else mean_scores(evidence.noted[POSE])
    if means is None:
        return Decision(False, doubt, bound, f"{told}; {blind or 'no left-out view could be drawn with joints'}")
    return Decision(
        bool(means[1, 0] >= means[0, 0] + WORTH),
        doubt,
        bound,
        f"{told}; left-out source views, drawn from the others, have {drawn_at(means, 1)} with views weighed by it,"
        f" {drawn_at(means, 0)} without, {WORTH:g} dB more are asked",
    )


def _no_limbs(evidence: Evidence) -> str | None:
    """Why nothing tells where the body goes on that no view sees."""
    if LIMB_BOUNDS not in evidence.facts:
        return "no limbs are believed (limb_bounds is off)"
    return _few_masks(evidence)


def widest_gap(rig: Rig) -> float:
    """Degrees at the subject from the loneliest of the source cameras to the one next to it."""
    towards = rig.centres - look_at_point(rig)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosines = towards @ towards.T - 3 * np.eye(len(towards))
    return float(np.degrees(np.arccos(np.clip(cosines.max(axis=1), -1, 1))).max())


def _stand_apart(evidence: Evidence, bound: float) -> Decision:
    gap = widest_gap(evidence.rig.subset(list(evidence.sources)))
    return Decision(
        bool(gap > bound),
        gap,
        bound,
        f"a source camera stands {gap:.0f} degrees from the one next to it, and limbs are known",
    )


def _of_ours(lacks: Callable[[Evidence], str | None]) -> Callable[[Evidence], str | None]:
    """What an effect of our Gaussians' pictures lacks: those, where another method draws."""

    def lacked(evidence: Evidence) -> str | None:
        method = evidence.params.method
        return lacks(evidence) if method == GAUSSIANS else f"rendering.method is {method}: our Gaussians are not drawn"

    return lacked


SURFACE_CLOSING = Effect(
    facts.SURFACE_CLOSING,
    "Close gaps of rendered pictures by the limbs between the source views, in the colours of those that see them.",
    "angle at the subject from the loneliest source view to its neighbour",
    # Rings of 8 cameras, 45 degrees apart, gain nothing; of 6, 60 degrees apart, 0.02 dB; of less, decibels.
    50.0,
    "degrees",
    _stand_apart,
    lacks=_of_ours(_no_limbs),
)
SILHOUETTE_CLIPPING = Effect(
    facts.SILHOUETTE_CLIPPING,
    "Take away from rendered pictures what lies beyond the source masks' hull.",
    "share of the pairs of cameras whose outlines agree",
    TRUSTED,
    "1",
    _clipping,
    asks=(AGREEMENT,),
    lacks=_of_ours(_no_masks),
)
HOLE_FILLING = Effect(
    facts.HOLE_FILLING,
    "Fill small holes of rendered pictures where the source masks' hull says that there is subject.",
    "share of the pairs of cameras whose outlines agree",
    TRUSTED,
    "1",
    _filling,
    asks=(AGREEMENT,),
    lacks=_of_ours(_few_masks),
)
OUTLINE_EVENING = Effect(
    facts.OUTLINE_EVENING,
    "Make the outlines of rendered pictures as smooth and as soft as those of the source masks.",
    "share of the pairs of cameras whose outlines agree",
    TRUSTED,
    "1",
    _evening,
    asks=(AGREEMENT,),
    lacks=_of_ours(_few_masks),
)
POSE_BLENDING = Effect(
    facts.POSE_BLENDING,
    "Weigh the source views of a picture by how sure they are of the joints near a point.",
    "difference between source views in the score of a joint",
    # Joints that were given exactly score 1 in all views; estimated ones differ by 0.2 to 0.5 on people who hide their
    # own arms.
    0.1,
    "1",
    _views_doubt,
    asks=(SCORES, POSE),
    lacks=_of_ours(_nothing_weighed),
)
SOURCE_DETAIL = Effect(
    facts.SOURCE_DETAIL,
    "Below the bound: give rendered pictures the detail that Gaussians blur, from where the source pictures show it.",
    "noise of the source pictures",
    # Eight tuning people gain 0.31 dB with noise of 0.5 to 1.3. Two gain 0.28 with 3.0, but no SSIM; with 4.8 one gains
    # 0.3 and the other nothing, and both lose SSIM; with 9 and more decibels are lost, too.
    4.0,
    "of 255",
    _tells_detail,
    asks=(NOISE,),
    lacks=_of_ours(lambda evidence: None),
)
ANTI_ALIASING = Effect(
    facts.ANTI_ALIASING,
    "Average Gaussians over the pixels of a picture that samples more coarsely than the sources.",
    "pixel of the coarsest target camera over the finest source's, at the subject",
    # Up to a quarter coarser, Gaussians of half a source pixel still cover the target's.
    1.25,
    "px/px",
    _aliases,
    lacks=_of_ours(lambda evidence: None),
)
