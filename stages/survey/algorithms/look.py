"""One measure's look at a view: which frames it asks for, what it takes of each, and what that comes to."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block

NO_FRAMES = np.zeros(0, np.int64)

KEPT_PICTURES = 24
"""Pictures whose features a process keeps for its other views' tasks, some 3 MB each."""


class Look:
    """What every look has; one that needs no pictures makes its blocks alone."""

    numbers: np.ndarray = NO_FRAMES
    """[n] source frame numbers whose pictures it sees, ascending."""
    joints: np.ndarray = NO_FRAMES
    """[n] source frame numbers in which it looks up the view's 2D joints, so that they are estimated in one pass."""
    joints_of_all: np.ndarray = NO_FRAMES
    """[n] source frame numbers in which it looks up the 2D joints of all source views."""

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Take what is needed of one frame: as it was read, uint8 or linear float16 [h, w, 3], and as uint8 sRGB."""

    def blocks(self) -> Iterator[Block]:
        """What came of all frames."""
        raise NotImplementedError
