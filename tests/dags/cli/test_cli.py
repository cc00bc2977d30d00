"""What a user meets: wrong input gets a sentence and exit status 2, never a traceback."""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app, main
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline, film


def process(*arguments: str, cwd: Path) -> subprocess.CompletedProcess:
    """The command as a process, in a folder of its own."""
    root = str(Path(__file__).resolve().parents[3])
    return subprocess.run(
        [
            sys.executable,
            "-c",
            f"import sys; sys.path.insert(0, {root!r}); from posegaussian.dags.cli.app import main; main()",
            *arguments,
        ],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
    )


def posegaussian(*arguments: str, cwd: Path) -> subprocess.CompletedProcess:
    """The command from its entry point on, in this process: sentences and exit status without seconds of imports.

    An error that would end the process with a traceback is raised.
    """
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        pytest.MonkeyPatch.context() as patched,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patched.chdir(cwd)
        patched.setattr(sys, "argv", ["posegaussian", *arguments])
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def assert_says(done: subprocess.CompletedProcess, *parts: str) -> None:
    text = done.stdout + done.stderr
    assert done.returncode == 2, text
    assert "Traceback" not in text, text
    for part in parts:
        assert part in text, f"{part!r} is missing from: {text}"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "capture"
    film(folder, views=3, frames=2, held_out=0, size=48)
    return folder


def test_no_such_folder(tmp_path: Path) -> None:
    for started in (posegaussian, process):
        assert_says(started("import", "images", "nowhere", cwd=tmp_path), "no such folder", "nowhere")


def test_unknown_layout(capture: Path, tmp_path: Path) -> None:
    assert_says(
        posegaussian("import", "unheard", str(capture), cwd=tmp_path),
        "unknown layout 'unheard'",
        "pose2sim, caliscope, easymocap, colmap",
    )


def test_a_word_too_few_is_answered_with_the_whole_command(capture: Path, tmp_path: Path) -> None:
    assert_says(posegaussian("import", str(capture), cwd=tmp_path), f"posegaussian import auto {capture}")
    assert_says(posegaussian("import", "images", cwd=tmp_path), "posegaussian import images FOLDER")


def test_unreadable_video(tmp_path: Path) -> None:
    (tmp_path / "c").mkdir()
    (tmp_path / "c/cam01.mp4").write_bytes(b"this is no video")
    (tmp_path / "c/calib.toml").write_text(
        "[cam01]\nname='cam01'\nsize=[64.0,48.0]\nmatrix=[[50.0,0,32],[0,50.0,24],[0,0,1.0]]\ndistortions=[0.0,0,0,0]\nrotation=[0.0,0,0]\ntranslation=[0.0,0,2]\n"
    )
    assert_says(posegaussian("import", "pose2sim", "c", cwd=tmp_path), "cam01.mp4")


def test_cameras_without_calibration(capture: Path, tmp_path: Path) -> None:
    broken = _edited(capture, tmp_path, lambda cameras: cameras["cameras"].pop())
    assert_says(posegaussian("import", "images", str(broken), cwd=tmp_path), "cam02")


def test_nan_in_a_calibration(capture: Path, tmp_path: Path) -> None:
    def poison(cameras: dict) -> None:
        cameras["cameras"][1]["t"][0] = float("nan")

    assert_says(posegaussian("import", "images", str(_edited(capture, tmp_path, poison)), cwd=tmp_path), "cam01", "nan")


def test_a_mask_of_another_size(capture: Path, tmp_path: Path) -> None:
    import shutil

    import numpy as np

    from posegaussian.storage.readers import images

    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    images.write_png(next((broken / "masks/cam01").iterdir()), np.zeros((20, 30), np.uint8))
    assert_says(posegaussian("import", "images", str(broken), cwd=tmp_path), "30", "20", "48")


def _edited(capture: Path, tmp_path: Path, edit) -> Path:
    import shutil

    broken = tmp_path / "broken"
    shutil.copytree(capture, broken)
    cameras = json.loads((broken / "cameras.json").read_text())
    edit(cameras)
    (broken / "cameras.json").write_text(json.dumps(cameras))
    return broken


def test_no_archive_and_no_sequence(tmp_path: Path) -> None:
    assert_says(posegaussian("plan", cwd=tmp_path), "there is no archive at", "posegaussian import")
    (tmp_path / "archive").mkdir()
    assert_says(posegaussian("run", cwd=tmp_path), "has no sequence yet")


def test_unknown_keys_are_reported_all_at_once_with_their_place(tmp_path: Path) -> None:
    (tmp_path / "pipeline.yaml").write_text("depth:\n  methd: hull\nsmothing: {}\nrendering:\n  sources: many\n")
    assert_says(
        posegaussian("plan", cwd=tmp_path),
        "pipeline.yaml:2:3 depth.methd",
        'did you mean "method"',
        "pipeline.yaml:3:1 smothing",
        'did you mean "smoothing"',
        "pipeline.yaml:5:3 rendering.sources",
    )


@pytest.mark.parametrize("command", ["plan", "run", "status", "verify", "gc", "tradeoff"])
def test_a_sequence_without_its_option_is_told_how_to_be_named(command: str) -> None:
    done = CliRunner().invoke(app, [command, "my walk"])
    assert isinstance(done.exception, ConfigError)
    assert str(done.exception).endswith("write --sequence 'my walk'")


def test_an_archive_of_a_newer_format(finished: Pipeline, tmp_path: Path) -> None:
    newer = finished.copy(tmp_path / "archive")
    meta = newer.root / NAME / "zarr.json"
    data = json.loads(meta.read_text())
    data["attributes"]["posegaussian"]["format"] = 99
    meta.write_text(json.dumps(data))
    assert_says(posegaussian("plan", cwd=tmp_path), "format 99", "update posegaussian")


