"""What a report shows of effects: panels are what the files and the archive hold, and what has no "before" is named."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.dags.planning.results import Results
from posegaussian.dags.report import changes
from posegaussian.dags.report.changes import GAP, HEIGHT, TIMES, Change, changes_of, not_shown
from posegaussian.dags.report.pictures import MOST_BYTES, pictures_of
from posegaussian.stages.contract.judged import SHARED_LIGHT
from posegaussian.stages.frames.exposures import compared
from posegaussian.stages.imaging.exposure import Matching
from posegaussian.storage.readers.images import read_picture
from tests.support.pipeline import NAME, Pipeline, film

SIZE, FRAME = 96, 1


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Three frames, one camera through a lens, computed up to the Gaussians."""
    folder = tmp_path_factory.mktemp("changes")
    film(folder / "capture", views=5, size=SIZE, frames=3)
    told = json.loads((folder / "capture" / "cameras.json").read_text())
    told["cameras"][1]["distortion"] = [-0.1, 0.02, 0, 0]
    (folder / "capture" / "cameras.json").write_text(json.dumps(told))
    on = [f"effects.{e}=on" for e in ("noise_averaging", "exposure_matching")]
    pipeline = Pipeline(
        folder / "archive", folder / "capture", ["depth.method=hull", "rendering.paths=[]", *on], held_out="[]"
    )
    pipeline.register()
    pipeline.run()
    return pipeline


def rows(pipeline: Pipeline) -> tuple[Results, dict[str, Change]]:
    results = Results(pipeline.context())
    return results, {change.names[0]: change for change in changes_of(results)}


def panels(change: Change, count: int) -> list[np.ndarray]:
    """The panels of a row, all equally wide."""
    width = (change.picture.shape[1] - GAP * (count - 1)) // count
    return [change.picture[:, i * (width + GAP) :][:, :width] for i in range(count)]


def enlarged(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture, (HEIGHT, HEIGHT), interpolation=cv2.INTER_NEAREST)


