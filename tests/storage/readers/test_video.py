"""Laws of video decoding: every way to a frame gives the same frame; colours follow the H.273 equations."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest
from av.video.frame import PictureType

from posegaussian.storage.exporters.video import write_video
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.video import VideoFile
from posegaussian.storage.readers.wide_color import HLG, PQ, WideColor
from tests.support.video_clips import counted, counting_clip, planes, write_clip

CONTAINERS = [
    ("a.mp4", {"g": 7, "bf": 3}),
    ("b.mkv", {"g": 7, "bf": 3, "x264-params": "open-gop=1:scenecut=0"}),
    ("c.mp4", {"g": 7, "bf": 3, "x264-params": "open-gop=1:scenecut=0"}),
    ("d.avi", {"codec": "mpeg4", "g": 5, "qmin": 1, "qmax": 2, "b": 10**8}),
    ("e.mp4", {"codec": "libvpx-vp9", "g": 9}),
    ("g.avi", {"codec": "libx264", "g": 9, "bf": 2}),
    ("f.mp4", {"codec": "mpeg4", "g": 10, "bf": 2, "qmin": 1, "qmax": 2, "b": 10**8}),
]


@pytest.mark.parametrize(("name", "options"), CONTAINERS)
@pytest.mark.parametrize("gap", [0, 48])
def test_any_frames_are_the_frames_of_the_whole(tmp_path, monkeypatch, name, options, gap):
    monkeypatch.setattr("posegaussian.storage.readers.video._SEEK_GAP", gap)
    video = VideoFile(counting_clip(tmp_path / name, 60, **options))
    assert video.count == 60
    assert video.size == (32, 32)
    whole = list(video.read(range(60)))
    assert [counted(p) for p in whole] == list(range(60))
    for numbers in (
        [0],
        [59],
        [13],
        [7, 8],
        [1, 20, 21, 40, 59],
        list(range(3, 60, 5)),
        [48, 49, 50, 51, 52, 53, 54, 55, 56],
    ):
        for n, picture in zip(numbers, video.read(numbers), strict=True):
            np.testing.assert_array_equal(picture, whole[n])


@pytest.mark.parametrize(("frames", "options"), [(150, ""), (150, ":bframes=2:b-pyramid=none"), (90, ":ref=4")])
@pytest.mark.parametrize("name", ["a.mp4", "b.mkv"])
def test_pictures_renewed_a_column_at_a_time_are_those_of_the_whole(tmp_path, name, frames, options):
    # Three intra refreshes or more, each of 8 columns over 7 frames; the frame numbers of H.264 wrap at recovery points
    # 32, 64, 96 and 128, where a decoder that begins there loses the picture.
    texture = np.random.default_rng(0).integers(16, 235, (64, 128 + frames), np.uint8)
    clip = write_clip(
        tmp_path / name,
        [planes(np.ascontiguousarray(texture[:, i : i + 128])) for i in range(frames)],
        preset="ultrafast",
        **{"x264-params": f"intra-refresh=1:keyint=32:scenecut=0{options}"},
    )
    with av.open(str(clip)) as container:
        keys = sum(p.is_keyframe for p in container.demux(video=0))
        container.seek(0)
        whole_pictures = sum(f.pict_type == PictureType.I for f in container.decode(video=0))
    if whole_pictures != 1 or keys < 2:
        pytest.skip("the encoder has no intra refresh")
    video = VideoFile(clip)
    whole = list(video.read(range(frames)))
    assert len(whole) == frames
    for start in range(frames):
        for n, picture in enumerate(video.read(range(start, min(start + 4, frames))), start):
            np.testing.assert_array_equal(picture, whole[n], err_msg=f"frame {n}, read from {start} on")
    for n, picture in zip(range(5, frames, 60), video.read(range(5, frames, 60)), strict=True):
        np.testing.assert_array_equal(picture, whole[n])


def test_indices_must_ascend_and_exist(tmp_path):
    video = VideoFile(counting_clip(tmp_path / "a.mp4", 5))
    with pytest.raises(SourceError, match="has frames 0 to 4, not 5"):
        next(video.read([5]))
    with pytest.raises(ValueError, match="ascend"):
        next(video.read([3, 2]))
    assert list(video.read([])) == []


def equation(y, u, v, kr, kb, full):
    """ITU-T H.273 (8.3.3-4): YCbCr to RGB from the luma weights."""
    luma, cb, cr = (
        (y / 255, (u - 128) / 255, (v - 128) / 255) if full else ((y - 16) / 219, (u - 128) / 224, (v - 128) / 224)
    )
    red, blue = luma + 2 * (1 - kr) * cr, luma + 2 * (1 - kb) * cb
    green = (luma - kr * red - kb * blue) / (1 - kr - kb)
    return np.clip(255 * np.array([red, green, blue]), 0, 255)


BT709, BT601, BT2020 = (0.2126, 0.0722), (0.299, 0.114), (0.2627, 0.0593)


@pytest.mark.parametrize(
    ("height", "tags", "weights", "full"),
    [
        (720, {}, BT709, False),
        (718, {}, BT601, False),
        (718, {"colorspace": 1, "color_range": 1}, BT709, False),
        (720, {"colorspace": 5, "color_range": 1}, BT601, False),
        (720, {"colorspace": 6}, BT601, False),
        (720, {"colorspace": 1, "color_range": 2}, BT709, True),
        (720, {"colorspace": 9}, BT2020, False),
    ],
)
def test_colours_follow_tags_or_the_number_of_lines(tmp_path, height, tags, weights, full):
    patches = [(128, 90, 170), (200, 128, 128), (100, 160, 100), (60, 140, 120)]
    # flat frames, nearly lossless: what is left is the rounding of the codec and of swscale, a count or two
    frames = [planes(np.full((height, 64), y, np.uint8), u, v) for y, u, v in patches]
    video = VideoFile(write_clip(tmp_path / "a.mp4", frames, tags=tags, crf=1, g=1))
    for patch, picture in zip(patches, video.read(range(4)), strict=True):
        np.testing.assert_allclose(picture[height // 2, 32], equation(*patch, *weights, full), atol=3)


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_high_dynamic_range_is_brought_to_srgb(tmp_path, transfer):
    """By the equations of its matrix and of its transfer; 8 bits of limited range are a level or two of either."""
    patches = [(128, 90, 170), (150, 128, 128), (100, 160, 100), (60, 140, 120)]
    frames = [planes(np.full((720, 64), y, np.uint8), u, v) for y, u, v in patches]
    tags = {"colorspace": 9, "color_trc": transfer, "color_primaries": 9}
    video = VideoFile(write_clip(tmp_path / "a.mp4", frames, tags=tags, crf=1, g=1))
    color = WideColor.of(transfer, 9)
    for patch, picture in zip(patches, video.read(range(4)), strict=True):
        coded = np.rint(257 * equation(*patch, *BT2020, False)).astype(np.uint16).reshape(1, 1, 3)
        near = [color.displayed(np.clip(coded.astype(int) + by, 0, 65535).astype(np.uint16)) for by in (-514, 514)]
        assert (picture[360, 32] >= near[0][0, 0].astype(int) - 3).all()
        assert (picture[360, 32] <= near[1][0, 0].astype(int) + 3).all()


def test_a_matrix_that_is_not_named_is_that_of_the_primaries(tmp_path):
    frames = [planes(np.full((720, 64), 128, np.uint8), 90, 170)]
    tags = {"color_trc": HLG, "color_primaries": 9}
    named, unnamed = (
        next(VideoFile(write_clip(tmp_path / f"{n}.mp4", frames, tags={**tags, **more}, crf=1)).read([0]))
        for n, more in (("a", {"colorspace": 9}), ("b", {}))
    )
    np.testing.assert_array_equal(unnamed, named)


def test_primaries_with_another_white_are_refused(tmp_path):
    frames = [planes(np.full((64, 64), 90, np.uint8))]
    with pytest.raises(SourceError, match=r"primaries 11 .* convert it to BT\.709 first"):
        VideoFile(write_clip(tmp_path / "a.mp4", frames, tags={"colorspace": 1, "color_primaries": 11}))


@pytest.mark.parametrize("rotation", [90, 180, 270])
def test_rotation_of_the_display_matrix_is_applied(tmp_path, rotation):
    luma = np.full((32, 64), 30, np.uint8)
    luma[:16, :16] = 220
    flat = next(VideoFile(write_clip(tmp_path / "flat.mp4", [planes(luma)])).read([0]))
    video = VideoFile(write_clip(tmp_path / "turned.mp4", [planes(luma)], rotation=rotation))
    turned = next(video.read([0]))
    # PyAV, as FFmpeg, counts the display rotation counter-clockwise, and so does numpy.rot90
    np.testing.assert_array_equal(turned, np.rot90(flat, rotation // 90))
    assert video.size == (turned.shape[1], turned.shape[0])


@pytest.mark.parametrize(("aspect", "square"), [("4/3", (85, 32)), ("8/9", (57, 32)), ("1/1", (64, 32))])
@pytest.mark.parametrize("rotation", [0, 90])
def test_the_size_with_square_pixels_is_that_of_a_player(tmp_path, aspect, square, rotation):
    path = tmp_path / "a.mp4"
    video = VideoFile(
        write_clip(path, [planes(np.full((32, 64), 30, np.uint8))], rotation=rotation, aspect=Fraction(aspect))
    )
    assert video.size == ((32, 64) if rotation else (64, 32))
    assert video.square_size == (square[::-1] if rotation else square)


def test_other_display_matrices_are_refused(tmp_path):
    path = write_clip(tmp_path / "a.mp4", [planes(np.full((32, 64), 30, np.uint8))], rotation=45)
    with pytest.raises(SourceError, match="display matrix"):
        VideoFile(path)


def test_unreadable_videos_get_a_sentence(tmp_path):
    with pytest.raises(SourceError, match="No such file"):
        VideoFile(tmp_path / "none.mp4")
    (tmp_path / "nothing.mp4").touch()
    with pytest.raises(SourceError, match=r"nothing\.mp4 is empty, 0 bytes"):
        VideoFile(tmp_path / "nothing.mp4")
    (tmp_path / "text.mp4").write_text("this is no video")
    with pytest.raises(SourceError, match=r"text\.mp4: Invalid data"):
        VideoFile(tmp_path / "text.mp4")
    whole = counting_clip(tmp_path / "a.mp4", 40, movflags="+faststart", g=5).read_bytes()
    (tmp_path / "headless.mp4").write_bytes(whole[-200:])
    with pytest.raises(SourceError, match="cannot read video"):
        VideoFile(tmp_path / "headless.mp4")


@pytest.fixture
def textured(tmp_path):
    """A video whose packets all carry much, with their places: (path, [(position, size)])."""
    blocks = np.kron(np.random.default_rng(0).integers(0, 255, (8, 8, 3), np.uint8), np.ones((16, 16, 1), np.uint8))
    write_video(tmp_path / "whole.mp4", [np.roll(blocks, 3 * i, 1) for i in range(20)], 30)
    with av.open(str(tmp_path / "whole.mp4")) as container:
        return tmp_path / "whole.mp4", [(p.pos, p.size) for p in container.demux(container.streams.video[0]) if p.size]


@pytest.mark.parametrize("inside", [0, 0.5])
@pytest.mark.parametrize("packet", [3, 19])
def test_a_video_that_is_cut_off_is_refused(tmp_path, textured, packet, inside):
    path, packets = textured
    position, size = packets[packet]
    (tmp_path / "cut.mp4").write_bytes(path.read_bytes()[: position + int(inside * size)])
    with pytest.raises(SourceError, match=f"cut off: it promises 20 frames and holds {packet} whole ones"):
        VideoFile(tmp_path / "cut.mp4")


def test_damaged_frames_are_refused_and_not_patched_up(tmp_path, textured):
    path, packets = textured
    data = bytearray(path.read_bytes())
    position, size = packets[6]
    data[position + size // 2 : position + size // 2 + 16] = (
        np.random.default_rng(1).integers(0, 255, 16, np.uint8).tobytes()
    )
    (tmp_path / "bad.mp4").write_bytes(data)
    with pytest.raises(SourceError, match=r"of video .*bad\.mp4 cannot be decoded"):
        list(VideoFile(tmp_path / "bad.mp4").read(range(20)))
