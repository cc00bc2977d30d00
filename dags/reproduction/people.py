"""Whom a table of the paper is measured on: sequences of its data sets in the archive, and simulated people always."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from posegaussian.dags.ablation.groups import SimulatedFootage
from posegaussian.dags.config.settings import validate
from posegaussian.dags.config.yaml_source import Document
from posegaussian.dags.evaluation.evaluate import evaluate
from posegaussian.dags.evaluation.methods import Method
from posegaussian.dags.evaluation.results import SIMULATED, Result, data_set
from posegaussian.dags.planning.context import Context
from posegaussian.dags.runtime.signals import STATUS as INTERRUPTED
from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.simulate import film_scene
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ArchiveError, UserError

FILMED = "simulated"
"""Archive of the simulated people that are filmed for the tables, in the output's folder."""
SEEDS = (0, 1)
"""Simulated people that are filmed where the archive has none."""
ITS_OWN: dict[str, Any] = {"views": {"sources": None, "held_out": None}, "frames": {"range": "::"}}
"""Settings of what is filmed, laid over the user's, which name cameras and frames of other sequences."""


@dataclass(frozen=True)
class Wanted:
    """Simulated people that a column of a table takes."""

    name: str
    """Of those that are filmed, before their seed."""
    footage: SimulatedFootage
    cameras: int | None = None
    """Source cameras; None: any number, and as many as the footage has where they are filmed."""
    frames: int = 1
    """At least."""


@dataclass(frozen=True)
class Subject:
    """One sequence with held-out cameras."""

    session: Session
    name: str
    data_set: str
    cameras: int
    """Source cameras."""
    frames: int

    def suits(self, wanted: Wanted) -> bool:
        """Whether a column takes it."""
        return self.frames >= wanted.frames and wanted.cameras in (None, self.cameras)


@dataclass(frozen=True)
class Measured:
    """What methods came to on subjects."""

    results: list[tuple[Subject, Result]]
    protocols: list[str]
    status: int
    """As of `evaluate`; where it was interrupted there are no results."""

    def of(self, data_set: str, cameras: int | None = None) -> list[Result]:
        """On one data set, of so many source cameras where it is said."""
        return [r for s, r in self.results if s.data_set == data_set and cameras in (None, s.cameras)]


def in_archive(
    session: Session, globs: Sequence[str], sets: Sequence[str], frames: int = 1
) -> tuple[list[Subject], list[str]]:
    """Sequences with held-out cameras, of the data sets that are named and at least so many frames; and a sentence for
    each that cannot be read. An archive that is not there has none, unless globs ask for some of it: raises
    ArchiveError."""
    try:
        names = session.names(globs)
    except ArchiveError:
        if globs:
            raise
        return [], []
    found, refused = [], []
    for name in names:
        try:
            found.append(subject(session, name))
        except UserError as e:
            refused.append(f"{name}: {e}")
    return [s for s in found if s is not None and s.data_set in sets and s.frames >= frames], refused


def subject(session: Session, name: str) -> Subject | None:
    """A sequence under its settings; None without held-out cameras."""
    c = Context(session.archive.sequence(name), session.configuration.for_sequence(name), ())
    return Subject(session, name, data_set(c.capture), len(c.views.sources), c.grid.frames) if c.held_out else None


def simulated(session: Session, known: Sequence[Subject], wanted: Sequence[Wanted], output: Path) -> list[Subject]:
    """For every column the simulated people among the known; where it takes none of them, those that are filmed for it,
    once, into an archive below `output`."""
    of_archive = [s for s in known if s.data_set == SIMULATED]
    found = [s for s in of_archive if any(s.suits(w) for w in wanted)]
    everywhere = {**ITS_OWN, "sequences": dict.fromkeys(session.configuration.overrides, ITS_OWN)}
    configuration = validate((*session.configuration.layers, Document("simulated people", everywhere)))
    own = replace(session, archive_url=str(output / FILMED), configuration=configuration)
    for w in wanted:
        if not any(s.suits(w) for s in of_archive):
            found += [_filmed(own, w, seed) for seed in SEEDS]
    return found


def _filmed(session: Session, wanted: Wanted, seed: int) -> Subject:
    name = f"{wanted.name}-{seed}"
    archive = Archive.open(session.archive_url, create=True)
    if name not in archive.names():
        scene = wanted.footage.scene(seed, wanted.cameras)
        film_scene(session, scene, Path(), name, f"simulated people of {wanted.name}", session.console)
    made = subject(session, name)
    assert made is not None, f"{name} was filmed without held-out cameras"
    return made


def measured(subjects: Sequence[Subject], methods: Sequence[Method]) -> Measured:
    """Every method on every subject, in the protocol of `evaluate`. Raises ConfigError for settings that cannot be."""
    results: list[tuple[Subject, Result]] = []
    protocols, status = [], 0
    for url in dict.fromkeys(s.session.archive_url for s in subjects):
        own = [s for s in subjects if s.session.archive_url == url]
        made = evaluate(own[0].session, [s.name for s in own], methods)
        if made.status == INTERRUPTED:
            return Measured([], [], made.status)
        status = max(status, made.status)
        protocols += [made.protocol] if made.protocol else []
        each = made.results[: len(own) * len(methods)]
        results += [(own[i // len(methods)], r) for i, r in enumerate(each)]
    return Measured(results, protocols, status)
