"""Scenes, weights and models as files: whole ones, and what reads them."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tests.stages.estimators import test_onnx
from tests.storage.formats import test_splat_files
from tests.support import onnx_files


def rows() -> Iterator[tuple[str, Callable[[Path], None], str, str, Callable[[Path, Path], object]]]:
    """(name, maker, glob, kind, reader) of each."""
    yield "PLY of splats", splats, "*.ply", "binary", read_splat_file
    yield "compressed PLY of splats", packed_splats, "*.ply", "binary", read_splat_file
    yield "PLY header", splats, "*.ply", "table", read_splat_file
    yield "weights and their card", weights, "*.safetensors", "binary", read_weights
    yield "weights' card", weights, "*.safetensors", "table", read_weights
    yield "checkpoint of a training", checkpoint, "checkpoints/*.checkpoint", "binary", read_checkpoints
    yield "model description YAML", described, "own.yaml", "yaml", read_model
    yield "ONNX model", described, "*.onnx", "binary", read_model
    yield "tflite and wheel", bought, "*", "binary", add_models
    yield "scan OBJ and MTL", scan, "*.[om][bt][jl]", "table", read_scan


def splats(base: Path) -> None:
    from posegaussian.storage.formats.splat_ply import write_splats

    base.mkdir(parents=True)
    write_splats(base / "a.ply", test_splat_files.made(20, 2))


def packed_splats(base: Path) -> None:
    base.mkdir(parents=True)
    test_splat_files.packed(base / "a.ply", n=300, chunks=2, sh=9, colors=True)


def read_splat_file(folder: Path, out: Path) -> None:
    from posegaussian.stages.splatting.splat_scene import scene_of
    from posegaussian.storage.formats.splat_ply import read_splats, write_splats

    read = read_splats(folder / "a.ply")
    scene_of(read.splats)
    write_splats(out / "b.ply", read.splats, read.carried)


def weights(base: Path) -> None:
    """A network of the smallest widths."""
    from posegaussian.dags.training.weights import save_weights
    from posegaussian.stages.network.card import Card
    from posegaussian.stages.network.model.network import PoseGaussianNetwork
    from posegaussian.stages.network.model.presets import Preset

    base.mkdir(parents=True)
    preset = Preset("fast", widths=(8, 8, 8, 8), hidden=8)
    card = Card(
        "tiny",
        "fast",
        preset.as_json(),
        6,
        "Two spheres.",
        "1 and 2",
        0.5,
        "one core",
        (("measure", "value"), ("EPE", "1.5")),
        ("Anything at all.",),
    )
    save_weights(base / "tiny.safetensors", PoseGaussianNetwork(preset).state_dict(), card)


def read_weights(folder: Path, out: Path) -> None:
    from posegaussian.stages.network.asset import network_of, notes
    from posegaussian.stages.network.params import NetworkParams

    params = NetworkParams(weights=str(folder / "tiny.safetensors"))
    notes(params)
    network_of(params)


def checkpoint(base: Path) -> None:
    """Two checkpoints with the state of an optimiser."""
    import torch

    from posegaussian.dags.training.state import packed
    from posegaussian.storage.archive.checkpoints import write_checkpoint

    for step in (100, 200):
        state = {
            "network": {"w": torch.zeros(3, 4)},
            "optimiser": {
                "state": {0: {"step": 3, "mean": torch.ones(4)}},
                "groups": [{"rate": 1e-3, "betas": (0.9, 0.99), "none": None}],
            },
        }
        write_checkpoint(base / "checkpoints", step, packed(state), {"minutes": 1.5})


def read_checkpoints(folder: Path, out: Path) -> None:
    from posegaussian.dags.training.state import unpacked
    from posegaussian.storage.archive.checkpoints import read_latest

    found, _ = read_latest(folder / "checkpoints")
    if found is not None:
        unpacked(found.data)


def described(base: Path) -> None:
    """An ONNX network and its description."""
    base.mkdir(parents=True)
    onnx_files.heatmap_network(base / "net.onnx", 96, 128, 4)
    lines = [f"{k}: {v}" for k, v in test_onnx.HEATMAP.items()]
    (base / "own.yaml").write_text(
        "\n".join([*lines, "mean: [0.1, 0.2, 0.3]", "std: [0.5, 0.6, 0.7]", "channels: bgr", "margin: 1.25"]) + "\n"
    )


def read_model(folder: Path, out: Path) -> None:
    from posegaussian.dags.assets.downloads import add
    from posegaussian.stages.estimators.description import read_description
    from posegaussian.stages.estimators.onnx import OnnxEstimator

    add([folder / "own.yaml"])
    OnnxEstimator(read_description(folder / "own.yaml")).look(
        np.full((64, 64, 3), 100, np.uint8), np.array([[32.0, 32.0, 40.0, 0.0]])
    )


def bought(base: Path) -> None:
    """Files that claim to be BlazePose's; what was published would be refused as well, were it spoilt."""
    from posegaussian.stages.estimators.blazepose_files import BLAZEPOSE

    base.mkdir(parents=True)
    (base / "pose.tflite").write_bytes(bytes(range(256)) * 20)
    with zipfile.ZipFile(base / "mediapipe.whl", "w") as z:
        for m in BLAZEPOSE:
            z.writestr(m.member, bytes(1000))
        z.writestr("../../planted", b"x")


def add_models(folder: Path, out: Path) -> None:
    from posegaussian.dags.assets.downloads import add

    os.environ["POSEGAUSSIAN_MODELS"] = str(out / "models")
    for file in sorted(folder.iterdir()):
        add([file])


def scan(base: Path) -> None:
    """A textured square."""
    from posegaussian.storage.readers.images import write_png

    base.mkdir(parents=True)
    (base / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1.7 0.2\nv 0 1.7 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 "
        "4/4\nf -4 -3 -2\n"
    )
    (base / "a.mtl").write_text("newmtl skin\nmap_Kd a.png\n")
    write_png(base / "a.png", np.full((8, 8, 3), 100, np.uint8))


def read_scan(folder: Path, out: Path) -> None:
    from posegaussian.dags.simulation.simulate import load_scan
    from posegaussian.stages.simulator.scene import Scan

    load_scan(Scan(obj=Path("a.obj"), height=1.7), folder)


NEVER_WHOLE = partial(frozenset, ("tflite and wheel",))
"""Rows whose unspoilt files are refused, too."""