def test_a_lens_is_shown_by_the_file_and_the_picture_that_is_worked_on(made: Pipeline) -> None:
    results, found = rows(made)
    change = found["undistortion"]
    bent = results.context.rig.names[1]
    assert change.caption.startswith(bent), "the camera whose lens moves points is shown"
    filmed, worked, apart = panels(change, 3)
    file = made.folder / "images" / bent / f"{FRAME:06d}.png"
    np.testing.assert_array_equal(filmed, enlarged(read_picture(file)))
    width, height = results.context.rig.size[1]
    held = results.read("frames/color", range(FRAME, FRAME + 1), 1)[0][:height, :width]
    assert width > SIZE, "a barrel lens filmed more than the calibrated picture holds without it"
    np.testing.assert_array_equal(worked, enlarged(held))
    left, top = ((n - SIZE) // 2 for n in (width, height))  # the lens is in the middle
    wanted = np.abs(read_picture(file).astype(int) - held[top : top + SIZE, left : left + SIZE]) * TIMES
    np.testing.assert_array_equal(apart, enlarged(wanted.clip(0, 255).astype(np.uint8)))
    assert apart.any()


def test_gains_are_shown_of_the_two_cameras_that_they_part_most(
    made: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, found = rows(made)
    assert "exposure_matching" not in found, "cameras that agree have no gains to show"
    gains = np.ones((len(results.context.rig), 3))
    gains[[1, 3]] = [[0.5], [3.0]]
    empty = np.zeros(len(gains))
    monkeypatch.setattr(changes, "match", lambda _: Matching(gains, empty, empty, empty, empty))
    change = rows(made)[1]["exposure_matching"]
    names = [results.context.rig.names[v] for v in (1, 3)]
    assert change.caption.startswith(" and ".join(names))
    filmed = [read_picture(made.folder / "images" / name / f"{FRAME:06d}.png") for name in names]
    sizes = results.context.rig.size
    held = [results.read("frames/color", range(FRAME, FRAME + 1), v)[0][: sizes[v, 1], : sizes[v, 0]] for v in (1, 3)]
    for panel, wanted in zip(panels(change, 4), [*filmed, *held], strict=True):
        np.testing.assert_array_equal(panel, enlarged(wanted))


def test_gains_are_found_by_the_points_that_the_pictures_gains_were_found_by(
    made: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what the judge saw of the surface where it can draw left-out views, and as for the frames themselves."""
    asked: list[np.ndarray] = []
    monkeypatch.setattr(changes, "match", asked.append)
    results, found = rows(made)
    sources = list(results.context.views.sources)
    assert compared(results.context.facts) == SHARED_LIGHT
    (points,) = asked
    np.testing.assert_array_equal(points, results.read(SHARED_LIGHT, range(1))[np.ix_(sources, sources)])
    assert "exposure_matching" not in found, "where cameras share no points there is nothing to show"


def test_every_effect_that_is_on_is_shown_or_named(made: Pipeline) -> None:
    results, found = rows(made)
    shown = {name for change in found.values() for name in change.names}
    assert shown >= {"noise_averaging", "temporal_smoothing", "frames.matte", "depth.method"}
    on = {name for name, verdict in results.context.effects.items() if verdict.state == "on"}
    left = not_shown(results, list(found.values()))
    assert left
    assert {*left, *shown} >= on
    assert not shown & set(left)
    for change in found.values():
        assert change.picture.shape[0] == HEIGHT
        assert change.picture.any()


def test_without_the_capture_what_the_archive_holds_is_shown_still(made: Pipeline, tmp_path: Path) -> None:
    pictures = made.folder / "images"
    pictures.rename(made.folder / "gone")
    try:
        _, found = rows(made)
    finally:
        (made.folder / "gone").rename(pictures)
    assert found.keys() == {"temporal_smoothing", "frames.matte", "depth.method"}


def test_a_sequence_that_is_not_rendered_plays_what_was_filmed(made: Pipeline) -> None:
    results, _ = rows(made)
    (strip,) = pictures_of(results, [], MOST_BYTES)
    assert (strip.kind, strip.frames) == ("strip", 3)
    mask = results.read("frames/mask", range(1), 0)[0][:SIZE, :SIZE]  # padded to the camera with a lens
    assert 0 < (mask > 0).mean() < 0.5
    jpeg = np.frombuffer(base64.b64decode(strip.uri.partition(",")[2]), np.uint8)
    first = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)[: strip.height]
    assert first[cv2.dilate(mask, np.ones((17, 17))) == 0].max() < 24, "black where nobody is"
    assert first.max() > 100


def test_a_sequence_without_results_has_nothing_to_show(made: Pipeline, tmp_path: Path) -> None:
    fresh = Pipeline(tmp_path / "archive", made.folder, made.settings, held_out="[]")
    fresh.register()
    assert rows(fresh)[1] == {}
    assert fresh.session.names([]) == [NAME]


def test_refined_depth_is_shown_where_gaussians_are_left_over_what_it_was(made: Pipeline, tmp_path: Path) -> None:
    """Refinement keeps a list, which is no map; the last panel but one is refined, the first as matched."""
    keep = "keep={refinement/depth: always, refinement/pixel: always}"
    refined = made.copy(tmp_path / "refined").with_settings("refinement.steps=2", keep)
    refined.run()
    results, found = rows(refined)
    assert "refined" in found["depth.method"].caption
    view = results.context.views.sources[0]
    before = results.read("depth/depth", range(FRAME, FRAME + 1), view)[0]
    after = changes._refined(results, FRAME, view, before)
    count = int(results.read("refinement/count", range(FRAME, FRAME + 1), view)[0])
    assert 0 < (after != before).sum() <= count
    assert (after[before == 0] == 0).all()
