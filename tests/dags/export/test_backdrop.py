"""Pictures over a background: what may be asked for, where a plate comes from,
and that nothing but the files changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.export.background import Backdrop, filling, over, parse, turned
from posegaussian.dags.export.pictures import export_video, pictures
from posegaussian.dags.export.request import ExportOrder
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.archive import shards
from posegaussian.storage.exporters.images_layout import write_capture
from posegaussian.storage.exporters.video import write_video
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.readers.images import read_picture, write_png
from tests.support.pipeline import NAME, Pipeline, film

SIZE = 48


def room(views: int) -> np.ndarray:
    """[V, h, w, 3] a smooth background of its own for every camera."""
    rows, columns = np.mgrid[:SIZE, :SIZE]
    return np.stack(
        [np.stack([40 + 3 * rows, 200 - 3 * columns, np.full_like(rows, 60 + 20 * v)], axis=-1) for v in range(views)]
    ).astype(np.uint8)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """A person before walls, rendered; masks are given, so nothing of the run itself asks for a plate."""
    folder = tmp_path_factory.mktemp("backdrop")
    p = capture_person(views=4, size=SIZE, frames=6, held_out=1, motion="kick")
    share = p.mask[..., None] / 255.0
    color = np.rint(p.color * share + room(5)[None] * (1 - share)).astype(np.uint8)
    write_capture(
        folder / "capture", p.rig, color, mask=p.mask, joints2d=p.joints2d, depth=p.depth, frame_rate=p.frame_rate
    )
    pipeline = Pipeline(folder / "archive", folder / "capture", ["depth.method=truth"], 3)
    pipeline.register()
    pipeline.run()
    return pipeline


def order(background: str, folder: Path, **more: object) -> ExportOrder:
    return ExportOrder(**{"frames": folder, "backdrop": parse(background), **more})  # type: ignore[arg-type]


def exported(p: Pipeline, background: str, folder: Path) -> dict[str, np.ndarray]:
    wanted = order(background, folder)
    plan = p.session.plan(NAME, Selection(), (), wanted.needed)
    p.session.run_and_report([plan], Selection())
    wanted.write(plan)
    return {f.relative_to(folder).as_posix(): read_picture(f) for f in sorted(folder.rglob("*.png"))}


def test_a_render_stands_where_the_camera_saw_it(made: Pipeline, tmp_path: Path) -> None:
    p = made.copy(tmp_path / "archive")
    assert not (p.root / NAME / "survey/plate").exists()
    before = p.plan().counts("rendering")
    pictures = exported(p, "plate", tmp_path / "out")
    assert p.plan().all_fresh, "the survey was asked for more, and nothing else was made again"
    assert p.plan().counts("rendering") == before
    assert len(pictures) == 6
    for name, picture in pictures.items():
        filmed = read_picture(p.folder / "images" / name)
        mask = read_picture(p.folder / "masks" / name)[..., 0]
        # The plate is a median of six frames; where the person stood in most of them nobody knows it.
        assert np.median(np.abs(picture.astype(int) - filmed)[mask == 0]) <= 1
        assert np.abs(picture.astype(int) - filmed)[mask == 0].mean() < 4


def test_a_colour_and_a_picture_fill_what_the_render_leaves(made: Pipeline, tmp_path: Path) -> None:
    black, green = exported(made, "none", tmp_path / "black"), exported(made, "#20c040", tmp_path / "green")
    write_png(tmp_path / "wall.png", np.full((30, 90, 3), (32, 192, 64), np.uint8))
    wall = exported(made, str(tmp_path / "wall.png"), tmp_path / "wall")
    assert black.keys() == green.keys() == wall.keys()
    for name, picture in green.items():
        empty = read_picture(made.folder / "masks" / name)[..., 0] == 0
        np.testing.assert_array_equal(picture[0, 0], (32, 192, 64))
        assert (picture >= black[name]).all()
        assert (black[name][empty] == 0).mean() > 0.8
        np.testing.assert_array_equal(wall[name], picture)


def test_a_plate_is_refused_where_nobody_filmed_it(made: Pipeline, tmp_path: Path) -> None:
    wanted = order("plate", tmp_path)
    with pytest.raises(ConfigError, match=r"orbit.* m from the nearest camera.*--path held_out"):
        wanted.needed(made.context("orbit"))
    assert wanted.needed(made.context("still cam01"))
    single = made.with_settings("frames.range=0:1")
    assert wanted.needed(single.context()), "other frames of the source show the background"


@pytest.mark.parametrize(
    ("background", "more", "said"),
    [
        ("#12345", {}, "six hexadecimal digits"),
        ("#12345g", {}, "six hexadecimal digits"),
        ("nowhere.png", {}, "no such file.*none, plate"),
        ("plate", {"alpha": True}, "--alpha"),
        ("#000000", {"frames": None, "sheet": Path("s.png")}, "--video FILE or --frames FOLDER"),
        ("none", {"frames": None}, "--splats FOLDER"),
    ],
)
def test_what_cannot_be_is_said(background: str, more: dict, said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        order(background, tmp_path, **more)


def test_wishes_are_read() -> None:
    assert parse("none") == Backdrop("none")
    assert parse("#0Aff10").color == (10, 255, 16)


def test_over_is_a_blend_by_alpha() -> None:
    random = np.random.default_rng(0)
    behind = random.integers(0, 256, (8, 8, 3), np.uint8)
    straight = random.integers(0, 256, (8, 8, 3), np.uint8)
    np.testing.assert_array_equal(over(np.zeros_like(behind), np.zeros((8, 8), np.uint8), behind), behind)
    np.testing.assert_array_equal(over(straight, np.full((8, 8), 255, np.uint8), behind), straight)
    alpha = random.integers(0, 256, (8, 8), np.uint8)
    share = alpha[..., None] / 255
    found = over(np.rint(straight * share).astype(np.uint8), alpha, behind)
    assert np.abs(found - (straight * share + behind * (1 - share))).max() <= 1.0


def test_a_plate_is_turned_into_the_target_camera() -> None:
    k, picture = np.array([[50.0, 0, 24], [0, 50, 24], [0, 0, 1]]), room(1)[0]
    same = (k, np.eye(3))
    np.testing.assert_array_equal(turned(picture, same, same, (SIZE, SIZE)), picture)
    moved = turned(picture, same, (k + np.array([[0, 0, 3.0], [0, 0, 0], [0, 0, 0]]), np.eye(3)), (SIZE, SIZE))
    np.testing.assert_array_equal(moved[:, 3:], picture[:, :-3])
    assert not moved[:, :3].any(), "what the camera did not see is black"
    half = turned(picture, same, (np.diag([0.5, 0.5, 1]) @ k, np.eye(3)), (24, 24))
    assert np.abs(half - picture.reshape(24, 2, 24, 2, 3).mean(axis=(1, 3))).max() <= 1
    away = turned(picture, same, (k, np.diag([-1.0, 1, -1])), (SIZE, SIZE))
    assert not away.any(), "behind the camera"


def test_a_picture_fills_the_frame_from_its_middle() -> None:
    wide = np.zeros((10, 40, 3), np.uint8)
    wide[:, 15:25] = 255
    np.testing.assert_array_equal(filling(wide, (10, 10)), np.full((10, 10, 3), 255))
    assert filling(wide, (33, 21)).shape == (21, 33, 3)


def test_the_video_of_each_camera_reads_and_fills_its_own_pictures_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And says what those of all cameras, taken apart, say."""
    # x264 makes other bytes of the same tiny pictures, 32 or 64 px, in one of fifty runs
    film(tmp_path / "capture", views=3, size=128, frames=4, held_out=2)
    p = Pipeline(tmp_path / "archive", tmp_path / "capture", ["depth.method=hull"], held_out="[mid00,mid01]")
    p.register()
    p.run()
    context, backdrop = p.context(), Backdrop("color", (9, 90, 200))
    results, (path,) = Results(context), context.paths.values()
    apart = [[picture for _, c, picture, _ in pictures(results, path, backdrop) if c == camera] for camera in range(2)]
    filled, read = [], []
    plain = shards.read_array
    monkeypatch.setattr(shards, "read_array", lambda *words: read.append(plain(*words)) or read[-1])
    monkeypatch.setattr(
        "posegaussian.dags.export.pictures.over", lambda *layers: filled.append(layers) or over(*layers)
    )
    written = export_video(results, path, tmp_path / "out.mp4", backdrop)
    assert [f.name for f in written] == ["out_mid00.mp4", "out_mid01.mp4"]
    assert len(filled) == sum(map(len, apart)) == 8
    assert {a.shape[1] for a in read} == {1}
    for file, own in zip(written, apart, strict=True):
        write_video(tmp_path / "own.mp4", own, context.capture.frame_rate)
        assert file.read_bytes() == (tmp_path / "own.mp4").read_bytes()
