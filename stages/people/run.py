"""The people kernel.

Following needs the whole sequence, and its one output changes with every frame that is added. What is cut from it does
so only where somebody turns out to be somebody else, so that the stages behind it stay fresh.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.people.params import PeopleParams


def run(inputs: Inputs, params: PeopleParams) -> Iterator[Block]:
    """Yield people/number view by view."""
    own = inputs.partition
    numbers = np.asarray(inputs.read("tracks/people"))[own.start : own.stop]
    for v in range(len(inputs.rig)):
        yield Block("people/number", np.ascontiguousarray(numbers[:, v]), v)