def test_settings_that_the_capture_cannot_serve(finished: Pipeline, tmp_path: Path) -> None:
    archive = finished.options
    assert_says(
        posegaussian("plan", *archive, "--set", "views.held_out=[camX]", cwd=tmp_path), "no camera 'camX'", "cam00"
    )
    assert_says(
        posegaussian("plan", *archive, "--set", "frames.range=100:200", cwd=tmp_path), "selects no frame", "0..5"
    )
    assert_says(
        posegaussian("export", NAME, "--path", "arc cam00 cam77", "--video", "x.mp4", *archive, cwd=tmp_path), "cam77"
    )
    assert_says(
        posegaussian("export", NAME, "--path", "spiral", "--video", "x.mp4", *archive, cwd=tmp_path), "spiral", "orbit"
    )
    assert_says(posegaussian("export", NAME, *archive, cwd=tmp_path), "--video")
    assert_says(
        posegaussian("run", "--scheduler", "tcp://127.0.0.1:9", *archive, "--force", "metrics", cwd=tmp_path),
        "no scheduler answers",
    )


def test_a_source_that_changed_after_import_fails_in_a_sentence(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=3, frames=2, held_out=0)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", held_out="[]")
    pipeline.register()
    next((tmp_path / "capture/images/cam01").iterdir()).write_bytes(b"gone")
    done = process("run", "--archive", str(pipeline.root), "--scheduler", "serial", cwd=tmp_path)
    assert done.returncode == 1, done.stdout
    assert "changed since it was imported" in done.stdout
    assert "Traceback" not in done.stdout + done.stderr


@pytest.mark.parametrize("command", ["import", "plan", "run", "status", "why", "export", "demo"])
def test_help_has_an_example(command: str, tmp_path: Path) -> None:
    done = posegaussian(command, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "Example: posegaussian" in done.stdout


def test_status_shows_sequence_by_stage(finished: Pipeline, tmp_path: Path) -> None:
    done = process("status", *finished.options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert NAME in done.stdout
    assert "3/3" in done.stdout


def test_places_that_cannot_be_written_are_named(finished: Pipeline, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    archive = finished.options
    assert_says(posegaussian("import", "images", str(finished.folder), "--archive", "file/sub", cwd=tmp_path), "file")
    assert_says(posegaussian("export", NAME, "--path", "held_out", "--frames", "file", *archive, cwd=tmp_path), "file")
    assert_says(
        posegaussian("export", NAME, "--path", "held_out", "--sheet", "sheet.foo", *archive, cwd=tmp_path), "sheet.png"
    )


def test_one_export_is_of_one_sequence(finished: Pipeline, tmp_path: Path) -> None:
    two = finished.copy(tmp_path / "archive")
    import shutil

    shutil.copytree(two.root / NAME, two.root / "person2")
    assert_says(posegaussian("export", "*", "--video", "x.mp4", cwd=tmp_path), "matches 2 sequences", "person2")


def test_frames_are_not_mixed_with_those_of_another_export(finished: Pipeline, tmp_path: Path) -> None:
    archive = finished.options
    done = process("export", NAME, "--frames", "out", *archive, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["frames.csv", "mid00"]
    (tmp_path / "out" / "cam09").mkdir()
    (tmp_path / "out" / "mid00" / "000000.png").rename(tmp_path / "out" / "cam09" / "000000.png")
    assert_says(
        posegaussian("export", NAME, "--frames", "out", *archive, cwd=tmp_path),
        "cam09/000000.png",
        "empty it or name another folder",
    )


def test_ctrl_c_ends_the_run_with_one_sentence_and_keeps_what_is_done(person_folder: Path, tmp_path: Path) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder)
    pipeline.register()
    root = str(Path(__file__).resolve().parents[3])
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {root!r}); from posegaussian.dags.cli.app import main; main()",
        "run",
        "--archive",
        str(pipeline.root),
    ]
    settings = [
        "--set",
        "views.held_out=[mid00]",
        "--set",
        "partition.frames=2",
        "--scheduler",
        "local",
        "--set",
        "run.workers=1",
    ]
    process = subprocess.Popen(
        [*command, *settings],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        start_new_session=True,
    )
    deadline = time.monotonic() + 120
    while len(list((pipeline.root / NAME / "_receipts").rglob("*.json"))) < 5:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the driver and its workers alike
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, out + err
    assert "interrupted; what is done is kept" in out
    assert "Traceback" not in out + err, out + err
    pipeline.run()
    assert pipeline.plan().all_fresh


def test_settings_that_an_import_prints_can_be_pasted(tmp_path: Path) -> None:
    """Sizes that nothing explains: every indented line, as printed, is one YAML file, and with it the import works."""
    film(tmp_path / "capture", views=2, frames=1, held_out=0, masks=False, joints=False, depth=False)
    for camera in ("cam00", "cam01"):
        picture = tmp_path / "capture/images" / camera / "000000.png"
        cv2.imwrite(str(picture), np.maximum(cv2.imread(str(picture)), 90)[:, :40])
    refused = posegaussian("import", "images", "capture", cwd=tmp_path)
    assert_says(refused, "camera cam00: pictures are 40x48 px, the calibration is for 48x48 px; that is another shape")
    (tmp_path / "pipeline.yaml").write_text(
        "\n".join(line for line in refused.stderr.splitlines() if line.startswith(" "))
    )
    done = posegaussian("import", "images", "capture", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
