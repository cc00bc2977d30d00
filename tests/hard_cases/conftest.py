"""The catalogue is run by every compiled back end that is to be had here. Nothing is imported before `pytest_configure` has spoken."""

import pytest


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    from tests.stages.rendering import scenes

    if "each_compiled" in metafunc.fixturenames:
        metafunc.parametrize("each_compiled", scenes.COMPILED, indirect=True)


@pytest.fixture
def each_compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What draws float32 in `draw` and `drawn`. The interpreter is given large tiles: it takes as long for a pixel as for a thousand."""
    from stages.rendering import gpu
    from tests.stages.rendering import scenes

    monkeypatch.setattr(scenes, "compiled", request.param)
    if gpu.interpreted():
        monkeypatch.setattr(gpu, "SHAPE", gpu.Shape(tile=64, chunk=32))
    return request.param


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Float64 is drawn by the reference, once. Infinities are masked by what `gpu` shares with it: there NaN is enough, the interpreter is slow."""
    import torch

    params = [i.callspec.params if hasattr(i, "callspec") else {} for i in items]
    items[:] = [i for i, p in zip(items, params, strict=True) if p.get("each_compiled") != "gpu" or (p.get("dtype") != torch.float64 and abs(p.get("bad", 0)) != float("inf"))]
