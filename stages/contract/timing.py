"""What kernels of several modules are given beside `posegaussian.stages.contract.io.Inputs`: somebody who takes their
times.

Apart from the other inputs, so that taking times is no part of any stage's code digest.
"""

from __future__ import annotations

from abc import abstractmethod
from contextlib import AbstractContextManager

from posegaussian.stages.contract.io import Inputs


class TimedInputs(Inputs):
    """Inputs of a kernel that says what its modules take."""

    @abstractmethod
    def timed(self, module: str) -> AbstractContextManager[None]:
        """Wall time within counts for a module of the kernel, by name; where modules are nested, for the innermost
        alone.

        For the kernel's own thread, around work and never around a `yield`. Times go beside the result, never into it.
        """
