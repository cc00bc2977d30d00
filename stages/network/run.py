"""Kernel of the network stage: what the trained network makes of every source view, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.contract.reading import read_together
from posegaussian.stages.contract.timing import TimedInputs
from posegaussian.stages.depth.algorithms.smooth_disparity import even
from posegaussian.stages.matching.fuse import MATCHED
from posegaussian.stages.network.inference import NUMBERS, Learned, Looks, leaning, look, look_alone, refined
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.pairs import SourceView
from posegaussian.stages.network.model.presets import LONELY_ANGLE, Preset
from posegaussian.stages.network.notes import notes
from posegaussian.stages.network.params import QUATERNIONS, TURNED, NetworkParams, shown_bytes
from posegaussian.stages.network.precision import precision_of
from posegaussian.stages.network.silhouettes import held, silhouettes_of
from posegaussian.stages.pose.facts import POSE_HEATMAPS
from posegaussian.stages.smoothing.facts import TEMPORAL_SMOOTHING

EVENED, NOISE = 2, 0.5
"""Times that depth is evened, and px of disparity that are noise. Each view is moved by itself, and what stands out of
a limb in any of them makes it wider to a camera beside. Refined pictures of eight tuning people (384 px) gain 0.08 dB
on the mean (-0.14 to 0.23), although the mean error of depth is 1 to 8 % larger."""


def run(inputs: TimedInputs, params: NetworkParams) -> Iterator[Block]:
    """Blocks `network/depth`, `network/confidence`, `network/share`, `network/blend` and `network/numbers` of every
    view, and `network/turn` of quaternions, `network/axes` of turned pairs; views that are not sources get zeros.

    Each frame follows from its own pictures, heatmaps and analytic depth alone.
    """
    with inputs.timed("loading"):
        network = inputs.source("network")
    shape = _shape(inputs)
    reader, sources = _Reader(inputs), inputs.views.sources
    depth = {v: np.zeros(shape, np.float32) for v in sources}
    confidence = {v: np.zeros(shape, np.float16) for v in sources}
    blend = {v: np.zeros(shape, np.float16) for v in sources}
    numbers = {v: np.zeros((shape[0], NUMBERS, *shape[1:]), np.float16) for v in sources}
    turn = {v: np.zeros((shape[0], 1, *shape[1:]), np.float16) for v in sources}
    axes = np.zeros((len(inputs.rig), shape[0], 1), np.float32)
    left_out = Counter[int]()

    @cache
    def looks(valid: tuple[int, ...]) -> Looks:
        with inputs.timed("rectification"):
            return Looks.of(inputs.rig, valid, params.pairs, network.preset.widest, TURNED in inputs.facts)

    for f in range(shape[0]):
        valid = tuple(v for v in sources if inputs.valid[f, v])
        filmed = reader.frame(f)
        for v, view in filmed.items():
            depth[v][f] = view.depth
        shown = {v: filmed[v] for v in valid}
        for v, learned in _learned(inputs, network, params, looks, shown, left_out).items():
            with inputs.timed("pulling back"):
                sensitivity = looks(valid).sensitivity(v) if len(valid) > 1 else 0.0
                depth[v][f] = evened(depth[v][f], refined(depth[v][f], learned), learned.confidence, sensitivity)
            confidence[v][f], blend[v][f] = learned.confidence, learned.share
            numbers[v][f], turn[v][f] = stored(learned.numbers, network.preset)
            axes[v, f] = looks(valid).axes[v] if TURNED in inputs.facts else 0
    for v in range(len(inputs.rig)):
        z, sure = depth.get(v, np.zeros(shape, np.float32)), confidence.get(v, np.zeros(shape, np.float16))
        mean = _mean(z, sure)
        known = float(mean[mean > 0].mean()) if (mean > 0).any() else 0.0
        reach = max(network.preset.widest, LONELY_ANGLE)
        said = notes(inputs.rig, sources, v, reach, known, left_out[v]) if z.any() else ()
        yield Block("network/depth", z, v)
        yield Block("network/confidence", sure, v)
        yield Block("network/share", mean, v, notes=said)
        yield Block("network/blend", blend.get(v, np.zeros(shape, np.float16)), v)
        yield Block("network/numbers", numbers.get(v, np.zeros((shape[0], NUMBERS, *shape[1:]), np.float16)), v)
        if QUATERNIONS in inputs.facts:
            yield Block("network/turn", turn.get(v, np.zeros((shape[0], 1, *shape[1:]), np.float16)), v)
        if TURNED in inputs.facts:
            yield Block("network/axes", axes[v], v)


def evened(start: np.ndarray, refined: np.ndarray, confidence: np.ndarray, sensitivity: float) -> np.ndarray:
    """Refined depth [h, w] float32 m with the noise between neighbours averaged away, as far as `confidence` [h, w]
    comes to that of a match; what is the depth it `start`ed from stays bit by bit. `sensitivity`: px of disparity for
    1/metre; 0 evens nothing."""
    out = refined
    for _ in range(EVENED if sensitivity > 0 else 0):
        out = even(out, 1 / sensitivity, NOISE)
    said = (refined != start) & (refined > 0) & (out > 0)
    believed = np.clip(np.nan_to_num(confidence.astype(np.float32)) / np.float32(MATCHED), 0, 1)
    inverse = (1 - believed) / np.where(said, refined, 1) + believed / np.where(said, out, 1)
    return np.where(said, 1 / inverse, refined).astype(np.float32)


def stored(said: np.ndarray, preset: Preset) -> tuple[np.ndarray, np.ndarray]:
    """`network/numbers` [8, h, w] and `network/turn` [1, h, w] of what the heads say [n, h, w]: scale (3), rotation
    (3, or 4 of a quaternion, whose first is the turn), opacity (2, or 1)."""
    said, first = np.clip(said, -6e4, 6e4), leaning(preset)
    numbers = np.zeros((NUMBERS, *said.shape[1:]), said.dtype)
    numbers[:3], rest = said[:3], said[first:]
    numbers[3 : 3 + len(rest)] = rest
    return numbers, said[3:4] if first == 4 else np.zeros_like(said[:1])


def _learned(
    inputs: TimedInputs,
    network: PoseGaussianNetwork,
    params: NetworkParams,
    looks: Callable[[tuple[int, ...]], Looks],
    shown: Mapping[int, SourceView],
    left_out: Counter[int],
) -> dict[int, Learned]:
    """What is learnt about the views of one frame, held within each other's silhouettes; `left_out` as in `look`."""
    rig, (precision, _) = inputs.rig, precision_of(params, inputs.facts)
    if len(inputs.views.sources) == 1:
        if not network.preset.alone:
            return {}
        alone = {
            v: look_alone(network, rig, v, s, params.iterations, precision, inputs.timed, left_out)
            for v, s in shown.items()
        }
        return {v: said for v, said in alone.items() if said is not None}
    if len(shown) < 2:
        return {}
    found = look(network, looks(tuple(shown)), shown, params.iterations, precision, inputs.timed, left_out)
    with inputs.timed("silhouettes"):
        silhouettes = silhouettes_of(rig, {u: s.mask for u, s in shown.items()})
        return {v: held(rig, v, shown[v].depth, said, silhouettes) for v, said in found.items()}


