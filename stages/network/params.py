"""Settings of the network stage, and which depth is the last one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from posegaussian.stages.contract.declaration import Params, Read, setting
from posegaussian.stages.contract.facts import Facts, fact
from posegaussian.stages.frames.facts import NOISE_AVERAGING

NETWORK = fact("network")
"""The stage's name, and the fact that it is needed."""
QUATERNIONS = fact("quaternions")
"""The weights' rotation head says a whole rotation, so that Gaussians have a twist about their normal."""
TURNED = fact("turned_pairs")
"""Pairs lie turned in their pictures, so that the sizes that the weights give Gaussians lie along turned axes."""
TWISTED = fact("twisted")
"""Gaussians have a twist about their normal, for one or the other of these reasons."""
SINGLE_OPACITY = fact("single_opacity")
"""The weights' opacity head says one opacity, the same from everywhere."""
AUTO, NONE = "auto", "none"
"""In place of the name of weights: those that suit the capture, and no network."""
Halo = tuple[int, int] | Callable[[Any, Facts], tuple[int, int]]


class NetworkParams(Params):
    """Which weights, and how much is computed with them."""

    weights: str = setting(
        AUTO,
        "none: depth and Gaussians stay the analytic ones; the name of weights that ship (`posegaussian models list`);"
        " a .safetensors file that `posegaussian train` wrote; or auto: the weights that ship and were"
        " trained on pairs as wide as the cameras stand, unless left-out source views look less alike with them.",
        quality_levels=["none", "fast", "wide"],
    )
    iterations: int = setting(
        4, "Steps of the recurrent refinement, T.", unit="iterations", quality_levels=[1, 2, 4, 6], ge=1, le=32
    )
    pairs: int = setting(
        2,
        "Neighbouring views each view is paired with; what the pairs say is averaged by their confidence.",
        quality_levels=[1, 2],
        ge=1,
        le=4,
    )
    precision: Literal["auto", "bf16", "float32"] = setting(
        AUTO,
        "Of the layers; correlation, coordinates and what the heads say are float32 in both. auto: bf16 where the"
        " processor that plans the run multiplies it faster than float32, else float32.",
        quality_levels=["bf16", "float32"],
    )


def shown_bytes(height: int, width: int, views: int) -> int:
    """Bytes of what the network is shown of one frame: pictures, masks, depth and its confidence, and heatmaps of 17
    joints, raw and stabilised, a cell per 16 pixels."""
    return height * width * views * (3 + 1 + 4 + 2 + 2 * 17 * 2 // 16)


def depth_reads(halo: Halo = (0, 0)) -> tuple[Read, ...]:
    """Reads of the depth that `depth_array` names."""
    return (
        *(Read(r.array, halo=halo, when=_unless_averaged(r)) for r in found_depth_reads()),
        Read("gaussians/depth", halo=halo, when=lambda p, f: NOISE_AVERAGING in f),
    )


def found_depth_reads(halo: Halo = (0, 0)) -> tuple[Read, Read]:
    """Reads of the depth that `found_depth_array` names."""
    return (
        Read("depth/depth", halo=halo, when=lambda p, f: NETWORK not in f),
        Read("network/depth", halo=halo, when=lambda p, f: NETWORK in f),
    )


def depth_array(facts: Facts) -> str:
    """The depth that Gaussians are lifted from: averaged over time where that is on, else as it was found."""
    return "gaussians/depth" if NOISE_AVERAGING in facts else found_depth_array(facts)


def found_depth_array(facts: Facts) -> str:
    """The depth that each frame has by itself: the network's where it runs, else the analytic one."""
    return "network/depth" if NETWORK in facts else "depth/depth"


def _unless_averaged(read: Read) -> Callable[[Params, Facts], bool]:
    return lambda p, f: NOISE_AVERAGING not in f and read.when(p, f)
