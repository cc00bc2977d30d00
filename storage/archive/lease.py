"""Leases: who works on what, since when, until when. The only trace of running work, and never a fact to clean up.

A lease is one small file, created exclusively beside the receipt it is about. It carries a token, is renewed by a
thread of the process that holds it, and ends by itself: after its time, or at once when its holder is provably dead.
Whoever finds an ended lease takes it over; the old holder, should it wake, finds another token and writes nothing more.

Renewals go through the file that was created, not through its name: a holder that lost the name renews a file nobody
sees. What is not closed: a writer that is suspended between `check` and the write that follows it may still finish that
one atomic write.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from posegaussian.storage.files.names import files_below, parse_json, read_file
from posegaussian.storage.files.write import refusals
from posegaussian.storage.model.errors import LeaseHeld, LeaseLost

SUFFIX = ".lease"
"""Ending of a lease's file name."""
LENGTH = 1024
"""Bytes of a lease's own line: fixed, so that a renewal overwrites the old one whole. Last words come after it."""
RENEWALS = 4
"""Renewals in the time of one lease."""
CLAIM_SECONDS = 10.0
"""Age at which the claim to an ended lease was left behind by a contender that died in the moment it takes."""
MOST_BYTES = 2**20
"""Bytes of a lease that is read: last words are a traceback of every thread."""
_TOKEN = re.compile(r"[A-Za-z0-9_\-]{0,64}")
"""A token: files beside the lease are named after it."""
_SEEN: dict[str, tuple[float, float]] = {}
"""{token: (end, time of the monotonic clock at which it was first seen)} of leases from the future."""
SAME_START = 2.0
"""Seconds within which two readings of a process's start are the same process."""


def own_name(command: str) -> str:
    """A name of a run that nobody else has, for a command that takes leases: under an equal one it would take over what
    another process holds."""
    return f"{command}-{uuid.uuid4().hex[:12]}"


@dataclass(frozen=True)
class Holder:
    """What a lease says."""

    token: str
    """Unique to this taking of the lease."""
    run: str
    """Name of the run it belongs to."""
    worker: str
    """Name of the worker."""
    host: str
    """Name of its machine."""
    boot: str
    """Boot of that machine and namespace of its process numbers: a pid means something within them only."""
    pid: int
    """Its process."""
    started: float
    """Seconds from the machine's boot to the start of the process: a pid alone may have been given anew."""
    since: float
    """When it was taken, seconds since the epoch."""
    until: float
    """When it ends unless it is renewed, seconds since the epoch."""
    ended: str = ""
    """What its process said last, when it ended itself in the middle of its work."""
    seconds: float = 0.0
    """How long it holds without renewal; 0 where it does not say."""

    def sentence(self, now: float) -> str:
        """`run R, worker W (process P on host H) since 12:03:11 UTC (for 40 s)`."""
        ahead = self.ahead(now)
        return (
            f"run {self.run}, worker {self.worker} (process {self.pid} on {self.host}) since {_clock(self.since)} (for"
            f" {max(0.0, now - self.since):.0f} s"
            + (f"; its clock is {ahead:.0f} s ahead of this one, or was when it died" if ahead else "")
            + ")"
        )

    def ahead(self, now: float) -> float:
        """Seconds by which the clock it was renewed by is ahead of `now`; 0 for less than it holds, as clocks of
        machines differ."""
        found = self.until - self.seconds - now
        return found if found > self.seconds > 0 else 0.0