class _Reader:
    """Reads what the source views show, of large pictures some frames at a time."""

    def __init__(self, inputs: TimedInputs) -> None:
        self.inputs = inputs
        names = ["frames/color", "frames/mask", "depth/depth", "depth/confidence"]
        if POSE_HEATMAPS in inputs.facts:
            names.append("pose/heatmaps")
            if TEMPORAL_SMOOTHING in inputs.facts:
                names.append("smoothing/heatmaps")
        self.names = tuple(names)
        """Arrays that are read, in the order of the fields of `SourceView`."""
        self.span = range(0)
        """Frames of the partition that were read last."""
        self.read: dict[int, list[np.ndarray]] = {}
        """{source view: what was read of these frames}."""

    def frame(self, f: int) -> dict[int, SourceView]:
        """What each source view shows of the f-th frame of the partition."""
        own, views = self.inputs.partition, self.inputs.views.sources
        if f not in self.span:
            span = read_together(own, own.start + f, shown_bytes(*_shape(self.inputs)[1:], len(views)))
            self.read, self.span = {}, range(span.start - own.start, span.stop - own.start)
            with self.inputs.timed("reading"):
                self.read = {v: [self.inputs.read(n, v, span) for n in self.names] for v in views}
        return {v: SourceView(*(a[f - self.span.start] for a in self.read[v])) for v in views}


def _shape(inputs: Inputs) -> tuple[int, int, int]:
    """(frames, height, width) of the arrays: pictures are padded to the largest."""
    width, height = inputs.rig.size.max(axis=0)
    return len(inputs.partition), int(height), int(width)


def _mean(depth: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """[F, 1] float32 mean confidence over the surface of each frame, 0 without one."""
    surface = depth > 0
    total = np.where(surface, confidence, 0).sum(axis=(1, 2), dtype=np.float64)
    return (total / np.maximum(surface.sum(axis=(1, 2)), 1)).astype(np.float32)[:, None]


def check(block: Block, params: NetworkParams) -> list[str]:
    """Raise ValueError for values that no depth, confidence or head can have."""
    data = np.asarray(block.data)
    low, high = {
        "network/depth": (0.0, np.inf),
        "network/confidence": (0.0, 1.0),
        "network/share": (0.0, 1.0),
        "network/blend": (0.0, 1.0),
        "network/numbers": (-65504.0, 65504.0),
        "network/turn": (-65504.0, 65504.0),
        "network/axes": (-np.pi / 4 - 1e-6, np.pi / 4 + 1e-6),
    }[block.array]
    wrong = ~(np.isfinite(data) & (data >= low) & (data <= high))
    if wrong.any():
        raise ValueError(
            f"{block.array} of view {block.view}: {int(wrong.sum())} values such as {data[wrong][0]} are not in"
            f" [{low:g}, {high:g}]"
        )
    return []
