"""The catalogue is run by every compiled back end that is to be had here. Nothing is imported before
`pytest_configure` has spoken."""

from collections import Counter

import pytest


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    from tests.support import gaussian_scenes

    if "each_compiled" in metafunc.fixturenames:
        metafunc.parametrize("each_compiled", gaussian_scenes.COMPILED, indirect=True)


@pytest.fixture
def each_compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What draws float32 in `draw` and `drawn`. The interpreter is given large tiles: it takes as long for a pixel
    as for a thousand."""
    from posegaussian.stages.splatting.gpu import backend
    from tests.support import gaussian_scenes

    monkeypatch.setattr(gaussian_scenes, "compiled", request.param)
    if backend.interpreted():
        monkeypatch.setattr(backend, "SHAPE", backend.Shape(tile=64, chunk=32))
    return request.param


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Float64 is drawn by the reference, once. Of a case's parameters the interpreter, which is slow, gets four, and
    every sixth beyond."""
    import torch

    from posegaussian.stages.splatting.gpu import backend

    kept, met = [], Counter[str]()
    for item in items:
        params = item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
        if params.get("each_compiled") == "gpu":
            if params.get("dtype") == torch.float64:
                continue
            case = item.nodeid.partition("[")[0]
            met[case] += 1
            if backend.interpreted() and met[case] > 4 and met[case] % 6:
                continue
        kept.append(item)
    items[:] = kept
