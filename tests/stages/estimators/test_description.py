"""The YAML of an ONNX model: every fault is named with its key."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import yaml

from posegaussian.stages.estimators.description import read_description
from posegaussian.storage.model.errors import ConfigError, SourceError

GOOD = {"file": "net.onnx", "kind": "simcc", "input": [192, 256], "outputs": ["x", "y"], "joint_set": "coco17"}


def written(folder: Path, **changes: object) -> Path:
    (folder / "net.onnx").write_bytes(b"network")
    file = folder / "net.yaml"
    file.write_text(yaml.safe_dump({k: v for k, v in (GOOD | changes).items() if v is not None}))
    return file


def test_a_good_one_is_read_and_its_file_lies_beside_it(tmp_path: Path) -> None:
    d = read_description(written(tmp_path, sha256=hashlib.sha256(b"network").hexdigest()))
    assert d.path == tmp_path / "net.onnx"
    assert d.input == (192, 256)
    assert (d.channels, d.scale, d.mean, d.std, d.margin) == ("rgb", 1.0, (0, 0, 0), (1, 1, 1), 1.0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"kind": "magic"}, "kind: Input should be 'heatmap' or 'simcc'"),
        ({"outputs": ["x"]}, "a simcc network has 2 named outputs, 1 given"),
        ({"kind": "heatmap"}, "a heatmap network has 1 named output, 2 given"),
        ({"joint_set": "coco99"}, "joint_set: unknown joint set 'coco99'; known are coco17"),
        ({"input": [192]}, "input"),
        ({"std": [1, 0, 1]}, "std: a std of 0 cannot be divided by"),
        ({"colour": "rgb"}, "colour: Extra inputs are not permitted"),
        ({"file": None}, "file: Field required"),
        ({"sha256": "abc"}, "sha256"),
    ],
)
def test_a_fault_is_named(changes: dict[str, object], says: str, tmp_path: Path) -> None:
    file = written(tmp_path, **changes)
    with pytest.raises(ConfigError) as e:
        read_description(file)
    assert says in str(e.value)
    assert str(e.value).startswith(str(file))


def test_another_file_under_its_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"net\.onnx has sha256 .*, the description says 0000"):
        read_description(written(tmp_path, sha256="0" * 64))


def test_a_missing_network_is_named(tmp_path: Path) -> None:
    file = written(tmp_path)
    (tmp_path / "net.onnx").unlink()
    with pytest.raises(SourceError, match=r"no file .*net\.onnx; `file` is relative"):
        read_description(file)


@pytest.mark.parametrize("text", ["- a\n- b\n", "kind: [\n"])
def test_what_is_no_mapping_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "net.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"docs/guide/pose\.md"):
        read_description(file)
