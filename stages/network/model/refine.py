"""Recurrent refinement of the analytic disparity: the paper's depth refinement module.

    D(t) = limit(D(t-1) + delta(state(t))),  t = 1 ... T

starting from the disparity that geometry gave. T is chosen at each call: the first T results do not depend on what
follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import nn

from posegaussian.stages.network.model.correlation import Correlation, columns_of, exact
from posegaussian.stages.network.model.disparity import Coding
from posegaussian.stages.network.model.quarters import Quarters
from posegaussian.stages.network.model.update import Update, upsample
from posegaussian.stages.network.model.warping import warped_correlation

CONFIDENCE_BIAS = 1.0
"""Logit an untrained network starts with: a confidence near 0 would starve what comes after of gradient."""


@dataclass(frozen=True)
class Refined:
    """What the refinement gives for B directions; H, W are the size of the start in px."""

    disparities: list[torch.Tensor]
    """[B, 1, H, W] px after each step, first to last (only the last where no more was asked for),
    within the coding's bounds."""
    confidence: torch.Tensor
    """[B, 1, H, W] in 0..1: trust in the last disparity over the start."""
    state: torch.Tensor
    """[B, hidden, h, w] of the last step."""


class DepthRefinement(nn.Module):
    """Features of both views of a rectified pair and a start -> disparities and a confidence.

    channels: of the features; hidden: width of the recurrence; levels, radius: of the correlation; factor: px a feature
    cell;
    further_views: whether other cameras than the pair's are looked up, too, by warping; beside: channels that the
    context reads beside the first view's features; alone: whether a view without another can be refined: what stands in
    for its correlation is learnt.
    """

    def __init__(
        self,
        channels: int,
        hidden: int,
        levels: int,
        radius: int,
        factor: int,
        further_views: bool = False,
        beside: int = 0,
        alone: bool = False,
    ) -> None:
        super().__init__()
        self.levels, self.radius, self.factor, self.hidden = levels, radius, factor, hidden
        taps = 2 * radius + 1
        self.further_views = further_views
        self.context = nn.Conv2d(channels + beside, 4 * hidden, 3, padding=1)
        self.update = Update(levels * taps + (2 * taps if further_views else 0), hidden, factor)
        self.confidence = nn.Conv2d(hidden, 1, 3, padding=1)
        weight, bias = self.confidence.parameters()
        nn.init.zeros_(weight)
        nn.init.constant_(bias, CONFIDENCE_BIAS)
        # begins as what features give that have nothing to do with each other
        self.absent = nn.Parameter(torch.zeros(1, levels * taps, 1, 1)) if alone else None

    def forward(
        self,
        first: torch.Tensor,
        second: torch.Tensor | None,
        start: torch.Tensor,
        coding: Coding,
        iterations: int,
        others: Sequence[tuple[torch.Tensor, torch.Tensor]] = (),
        only_last: bool = False,
        beside: torch.Tensor | None = None,
        alone: torch.Tensor | None = None,
        turned: Quarters | None = None,
    ) -> Refined:
        """Refine.

        first, second: features [B, C, h, w] and [B, C, h, w'] of the rectified views, in either order of the pair; no
        second where all views are alone.
        start: [B, 1, H, W] px, NaN where nothing is known; h = ceil(H / factor), w = ceil(W / factor).
        others: (features [B, C, h", w"], `warping.projection` [B, 3, 4] from cells of the first rectified view) of
        further views.
        only_last: up-sample the last step only, as inference wants it.
        beside: [B, beside, h, w] what else is known about the first view's cells, where the refinement was built with
        it.
        alone: [B] bool, of directions whose second view counts for nothing; None: of none.
        turned: by how much all of these maps are turned against the pair's rows; None: not at all.

        On the CPU results are the same bytes on one thread and on several for B >= 2, as the two directions of a pair
        are. A single direction of tiny maps (up to 20480 values) may differ by 1e-6 px: torch chooses its convolutions
        by that.

        Raises ValueError for `iterations` < 1, for sizes that do not fit, and for further views, or views alone, that
        the network was not built for.
        """
        self._check(first, start, iterations, others, alone)
        turned = Quarters.none(len(first)) if turned is None else turned
        rows = turned.in_rows(first)
        correlation = None if second is None else Correlation(rows, turned.in_rows(second), self.levels, self.radius)
        read = self.context(first if beside is None else torch.cat([first, beside.to(first.dtype)], dim=1))
        state, context = torch.tanh(read[:, : self.hidden]), read[:, self.hidden :]
        begin = coding.seeded(start, self.factor)
        disparity, found = begin, []
        for step in range(iterations):
            disparity = disparity.detach()  # as in RAFT: each step answers for its own change
            seen = turned.upright(self._seen(correlation, rows, turned.in_rows(disparity), coding, others, alone))
            state, delta = self.update(state, context, seen, disparity - begin)
            disparity = coding.limit(disparity + delta.to(disparity.dtype), self.factor)
            if step < iterations - 1 and not only_last:
                found.append(self._fine(disparity, self.update.weights(state), coding, start))
        with torch.autocast(state.device.type, enabled=False):
            trust = torch.sigmoid(self.confidence(state.to(exact(state.dtype))))
        # Apart: some processors multiply matrices of one and of two rows in another order, and the last step would
        # differ from the same step of a longer walk.
        weights = self.update.weights(state)
        confidence = _cut(upsample(trust, weights), start).clamp(0, 1)
        return Refined([*found, self._fine(disparity, weights, coding, start)], confidence, state)

    def _seen(
        self,
        correlation: Correlation | None,
        first: torch.Tensor,
        disparity: torch.Tensor,
        coding: Coding,
        others: Sequence[tuple[torch.Tensor, torch.Tensor]],
        alone: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Correlation [B, K, h, w] about a disparity, cells,
        with that of the further views at the same disparities behind it."""
        if correlation is None:
            assert self.absent is not None, "_check asks for it"
            found = self.absent.to(disparity.dtype).expand(len(first), -1, *disparity.shape[2:])
        else:
            found = correlation.look_up(columns_of(disparity))
            if alone is not None and self.absent is not None:
                found = torch.where(alone[:, None, None, None], self.absent.to(found.dtype), found)
        if not self.further_views:
            return found
        steps = torch.arange(-self.radius, self.radius + 1, device=disparity.device, dtype=disparity.dtype)
        hypotheses = torch.stack([coding.depth(self.factor * (disparity - s))[:, 0] for s in steps], dim=1)
        return torch.cat([found, *warped_correlation(first, list(others), hypotheses)], dim=1)

    def _fine(
        self, disparity: torch.Tensor, weights: torch.Tensor, coding: Coding, start: torch.Tensor
    ) -> torch.Tensor:
        return coding.limit(_cut(self.factor * upsample(disparity, weights), start))

    def _check(
        self,
        first: torch.Tensor,
        start: torch.Tensor,
        iterations: int,
        others: Sequence[tuple[torch.Tensor, torch.Tensor]],
        alone: torch.Tensor | None,
    ) -> None:
        if iterations < 1:
            raise ValueError(f"{iterations} steps of refinement; at least 1 (without any, use the start itself)")
        cells = tuple(-(-s // self.factor) for s in start.shape[2:])
        if start.ndim != 4 or start.shape[1] != 1 or (start.shape[0], *cells) != (first.shape[0], *first.shape[2:]):
            raise ValueError(
                f"a start of {tuple(start.shape)} px for features of {tuple(first.shape)}; at {self.factor} px a cell"
                f" it must be [{first.shape[0]}, 1, H, W] with cells {tuple(first.shape[2:])}, not {cells}"
            )
        if others and not self.further_views:
            raise ValueError(f"{len(others)} further views for a network of pairs; build it with further_views=True")
        if alone is not None and self.absent is None and bool(alone.any()):
            raise ValueError(f"{int(alone.sum())} views alone for a network of pairs; build it with alone=True")


def _cut(fine: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    """The last cells may reach beyond the picture."""
    return fine[..., : like.shape[2], : like.shape[3]]
