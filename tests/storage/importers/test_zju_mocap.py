"""The zju_mocap importer: millimetres, cameras by place, labels, numbers from 1, the refined layout, and sentences."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import register
from posegaussian.dags.planning.context import Context
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture, ring

FRAMES = 3
NAMES = ("Camera (1)", "Camera (2)", "Camera (10)")


def cams(order: tuple[float, ...] = (0, 1, 2)) -> dict[str, list[np.ndarray]]:
    return {
        "K": [ring.intrinsics(v) for v in order],
        "D": [ring.DISTORTION[:, None] for _ in order],
        "R": [ring.rotation(v) for v in order],
        "T": [1000 * ring.translation(v)[:, None] for v in order],
    }


def listed(names: tuple[str, ...] = NAMES, separator: str = "/") -> list[dict[str, list[str]]]:
    """Names with the frame's number, from 1, in the fifth of the parts between `_`, as 313 and 315 have them."""
    return [{"ims": [f"{c}{separator}{c}_a_b_{n + 1:04d}_x.jpg" for c in names]} for n in range(FRAMES)]


def save(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, content, allow_pickle=True)


def write(base: Path) -> None:
    """A subject as the first two have it; masks hold the labels 1, 5 and 13."""
    frames = listed()
    save(base / "annots.npy", {"cams": cams(), "ims": frames})
    for n, frame in enumerate(frames):
        for v, place in enumerate(frame["ims"]):
            ring.write_picture(base / place, v, n)
            ring.write_mask((base / "mask_cihp" / place).with_suffix(".png"), v, n, (1, 5, 13)[v])


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("zju_mocap", base, options)


def test_cameras_pictures_and_masks_are_those_of_the_lists(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (NAMES, [0, 1, 2], 30)
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), {0: 0, 1: 1, 2: 2})
    ring.check_masks(capture, (0, 1, 2), {0: 0, 1: 1, 2: 2})
    assert {*np.unique(next(iter(open_source(capture, "masks").read(0, [0]))))} == {0, 255}
    for part in (
        "unit: millimetres, as the layout has it",
        "direction: world to camera; all cameras look at one point to 0 degrees",
        "frames are counted from 0 as in annots.npy",
        "30 frames/s are assumed",
        "masks hold labels of body parts",
    ):
        assert any(part in n for n in capture.notes), part


def test_a_cameras_index_is_its_place_and_not_its_number(base: Path) -> None:
    """Cameras that come in another order than their folders' names, as texts or as numbers."""
    order = (2, 0, 1)
    save(base / "annots.npy", {"cams": cams(order), "ims": listed(tuple(NAMES[v] for v in order))})
    capture = find(base)
    assert capture.rig.names == tuple(NAMES[v] for v in order)
    ring.check_cameras(capture, order)
    ring.check_pictures(capture, order, {1: 1})
    ring.check_cameras(find(base, cameras=["Camera (10)", "Camera (1)"]), (2, 0))


def test_paths_of_windows_and_partial_downloads(base: Path) -> None:
    """A picture, a mask and a whole camera that are not there; what is left lands where it did."""
    save(base / "annots.npy", {"cams": cams(), "ims": listed(separator="\\")})
    os.remove(base / "Camera (1)" / "Camera (1)_a_b_0002_x.jpg")
    os.remove(base / "mask_cihp" / "Camera (2)" / "Camera (2)_a_b_0003_x.png")
    shutil.rmtree(base / "Camera (10)")
    capture = find(base)
    assert [list(s.numbers) for s in capture.pictures] == [[0, 2], [0, 1, 2]]
    ring.check_pictures(capture, (0, 1), {2: 2})
    assert list(capture.streams("masks")[1].numbers) == [0, 1]  # type: ignore[union-attr]
    for part in (
        "camera Camera (10) has no pictures and is left out",
        "camera Camera (1) lacks pictures of 1 frames (1)",
        "camera Camera (2) lacks masks of 1 frames (2)",
    ):
        assert part in capture.notes, part


def test_the_refined_layout_lists_no_pictures(tmp_path: Path) -> None:
    """`annots_new.npy` with an empty `ims`: cameras go with the folders of images, 2 before 10."""
    save(tmp_path / "annots_new.npy", {"cams": cams(), "ims": []})
    for v, name in enumerate(("00", "02", "010")):
        for n in range(FRAMES):
            ring.write_picture(tmp_path / "images" / name / f"{n:06d}.jpg", v, n)
            ring.write_mask(tmp_path / "mask" / name / f"{n:06d}.png", v, n)
    capture = find_capture("auto", tmp_path, {})
    assert (capture.layout, capture.rig.names) == ("zju_mocap", ("00", "02", "010"))
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), {2: 2})
    ring.check_masks(capture, (0, 1, 2), {1: 1})
    assert find(tmp_path, masks="none").masks == ()
    shutil.rmtree(tmp_path / "images" / "02")
    with pytest.raises(UserError, match="has 2 folders for 3 cameras; cameras go with the folders in order"):
        find(tmp_path)