def _clock(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


@lru_cache(maxsize=1)
def _boot() -> str:
    """Identity of this boot of the machine and of this namespace of process numbers."""
    try:
        return f"{Path('/proc/sys/kernel/random/boot_id').read_text().strip()} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return f"booted {psutil.boot_time():.0f}"


def _process_start(pid: int) -> float | None:
    """Seconds from boot to the start of a process; None when it is gone or only waits to be collected."""
    booted = psutil.boot_time()  # first: psutil derives create_time from the same reading
    try:
        process = psutil.Process(pid)
        return None if process.status() == psutil.STATUS_ZOMBIE else process.create_time() - booted
    except psutil.Error:
        return None


@lru_cache(maxsize=8)
def _own_start(pid: int) -> float:
    return _process_start(pid) or 0.0


def _stands_still(holder: Holder) -> bool:
    """Whether this process first saw a lease as it is longer ago than it holds: its holder would have renewed it."""
    if _SEEN.get(holder.token, (None, 0.0))[0] != holder.until:
        _SEEN[holder.token] = (holder.until, time.monotonic())
    return time.monotonic() - _SEEN[holder.token][1] > holder.seconds


def ended(holder: Holder, now: float) -> bool:
    """Whether a lease may be taken over: given up, past its time, or its holder provably dead. One from the future, as
    a clock that was set back leaves it, has ended when it is not renewed while somebody waits for it."""
    if holder.ended or holder.until < now:
        return True
    if (holder.host, holder.boot) != (socket.gethostname(), _boot()):
        return holder.ahead(now) > 0 and _stands_still(holder)
    start = _process_start(holder.pid)
    return start is None or abs(start - holder.started) > SAME_START


def read_lease(file: Path, seconds: float) -> Holder | None:
    """What a lease file says; None when there is none. One that is just being written counts as taken for `seconds`.

    Raises Unsafe for a link or what is no file in its place.
    """
    try:
        text = read_file(file, MOST_BYTES)
        changed = file.stat().st_mtime
    except FileNotFoundError:
        return None
    line, _, last_words = text.partition(b"\n")
    try:
        holder = _holder(parse_json(line))
    except (ValueError, TypeError):
        return Holder("", "unknown", "unknown", "unknown", "", 0, 0.0, changed, changed + seconds)
    return replace(holder, ended=last_words.decode(errors="replace")) if last_words else holder


def _holder(said: dict[str, Any]) -> Holder:
    """The holder that a lease names. Raises TypeError and ValueError for what no lease says."""
    holder = Holder(**said)
    texts = (holder.token, holder.run, holder.worker, holder.host, holder.boot, holder.ended)
    numbers = (holder.pid, holder.started, holder.since, holder.until, holder.seconds)
    if not all(isinstance(t, str) for t in texts) or not all(
        type(n) in (int, float) and -1e9 < n < 2.5e11 for n in numbers
    ):
        raise TypeError("entries of a lease are texts and times")
    if _TOKEN.fullmatch(holder.token) is None or type(holder.pid) is not int or not 0 <= holder.pid < 2**31:
        raise ValueError("a lease has a token and a process")
    return holder


def _create(file: Path, holder: Holder) -> int:
    """A handle on a new lease that has its content from the first moment. Raises FileExistsError.

    Killed between making the name and writing, a process would leave a lease that nobody knows the holder of. Only
    where the file system has no hard links does the name come first.
    """
    written = file.with_name(f".{file.name}.{holder.token}.partial")
    handle = os.open(written, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
    try:
        os.pwrite(handle, _text(holder), 0)
        try:
            os.link(written, file)
        except FileExistsError:
            raise
        except OSError as e:
            if e.errno not in (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EMLINK):
                raise
            first = os.open(file, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o644)
            os.close(handle)
            handle = first
    except BaseException:
        os.close(handle)
        raise
    finally:
        written.unlink(missing_ok=True)
    return handle


def _text(holder: Holder) -> bytes:
    return json.dumps(asdict(holder)).encode().ljust(LENGTH - 1) + b"\n"


def _displace(file: Path, token: str, meant: Callable[[Holder], bool]) -> None:
    """Remove the lease of a token, if it is still the one that is meant.

    Of several contenders for one token a claim of its name lets one through: a contender that read the old lease and
    was slow would otherwise remove the new one.
    """
    claim = file.with_name(f".{file.name}.{token}.partial")
    try:
        os.close(os.open(claim, os.O_CREAT | os.O_EXCL, 0o644))
    except FileExistsError:
        try:
            left_behind = time.time() - claim.stat().st_mtime > CLAIM_SECONDS
        except FileNotFoundError:
            return
        if not left_behind:
            time.sleep(0.001)
            return
    try:
        _remove(file, meant)
    finally:
        claim.unlink(missing_ok=True)


def _remove(file: Path, meant: Callable[[Holder], bool]) -> None:
    """Remove a lease that is meant; what came in its place between reading and removing is put back."""
    holder = read_lease(file, 0.0)
    if holder is None or not meant(holder):
        return
    grave = file.with_name(f".{file.name}.{uuid.uuid4().hex}.partial")
    try:
        os.rename(file, grave)
    except FileNotFoundError:
        return
    holder = read_lease(grave, 0.0)
    if holder is None or meant(holder):
        grave.unlink(missing_ok=True)
    else:
        os.replace(grave, file)


def remove_ended(file: Path, holder: Holder) -> None:
    """Remove a lease that this process found to have ended: another one, which is to take it, may know less of it."""
    with contextlib.suppress(OSError):  # whoever takes it says what the disk does not allow
        _displace(file, holder.token, lambda h: h.token == holder.token and ended(h, time.time()))


class Lease:
    """The right to write one task's output, or to change one sequence's arrays."""

    def __init__(self, file: Path, holder: Holder, handle: int, seconds: float, clock: Callable[[], float]) -> None:
        """Use `take`."""
        self.file, self.holder = file, holder
        self._handle, self._seconds, self._clock = handle, seconds, clock
        self._until = holder.until
        self._guard = threading.Lock()

    @classmethod
    def take(
        cls, file: Path, run: str, worker: str = "main", seconds: float = 60.0, clock: Callable[[], float] = time.time
    ) -> Lease:
        """Take a lease, or take over one that has ended or that this very run left behind. Raises LeaseHeld, and
        NotWritten.

        Args:
            file: where it lies.
            run: name of the run, or `own_name`; a run hands out a task once at a time, so its own lease is one of a
                worker it lost.
            worker: name of the worker.
            seconds: how long it holds without renewal.
            clock: seconds since the epoch.
        """
        with refusals(file, LENGTH):
            file.parent.mkdir(parents=True, exist_ok=True)
            return cls._take(file, run, worker, seconds, clock)

    @classmethod
    def _take(cls, file: Path, run: str, worker: str, seconds: float, clock: Callable[[], float]) -> Lease:
        while True:
            now = clock()
            holder = Holder(
                uuid.uuid4().hex,
                run,
                worker,
                socket.gethostname(),
                _boot(),
                os.getpid(),
                _own_start(os.getpid()),
                now,
                now + seconds,
                seconds=seconds,
            )
            try:
                handle = _create(file, holder)
            except FileExistsError:
                old = read_lease(file, seconds)
                if old is not None and not cls._free(old, run, now):
                    raise LeaseHeld(f"{file.name} is held by {old.sentence(now)}", old) from None
                if old is not None:
                    _displace(file, old.token, partial(cls._still_free, token=old.token, run=run, clock=clock))
                continue
            lease = cls(file, holder, handle, seconds, clock)
            lease._write(holder)
            _KEEPER.add(lease)
            return lease

    @staticmethod
    def _free(holder: Holder, run: str, now: float) -> bool:
        return holder.run == run or ended(holder, now)

    @classmethod
    def _still_free(cls, holder: Holder, token: str, run: str, clock: Callable[[], float]) -> bool:
        return holder.token == token and cls._free(holder, run, clock())

    def _write(self, holder: Holder) -> None:
        os.pwrite(self._handle, _text(holder), 0)
        self.holder, self._until = holder, holder.until

    @property
    def pause(self) -> float:
        """Seconds between two renewals."""
        return self._seconds / RENEWALS

    def renew(self) -> None:
        """Move the end; without effect on anybody when the lease was taken over."""
        with self._guard:
            if self._handle >= 0:
                self._write(Holder(**{**asdict(self.holder), "until": self._clock() + self._seconds}))

    def last_words(self) -> int:
        """Handle on the place after the lease's line, valid until it is dropped: text that is written there ends the
        lease.

        It is for a process that ends itself and can run no Python any more.
        """
        with self._guard:
            os.lseek(self._handle, 0, os.SEEK_END)
            return self._handle

    def check(self) -> None:
        """Raise LeaseLost unless this lease is still ours: to be called before every write."""
        if self._clock() > self._until:
            self.renew()  # nobody may have come in the meantime; whoever did has removed the name, which is read next
        now = read_lease(self.file, self._seconds)
        if now is None or now.token != self.holder.token:
            by = "and is gone" if now is None else f"and was taken over by {now.sentence(self._clock())}"
            raise LeaseLost(
                f"the lease {self.file.name} of this writer ended {by}; it was suspended or cut off, so it stops and"
                " writes nothing more"
            )

    def drop(self) -> None:
        """Give the lease back; what another one took over is left alone."""
        _KEEPER.remove(self)
        with self._guard:
            if self._handle >= 0:
                os.close(self._handle)
                self._handle = -1
                with contextlib.suppress(OSError):  # a disk that became read-only: the lease then ends by itself
                    _remove(self.file, lambda h: h.token == self.holder.token)

    def __enter__(self) -> Lease:
        """The lease; it is dropped at the end, whatever happens."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.drop()


class _Keeper:
    """One thread a process, which renews every lease the process holds."""

    def __init__(self) -> None:
        self._held: set[Lease] = set()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._next = float("inf")
        """When the thread looks again."""

    def add(self, lease: Lease) -> None:
        with self._changed:
            self._held.add(lease)
            if self._thread is None or not self._thread.is_alive():
                self._thread = threading.Thread(target=self._keep, name="lease-keeper", daemon=True)
                self._thread.start()
            if time.monotonic() + lease.pause < self._next:
                self._changed.notify()

    def remove(self, lease: Lease) -> None:
        with self._changed:
            self._held.discard(lease)

    def _keep(self) -> None:
        due: dict[Lease, float] = {}
        while True:
            with self._changed:
                now = time.monotonic()
                due = {lease: due.get(lease, now + lease.pause) for lease in self._held}
                self._next = min(due.values(), default=float("inf"))
                self._changed.wait(max(0.0, self._next - now) if due else None)
                ready = [lease for lease in due if lease in self._held and due[lease] <= time.monotonic()]
            for lease in ready:
                try:
                    lease.renew()
                except OSError:
                    continue  # the lease then ends by itself, and the next check says whether anybody took it
                finally:
                    due[lease] = time.monotonic() + lease.pause


_KEEPER = _Keeper()


def wait_for(file: Path, run: str, seconds: float, patience: float, pause: float = 0.05) -> Lease:
    """Take a lease that others hold for moments only.
    Raises LeaseHeld when it is not free within `patience` seconds."""
    end = time.monotonic() + patience
    while True:
        try:
            return Lease.take(file, run, seconds=seconds)
        except LeaseHeld:
            if time.monotonic() > end:
                raise
            time.sleep(pause)


def living(folder: Path, seconds: float = 60.0) -> Iterator[tuple[Path, Holder]]:
    """All leases below a folder that have not ended."""
    for file in (Path(f) for f in files_below(folder) if f.endswith(SUFFIX)):
        holder = read_lease(file, seconds)
        if holder is not None and not ended(holder, time.time()):
            yield file, holder
