"""`posegaussian models`: a made wheel in the place of the official one, pip in the place of the network."""

from __future__ import annotations

import hashlib
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.assets import downloads, wheels
from posegaussian.storage.model.errors import ConfigError, SourceError
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.support.onnx_files import heatmap_network


@pytest.fixture
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The cache folder, and three made files that are expected in it."""
    monkeypatch.delenv("POSEGAUSSIAN_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made = tuple(
        replace(m, size=len(m.name), sha256=hashlib.sha256(m.name.encode()).hexdigest()) for m in downloads.BLAZEPOSE
    )
    monkeypatch.setattr(downloads, "BLAZEPOSE", made)
    return tmp_path / "cache" / "posegaussian" / "models" / "blazepose"


def wheel(folder: Path, spoil: str = "") -> Path:
    """A tiny wheel that holds the files where the official one does."""
    file = folder / downloads.MEDIAPIPE.file
    with zipfile.ZipFile(file, "w") as z:
        for m in downloads.BLAZEPOSE:
            z.writestr(m.member, "spoilt" if m.name == spoil else m.name)
        z.writestr("mediapipe/__init__.py", "raise SystemExit('never imported')")
    return file


def expect(monkeypatch: pytest.MonkeyPatch, file: Path) -> None:
    monkeypatch.setattr(
        downloads, "MEDIAPIPE", replace(downloads.MEDIAPIPE, sha256=hashlib.sha256(file.read_bytes()).hexdigest())
    )


def pip_gives(monkeypatch: pytest.MonkeyPatch, file: Path | None, stderr: str = "") -> list[list[str]]:
    asked: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess:
        asked.append(command)
        if file is not None:
            Path(command[command.index("--dest") + 1], downloads.MEDIAPIPE.file).write_bytes(file.read_bytes())
        return subprocess.CompletedProcess(command, 0 if file else 1, "", stderr)

    monkeypatch.setattr(wheels.subprocess, "run", run)
    return asked


def test_fetch_takes_the_three_files_out_of_the_wheel(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = wheel(tmp_path)
    expect(monkeypatch, file)
    asked = pip_gives(monkeypatch, file)
    said = "\n".join(downloads.fetch("blazepose"))
    assert sorted(f.name for f in cache.iterdir()) == sorted(m.name for m in downloads.BLAZEPOSE)
    assert all((cache / m.name).read_text() == m.name for m in downloads.BLAZEPOSE)
    assert "mediapipe==0.10.21" in asked[0]
    assert {"--no-deps", "--only-binary=:all:"} <= set(asked[0])
    assert "Apache-2.0" in said
    assert str(cache) in said
    assert "already" in downloads.fetch("blazepose")[0]
    assert len(asked) == 1


def test_a_wheel_of_another_content_is_refused(cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pip_gives(monkeypatch, wheel(tmp_path))
    with pytest.raises(SourceError, match=r"has sha256 .*, the published one has 05dc4a9e.*nothing was kept"):
        downloads.fetch("blazepose")
    assert not cache.exists()


def test_without_a_network_the_other_way_is_named(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip_gives(
        monkeypatch,
        None,
        "WARNING: Retrying\nERROR: Could not find a version that satisfies the requirement\nERROR: No matching"
        " distribution found\n",
    )
    with pytest.raises(
        SourceError, match=r"exit status 1, Could not find a version.*posegaussian models add mediapipe-0\.10\.21"
    ):
        downloads.fetch("blazepose")


def test_a_folder_that_cannot_be_written_is_named(cache: Path, tmp_path: Path) -> None:
    cache.parent.mkdir(parents=True)
    cache.write_text("a file in the way")
    with pytest.raises(SourceError, match=r"cannot write .*blazepose is a file, no folder.*XDG_CACHE_HOME"):
        downloads.add([wheel(tmp_path)])


def test_a_wheel_the_user_has_is_as_good_whatever_its_platform(cache: Path, tmp_path: Path) -> None:
    mine = wheel(tmp_path).rename(tmp_path / "mediapipe-0.10.21-cp312-cp312-win_amd64.whl")
    downloads.add([mine])
    assert len(list(cache.iterdir())) == 3


def test_a_spoilt_member_keeps_nothing(cache: Path, tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"selfie_segmentation\.tflite has sha256 .*nothing was kept"):
        downloads.add([wheel(tmp_path, spoil="selfie_segmentation.tflite")])
    assert not cache.exists()


def test_single_files_are_known_by_their_content(cache: Path, tmp_path: Path) -> None:
    mine = tmp_path / "downloaded.tflite"
    mine.write_text("pose_detection.tflite")
    downloads.add([mine])
    assert [f.name for f in cache.iterdir()] == ["pose_detection.tflite"]
    mine.write_text("something else")
    with pytest.raises(SourceError, match="none of BlazePose's files"):
        downloads.add([mine])


def test_other_wheels_and_files_are_refused(cache: Path, tmp_path: Path) -> None:
    later = tmp_path / "mediapipe-0.10.30-py3-none-any.whl"
    with zipfile.ZipFile(later, "w") as z:
        z.writestr("mediapipe/__init__.py", "")
    (tmp_path / "broken.whl").write_bytes(b"no zip")
    (tmp_path / "model.onnx").write_bytes(b"")
    for name, says in (
        ("mediapipe-0.10.30-py3-none-any.whl", "does not hold"),
        ("broken.whl", "does not hold"),
        ("model.onnx", "description"),
        ("nowhere.whl", "no file"),
    ):
        with pytest.raises(SourceError, match=says):
            downloads.add([tmp_path / name])


def test_the_list_says_what_is_missing_and_how_to_bring_it(cache: Path, tmp_path: Path) -> None:
    before = "\n".join(downloads.listing())
    assert before.count("missing") == 3 + 4, "three files of BlazePose, four of LPIPS"
    assert "posegaussian models fetch blazepose" in before
    downloads.add([wheel(tmp_path)])
    assert "\n".join(downloads.listing()).count("missing") == 4
    (cache / "pose_detection.tflite").write_text("spoilt")
    assert "spoilt" in "\n".join(downloads.listing())


def test_an_unknown_name_is_refused_with_the_known() -> None:
    with pytest.raises(SourceError, match="known are blazepose, lpips"):
        downloads.fetch("openpose")


def test_a_description_is_checked(tmp_path: Path) -> None:
    heatmap_network(tmp_path / "net.onnx", 192, 256, 4)
    (tmp_path / "net.yaml").write_text(
        "{file: net.onnx, kind: heatmap, input: [192, 256], outputs: [maps], joint_set: coco17}"
    )
    assert "detection.model=" in downloads.add([tmp_path / "net.yaml"])[0]


def test_a_description_of_what_is_no_network_or_another_one_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "net.yaml"
    told = "{file: net.onnx, kind: heatmap, input: [192, 256], outputs: [maps], joint_set: %s}"
    file.write_text(told % "coco17")
    (tmp_path / "net.onnx").write_bytes(b"network")
    with pytest.raises(ConfigError, match=r"net\.onnx: OpenCV's DNN cannot read it"):
        downloads.add([file])
    heatmap_network(tmp_path / "net.onnx", 192, 256, 4)
    file.write_text(told % "body_25")
    with pytest.raises(ConfigError, match=r"output maps has the shape \[17, 64, 48\].*gives 25 joints"):
        downloads.add([file])


def test_the_command_line_prints_sentences(tmp_path: Path) -> None:
    assert_says(posegaussian("models", "add", "nowhere.whl", cwd=tmp_path), "no file nowhere.whl")
    listed = posegaussian("models", "list", cwd=tmp_path)
    assert listed.returncode == 0
    assert "pose_landmark_full.tflite" in listed.stdout
