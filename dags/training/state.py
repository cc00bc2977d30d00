"""A trainer's state as bytes and back: tensors as safetensors, everything around them as JSON. Equal states give equal
bytes.

No pickle: a checkpoint may come from somebody else. JSON keeps Python's numbers exactly, not-finite ones too.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from posegaussian.storage.model.documents import reader_of

if TYPE_CHECKING:
    import torch


def packed(state: Any) -> bytes:
    """Nested dicts, lists and tuples of tensors, numbers, texts and None as bytes. Raises TypeError naming what is
    none of these."""
    from safetensors.torch import save

    tensors: dict[str, torch.Tensor] = {}
    skeleton = _taken_apart(state, "state", tensors)
    return save(tensors, metadata={"state": json.dumps(skeleton)})


def unpacked(data: bytes) -> Any:
    """What was packed; tensors lie on the CPU. Raises SourceError for what was not."""
    from safetensors.torch import load

    with reader_of("of a checkpoint", "state"):
        length = int.from_bytes(data[:8], "little")  # of the header, by the format's definition
        # whole numbers of random generators are long
        skeleton = json.loads(json.loads(data[8 : 8 + length])["__metadata__"]["state"])
        return _put_together(skeleton, load(data))


def _taken_apart(node: Any, path: str, tensors: dict[str, torch.Tensor]) -> Any:
    import torch

    if isinstance(node, torch.Tensor):
        name = f"{len(tensors):06d}"
        # a copy: tensors may share memory, files must not
        tensors[name] = node.detach().to("cpu", copy=True).contiguous()
        return {"tensor": name}
    if isinstance(node, dict):
        if wrong := [k for k in node if type(k) not in (str, int)]:
            raise TypeError(f"{path} has the key {wrong[0]!r}; keys of a state are texts or whole numbers")
        return {"dict": [[k, _taken_apart(v, f"{path}.{k}", tensors)] for k, v in node.items()]}
    if isinstance(node, list | tuple):
        kind = "tuple" if isinstance(node, tuple) else "list"
        return {kind: [_taken_apart(v, f"{path}.{n}", tensors) for n, v in enumerate(node)]}
    if node is None or type(node) in (bool, int, float, str):
        return node
    raise TypeError(
        f"{path} is a {type(node).__name__}; a state holds tensors, numbers, texts and None in dicts, lists and tuples"
    )


def _put_together(node: Any, tensors: dict[str, torch.Tensor]) -> Any:
    if not isinstance(node, dict):
        return node
    ((kind, value),) = node.items()
    if kind == "tensor":
        return tensors[value]
    if kind == "dict":
        return {k: _put_together(v, tensors) for k, v in value}
    parts = [_put_together(v, tensors) for v in value]
    return tuple(parts) if kind == "tuple" else parts
