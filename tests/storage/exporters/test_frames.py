"""Written frames: names, the table, and alpha."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from posegaussian.storage.exporters.frames import write_frames
from posegaussian.storage.readers.images import read_picture


def test_names_table_and_pictures(tmp_path):
    pictures = np.random.default_rng(0).integers(0, 256, (2, 6, 8, 3), np.uint8)
    numbers, time = [10, 12, 14], [10 / 30, 12 / 30, 14 / 30]
    assert (
        write_frames(
            tmp_path, ["mid", "side"], numbers, time, [("mid", 12, pictures[0], None), ("side", 14, pictures[1], None)]
        )
        == 2
    )
    np.testing.assert_array_equal(read_picture(tmp_path / "mid" / "000012.png"), pictures[0])
    np.testing.assert_array_equal(read_picture(tmp_path / "side" / "000014.png"), pictures[1])
    rows = list(csv.DictReader((tmp_path / "frames.csv").open()))
    assert [(r["frame"], r["index"], float(r["time"])) for r in rows] == [("12", "1", 12 / 30), ("14", "2", 14 / 30)]


def test_alpha_only_where_asked(tmp_path):
    import OpenImageIO as oiio

    straight = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
    alpha = np.full((6, 8), 128, np.uint8)
    alpha[0], alpha[1] = 0, 255
    premultiplied = np.rint(straight * (alpha[..., None] / 255)).astype(np.uint8)
    write_frames(tmp_path, ["a"], [0, 1], [0.0, 0.1], [("a", 0, premultiplied, alpha), ("a", 1, premultiplied, None)])
    channels = [oiio.ImageInput.open(str(tmp_path / "a" / f"{n:06d}.png")).spec().nchannels for n in (0, 1)]
    assert channels == [4, 3]
    back = read_picture(tmp_path / "a" / "000000.png")
    np.testing.assert_array_equal(back[1], straight[1])
    # half a count of the premultiplied value at alpha 128
    assert np.abs(back[2:].astype(int) - straight[2:]).max() <= 1
    assert not back[0].any()


def test_an_export_that_is_ended_half_way_leaves_no_table_of_pictures_of_two_exports(tmp_path):
    dark, light = np.zeros((4, 4, 3), np.uint8), np.full((4, 4, 3), 200, np.uint8)
    numbers, time = [0, 1], [0.0, 0.1]
    write_frames(tmp_path, ["a"], numbers, time, [("a", n, dark, None) for n in numbers])

    def killed():
        yield "a", 0, light, None
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_frames(tmp_path, ["a"], numbers, time, killed())
    assert [read_picture(tmp_path / "a" / f"{n:06d}.png").max() for n in numbers] == [200, 0]
    assert not (tmp_path / "frames.csv").exists()
    write_frames(tmp_path, ["a"], numbers, time, [("a", n, light, None) for n in numbers])
    assert (tmp_path / "frames.csv").exists()


def test_unknown_cameras_and_frames_are_refused(tmp_path):
    picture = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(ValueError, match="camera 'b'"):
        write_frames(tmp_path, ["a"], [0], [0.0], [("b", 0, picture, None)])
    with pytest.raises(ValueError, match="frame 7"):
        write_frames(tmp_path, ["a"], [0], [0.0], [("a", 7, picture, None)])