def test_the_protocols_of_the_papers_are_known_by_name(tmp_path: Path) -> None:
    """Four cameras by place, the others held out, and the subject's test frames; a plan takes them by one name."""
    base = tmp_path / "CoreView_313"
    order = [f"Camera ({n})" for n in (3, 1, 2, *range(4, 20), 22, 23)]
    turns = {name: 0.15 * i for i, name in enumerate(order)}
    save(
        base / "annots.npy",
        {"cams": cams(tuple(turns.values())), "ims": [{"ims": [f"{c}/{n:06d}.jpg" for c in order]} for n in (0, 1)]},
    )  # type: ignore[arg-type]
    for name in order:
        for n in (0, 1):
            ring.write_picture(base / name / f"{n:06d}.jpg", 0, n)
    capture = find(base)
    sources = ["Camera (3)", "Camera (7)", "Camera (13)", "Camera (19)"]
    assert capture.splits["zju_4"].sources == tuple(sources)
    assert (
        "views.sources: zju_4 is a protocol of this data set: sources Camera (3), Camera (7), Camera (13), Camera (19),"
        " 17 held out; frames.range: zju_4 takes its test frames, 0:60:30" in capture.notes
    )
    assert Capture.from_json(json.loads(json.dumps(capture.to_json()))).splits == capture.splits

    def planned(*settings: str) -> Context:
        configuration = load_configuration(None, settings, folder=tmp_path)
        own = configuration.for_sequence("a")
        sequence, _ = register(Archive.open(str(tmp_path / "archive"), create=True), "a", capture, own)
        return Context(sequence, own, ())

    context = planned("views.sources=zju_4", "frames.range=zju_4")
    views = context.asked_views
    assert [views.names[v] for v in views.sources] == sources
    assert (len(views.held_out), context.source_frames.tolist()) == (17, [0])
    assert len(planned("views.sources=zju_21").asked_views.sources) == 21
    held = planned("views.sources=zju_4", "views.held_out=[Camera (1)]").asked_views
    assert [held.names[v] for v in held.held_out] == ["Camera (1)"]
    with pytest.raises(
        UserError, match=r"views.sources: genebody_4 is a protocol of genebody, .* it has zju_4, zju_1, zju_21"
    ):
        _ = planned("views.sources=genebody_4").asked_views
    shutil.rmtree(base / "Camera (7)")
    capture = find(base)
    assert "protocol zju_4 needs cameras that are not there: Camera (7)" in capture.notes
    with pytest.raises(UserError, match=r"views.sources zju_4: sequence a has no camera 'Camera \(7\)'; it has Camera"):
        _ = planned("views.sources=zju_4").asked_views


def changed(key: str, values: list[Any]) -> dict[str, Any]:
    return {"cams": {**cams(), key: values}, "ims": listed()}


def test_wrong_conventions_are_found(base: Path) -> None:
    own = cams()
    inverted = {
        **own,
        "R": [r.T for r in own["R"]],
        "T": [-r.T @ t for r, t in zip(own["R"], own["T"], strict=True)],
    }
    for content, said in (
        ({"cams": inverted, "ims": listed()}, "the poses were written in the other direction"),
        (
            changed("T", [t / 1000 for t in own["T"]]),
            r"cameras lie up to 0\.00\d+ m apart where the files' unit is mill",
        ),
        (changed("T", [t * 10 for t in own["T"]]), "were the places|Were the places converted"),
        (
            changed("K", [np.diag([0.5, 0.5, 1]) @ k for k in own["K"]]),
            "the intrinsics are for pictures of another size",
        ),
        (changed("K", [k.T for k in own["K"]]), r"the principal point \[0.0, 0.0\] px is not near"),
        (changed("R", [2 * r for r in own["R"]]), r"camera Camera \(1\)"),
    ):
        save(base / "annots.npy", content)
        with pytest.raises(UserError, match=said):
            find(base)


def test_the_order_of_tangential_coefficients_is_harmless() -> None:
    """p1 and p2 of up to 1e-3: no pixel of 1024 moves by more than 1.5 px."""
    k = np.array([[1100.0, 0, 512], [0, 1100, 512], [0, 0, 1]])
    corner = np.array([512 / 1100, 512 / 1100, 1.0])
    landed = [
        import_capture.project(k, np.array([0, 0, *p]), np.eye(3), np.zeros(3), corner)
        for p in ((1e-3, 5e-4), (5e-4, 1e-3))
    ]
    assert np.abs(landed[0] - landed[1]).max() < 1.5


def test_broken_files_get_a_sentence(base: Path) -> None:
    place = base / "annots.npy"
    for content, said in (
        ({"cams": {"K": []}}, "holds no cams with K, D, R and T"),
        ([1], r"it holds \(1,\) of <i8, one object"),
        (changed("K", cams()["K"][:2]), r"cams has lists of \{'K': 2, 'D': 3"),
        (changed("T", ["x"] * 3), "T 'x' is not made of numbers"),
        (changed("T", [np.full(3, np.nan)] * 3), "holds nan; calibrate again"),
        ({"cams": cams(), "ims": [{"ims": ["../../planted.jpg"]}]}, "does not lie below the folder"),
        ({"cams": cams(), "ims": [{"ims": [7]}]}, "frame 0 names the picture 7, a path is expected"),
        ({"cams": cams(), "ims": [{}]}, "ims must be a list over frames"),
        ({"cams": cams(), "ims": [{"ims": ["a/1.jpg"] * 4}]}, "frame 0 has 4 pictures, and there are 3 cameras"),
        ({"cams": cams(), "ims": [{"ims": ["a/1.jpg"]}, {"ims": ["b/2.jpg"]}]}, "a camera has one folder"),
        ({"cams": cams(), "ims": [{"ims": ["a/1.jpg", "a/2.jpg"]}]}, "two cameras have their pictures in a"),
        ({"cams": cams(), "ims": [{"ims": ["none/1.jpg"]}]}, "none of the pictures that .* names is in"),
        ({"cams": cams(), "ims": os.system}, "asks for 'posix.system'"),
    ):
        save(place, content)
        with pytest.raises(UserError, match=said):
            find(base)
    place.write_bytes(place.read_bytes()[:-9])
    with pytest.raises(UserError, match=r"annots\.npy: .*damaged or cut off|asks for"):
        find(base)
    place.unlink()
    with pytest.raises(UserError, match=r"there is no annots\.npy in"):
        find(base)
