"""Points into clusters: a tree of halves, of which the coarse ends are kept where little varies. numpy, float64.

A node holds some points; its error is the weighted sum of their squared distances from their weighted mean, over all
features. It is halved at that mean, along the feature that varies most. The cut through the tree is the one that
halving the node of greatest error first leads to, so what varies gets many small clusters and what does not a few large
ones.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np


class _Nodes(NamedTuple):
    """Nodes of the tree, parents before children."""

    start: np.ndarray  # [S]
    """Where a node's points begin in the order of the tree."""
    parent: np.ndarray  # [S]
    """Index of the node it is half of; -1 for the first."""
    error: np.ndarray  # [S]
    """Of the node or of one above it, whichever is least: a child never comes before its parent."""
    halved: np.ndarray  # [S] bool


def clusters(features: np.ndarray, weights: np.ndarray, most: int, enough: float = 0.0) -> np.ndarray:
    """[N] labels 0..K-1 of K clusters, K <= `most`; no label is empty, neighbours in the tree have near labels.

    Args:
        features: [N, D] finite, N >= 1, in units in which distances along all of them count alike.
        weights: [N] finite, above 0: how much a point's distance counts.
        most: clusters, 1 or more.
        enough: mean squared distance from the mean, weighted, up to which a cluster is not halved any more.

    Deterministic, on one thread. Sums run in the order of the points: labels of points in another order may differ by
    rounding, so callers who need more sort them first.
    """
    order = np.arange(len(features))
    nodes = _Nodes(*(np.concatenate(c) for c in zip(*_levels(features, weights, order, enough), strict=True)))
    splits = np.flatnonzero(nodes.halved)
    split = np.zeros(len(nodes.start), bool)
    split[splits[np.argsort(-nodes.error[splits], kind="stable")][: most - 1]] = True
    kept = ~split
    kept[1:] &= split[nodes.parent[1:]]
    labels = np.empty(len(order), np.int64)
    labels[order] = np.searchsorted(np.sort(nodes.start[kept]), np.arange(len(order)), side="right") - 1
    return labels


def _levels(features: np.ndarray, weights: np.ndarray, order: np.ndarray, enough: float) -> Iterator[_Nodes]:
    """The tree level by level, from one node of all points; `order` [N] becomes the order of the tree."""
    start, end = np.array([0]), np.array([len(order)])
    parent, bound, known = np.array([-1]), np.array([np.inf]), 0
    while len(start):
        size = end - start
        first = np.cumsum(size) - size
        at = np.arange(size.sum()) + np.repeat(start - first, size)
        owner = np.repeat(np.arange(len(size)), size)
        points, w = features[order[at]], weights[order[at]]
        total = np.add.reduceat(w, first)
        away = points - (np.add.reduceat(points * w[:, None], first) / total[:, None])[owner]
        spread = np.add.reduceat(away * away * w[:, None], first)
        beyond = away[np.arange(len(away)), np.argmax(spread, axis=1)[owner]] > 0
        upper = np.add.reduceat(beyond.astype(np.int64), first)
        # of points that differ by rounding alone, all may lie on one side of their mean
        halved = (spread.sum(axis=1) > enough * total) & (upper > 0) & (upper < size)
        error = np.minimum(bound, spread.sum(axis=1))
        order[at] = order[at][np.argsort(2 * owner + beyond, kind="stable")]
        yield _Nodes(start, parent, error, halved)
        middle, parts = end - upper, np.flatnonzero(halved)
        start, end = (np.stack(pair, axis=1)[parts].ravel() for pair in ((start, middle), (middle, end)))
        parent, bound, known = np.repeat(known + parts, 2), np.repeat(error[parts], 2), known + len(size)
