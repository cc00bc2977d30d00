"""Written videos: what a browser needs is in the file, and colours come back."""

from __future__ import annotations

import av
import numpy as np
import pytest

from posegaussian.storage.exporters.video import write_video
from posegaussian.storage.model.errors import SourceError, UserError
from posegaussian.storage.readers.video import VideoFile


def smooth(count: int, height: int, width: int) -> np.ndarray:
    """Moving colour gradients: smooth, so that chroma at half resolution loses little."""
    t, y, x = np.meshgrid(np.arange(count), np.linspace(0, 1, height), np.linspace(0, 1, width), indexing="ij")
    rgb = np.stack([x, y, 0.5 + 0.5 * np.sin(x + y + 0.3 * t)], axis=-1)
    return np.rint(30 + 190 * rgb).astype(np.uint8)


@pytest.mark.parametrize(("height", "width"), [(64, 96), (720, 64), (63, 97)])
def test_colours_come_back(tmp_path, height, width):
    frames = smooth(4, height, width)
    assert write_video(tmp_path / "a.mp4", frames, 30) == 4
    video = VideoFile(tmp_path / "a.mp4")
    assert (video.count, video.rate, video.size) == (4, 30, (width + width % 2, height + height % 2))
    back = np.stack(list(video.read(range(4))))[:, :height, :width].astype(int)
    # x264 at crf 16 and chroma at half resolution, on gradients: measured 1.1 counts on average, 11 at the worst pixel;
    # the BT.601 matrix instead of BT.709 would be off by more than 20
    assert np.abs(back - frames).mean() < 2
    assert np.abs(back - frames).max() <= 14


def test_the_file_is_what_browsers_play(tmp_path):
    write_video(tmp_path / "a.mp4", smooth(3, 31, 33), 29.97)
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.codec.name, context.pix_fmt, context.width, context.height) == ("h264", "yuv420p", 34, 32)
        assert [int(getattr(context, n)) for n in ("color_primaries", "color_trc", "colorspace", "color_range")] == [
            1,
            1,
            1,
            1,
        ]
        assert float(stream.average_rate) == pytest.approx(29.97, abs=1e-3)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays before it is whole


@pytest.mark.parametrize("rate", [1 / 3600, 1 / 2500, 0.04, 23.976, 2000, 5000, 1e6])
def test_every_frame_comes_at_its_time_however_slow_or_fast(tmp_path, rate):
    write_video(tmp_path / "a.mp4", smooth(4, 32, 32), rate)
    with av.open(str(tmp_path / "a.mp4")) as container:
        times = [frame.time for frame in container.decode(video=0)]
    np.testing.assert_allclose(times, np.arange(4) / rate, rtol=1e-3)


@pytest.mark.parametrize("rate", [0.0, -25.0, 1e-5, 2e6, float("nan")])
def test_a_rate_that_no_video_has_is_refused(tmp_path, rate):
    with pytest.raises(UserError, match=r"a video has 1 in 3600 seconds to 1000000 a second"):
        write_video(tmp_path / "a.mp4", smooth(2, 32, 32), rate)
    assert list(tmp_path.iterdir()) == []


def test_padding_repeats_the_edge(tmp_path):
    frames = np.full((2, 33, 33, 3), 200, np.uint8)
    write_video(tmp_path / "a.mp4", frames, 30)
    picture = next(VideoFile(tmp_path / "a.mp4").read([0]))
    assert picture.shape == (34, 34, 3)
    assert np.abs(picture.astype(int) - 200).max() <= 3


def test_equal_frames_give_equal_bytes(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, smooth(5, 32, 32), 30)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_nothing_half_written_is_left(tmp_path):
    with pytest.raises(UserError, match="no frames"):
        write_video(tmp_path / "a.mp4", [], 30)
    with pytest.raises(UserError, match=r"\.mp4, not \.avi"):
        write_video(tmp_path / "a.avi", smooth(1, 32, 32), 30)
    with pytest.raises(ValueError, match=r"frame 1 is uint8 \(32, 30, 3\)"):
        write_video(tmp_path / "a.mp4", [np.zeros((32, 32, 3), np.uint8), np.zeros((32, 30, 3), np.uint8)], 30)

    def broken():
        yield np.zeros((32, 32, 3), np.uint8)
        raise SourceError("no more")

    with pytest.raises(SourceError, match="no more"):
        write_video(tmp_path / "a.mp4", broken(), 30)
    assert list(tmp_path.iterdir()) == []
