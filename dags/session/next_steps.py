"""The next useful command, where it depends on what a command found."""

from __future__ import annotations

from collections.abc import Iterable

from posegaussian.dags.diagnostics.status import Numbers
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.session.session import Session
from posegaussian.storage.model.capture import Capture


def first_look_command(session: Session, name: str, capture: Capture, lead: str) -> list[str]:
    """The line with a page of few and small frames; none where the capture, or what the user set, is small already."""
    from posegaussian.dags.config.first_look import first_look

    words = first_look(capture, session.configuration.for_sequence(name).frames)
    if not words:
        return []
    return [next_command("export", name, "--page", f"{name}.html", *session.options, *words, lead=lead)]


def after_export(session: Session, name: str, path: str | None, paged: bool, rendered: bool) -> str:
    """What else shows the sequence: the page that plays it, else pictures of a camera path, else the report."""
    words = ["export", name, *session.options, *(("--path", path) if path is not None else ())]
    if not paged:
        return next_command(*words, "--page", f"{name}.html")
    if not rendered:
        return next_command(*words, "--video", f"{name}.mp4", "--sheet", f"{name}.png")
    return next_command("report", *session.options, "--page", "report.html")


def after_status(session: Session, found: Iterable[Numbers]) -> str:
    """What failed first, then what is not done, then the page of it all."""
    counted = [stage for numbers in found for stage in numbers.values()]
    if any(stage.get("failed") for stage in counted):
        return next_command("status", *session.options, "--failed")
    if any(stage.get("done", 0) < stage.get("all", 0) for stage in counted):
        return next_command("run", *session.options)
    return next_command("report", *session.options, "--page", "report.html")
