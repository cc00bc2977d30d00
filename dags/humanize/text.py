"""How numbers of things and the next command are said, and how much a command says."""

from __future__ import annotations

import shlex
from enum import IntEnum


class Voice(IntEnum):
    """How much a command says besides its results; errors, warnings and failures are always said."""

    QUIET = 0
    """No progress, no estimates, no hints."""
    NORMAL = 1
    """What was decided and how far it is."""
    VERBOSE = 2
    """Every reason, too: of effects that are off, of stages that are not needed."""


def number(count: int, noun: str) -> str:
    """`1 frame`, `3 frames`; `1 CPU worker`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def next_command(*words: str, lead: str = "next") -> str:
    """The last line of a command: what to type next, quoted where a shell wants it."""
    return f"{lead}: {shlex.join(['posegaussian', *words])}"


def gigabytes(count: float) -> str:
    """Bytes for people, in kB to TB."""
    if 0 < abs(count) < 1e5:
        return f"{count / 1e3:.1f} kB"
    if abs(count) < 1e8:
        return f"{count / 1e6:.1f} MB"
    return f"{count / 1e9:.2f} GB" if abs(count) < 1e12 else f"{count / 1e12:.2f} TB"


def seconds_text(seconds: float) -> str:
    """Seconds of work for people."""
    if round(seconds, 1) < 90:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    if round(minutes, 0) < 90:
        return f"{minutes:.1f} min" if round(minutes, 1) < 10 else f"{minutes:.0f} min"
    return f"{minutes / 60:.1f} h"
