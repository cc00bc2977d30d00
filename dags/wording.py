"""How numbers of things are said."""

from __future__ import annotations


def number(count: int, noun: str) -> str:
    """`1 frame`, `3 frames`; `1 CPU worker`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
