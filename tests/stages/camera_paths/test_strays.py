"""A camera that is no source (held out, or found to contradict the others) does not say where the subject is."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.camera_paths.gaps import gap_notes
from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.camera_paths.stretch import best_stretch
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.pairs import pair_report
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, rig_of, ring

SOURCES = tuple(range(8))


def with_stray(rig: Rig, centre: np.ndarray, target: np.ndarray) -> Rig:
    """The rig and one more camera, upside down."""
    turned = camera(centre, target, roll=180.0)
    return rig_of([*rig.world_to_camera, turned], tuple(rig.size[0]), float(rig.intrinsics[0, 0, 0]))


@pytest.mark.parametrize(
    ("centre", "target"),
    [
        ((30.0, 5.0, 2.0), (60.0, 9.0, 2.0)),
        ((1.0, 0.2, 0.5), (-3.0, 4.0, 0.0)),
        ((0.0, 2.0, 8.0), (0.0, 5.0, 8.0)),
    ],
)
def test_paths_and_pairs_are_those_of_the_sources(centre: tuple[float, ...], target: tuple[float, ...]) -> None:
    rig = ring(8, size=(640, 640), focal=600.0)
    stray = with_stray(rig, np.array(centre), np.array(target))
    assert stray.names[:8] == rig.names
    own, more = Views(rig.names, SOURCES, ()), Views(stray.names, SOURCES, ())
    assert [r.sentence for r in pair_report(stray, SOURCES)] == [r.sentence for r in pair_report(rig, SOURCES)]
    assert best_stretch(stray, SOURCES) == best_stretch(rig, SOURCES)
    for text in ("between", "orbit", "arc cam0 cam2", "sway cam1"):
        path, same = make_path(text, stray, more, np.arange(12)), make_path(text, rig, own, np.arange(12))
        np.testing.assert_allclose(path.world_to_camera, same.world_to_camera, atol=1e-9)
        np.testing.assert_allclose(path.intrinsics, same.intrinsics, atol=1e-9)
        assert gap_notes(stray, SOURCES, 40.0, {text: path}) == gap_notes(rig, SOURCES, 40.0, {text: same})
