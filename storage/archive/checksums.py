"""Checksums of what is kept as text: the record of a sequence, the descriptions of its arrays, receipts.

They are against accidents: a changed digit is noticed before anything is computed from it. What was written before
there were checksums has none and is accepted; whatever writes it next adds one, and so does `verify --repair`.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Any

from posegaussian.storage.model.spec import ENCODER

KEY = "checksum"
"""Where a checksum stands in what it is of."""

_LAST = re.compile(rb', "checksum": "([0-9a-f]{32})"\}\Z')


def checksum(content: Mapping[str, Any]) -> str:
    """BLAKE2b-128 over JSON types, whatever their order, but without the checksum among them."""
    # names of files may be no text
    return _hash(ENCODER.encode({k: v for k, v in content.items() if k != KEY}).encode(errors="surrogatepass"))


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content with its checksum."""
    return {**content, KEY: checksum(content)}


def changed(content: Mapping[str, Any]) -> bool:
    """Whether content has a checksum and is not what it was taken of."""
    return KEY in content and content[KEY] != checksum(content)


def sealed_text(text: bytes) -> bytes:
    """A JSON object's text with the checksum of the text as its last entry: ten thousand are read in a moment."""
    return text[:-1] + f', "{KEY}": "{_hash(text)}"}}'.encode()


def text_changed(text: bytes) -> bool:
    """Whether the text of a JSON object that has a checksum is not what it was taken of."""
    last = _LAST.search(text)
    return last is None or _hash(text[: last.start()] + b"}").encode() != last[1]


def _hash(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()
