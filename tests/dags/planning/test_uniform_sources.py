"""`views.sources: uniform N`: a plan has that many sources, evenly, of those that are not held out."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import Pipeline, film


def test_a_plan_has_that_many_sources(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=6, size=32, frames=1, held_out=0, depth=False)
    made = Pipeline(tmp_path / "archive", tmp_path / "capture", [], held_out="[]")
    made.register()
    names = made.context().asked_views.names
    every = made.with_settings("views.sources=uniform 3", f"views.held_out=[{names[0]}]")
    views = every.context().asked_views
    assert len(views.sources) == 3
    assert 0 not in views.sources
    assert views.held_out == (0,)
    assert len(made.with_settings("views.sources=uniform 6").context().asked_views.sources) == 6
    with pytest.raises(ConfigError, match="uniform 7 asks for 7 cameras, and 6 are not held out; ask for fewer"):
        _ = made.with_settings("views.sources=uniform 7").context().asked_views


def test_a_setting_that_is_no_number_of_cameras_is_refused(tmp_path: Path) -> None:
    for text in ("uniform", "uniform 0", "uniform -3", "uniform 8 9", "even 8", "uniform 99999"):
        (tmp_path / "pipeline.yaml").write_text(f"views: {{sources: {text}}}\n")
        with pytest.raises(
            ConfigError, match=r"pipeline.yaml:1:9 views.sources: a list.*uniform N or a protocol \(zju_4, .*, got '"
        ):
            load_configuration(tmp_path / "pipeline.yaml", folder=tmp_path)
