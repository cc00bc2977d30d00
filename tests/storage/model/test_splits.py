"""Protocols of data sets: places and not names, cameras and subjects that are not there, and sentences."""

from __future__ import annotations

import pytest

from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.splits import PROTOCOLS, Split, frames_of, said_of, split_named, splits_of
from posegaussian.storage.model.timegrid import parse_range, select

OF_23 = [f"Camera_B{n}" for n in range(1, 24)]
OF_21 = [f"Camera ({n})" for n in range(1, 24) if n not in (20, 21)]


def test_cameras_go_by_their_places_in_the_data_set() -> None:
    """313 has no cameras 20 and 21, so that place 19 is number 22; both kinds of subjects have the same 21 cameras."""
    whole = splits_of("zju_mocap", OF_23, OF_23, "CoreView_377")
    assert whole["zju_4"].sources == ("Camera_B1", "Camera_B7", "Camera_B13", "Camera_B19")
    assert set(whole["zju_4"].held_out) == {*OF_23} - {*whole["zju_4"].sources}
    assert whole["zju_1"].sources == ("Camera_B5",)
    small = splits_of("zju_mocap", OF_21, OF_21, "CoreView_313")
    numbers = [[int("".join(c for c in n if c.isdigit())) for n in s["zju_21"].sources] for s in (whole, small)]
    assert numbers[0] == numbers[1] == [n for n in range(1, 24) if n not in (20, 21)]
    assert not whole["zju_21"].held_out
    reordered = OF_21[::-1]
    assert splits_of("zju_mocap", reordered, OF_21, "x")["zju_4"].sources == tuple(reordered[p] for p in (0, 6, 12, 18))


def test_test_frames_are_those_of_the_subject() -> None:
    """Every 30th of those that Neural Body trains with; the one-camera protocol has 17."""
    for subject, first, count in (
        ("CoreView_313", 0, 2),
        ("my_377", 0, 10),
        ("390", 700, 10),
        ("CoreView_396", 810, 18),
    ):
        splits = splits_of("zju_mocap", OF_23, OF_23, subject)
        frames = select(range(2200), splits["zju_4"].frames or "")
        assert (frames[0], len(frames), {*(frames[1:] - frames[:-1]).tolist()}) == (first, count, {30})
        assert len(select(range(2200), splits["zju_1"].frames or "")) == 17
    assert splits_of("zju_mocap", OF_23, OF_23, "mine")["zju_4"].frames is None


def test_only_cameras_that_are_there_are_held_out() -> None:
    there = [n for n in OF_23 if n not in ("Camera_B2", "Camera_B7")]
    split = splits_of("zju_mocap", OF_23, there, "")["zju_4"]
    assert "Camera_B7" in split.sources
    assert set(split.held_out) == {*there} - {*split.sources}
    assert said_of({"zju_4": split}, there) == ["protocol zju_4 needs cameras that are not there: Camera_B7"]
    assert splits_of("zju_mocap", OF_23[:3], OF_23[:3], "")["zju_4"].sources[1:] == (
        "at place 6",
        "at place 12",
        "at place 18",
    )
    assert splits_of("easymocap", OF_23, OF_23, "") == {}


def test_a_name_of_another_data_set_gets_a_sentence() -> None:
    split = Split(("a",), ("b",))
    with pytest.raises(
        ConfigError, match=r"views.sources: zju_4 is a protocol of zju_mocap, and sequence walk came in as"
    ):
        split_named("zju_4", {}, "views.sources", "walk", "videos")
    with pytest.raises(ConfigError, match="it has gps_2"):
        split_named("zju_4", {"gps_2": split}, "views.sources", "walk", "gps_gaussian")
    with pytest.raises(ConfigError, match="protocol zju_4 tells no test frames for sequence walk; write them as"):
        frames_of("zju_4", {"zju_4": split}, "walk", "zju_mocap")
    assert frames_of("0:9:2", {}, "walk", "videos") == "0:9:2"


def test_every_protocol_has_ranges_that_parse() -> None:
    for protocol in PROTOCOLS.values():
        for text in protocol.frames.values():
            parse_range(text)
