"""Paths across gaps that depth cannot match are warned of, with what to render instead; ordinary paths are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posegaussian.stages.camera_paths.gaps import gap_notes
from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.pairs import MAX_ANGLE
from posegaussian.storage.model.cameras import Rig
from tests.stages.camera_paths.test_stretch import CLOSED, RIGS, places, row
from tests.support.known_geometry import ring
from tests.support.pipeline import Pipeline, film


def told(
    rig: Rig, text: str, held_out: tuple[int, ...] = (), max_angle: float = MAX_ANGLE, frames: int = 96
) -> list[str]:
    """What is said of one path, without its name."""
    sources = tuple(v for v in range(len(rig)) if v not in held_out)
    path = make_path(text, rig, Views(rig.names, sources, held_out), np.arange(frames), max_angle=max_angle)
    return [
        n.partition(f"camera path {path.text!r}: ")[2] for n in gap_notes(rig, sources, max_angle, {path.name: path})
    ]


@pytest.mark.parametrize("name", RIGS)
def test_paths_that_stay_with_the_cameras_are_not_warned_of(name: str) -> None:
    for text in ("between", "sway"):
        assert told(RIGS[name], text) == []


@pytest.mark.parametrize("rig", [*(RIGS[n] for n in CLOSED), ring(6), ring(8), ring(16)])
@pytest.mark.parametrize("frames", [1, 96])
def test_neither_are_orbits_and_arcs_of_ordinary_rings(rig: Rig, frames: int) -> None:
    last = rig.names[len(rig) // 2]
    for text in ("orbit", f"arc {rig.names[0]} {rig.names[1]}", f"arc {rig.names[0]} {last}", f"sway {last} 40"):
        assert told(rig, text, frames=frames) == []


def test_an_arc_across_a_gap_is_told_who_stands_at_its_ends_and_what_to_render_instead() -> None:
    (note,) = told(RIGS["two groups"], "arc cam0 cam3")
    assert note == (
        "81% of its pictures lie where no two neighbours that can be matched stand within 75 degrees at the"
        " subject: between cam0 and cam3 (113 degrees); expect torn limbs and holes there. No gap is crossed by"
        " --path between or 'arc cam0 cam1' or 'arc cam2 cam3'"
    )
    assert told(RIGS["two groups"], "arc cam0 cam1") == []


def test_the_gap_is_named_and_not_the_ends_of_the_path() -> None:
    """An arc from one end of a row to the other, with a gap on its way."""
    (note,) = told(places(*row(0, 40, 120, 160)), "arc cam0 cam3")
    assert "between cam1 and cam2 (79 degrees);" in note
    assert "'arc cam0 cam1' or 'arc cam2 cam3'" in note


def test_the_bound_is_the_setting_where_that_is_narrower() -> None:
    rig = places(*row(0, 40, 110, 150))
    assert told(rig, "arc cam0 cam3") == []
    assert "within 60 degrees" in told(rig, "arc cam0 cam3", max_angle=60.0)[0]
    assert "within 30 degrees" in told(ring(8), "arc cam0 cam1", max_angle=30.0)[0]


def test_a_camera_that_is_held_out_closes_no_gap() -> None:
    assert told(ring(8), "orbit", held_out=(3,)) != []
    assert told(ring(8), "held_out", held_out=(3,)) == []  # to be compared with, wherever it stands
    assert told(RIGS["two groups"], "still cam3") == []


def test_where_nobody_stands_and_where_nothing_is_matched() -> None:
    assert "beyond cam1 (no camera there)" in told(RIGS["two"], "orbit")[0]
    (note,) = told(ring(4), "orbit")
    assert "between cam2 and cam3 (89 degrees) and 1 more;" in note
    assert note.endswith(
        "No two that can be matched stand that near: --path sway stays near one, and a camera in the gap would close it"
    )


def test_another_reason_than_the_angle_is_said() -> None:
    """Two cameras that stand side by side, of which one does not show the subject."""
    rig = places(*row(0, 40, 80))
    rig = replace(rig, size=np.array([[1024, 1024], [1, 1], [1024, 1024]]))  # the second's picture ends before it
    (note,) = told(rig, "arc cam0 cam1")
    assert "between cam0 and cam1 (without the subject in view" in note


def test_names_with_spaces_are_quoted_and_one_camera_has_no_sides() -> None:
    rig = RIGS["two groups"]
    rig = replace(rig, names=("a 1", "a 2", "b 1", "b 2"))
    suggested = told(rig, "arc 'a 1' 'b 2'")[0].partition("between or ")[2].partition(" or ")[0]
    assert suggested == "'arc '\"'\"'a 1'\"'\"' '\"'\"'a 2'\"'\"''"
    assert told(rig, "sway 'a 1' 80", held_out=(1, 2, 3)) == []


def test_the_plan_warns(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=4, size=48, frames=3, held_out=0)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", held_out="[]")
    pipeline.register()
    assert [n for n in pipeline.plan("arc cam00 cam01").notes if "no two neighbours that can be matched" in n]
    assert not [n for n in pipeline.plan("sway").notes if "no two neighbours that can be matched" in n]
