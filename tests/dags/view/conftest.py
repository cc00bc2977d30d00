"""One finished archive for all tests of the served page, which copy it before they change it."""

from __future__ import annotations

import pytest

from tests.support.pipeline import Pipeline, film

FRAMES = 4


@pytest.fixture(scope="package")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("view")
    film(folder / "capture", views=3, frames=FRAMES)
    pipeline = Pipeline(folder / "archive", folder / "capture", ["depth.method=truth", "rendering.paths=[]"])
    pipeline.register()
    pipeline.run()
    return pipeline
