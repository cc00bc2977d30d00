"""Declaration of the judge stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage
from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, JOINTS3D, Facts
from posegaussian.stages.contract.judged import COLOR, DEPTH, EXPOSURE, GIVEN_MATTE, LEARNED, NO_MASKS
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.judge.params import JudgeParams
from posegaussian.stages.network.asset import SHIPPED_NETWORKS
from posegaussian.stages.network.choice import CANDIDATES
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: JudgeParams) -> Resources:
    """Pictures, masks, depth and Gaussians of all views of a few reduced frames, by every candidate (48 bytes a pixel
    each), what matching one frame works in, and one captured picture while it is reduced."""
    pixels = params.size**2
    each = params.frames * shape["view"] * 48 * (len(BY_PICTURES) + 2)
    return Resources(
        cpu=1, ram=pixels * (each + shape["view"] * 88 + 2000) + shape["source_y"] * shape["source_x"] * 24
    )


def _exposure(params: JudgeParams, facts: Facts) -> bool:
    return EXPOSURE in facts


def _given(kind: str, told: str) -> Read:
    return Read.source(kind, views="sources", when=lambda p, f: LEARNED in f and told in f and ESTIMATED not in f)


def unneeded(params: JudgeParams, facts: Facts) -> str | None:
    """Why no picture of a left-out view can be compared, or None."""
    return None if GIVEN_MATTE in facts else NO_MASKS


STAGE = Stage(
    name="judge",
    summary="Draw left-out source views from the others, choice by choice, on a few reduced frames.",
    version=1,
    run="posegaussian.stages.judge.run:run",
    reads=(
        Read.source("pictures", views="sources"),
        Read.source("masks", views="sources"),
        Read("survey/surface", views="sources", when=_exposure),
        _given("joints", JOINTS2D),
        _given("joints3d", JOINTS3D),
        Read.source(SHIPPED_NETWORKS.name, when=lambda p, f: LEARNED in f),
    ),
    writes=(
        ArraySpec(
            DEPTH,
            ("judged", "depth_method", "score"),
            "float64",
            "1",
            "PSNR in dB, SSIM and coverage of pictures of left-out source views by depth method, the worst quality"
            " level first; -1 where none was drawn.",
            when=DEPTH,
            noted=True,
        ),
        ArraySpec(
            EXPOSURE,
            ("judged", "switch", "score"),
            "float64",
            "1",
            "The same without and with exposure gains.",
            when=EXPOSURE,
            noted=True,
        ),
        ArraySpec(
            COLOR,
            ("judged", "switch", "score"),
            "float64",
            "1",
            "The same without and with colours blended by angle.",
            when=COLOR,
            noted=True,
        ),
        ArraySpec(
            LEARNED,
            ("judged", "weights", "score"),
            "float64",
            "1",
            "The same without a network and with the weights that ship, by name.",
            when=LEARNED,
            noted=True,
        ),
    ),
    over=("sequence",),
    params=JudgeParams,
    needs=needs,
    unneeded=unneeded,
    sequence_wide=True,
    cameras=lambda rig, params: frames_rig(rig, params.size),
    dimensions=lambda params, facts: {
        "judged": params.frames * params.views,
        "depth_method": len(BY_PICTURES),
        "weights": len(CANDIDATES),
    },
    sees=("depth", "pose"),
)
