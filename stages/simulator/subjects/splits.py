"""Who may be filmed in which scene: some subjects, outfits and a motion are kept from whatever is tuned or trained.

| seeds | for | subjects, outfits | motions |
| --- | --- | --- | --- |
| 0-7999 | tuning, training, demos | the open ones | all but the one for validation |
| 8000-8999 | validation | one more subject, the open outfits | all |
| from 9000 on | measuring, once | four kept of each | all but the one for validation |
"""

from __future__ import annotations

from dataclasses import dataclass

from posegaussian.stages.simulator.subjects.motion_names import MOTION_NAMES, VALIDATION_MOTION
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS

KEPT_SUBJECTS = ("emil", "fatima", "gao", "hana")
KEPT_OUTFITS = ("grey", "dots", "floral", "camouflage")
VALIDATION_SUBJECT = "ines"
FIRST_VALIDATION_SEED, FIRST_KEPT_SEED = 8000, 9000
OPEN_SUBJECTS = tuple(n for n in LOOKS if n not in (*KEPT_SUBJECTS, VALIDATION_SUBJECT))
OPEN_OUTFITS = tuple(n for n in OUTFITS if n not in KEPT_OUTFITS)


@dataclass(frozen=True)
class Casting:
    """What `auto` may choose."""

    subjects: tuple[str, ...]
    outfits: tuple[str, ...]
    motions: tuple[str, ...]


_OPEN_MOTIONS = tuple(n for n in MOTION_NAMES if n != VALIDATION_MOTION)


def casting(seed: int) -> Casting:
    """Who and what a scene of this seed chooses from."""
    if seed >= FIRST_KEPT_SEED:
        return Casting(KEPT_SUBJECTS, KEPT_OUTFITS, _OPEN_MOTIONS)
    if seed >= FIRST_VALIDATION_SEED:
        return Casting((VALIDATION_SUBJECT,), OPEN_OUTFITS, MOTION_NAMES)
    return Casting(OPEN_SUBJECTS, OPEN_OUTFITS, _OPEN_MOTIONS)


def cast(seed: int, person: str = "auto", outfit: str = "auto") -> tuple[str, str]:
    """(subject, outfit) of a scene; `auto` follows from the seed so that 16 seeds in a row show every pair."""
    allowed = casting(seed)
    n, m = len(allowed.subjects), len(allowed.outfits)
    return (allowed.subjects[seed % n] if person == "auto" else person), (
        allowed.outfits[(seed + seed // 4) % m] if outfit == "auto" else outfit
    )


def refusal(seed: int, name: str) -> str | None:
    """Why a scene of this seed may not show a subject, an outfit or a motion; None where it may.

    What is open may be named in any scene; what is kept only where it is kept for.
    """
    allowed = casting(seed)
    if name in (*KEPT_SUBJECTS, *KEPT_OUTFITS) and name not in (*allowed.subjects, *allowed.outfits):
        return (
            f"{name} is kept for measuring and appears only in scenes with a seed from {FIRST_KEPT_SEED} on;"
            f" this seed is {seed}"
        )
    if name in (VALIDATION_SUBJECT, VALIDATION_MOTION) and name not in (*allowed.subjects, *allowed.motions):
        return (
            f"{name} is kept for validation and appears only in scenes with a seed of {FIRST_VALIDATION_SEED} to"
            f" {FIRST_KEPT_SEED - 1}; this seed is {seed}"
        )
    return None
