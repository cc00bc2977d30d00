"""One HTML file out of a description, coded frames and small pictures; whatever names it holds, it stays one document.

Everything that comes from a capture is data: JSON and base64 in script elements that no browser runs, with `<` written
as an escape, so that no name can end its element. The policy in the document's head forbids every request.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from posegaussian.storage.exporters.page.maps import CodedView
from posegaussian.storage.files.write import whole_file

HERE = Path(__file__).parent
SCRIPTS = ("cameras.js", "renderer.js", "sequence.js", "movement.js", "controls.js", "player.js")
"""What the page runs, in this order."""
LIVE = "live.js"
"""What a page that is served runs besides."""
WORKER = ("decode.js", "sorter.js")
"""What its worker runs."""
SHADERS = ("splat.vert", "splat.frag")


Frames: TypeAlias = Iterable[tuple[Sequence[CodedView], Sequence[bytes]]]
"""Of every frame the coded source views, and a small picture of each (WebP), empty for none."""


def write_page(file: str | Path, title: str, frames: Frames, head: Callable[[], Mapping[str, Any]]) -> int:
    """Write a page and return its size in bytes.

    Args:
        file: where to.
        title: of the document.
        frames: taken one after the other, so that a page is never in memory as a whole.
        head: asked for when all frames are written: what `player.js` reads, numbers and text as JSON has them.

    Raises:
        NotWritten: when the disk does not take it.
    """
    size = 0
    with whole_file(file) as partial, open(partial, "wb") as out:
        for part in _parts(title, frames, head):
            size += out.write(part.encode())
    return size


def _parts(title: str, frames: Frames, head: Callable[[], Mapping[str, Any]], live: bool = False) -> Iterable[str]:
    before, after = _asset("page.html").split("<!-- data -->")
    before = before.replace("/* ASKED */", "'self'" if live else "'none'")
    yield before.replace("<!-- STYLE -->", _asset("page.css")).replace("<!-- TITLE -->", html.escape(title))
    for name in SHADERS:
        yield _data(name.replace(".", "-"), _asset(name))
    yield _data("worker", "".join(map(_asset, WORKER)))
    for number, (views, pictures) in enumerate(frames):
        coded, small = frame_texts(views, pictures)
        yield _data(f"frame-{number}", coded)
        yield _data(f"pictures-{number}", small)
    yield _data("head", _json(head()))
    yield f'<script>\n"use strict";\n{"".join(map(_asset, (*SCRIPTS, LIVE) if live else SCRIPTS))}</script>\n'
    yield after


def frame_texts(views: Sequence[CodedView], pictures: Sequence[bytes]) -> tuple[str, str]:
    """One frame and its small pictures as the player reads them: base64, that of pictures with commas between."""
    return base64.b64encode(packed(views)).decode(), ",".join(base64.b64encode(p).decode() for p in pictures)


def live_page(title: str, head: Mapping[str, Any]) -> str:
    """The same page without frames: it asks the server it came from, and nobody else, for those that are there.

    `live.js` says what it asks for; `head` holds `version` besides, which changes with everything else in it.
    """
    return "".join(_parts(title, (), lambda: head, live=True))


def packed(views: Sequence[CodedView]) -> bytes:
    """A frame: heads of all views, then their presence, then plane by plane what differs, as one zlib stream.

    Every plane starts a block of its own, because each has its own frequent numbers. Nothing but runs is looked for:
    differences repeat by chance alone, and looking for more costs 7 %.
    """
    pieces = [b"".join(v.head for v in views), b"".join(v.present for v in views)]
    pieces += [b"".join(of_views) for of_views in zip(*(v.planes for v in views), strict=True)]
    stream = zlib.compressobj(9, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    out = []
    for piece in pieces:
        out += [stream.compress(piece), stream.flush(zlib.Z_SYNC_FLUSH)]
    return b"".join([*out, stream.flush()])


def _json(value: Mapping[str, Any]) -> str:
    """JSON that no HTML parser finds a tag in. Raises ValueError for a number that is not finite."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _data(name: str, text: str) -> str:
    """An element that holds text without running it."""
    return f'<script type="text/plain" id="{name}">{text}</script>\n'


def _asset(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")
