"""Ctrl-C and SIGTERM: the first one ends the run in order, the second one ends the process."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STATUS = 130
"""Exit status of an interrupted run."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)

AGAIN_S = 0.02
"""Seconds after which an interrupt that was lost is raised again: by then the callback that lost it is over."""
SAID_S = 2.0
"""Seconds at most that the end of a run waits for the sentence to be said."""


def sigterm_as_ctrl_c() -> None:
    """From now on SIGTERM raises KeyboardInterrupt in the main thread, as Ctrl-C does: by itself it ends a process with
    a file half written.

    Processes that this one starts have the system's own way with it, as before: a handler does not outlive `exec`.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def deaf() -> Iterator[None]:
    """A process that is started within, or by a thread that is, never hears Ctrl-C: a terminal sends it there, too, and
    the run alone decides what it means."""
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # it is started with the first process otherwise, and lets signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def interruptible(
    say: Callable[[str], None], kill: Callable[[], None], stop: Callable[[], None] | None = None
) -> Iterator[None]:
    """Within, the first Ctrl-C (or SIGTERM) raises KeyboardInterrupt in the main thread, and the second ends
    everything.

    A thread listens as well: Python runs signal handlers between two steps of the main thread only, and a kernel may
    spend long in one C call. Outside of the main thread nothing is changed.

    Args:
        say: takes the sentence shown at the first one.
        kill: ends what would outlive this process, at the second one.
        stop: called at the first one instead of raising, for work that must not be torn apart and looks by itself
            whether to end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    first = _First(stop)
    handlers = {s: signal.signal(s, first.handle) for s in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    unraisable, sys.unraisablehook = sys.unraisablehook, first.again_if_lost
    listener = threading.Thread(target=_listen, args=(reader, first, say, kill), name="ctrl-c", daemon=True)
    listener.start()
    try:
        yield
    finally:
        sys.unraisablehook = unraisable
        signal.set_wakeup_fd(wakeup)
        for s, handler in handlers.items():
            signal.signal(s, handler)
        writer.close()  # ends the thread, when it has said what there is to say
        listener.join(SAID_S)


class _First:
    """The first Ctrl-C: raised once where the run can hear it.

    Python drops an exception raised in a destructor or in a callback of the garbage collector, wherever a signal
    happens to find the main thread; it tells `sys.unraisablehook` so, and then the interrupt is raised again.
    """

    def __init__(self, stop: Callable[[], None] | None) -> None:
        self.stop = stop
        self.raised = False
        self.repeats = 0
        """Signals on their way that nobody pressed a key for."""
        self.hook = sys.unraisablehook

    def handle(self, number: int, frame: Any) -> None:
        if not self.raised:
            self.raised = True
            if self.stop is None:
                raise KeyboardInterrupt
            self.stop()

    def again_if_lost(self, unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            self.hook(unraisable)
            return
        self.raised = False
        self.repeats += 1
        again = threading.Timer(AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()


def _listen(reader: socket.socket, first: _First, say: Callable[[str], None], kill: Callable[[], None]) -> None:
    count = 0
    with reader:
        while received := reader.recv(64):
            for number in received:
                if number not in SIGNALS:
                    continue
                if first.repeats:
                    first.repeats -= 1
                    continue
                count += 1
                if count == 1:
                    say("stopping; what is finished is kept. Ctrl-C once more ends at once")
                else:
                    kill()
                    os._exit(STATUS)
