"""A capture survives JSON, and its files are what they were at import or an error."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.archive.records import read_capture
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import BrokenRecord, SourceError, UserError
from tests.support.sample_captures import fake_file, make_capture


def through_json(capture: Capture) -> Capture:
    return Capture.from_json(json.loads(json.dumps(capture.to_json())))


@pytest.mark.parametrize("masks", [True, False])
@pytest.mark.parametrize("joints", [True, False])
def test_json_and_back_keeps_everything(masks: bool, joints: bool) -> None:
    capture = make_capture(masks=masks, joints=joints)
    some = tuple(None if v == 1 else s for v, s in enumerate(capture.joints))
    capture = replace(
        capture, joints=some, joints3d=Stream("trc", (fake_file("t"),), (0, 1), options={"joint_set": "body25b"})
    )
    back = through_json(capture)
    assert back.to_json() == capture.to_json()
    assert back.rig.digest == capture.rig.digest
    for kind in ("pictures", "masks", "joints", "depth", "joints3d"):
        assert back.streams(kind) == capture.streams(kind), kind
        assert back.has(kind) == capture.has(kind)
    assert (back.layout, back.frame_rate, back.notes) == (capture.layout, capture.frame_rate, capture.notes)


def test_crops_and_roles_are_kept_and_records_without_them_are_read() -> None:
    """Archives of older versions have neither."""
    capture = make_capture()
    name = capture.rig.names[1]
    back = through_json(replace(capture, crops={name: Crop(scale=1.5, offset=(1, -2))}, held_out=(name,)))
    assert (back.crops, back.held_out) == ({name: Crop(scale=1.5, offset=(1, -2))}, (name,))
    old = {k: v for k, v in capture.to_json().items() if k not in ("crops", "held_out")}
    assert Capture.from_json(old).to_json() == through_json(capture).to_json()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("crops", {"../x": {"scale": 1}}),
        ("held_out", ["nobody"]),
        ("held_out", [3]),
        ("crops", {"a": {"scale": 1e300}}),
        ("crops", {"a": {"scale": 1, "offset": [0, 1e300]}}),
        ("crops", 5),
    ],
)
def test_a_record_with_crops_or_roles_of_no_camera_is_broken(key: str, value: object) -> None:
    capture = make_capture()
    capture = replace(capture, rig=replace(capture.rig, names=("a", *capture.rig.names[1:])))
    assert read_capture({"capture": capture.to_json()}, Path("zarr.json")).rig.names == capture.rig.names
    with pytest.raises(BrokenRecord, match=r"zarr\.json does not describe a capture"):
        read_capture({"capture": {**capture.to_json(), key: value}}, Path("zarr.json"))


def test_cameras_keep_every_bit() -> None:
    capture = make_capture()
    k = capture.rig.intrinsics * (1 + 1e-16) / 3
    capture = replace(capture, rig=replace(capture.rig, intrinsics=k))
    np.testing.assert_array_equal(through_json(capture).rig.intrinsics, k)


def test_numbers_are_those_of_any_view() -> None:
    capture = make_capture()
    shorter = tuple(
        replace(s, files=s.files[v : 6 + v], numbers=s.numbers[v : 6 + v]) for v, s in enumerate(capture.pictures)
    )
    assert replace(capture, pictures=shorter).numbers.tolist() == list(range(8))


def test_a_digest_of_frames_follows_only_their_files() -> None:
    stream, *_ = make_capture().pictures
    other = list(stream.files)
    other[7] = fake_file("changed")
    changed = replace(stream, files=tuple(other))
    assert changed.digest([0, 1, 2]) == stream.digest([0, 1, 2])
    assert changed.digest([6, 7]) != stream.digest([6, 7])
    assert stream.digest([2, 1]) == stream.digest([1, 2])
    assert stream.digest([1, 2]) != stream.digest([1, 3])
    assert stream.digest([1, 99]) == stream.digest([1]), "numbers the view does not have count for nothing"


def test_a_digest_follows_the_whole_video_and_the_options() -> None:
    video = Stream("video", (fake_file("v"),), tuple(range(10)), (40, 30))
    assert replace(video, files=(fake_file("w"),)).digest([1]) != video.digest([1])
    assert video.digest([1]) != video.digest([2])
    early, late = (replace(video, numbers=n, options={"indices": [0, 1, 2]}) for n in ((0, 1, 5), (0, 5, 6)))
    assert (early.index_of(5), late.index_of(5), early.index_of(2), video.index_of(5)) == (2, 1, None, 5)
    assert early.digest([5]) != late.digest([5])
    assert early.digest([0]) == late.digest([0])
    joints = Stream("openpose", (fake_file("v"),), (0,), options={"joint_set": "body25"})
    assert replace(joints, options={"joint_set": "body25b"}).digest([0]) != joints.digest([0])


def test_a_digest_does_not_follow_where_the_files_lie_or_when_they_were_touched() -> None:
    stream, *_ = make_capture().pictures
    moved = replace(stream, files=tuple(replace(f, path="/elsewhere", mtime_ns=1) for f in stream.files))
    assert moved.digest(range(10)) == stream.digest(range(10))


def test_a_file_is_known_by_content(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"picture")
    file = SourceFile.of(path)
    assert (file.path, file.size) == (str(path), 7)
    file.verify()
    os.utime(path, ns=(1, 1))
    file.verify()
    path.write_bytes(b"changed")
    os.utime(path, ns=(2, 2))
    with pytest.raises(
        SourceError,
        match=(
            r"a\.png changed since it was imported: it has the same size and another content; put the old one back or"
            r" import"
        ),
    ):
        file.verify()
    path.write_bytes(b"longer than before")
    with pytest.raises(SourceError, match="it has 18 bytes, not 7"):
        file.verify()
    path.unlink()
    with pytest.raises(SourceError, match=r"cannot be read any more .*put it back or import"):
        file.verify()


def test_only_a_second_reading_finds_what_kept_size_and_time(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(b"picture")
    file = SourceFile.of(path)
    assert file.damage() is None
    path.write_bytes(b"changed")
    os.utime(path, ns=(file.mtime_ns, file.mtime_ns))
    assert not file.touched
    file.verify()
    assert file.damage() == "it has the same size and another content"
    path.write_bytes(b"longer than before")
    assert file.damage() == "it has 18 bytes, not 7"
    path.unlink()
    path.mkdir()
    with pytest.raises(SourceError, match="it is a folder"):
        file.damage()


def test_a_missing_file_and_a_folder_get_a_sentence(tmp_path: Path) -> None:
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(SourceError, match="cannot read") as error:
            SourceFile.of(path)
        assert str(path) in str(error.value)
        assert isinstance(error.value, UserError)
