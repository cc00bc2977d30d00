"""What a number is not of is said wherever it stands: pictures without a value, and what is hidden in others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.evaluation.measured import hidden_pictures, pictures
from posegaussian.dags.evaluation.methods import methods
from posegaussian.dags.evaluation.results import Result, with_means
from posegaussian.dags.evaluation.tables import latex, markdown, rows
from posegaussian.stages.metrics.run import LEFT_OUT
from tests.support.pipeline import NAME

SMALL = "not available: a region of less than 161 px height or width"


def row(frame: int, measure: str, value: float | None, region: str = "box", hidden: bool = False) -> dict[str, Any]:
    definition = SMALL if value is None else "d" + (LEFT_OUT if hidden else "")
    return {
        "camera": "mid00",
        "frame": frame,
        "region": region,
        "measure": measure,
        "value": value,
        "definition": definition,
    }


def result(table: list[dict[str, Any]], sequence: str = NAME) -> Result:
    return Result(sequence, "", "ours", {n.key: n for n in pictures(table)}, hosts=(), hidden=hidden_pictures(table))


def test_a_mean_over_some_pictures_says_so_wherever_it_stands() -> None:
    some = [row(0, "ms_ssim", 0.5), row(1, "ms_ssim", None), row(2, "ms_ssim", 0.7)]
    ours = result([*some, *(row(f, "psnr", 20.0) for f in range(3))])
    told = f"of 2 of 3 pictures, the others: {SMALL}"
    number = ours.numbers["ms_ssim", "box", "mean"]
    assert (number.value, number.told) == (pytest.approx(0.6), f"d; {told}")
    assert ours.numbers["psnr", "box", "mean"].told == "d"
    (page,) = [x for x in markdown([ours], "p") if "of 2 of 3" in x]
    assert page == f"- {NAME}, ours: MS-SSIM box: {told}."
    assert told in "\n".join(latex([ours], "p"))
    (kept,) = [r for r in rows([ours]) if r["measure"] == "ms_ssim"]
    assert (kept["count"], kept["missing"], kept["definition"]) == (2, 1, f"d; {told}")
    *_, mean = with_means([ours, result([row(f, "ms_ssim", 0.5) for f in range(3)], "other")])
    assert mean.numbers["ms_ssim", "box", "mean"].partly == f"of 5 of 6 pictures, the others: {SMALL}"


@pytest.mark.parametrize("hidden", [1, 2, 3])
def test_hidden_pixels_are_told_however_many_pictures_have_some(hidden: int) -> None:
    """A definition is not the one that most pictures have."""
    table = [row(f, m, 20.0, hidden=f < hidden) for f in range(3) for m in ("psnr", "ssim")]
    ours = result(table)
    told = f"in {hidden} of 3 pictures hidden pixels are left out"
    assert [n.told for n in ours.numbers.values()] == [f"d; {told}"] * 2
    assert all(r["definition"].endswith(told) for r in rows([ours]))
    sentence = f"{NAME}: hidden pixels are left out of {hidden} held-out picture{'s' if hidden > 1 else ''}."
    assert f"- {sentence}" in markdown([ours], "p")
    assert latex([ours], "p")[-2].count(sentence.split(": ")[1]) == 1
    assert "hidden" not in "\n".join(markdown([result([row(0, "psnr", 20.0)])], "p"))


def test_why_there_is_no_number_names_the_measure_as_the_table_does_and_the_regions() -> None:
    table = [row(0, "ms_ssim", 0.9, "full"), row(0, "ms_ssim", None), row(0, "ms_ssim", None, "mask")]
    page = markdown([result(table), result(table, "other")], "p")
    assert "MS-SSIM full" in page[0]
    assert [x for x in page if SMALL in x] == [f"- MS-SSIM box, mask: {SMALL}."]
    changes = [row(0, "delta_ssim", 0.1, region) for region in ("full", "box")]
    (line,) = [x for x in markdown([result(changes)], "p") if "three frames" in x]
    assert line == "- σ ΔSSIM full, box: not available: fewer than three frames in a row."


@pytest.mark.parametrize("name", list(methods()))
def test_no_other_method_draws_as_the_user_has_set_it_to(name: str) -> None:
    configuration = load_configuration(None, ["rendering.method=ibr"], folder=Path("/"))
    drawn = methods()[name].over(configuration).for_sequence("walk").rendering.method
    assert drawn == {"posegaussian": "ibr", "ibr": "ibr", "3dgs": "3dgs"}.get(name, "gaussians")
