"""What runs in a Dask worker: it says who it is, and executes one task after another."""

from __future__ import annotations

import os
import pickle
import socket
from dataclasses import dataclass
from pathlib import Path

from posegaussian.dags.provenance import builds
from posegaussian.dags.runtime.worker import execute
from posegaussian.storage.model.errors import OtherCode


@dataclass(frozen=True)
class Introduction:
    """What a worker says of itself."""

    host: str
    """Name of its machine."""
    pid: int
    """Its process."""
    sees: bool
    """Whether the archive is there."""
    digest: str
    """Of its code and libraries."""
    versions: dict[str, str]
    """Its code and libraries by name."""


def introduce(archive: str | None) -> Introduction:
    """Asked of a worker before it is given anything. Raises OtherCode when files it may have imported were edited
    since."""
    own = builds.here()
    return Introduction(
        socket.gethostname(), os.getpid(), archive is None or Path(archive).is_dir(), own.digest, own.versions
    )


def execute_packed(wanted: str, order: bytes) -> bytes:
    """`execute` between pickles: as one piece of bytes an order is a message of one part; as an object Dask would send
    each of its arrays as a part of its own.

    Nothing is unpacked before the worker has compared its code and libraries with the run's. Raises OtherCode.
    """
    from distributed import get_worker

    worker = get_worker().address
    builds.refuse_other(wanted, worker)
    try:
        return pickle.dumps(execute(pickle.loads(order)))
    except OtherCode as e:
        raise OtherCode(str(e), worker) from None
