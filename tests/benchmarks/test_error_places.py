import numpy as np
import pytest

from benchmarks.quality.error_places import PLACES, squared_error_by_place


@pytest.fixture
def pictures() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    rendered, truth = random.integers(0, 256, (2, 40, 40, 3)).astype(np.uint8)
    mask = np.zeros((40, 40), np.uint8)
    mask[10:30, 12:28] = 255
    alpha = np.where(mask > 0, 255, 0).astype(np.uint8)
    alpha[18:22, 18:22] = 100
    return rendered, alpha, truth, mask


def test_no_error_is_lost_or_counted_twice(pictures: tuple[np.ndarray, ...]) -> None:
    rendered, alpha, truth, mask = pictures
    whole = ((rendered.astype(float) - truth * (mask[..., None] / 255.0)) ** 2).sum()
    assert squared_error_by_place(rendered, alpha, truth, mask).sum() == pytest.approx(whole, rel=1e-12)


@pytest.mark.parametrize(
    ("row", "column", "place"),
    [(2, 2, "outside"), (9, 15, "rim"), (10, 15, "rim"), (19, 19, "holes"), (14, 20, "inside")],
)
def test_a_wrong_pixel_counts_where_it_lies(
    pictures: tuple[np.ndarray, ...], row: int, column: int, place: str
) -> None:
    _, alpha, truth, mask = pictures
    rendered = np.rint(truth * (mask[..., None] / 255.0)).astype(np.uint8)
    rendered[row, column] ^= 255
    found = squared_error_by_place(rendered, alpha, truth, mask)
    assert [p for p, e in zip(PLACES, found, strict=True) if e > 0] == [place]
