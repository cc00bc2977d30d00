"""Whether a video is whole: what is cut off is refused in its own words, and what only leaves frames out is not."""

from __future__ import annotations

import av
import numpy as np
import pytest

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video import VideoFile
from tests.support.video_clips import copied, counted, counting_clip

UNTAGGED = (b"DURATION", b"XURATION")
"""What makes the tag of a track's length another tag."""


def cut(path, share):
    data = path.read_bytes()
    target = path.with_name(f"cut_{path.name}")
    target.write_bytes(data[: int(share * len(data))])
    return target


@pytest.fixture
def film(tmp_path):
    """A Matroska file of 70 frames, 2.33 s, of much the same size."""
    whole = counting_clip(tmp_path / "a.mkv", 70, (64, 64), codec="ffv1", g=1)
    assert VideoFile(whole).count == 70
    assert VideoFile(whole).perhaps_cut is None
    return whole


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_matroska_file_is_cut_off_where_it_ends_before_the_time_its_track_is_tagged_with(film, share):
    with pytest.raises(SourceError, match=r"is cut off: it says that it lasts 2\.3 s and ends after [01]\.\d s; copy"):
        VideoFile(cut(film, share))


def test_a_matroska_file_without_that_tag_only_may_be_cut_off(film):
    film.write_bytes(film.read_bytes().replace(*UNTAGGED))
    assert VideoFile(film).perhaps_cut is None
    short = VideoFile(cut(film, 0.5))
    held, said = short.perhaps_cut
    assert held == pytest.approx(short.count / 30, abs=0.01)
    assert said == pytest.approx(70 / 30, abs=0.01)


def test_a_longer_sound_track_does_not_make_a_video_seem_cut_off(film, tmp_path):
    both = tmp_path / "both.mkv"
    with av.open(str(film)) as i, av.open(str(both), "w") as o:
        video = o.add_stream_from_template(i.streams.video[0])
        sound = o.add_stream("pcm_s16le", rate=8000, layout="mono")
        for packet in i.demux(video=0):
            if packet.dts is not None:
                packet.stream = video
                o.mux(packet)
        for second in range(5):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.int16), format="s16", layout="mono")
            frame.sample_rate, frame.pts = 8000, 8000 * second
            o.mux(sound.encode(frame))
        o.mux(sound.encode(None))
    with av.open(str(both)) as container:
        assert container.duration / 1e6 == pytest.approx(5, abs=0.1)
    assert VideoFile(both).count == 70
    both.write_bytes(both.read_bytes().replace(*UNTAGGED))
    assert VideoFile(both).perhaps_cut is None


def test_a_fragmented_mp4_that_ends_within_a_frame_promises_nothing(tmp_path):
    whole = counting_clip(tmp_path / "whole.mp4", 40, (64, 64), g=5, crf=1)
    parts = copied(whole, tmp_path / "parts.mp4", movflags="frag_keyframe+empty_moov")
    assert VideoFile(parts).count == 40
    with av.open(str(parts)) as container:
        third = [p for p in container.demux(video=0) if p.size][12]
    end = cut(parts, (third.pos + third.size / 2) / parts.stat().st_size)
    with pytest.raises(SourceError, match=r"is cut off: it ends within a frame, after 12 whole ones; copy it again"):
        VideoFile(end)


@pytest.mark.parametrize("earlier", [3, 12, 25])
def test_frames_before_an_edit_list_begins_are_not_lacking(tmp_path, earlier):
    """A player shows frames `earlier` to the last; whole groups before them are not even handed out."""
    whole = counting_clip(tmp_path / "whole.mp4", 40, g=10, bf=2, sc_threshold=0)
    edited = copied(whole, tmp_path / "edited.mp4", earlier, avoid_negative_ts="disabled", use_editlist="1")
    video = VideoFile(edited)
    pictures = [counted(p) for p in video.read(range(video.count))]
    assert pictures == list(range(earlier, 40))
    for start in range(video.count):
        assert [counted(p) for p in video.read([start])] == [earlier + start]


def test_an_edit_list_does_not_hide_that_a_file_is_cut_off(tmp_path):
    whole = counting_clip(tmp_path / "whole.mp4", 40, g=10, sc_threshold=0)
    edited = copied(whole, tmp_path / "edited.mp4", 12, avoid_negative_ts="disabled", movflags="faststart")
    with pytest.raises(SourceError, match="is cut off: it promises 40 frames and holds"):
        VideoFile(cut(edited, 0.9))
