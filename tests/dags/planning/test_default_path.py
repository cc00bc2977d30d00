"""What is rendered when nothing is asked for: only what cameras stand beside."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.config.settings import Settings
from posegaussian.dags.planning.context import Context, make_context
from posegaussian.storage.archive.store import Archive
from tests.support.known_geometry import camera, on_ring, rig_of
from tests.support.sample_captures import make_capture


def context_of(folder: Path, *azimuths: float, settings: dict | None = None) -> Context:
    rig = rig_of([camera(on_ring(a), np.zeros(3)) for a in azimuths], size=(40, 30), focal=24.0)
    capture = replace(make_capture(len(azimuths), range(4), joints=False), rig=rig)
    return make_context(
        Archive.open(str(folder), create=True).create_sequence("kick", capture, 4),
        Settings.model_validate(settings or {}),
    )


@pytest.mark.parametrize(
    ("azimuths", "settings", "kind"),
    [
        ((0, 48, 180, 245), {}, "between"),
        (tuple(range(0, 360, 45)), {}, "between"),
        ((0, 48), {}, "between"),
        ((0, 120, 240), {}, "sway"),
        ((0, 48), {"depth": {"max_angle": 40}}, "sway"),
        ((0,), {}, "sway"),
        ((0, 45, 90), {"views": {"held_out": ["cam1"]}}, "held_out"),
        ((0, 48, 180, 245), {"rendering": {"paths": ["orbit"]}}, "orbit"),
    ],
)
def test_the_default_path_is_one_that_cameras_stand_beside(
    azimuths: tuple[float, ...], settings: dict, kind: str, tmp_path: Path
) -> None:
    assert [p.kind for p in context_of(tmp_path, *azimuths, settings=settings).paths.values()] == [kind]
