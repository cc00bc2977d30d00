"""What kernels are given beside `posegaussian.stages.contract.io.Inputs` that look at pictures along a camera path
before or after the partition: the path there.

Apart from the other inputs, so that it is part of the code digest of these stages alone.
"""

from __future__ import annotations

from abc import abstractmethod

from posegaussian.stages.contract.io import Inputs
from posegaussian.storage.model.cameras import CameraPath


class PathInputs(Inputs):
    """Inputs of a kernel that reads what lies along its path with a halo."""

    @abstractmethod
    def path_over(self, array: str) -> CameraPath:
        """The target cameras of the frames `span(array)`, of an array along the task's path (`{path}` in its name)."""
