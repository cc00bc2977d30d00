"""Tiny ONNX networks written byte by byte, so that no test needs an exporter:
protocol buffers of the few messages used."""

from __future__ import annotations

from pathlib import Path

import numpy as np

FLOAT, INTS = 1, 7


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    body = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(body)) + body


def tensor(name: str, values: np.ndarray) -> bytes:
    return (
        b"".join(field(1, d) for d in values.shape)
        + field(2, FLOAT)
        + field(8, name)
        + field(9, values.astype("<f4").tobytes())
    )


def info(name: str, shape: tuple[int, ...]) -> bytes:
    dims = b"".join(field(1, field(1, d)) for d in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dims)))


def node(op: str, inputs: list[str], output: str, **attributes: list[int] | int) -> bytes:
    body = b"".join(field(1, i) for i in inputs) + field(2, output) + field(3, output) + field(4, op)
    for name, value in attributes.items():
        if isinstance(value, int):
            body += field(5, field(1, name) + field(3, value) + field(20, 2))
        else:
            body += field(5, field(1, name) + b"".join(field(8, v) for v in value) + field(20, INTS))
    return body


def write(
    path: Path,
    nodes: list[bytes],
    weights: dict[str, np.ndarray],
    given: tuple[str, tuple[int, ...]],
    outputs: dict[str, tuple[int, ...]],
) -> None:
    graph = (
        b"".join(field(1, n) for n in nodes)
        + field(2, "tiny")
        + b"".join(field(5, tensor(k, w)) for k, w in weights.items())
    )
    graph += field(11, info(*given)) + b"".join(field(12, info(k, s)) for k, s in outputs.items())
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13)))


def colours_to_joints() -> np.ndarray:
    """[17, 3, 1, 1] weights: joint j sees colour j mod 3."""
    w = np.zeros((17, 3, 1, 1))
    w[np.arange(17), np.arange(17) % 3] = 1
    return w


def heatmap_network(path: Path, width: int, height: int, stride: int) -> None:
    """Every stride-th pixel of a colour is its joints' heatmap."""
    nodes = [node("Conv", ["x", "w"], "maps", kernel_shape=[1, 1], strides=[stride, stride])]
    write(
        path,
        nodes,
        {"w": colours_to_joints()},
        ("x", (1, 3, height, width)),
        {"maps": (1, 17, height // stride, width // stride)},
    )


def simcc_network(path: Path, width: int, height: int) -> None:
    """The largest value of a colour in each column, and in each row."""
    nodes = [
        node("Conv", ["x", "w"], "all", kernel_shape=[1, 1], strides=[1, 1]),
        node("ReduceMax", ["all"], "along_x", axes=[2], keepdims=0),
        node("ReduceMax", ["all"], "along_y", axes=[3], keepdims=0),
    ]
    write(
        path,
        nodes,
        {"w": colours_to_joints()},
        ("x", (1, 3, height, width)),
        {"along_x": (1, 17, width), "along_y": (1, 17, height)},
    )
