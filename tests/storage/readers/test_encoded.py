"""Pictures in memory: sizes by the header, and what is no picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.encoded import decode, encoded_size


@pytest.mark.parametrize("kind", [".png", ".jpg"])
@pytest.mark.parametrize("size", [(1, 1), (7, 300), (640, 33)])
def test_the_header_says_the_size_that_is_decoded(kind: str, size: tuple[int, int]) -> None:
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    picture[...] = (10, 100, 200)  # blue, green, red
    for options in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]) if kind == ".jpg" else ([],):
        raw = cv2.imencode(kind, picture, options)[1].tobytes()
        assert encoded_size(raw, "picture") == size
        found = decode(raw, "picture")
        assert found.shape == (size[1], size[0], 3)
        np.testing.assert_allclose(found[0, 0], (200, 100, 10), atol=3)


@pytest.mark.parametrize("kind", [".png", ".jpg"])
def test_what_is_no_picture_gets_a_sentence(kind: str) -> None:
    raw = cv2.imencode(kind, np.zeros((9, 9), np.uint8))[1].tobytes()
    for broken in (b"", raw[:3], raw[:12], b"GIF89a" + raw, raw[3:]):
        with pytest.raises(SourceError, match=f"cannot read it: its {len(broken)} bytes are no whole JPEG or PNG"):
            decode(broken, "it")
    with pytest.raises(SourceError, match="cannot read it: "):
        decode(raw[: len(raw) // 4] if kind == ".jpg" else raw[:24] + bytes(9), "it")
