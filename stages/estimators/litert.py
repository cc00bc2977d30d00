"""The one module that runs LiteRT models: a network kept open, one thread, equal bytes for equal input."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from posegaussian.storage.model.errors import ConfigError

MISSING = (
    'LiteRT cannot be imported ({error}), so BlazePose cannot run; install it with "python -m pip install'
    ' ai-edge-litert", or set detection.estimator to files or onnx'
)


@contextmanager
def _without_log() -> Iterator[None]:
    """Within, nothing reaches standard error: LiteRT writes there, past Python, that it made itself ready.

    What goes wrong it raises as an exception besides.
    """
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class LiteRTNetwork:
    """A `.tflite` model with one input; call it with the input, get its outputs in the model's own order."""

    def __init__(self, file: Path) -> None:
        """Open the model; raises ConfigError, with the command that mends it, where LiteRT is not installed."""
        try:
            from ai_edge_litert.interpreter import Interpreter
        except (ImportError, OSError) as e:
            raise ConfigError(MISSING.format(error=e)) from e
        with _without_log():
            self._interpreter = Interpreter(str(file), num_threads=1)
            self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = [
            d["index"] for d in sorted(self._interpreter.get_output_details(), key=lambda d: str(d["name"]))
        ]

    def __call__(self, values: np.ndarray) -> list[np.ndarray]:
        """Outputs without their batch axis, for one input [h, w, 3] float32."""
        self._interpreter.set_tensor(self._input, values[None])
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(i)[0] for i in self._outputs]
