"""`import auto`, and what a layout that was named wrongly is told."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.model.errors import SourceError, UserError
from tests.storage.importers.test_actorshq import base as actorshq
from tests.storage.importers.test_caliscope import base as caliscope
from tests.storage.importers.test_colmap import base as colmap
from tests.storage.importers.test_dna_rendering import base as dna_rendering
from tests.storage.importers.test_dynacap import base as dynacap
from tests.storage.importers.test_easymocap import base as easymocap
from tests.storage.importers.test_genebody import base as genebody
from tests.storage.importers.test_gps_gaussian import base as gps_gaussian
from tests.storage.importers.test_humman import base as humman
from tests.storage.importers.test_images import base as images
from tests.storage.importers.test_llff import base as llff
from tests.storage.importers.test_mvhumannet import base as mvhumannet
from tests.storage.importers.test_nerfstudio import base as nerfstudio
from tests.storage.importers.test_panoptic import base as panoptic
from tests.storage.importers.test_people_snapshot import base as people_snapshot
from tests.storage.importers.test_pose2sim import base as pose2sim
from tests.storage.importers.test_videos import base as videos
from tests.storage.importers.test_zju_mocap import base as zju_mocap

FIXTURES = {
    "caliscope": caliscope,
    "colmap": colmap,
    "easymocap": easymocap,
    "gps_gaussian": gps_gaussian,
    "images": images,
    "llff": llff,
    "nerfstudio": nerfstudio,
    "pose2sim": pose2sim,
    "videos": videos,
    "panoptic": panoptic,
    "dynacap": dynacap,
    "mvhumannet": mvhumannet,
    "genebody": genebody,
    "actorshq": actorshq,
    "humman": humman,
    "people_snapshot": people_snapshot,
    "dna_rendering": dna_rendering,
    "zju_mocap": zju_mocap,
}


@pytest.mark.parametrize("layout", IMPORTERS)
def test_each_layout_is_recognised_by_what_is_there(layout: str, request: pytest.FixtureRequest) -> None:
    base: Path = request.getfixturevalue(layout)
    found = find_capture("auto", base, {})
    assert found.layout == layout
    assert found.notes[0] == f"layout: {layout}"
    assert found.to_json() == {**find_capture(layout, base, {}).to_json(), "notes": found.notes}


CLUTTER = ("@eaDir", "__MACOSX", ".ipynb_checkpoints")
"""Folders of a NAS, of macOS and of Jupyter."""


@pytest.mark.parametrize("layout", IMPORTERS)
def test_what_macos_a_nas_or_jupyter_leave_changes_nothing(layout: str, request: pytest.FixtureRequest) -> None:
    base: Path = request.getfixturevalue(layout)
    clean = find_capture("auto", base, {}).to_json()
    for place in [base, *(p for p in base.rglob("*") if p.is_dir())]:
        files = [p for p in place.iterdir() if p.is_file()]
        for name in CLUTTER:
            (place / name).mkdir()
        for file in files:
            (place / f"._{file.name}").write_bytes(b"\0\5\x16\7Mac OS X")
            for name in CLUTTER:
                shutil.copy(file, place / name / file.name)
    assert find_capture("auto", base, {}).to_json() == clean


@pytest.mark.parametrize(
    ("named", "there"), [(a, b) for a in IMPORTERS for b in IMPORTERS if a != b and (a, b) != ("pose2sim", "caliscope")]
)
def test_a_wrong_layout_is_told_what_it_expects_what_is_there_and_what_fits(
    named: str, there: str, request: pytest.FixtureRequest
) -> None:
    """Caliscope's files are what Pose2Sim's importer reads, too."""
    base: Path = request.getfixturevalue(there)
    with pytest.raises(UserError) as refused:
        find_capture(named, base, {})
    said = str(refused.value).splitlines()[-1]
    assert said.startswith(
        f"the layout {named} expects {'; '.join(t.expected for t in IMPORTERS[named].traits)}: {base} has no"
    )
    assert said.endswith(f"; that is the layout {there}: posegaussian import {there} {base}")
    assert "It holds " in said


def test_a_sentence_in_full(pose2sim: Path) -> None:
    with pytest.raises(UserError) as refused:
        find_capture("easymocap", pose2sim, {})
    assert (
        str(refused.value).splitlines()[-1]
        == f"the layout easymocap expects intri.yml; extri.yml; images/NAME/000000.jpg or videos/NAME.mp4: {pose2sim}"
        " has no intri.yml; no extri.yml. It holds calib/, videos/; that is the layout pose2sim: posegaussian"
        f" import pose2sim {pose2sim}"
    )
    with pytest.raises(
        SourceError,
        match=r"unknown layout 'easymocp'; known are .*, and auto, which takes the one that fits: here pose2sim$",
    ):
        find_capture("easymocp", pose2sim, {})


def test_what_is_wrong_inside_the_right_layout_is_said_alone(images: Path) -> None:
    (images / "cameras.json").write_text("{")
    for layout in ("images", "auto"):
        with pytest.raises(UserError) as refused:
            find_capture(layout, images, {})
        assert "cameras.json" in str(refused.value)
        assert "expects" not in str(refused.value)


def test_no_layout_and_two(images: Path, tmp_path: Path) -> None:
    for name in ("intri.yml", "extri.yml"):
        (images / name).write_text("names: []\n")
    with pytest.raises(SourceError, match="fits the layouts easymocap and images; name the one that is meant"):
        find_capture("auto", images, {})
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("x")
    with pytest.raises(SourceError) as refused:
        find_capture("auto", tmp_path / "other", {})
    base = tmp_path / "other"
    assert str(refused.value).splitlines() == [
        f"{base} has no layout that is read; it holds notes.txt, but no videos and no pictures",
        (
            "videos are looked for in the folder itself or in videos, pictures as images/CAMERA/000000.jpg, and a"
            " calibration of the cameras beside them"
        ),
        f"what another layout lacks: posegaussian import LAYOUT {base}, LAYOUT being one of {', '.join(IMPORTERS)}",
    ]
    with pytest.raises(SourceError, match="no such folder"):
        find_capture("auto", tmp_path / "none", {})


def _told(base: Path) -> list[str]:
    with pytest.raises(SourceError) as refused:
        find_capture("auto", base, {})
    return str(refused.value).splitlines()


def test_videos_without_a_calibration_are_told_which_layouts_are_closest_and_what_to_add(tmp_path: Path) -> None:
    for name in ("cam01.mp4", "cam02.mp4", "rig.txt"):
        (tmp_path / name).write_bytes(b"")
    near = ["pose2sim", "llff", "videos"]
    others = ", ".join(n for n in IMPORTERS if n not in near)
    elsewhere = f"posegaussian import pose2sim {tmp_path} --option calibration=FILE, or videos in place of pose2sim"
    assert _told(tmp_path) == [
        f"{tmp_path} has no layout that is read; it holds 2 videos, but no calibration of the cameras",
        *(f"for the layout {n} add {IMPORTERS[n].traits[0].expected}" for n in near),
        "rig.txt is there, but by name or content none of these",
        "no command here calibrates cameras: COLMAP, Caliscope, Pose2Sim or FreeMoCap do",
        f"then: posegaussian import auto {tmp_path}",
        f"for a calibration of another name or in another folder: {elsewhere}",
        f"what another layout lacks: posegaussian import LAYOUT {tmp_path}, LAYOUT being one of {others}",
    ]


def test_pictures_without_cameras_and_pictures_that_lie_elsewhere(tmp_path: Path) -> None:
    for camera in ("a", "b", "c"):
        (tmp_path / "images" / camera).mkdir(parents=True)
        (tmp_path / "images" / camera / "000000.png").write_bytes(b"")
    told = _told(tmp_path)
    assert told[0].endswith("it holds 3 pictures (in images/a, images/b and 1 more), but no calibration of the cameras")
    assert "for the layout images add cameras.json that lists cameras" in told
    told = _told(tmp_path / "images" / "a")
    assert told[0].endswith("it holds 1 picture, but not where a layout has them")
    assert "pictures as images/CAMERA/000000.jpg" in told[1]


def test_the_layout_that_lacks_least_is_named_alone(tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / "cam01.mp4").write_bytes(b"")
    (tmp_path / "intri.yml").write_text("names: []\n")
    told = _told(tmp_path)
    assert [line for line in told if line.startswith("for the layout")] == ["for the layout easymocap add extri.yml"]
    assert not [line for line in told if "none of these" in line]  # intri.yml is what easymocap wants


def test_a_calibration_without_pictures_and_neither_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text('{"pixel_center": "half", "cameras": []}')
    told = _told(tmp_path)
    assert told[0].endswith("it holds cameras.json, but no videos or pictures where a layout has them")
    assert told[1:4] == [
        "for the layout humman add kinect_color/kinect_000",
        "for the layout images add pictures images/NAME/<number>.png, .jpg or .exr",
        f"then: posegaussian import auto {tmp_path}",
    ]
    assert len(told) == 5


def test_a_folder_around_a_capture_names_it(images: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    around = tmp_path_factory.mktemp("around")
    shutil.copytree(images, around / "my walk")
    assert _told(around) == [
        f"{around} is no capture, its folder my walk is one (images): posegaussian import auto '{around}/my walk'"
    ]


def test_a_folder_of_captures_names_them(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("captures")
    shutil.copytree(request.getfixturevalue("pose2sim"), folder / "a")
    shutil.copytree(request.getfixturevalue("images"), folder / "b")  # the same folder, with what was there before
    with pytest.raises(
        SourceError, match=r"holds several captures, a \(pose2sim\), b \(.*images.*\); give the folder of"
    ):
        find_capture("auto", folder, {})
