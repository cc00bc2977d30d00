"""Where the model files are looked for, and what is said when they are not there."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.stages.estimators import blazepose_files
from posegaussian.storage.model.errors import SourceError


def lay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, bytes]:
    """Made model files in the folder, and the module expecting exactly them."""
    contents = {m.name: m.name.encode() * 3 for m in blazepose_files.BLAZEPOSE}
    made = tuple(
        replace(m, size=len(contents[m.name]), sha256=hashlib.sha256(contents[m.name]).hexdigest())
        for m in blazepose_files.BLAZEPOSE
    )
    monkeypatch.setattr(blazepose_files, "BLAZEPOSE", made)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return contents


def test_the_cache_folder_follows_xdg(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("POSEGAUSSIAN_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert blazepose_files.blazepose_folder() == tmp_path / "posegaussian" / "models" / "blazepose"


@pytest.mark.parametrize(
    ("platform", "folder"), [("linux", ".cache"), ("darwin", "Library/Caches"), ("win32", "AppData/Local")]
)
def test_without_xdg_it_is_the_platform_s(
    platform: str, folder: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("POSEGAUSSIAN_MODELS", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", platform)
    assert blazepose_files.cache_folder() == tmp_path / folder / "posegaussian" / "models"


def test_all_three_files_or_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert blazepose_files.model_files(tmp_path) is None
    lay(tmp_path, monkeypatch)
    found = blazepose_files.model_files(tmp_path)
    assert found is not None
    assert set(found) == {"pose_detection", "pose_landmark_full", "selfie_segmentation"}
    blazepose_files.check_files(found)
    found["pose_detection"].write_bytes(b"cut")
    assert blazepose_files.model_files(tmp_path) is None


def test_a_spoilt_file_of_the_right_size_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    contents = lay(tmp_path, monkeypatch)
    (tmp_path / "pose_landmark_full.tflite").write_bytes(bytes(len(contents["pose_landmark_full.tflite"])))
    found = blazepose_files.model_files(tmp_path)
    assert found is not None
    with pytest.raises(
        SourceError, match=r"pose_landmark_full\.tflite has sha256 .*posegaussian models fetch blazepose"
    ):
        blazepose_files.check_files(found)


def test_what_is_missing_names_the_command(tmp_path: Path) -> None:
    assert "`posegaussian models fetch blazepose`" in blazepose_files.missing_sentence(tmp_path)
    assert str(tmp_path) in blazepose_files.missing_sentence(tmp_path)


def test_looking_for_models_imports_nothing_heavy() -> None:
    code = (
        "import sys, posegaussian.stages.estimators.blazepose_files, posegaussian.stages.estimators.interface,"
        " posegaussian.stages.estimators.description; print(sorted({m.partition('.')[0] for m in sys.modules} & {'cv2',"
        " 'torch', 'numba', 'ai_edge_litert'}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(Path(blazepose_files.__file__).parents[3])},
    )
    assert done.stdout.strip() == "[]"
