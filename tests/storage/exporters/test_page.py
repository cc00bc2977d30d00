"""A page's bytes: what is coded is what is read back, names stay text, and equal input gives equal bytes."""

from __future__ import annotations

import base64
import html.parser
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.exporters.page import maps as coding
from posegaussian.storage.exporters.page.document import packed, write_page
from posegaussian.storage.exporters.page.maps import HEAD, ViewMaps, coded, octahedral

HOSTILE = "</script><script>alert('x')</script><!-- \"Jörg's\" & <b>&amp;\u2028"


def maps(height: int = 23, width: int = 31, seed: int = 0, twist: bool = False, shift: bool = False) -> ViewMaps:
    """A bumpy surface with holes, an edge and noise."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    there = ((x - 15) ** 2 + (y - 11) ** 2 < 100) & (random.random((height, width)) > 0.1)
    depth = np.where(there, 2 + 0.02 * np.sin(x / 3) + 0.5 * (x > 18), 0.0)
    normal = random.normal(size=(3, height, width)) - [[[0]], [[0]], [[2]]]
    angle = random.uniform(-np.pi, np.pi, (height, width))
    return ViewMaps(
        random.integers(0, 256, (height, width, 3), np.uint8),
        depth,
        np.exp(random.normal(-6, 1, (3, height, width))),
        normal,
        random.uniform(0.01, 1, (2, height, width)),
        np.stack([np.cos(angle), np.sin(angle)]) if twist else None,
        40.0,
        random.uniform(-3, 3, (2, height, width)) if shift else None,
    )


def read_back(of: ViewMaps) -> tuple[tuple, np.ndarray, list[np.ndarray]]:
    """Head, presence and planes [h, w] of a coded view, slowly: what `decode.js` does."""
    view = coded(of)
    head = HEAD.unpack(view.head)
    _, _, width, height, *_ = head
    present = np.unpackbits(np.frombuffer(view.present, np.uint8), count=width * height).reshape(height, width) > 0
    low, high, *others = (np.frombuffer(p, np.uint8).astype(int) for p in view.planes)
    folded = low | high << 8
    signed = np.where(folded & 1, -(folded + 1) // 2, folded // 2)
    return head, present, [unfolded(signed, present, 1 << 20), *(unfolded(o, present, 256) for o in others)]


def unfolded(changes: np.ndarray, present: np.ndarray, modulus: int) -> np.ndarray:
    out, n = np.zeros(np.add(present.shape, 1), int), 0
    for y, x in np.ndindex(present.shape):
        left, upper, corner = out[y + 1, x], out[y, x + 1], out[y, x]
        if present[y, x]:
            foretold = sorted((left, upper, left + upper - corner))[1]
            out[y + 1, x + 1] = (foretold + changes[n]) % modulus
            n += 1
        else:
            out[y + 1, x + 1] = left
    return out[1:, 1:]


@pytest.mark.parametrize(("twist", "shift"), [(False, False), (True, False), (False, True), (True, True)])
def test_what_is_read_back_is_what_was_coded_within_a_step(twist: bool, shift: bool) -> None:
    given = maps(twist=twist, shift=shift)
    head, present, (depth, nx, ny, *scales, green, red, blue, face, grazing, turn), shifts = _parted(read_back(given))
    left, top, width, height, nearest, step, count = head
    crop = np.s_[top : top + height, left : left + width]
    there = given.depth[crop] > 0
    assert count == there.sum() == (given.depth > 0).sum()
    np.testing.assert_array_equal(present, there)
    z = nearest * np.exp(depth * step)
    np.testing.assert_allclose(z[there], given.depth[crop][there], rtol=0.51 * step + 1e-6)
    assert step == pytest.approx(1 / (coding.DEPTH_STEPS * given.focal))
    np.testing.assert_array_equal(green[there], given.color[crop][there][:, 1])
    for plane, channel in ((red, 0), (blue, 2)):
        np.testing.assert_array_equal((plane + green - 128)[there] & 255, given.color[crop][there][:, channel])
    for plane, values in zip((face, grazing), given.opacity, strict=True):
        np.testing.assert_allclose(
            plane[there] / coding.OPACITY_STEPS, values[crop][there], atol=0.51 / coding.OPACITY_STEPS
        )
    for plane, values in zip(scales, given.scale, strict=True):
        said = 2 ** ((plane - coding.SCALE_ZERO) / coding.SCALE_STEPS) * given.depth[crop] / given.focal
        np.testing.assert_allclose(said[there], values[crop][there], rtol=0.06)
    exact = octahedral(given.normal[:, *crop])
    np.testing.assert_array_equal(nx[there], exact[0][there])
    np.testing.assert_array_equal(ny[there], exact[1][there])
    if given.twist is not None:
        angle = np.arctan2(given.twist[1], given.twist[0])[crop][there]
        off = np.exp(1j * (turn[there] / coding.TURN_STEPS * 2 * np.pi - angle))
        assert np.abs(np.angle(off)).max() < 0.51 * 2 * np.pi / coding.TURN_STEPS
    assert len(shifts) == 2 * shift
    for plane, values in zip(shifts, [] if given.shift is None else given.shift, strict=True):
        said = (plane - coding.SHIFT_ZERO) / coding.SHIFT_STEPS
        np.testing.assert_allclose(said[there], values[crop][there], atol=0.51 / coding.SHIFT_STEPS)


def _parted(found: tuple) -> tuple:
    """Head, presence, the planes up to the turn, 0 where there is none, and those of shifts."""
    head, present, planes = found
    own, others = planes[:11], planes[11:]
    turn = others[:1] if len(others) % 2 else [np.zeros_like(planes[0])]
    return head, present, [*own, *turn], others[len(others) % 2 :]


def test_what_is_not_finite_makes_no_gaussian_and_an_empty_view_is_empty() -> None:
    given = maps()
    spoilt = ViewMaps(
        given.color, given.depth.copy(), given.scale.copy(), given.normal, given.opacity.copy(), None, given.focal
    )
    rows, columns = np.nonzero(given.depth > 0)
    spoilt.depth[rows[0], columns[0]] = np.nan
    spoilt.scale[1, rows[1], columns[1]] = np.inf
    spoilt.opacity[0, rows[2], columns[2]] = 0
    assert coded(spoilt).count == len(rows) - 3
    spoilt.depth[:] = 0
    assert coded(spoilt).count == 0
    assert len(packed([coded(spoilt), coded(given)])) < 10_000


def test_a_surface_takes_fewer_bytes_than_its_noise() -> None:
    """Prediction by neighbours is worth something: a smooth surface takes a fraction of the same pixels in disorder."""
    y, x = np.mgrid[:64, :64]
    waves = np.stack([np.sin(x / 9), np.cos(y / 7), np.full(x.shape, -2.0)])
    color = np.stack([x + y, x * 2, y * 2], axis=-1).astype(np.uint8)
    smooth = ViewMaps(color, 2 + x / 500, np.full((3, 64, 64), 0.01), waves, np.full((2, 64, 64), 0.9), None, 100.0)
    order = np.random.default_rng(0).permutation(64 * 64)

    def mixed(a: np.ndarray) -> np.ndarray:
        return a.reshape(*a.shape[:-2], -1)[..., order].reshape(a.shape)

    shuffled = ViewMaps(
        mixed(color.transpose(2, 0, 1)).transpose(1, 2, 0),
        mixed(smooth.depth),
        smooth.scale,
        mixed(waves),
        smooth.opacity,
        None,
        100.0,
    )
    assert len(packed([coded(smooth)])) < 0.3 * len(packed([coded(shuffled)]))


class Elements(html.parser.HTMLParser):
    """Scripts of a document by id, and all other text."""

    def __init__(self) -> None:
        super().__init__()
        self.scripts: dict[str | None, str] = {}
        self.text, self.inside, self.tags = "", "", []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.inside, self.own = tag, dict(attrs).get("id")
        self.tags.append(tag)
        if tag == "script":
            self.scripts[self.own] = ""

    def handle_endtag(self, tag: str) -> None:
        self.inside = ""

    def handle_data(self, data: str) -> None:
        if self.inside == "script":
            self.scripts[self.own] += data
        else:
            self.text += data


def test_names_stay_text_and_nothing_is_asked_for_elsewhere(tmp_path: Path) -> None:
    head = {"title": HOSTILE, "views": [{"name": HOSTILE}]}
    views = [coded(maps())]
    size = write_page(tmp_path / "a.html", HOSTILE, [(views, [b"picture"])], lambda: head)
    text = (tmp_path / "a.html").read_bytes().decode()
    assert size == len(text.encode())
    document = Elements()
    document.feed(text)
    assert json.loads(document.scripts["head"]) == head
    assert HOSTILE in document.text  # the title
    assert zlib.decompress(base64.b64decode(document.scripts["frame-0"]))[:20] == views[0].head
    assert base64.b64decode(document.scripts["pictures-0"]) == b"picture"
    assert document.tags.count("script") == 7  # head, two shaders, the worker, a frame, its pictures, the player
    assert "b" not in document.tags
    assert not re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?:https?:)?//""", text)
    assert "default-src 'none'" in text


def test_equal_frames_give_equal_bytes_and_a_number_that_is_none_is_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_page(tmp_path / f"{name}.html", "walk", [([coded(maps())], [b""])], lambda: {"rate": 30.0})
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_page(tmp_path / "c.html", "walk", [], lambda: {"rate": float("nan")})
    assert not (tmp_path / "c.html").exists()
