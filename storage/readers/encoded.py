"""JPEG and PNG pictures in memory, as they lie in HDF5 files."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.plausible import check_picture

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_ALONE = {0x01, *range(0xD0, 0xD9)}
"""Markers of a JPEG without a length."""
_FRAMES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of a JPEG's frame header (ITU-T T.81, table B.1)."""


def is_jpeg(raw: bytes) -> bool:
    """Whether bytes begin as a JPEG does."""
    return raw.startswith(_JPEG)


def encoded_size(raw: bytes, where: str) -> tuple[int, int]:
    """(width, height) px that the header says; nothing is decoded. Raises SourceError for what is neither JPEG nor PNG,
    and for more px than are read."""
    if raw.startswith(_PNG) and len(raw) >= 24:
        size = int.from_bytes(raw[16:20], "big"), int.from_bytes(raw[20:24], "big")
    elif is_jpeg(raw):
        size = _jpeg_size(raw)
    else:
        size = (0, 0)
    if size == (0, 0):
        raise SourceError(f"cannot read {where}: its {len(raw)} bytes are no whole JPEG or PNG")
    check_picture(where, *size)
    return size


def _jpeg_size(raw: bytes) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(raw) and raw[at] == 0xFF:
        marker = raw[at + 1]
        if marker == 0xFF or marker in _ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        if marker in _FRAMES:
            return int.from_bytes(raw[at + 7 : at + 9], "big"), int.from_bytes(raw[at + 5 : at + 7], "big")
        at += 2 + int.from_bytes(raw[at + 2 : at + 4], "big")
    return 0, 0


def decode(raw: bytes, where: str) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of a JPEG or PNG; its orientation tag is not looked at. Raises SourceError."""
    import cv2

    encoded_size(raw, where)
    try:
        found = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as e:
        raise SourceError(f"cannot read {where}: {' '.join(str(e).split())[:200]}") from e
    if found is None:
        raise SourceError(f"cannot read {where}: it is damaged or cut off")
    return np.ascontiguousarray(found[..., ::-1])
