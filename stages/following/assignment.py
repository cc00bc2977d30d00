"""Whom to give to whom at the least cost.

Shortest augmenting paths with potentials (Jonker and Volgenant, "A shortest augmenting path algorithm for dense and
sparse linear assignment problems", 1987), for the few people of a picture: no library that this package needs has it.
"""

from __future__ import annotations

import numpy as np


def matched(off: np.ndarray, limit: np.ndarray | float) -> list[tuple[int, int]]:
    """Pairs (row, column) of a matrix of distances [n, m], each row and column once at most, none beyond its limit,
    as many as there can be and their sum the least."""
    if not off.size:
        return []
    within = off <= limit
    far = 1.0 + 2.0 * max(off.shape) * float(np.where(within, off, 0.0).max())
    cost = np.where(within, off, far)
    if cost.shape[0] <= cost.shape[1]:
        pairs = list(enumerate(_columns(cost)))
    else:
        pairs = sorted((i, j) for j, i in enumerate(_columns(cost.T)))
    return [(int(i), int(j)) for i, j in pairs if within[i, j]]


def _columns(cost: np.ndarray) -> np.ndarray:
    """[n] the column of each row of a matrix [n, m], n <= m, that makes the sum least; every row gets one."""
    n, m = cost.shape
    of_row, of_column = np.zeros(n + 1), np.zeros(m + 1)
    row_at = np.zeros(m + 1, dtype=np.int64)  # 1-based; 0: free. Column 0 stands for the row that looks for one.
    for row in range(1, n + 1):
        row_at[0], column = row, 0
        least, via = np.full(m + 1, np.inf), np.zeros(m + 1, dtype=np.int64)
        done = np.zeros(m + 1, dtype=bool)
        while True:
            done[column] = True
            here = int(row_at[column])
            reduced = cost[here - 1] - of_row[here] - of_column[1:]
            shorter = ~done[1:] & (reduced < least[1:])
            least[1:][shorter], via[1:][shorter] = reduced[shorter], column
            following = int(np.where(done, np.inf, least).argmin())
            step = least[following]
            of_row[row_at[done]] += step
            of_column[done] -= step
            least[~done] -= step
            column = following
            if row_at[column] == 0:
                break
        while column:
            row_at[column], column = row_at[via[column]], int(via[column])
    out = np.zeros(n, dtype=np.int64)
    for j in np.flatnonzero(row_at[1:]):
        out[row_at[j + 1] - 1] = j
    return out
