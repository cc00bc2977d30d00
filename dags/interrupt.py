"""Ctrl-C: the first one ends the run in order, the second one ends the process."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STATUS = 130
"""Exit status of an interrupted run."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def interruptible(say: Callable[[str], None], kill: Callable[[], None]) -> Iterator[None]:
    """Within, the first Ctrl-C (or SIGTERM) raises KeyboardInterrupt in the main thread, and the second ends everything.

    A thread listens as well: Python runs signal handlers between two steps of the main thread only, and a kernel may spend
    long in one C call. Outside of the main thread nothing is changed.

    Args:
        say: takes the sentence shown at the first one.
        kill: ends what would outlive this process, at the second one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    raised = False

    def first(number: int, frame: Any) -> None:
        nonlocal raised
        if not raised:
            raised = True
            raise KeyboardInterrupt

    handlers = {s: signal.signal(s, first) for s in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(reader, say, kill), name="ctrl-c", daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup)
        for s, handler in handlers.items():
            signal.signal(s, handler)
        writer.close()  # ends the thread


def _listen(reader: socket.socket, say: Callable[[str], None], kill: Callable[[], None]) -> None:
    count = 0
    with reader:
        while received := reader.recv(64):
            for number in received:
                if number not in SIGNALS:
                    continue
                count += 1
                if count == 1:
                    say("stopping; what is finished is kept. Ctrl-C once more ends at once")
                else:
                    kill()
                    os._exit(STATUS)
