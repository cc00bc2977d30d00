"""The one module that runs LiteRT models: a network kept open, one thread, equal bytes for equal input."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from storage.errors import ConfigError

MISSING = 'LiteRT cannot be imported ({error}), so BlazePose cannot run; install it with "python -m pip install ai-edge-litert", or set detection.estimator to files or onnx'


class Network:
    """A `.tflite` model with one input; call it with the input, get its outputs in the model's own order."""

    def __init__(self, file: Path) -> None:
        """Open the model; raises ConfigError, with the command that mends it, where LiteRT is not installed."""
        try:
            from ai_edge_litert.interpreter import Interpreter
        except (ImportError, OSError) as e:
            raise ConfigError(MISSING.format(error=e)) from e
        self._interpreter = Interpreter(str(file), num_threads=1)
        self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = [d["index"] for d in sorted(self._interpreter.get_output_details(), key=lambda d: str(d["name"]))]

    def __call__(self, values: np.ndarray) -> list[np.ndarray]:
        """Outputs without their batch axis, for one input [h, w, 3] float32."""
        self._interpreter.set_tensor(self._input, values[None])
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(i)[0] for i in self._outputs]
