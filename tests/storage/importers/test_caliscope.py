"""The caliscope importer: frame n is one instant in every view, whatever the videos lack,
and a sentence for everything wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, SourceError, UserError
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers.test_pose2sim import table
from tests.support import import_capture
from tests.support.video_clips import counted, counting_clip

CAMERAS = (1, 2, 10)
NAMES = ("cam_1", "cam_2", "cam_10")
FRAMES = 6
SEEN = {1: [0, 1, 2, 3, 4, 5], 2: [0, 1, 3, 4, 5], 10: [1, 2, 3, 4]}
"""{camera: the instants it saw}: cam_2 dropped one, cam_10 started late and ended early."""
LATE = {1: 0.0, 2: 0.004, 10: -0.003}
"""How much later than the first camera each one exposes, seconds."""
RATE = 30


def write_calibration(path: Path, **changes: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(table(v, f"cameras.{c}", cam_id=str(c), **changes) for v, c in enumerate(CAMERAS)))


def write_recording(
    base: Path,
    seen: Mapping[int, list[int]],
    first: int = 35,
    index: bool = True,
    camera: str = "cam_id",
    times: str = "timestamps.csv",
) -> None:
    """Videos whose frame k is the k-th instant seen, and the times, not in order; `first` is the first sync index."""
    base.mkdir(parents=True, exist_ok=True)
    rows = []
    for c, found in seen.items():
        counting_clip(base / f"{camera.removesuffix('_id')}_{c}.mp4", len(found), import_capture.SIZE, rate=RATE)
        rows += [(f"{first + n}," if index else "") + f"{c},{7.25 + n / RATE + LATE[c]!r}" for n in found]
    head = ("sync_index," if index else "") + f"{camera},frame_time"
    (base / times).write_text("\n".join([head, *rows[::-1]]) + "\n")


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write_recording(tmp_path / "walk", SEEN)
    write_calibration(tmp_path / "walk" / "camera_array.toml")
    return tmp_path / "walk"


def find(base: Path, **options: object) -> Capture:
    return find_capture("caliscope", base, options)


def seen_in(capture: Capture) -> dict[str, dict[int, int]]:
    """{camera: {frame number: which frame of the video comes}}, by what the decoded pictures show."""
    pictures = open_source(capture, "pictures")
    return {
        n: dict(zip(w, map(counted, pictures.read(v, w)), strict=True))
        for v, n in enumerate(capture.rig.names)
        for w in [pictures.numbers(v).tolist()]
    }


TRUE = {f"cam_{c}": {n: k for k, n in enumerate(found)} for c, found in SEEN.items()}


@pytest.mark.parametrize("index", [True, False])
def test_a_frame_is_one_instant_in_every_view(base: Path, index: bool) -> None:
    write_recording(base, SEEN, index=index)
    capture = find(base)
    assert capture.rig.names == NAMES
    assert seen_in(capture) == TRUE
    assert capture.numbers.tolist() == list(range(FRAMES))
    assert capture.frame_rate == RATE
    assert (
        f"frames are matched by {'sync_index' if index else 'time'} of timestamps.csv; frames of one instant are up to"
        " 7.0 ms apart" in capture.notes
    )
    assert "camera cam_2 lacks pictures of 1 frames (2)" in capture.notes
    assert "camera cam_10 lacks pictures of 2 frames (0, 5)" in capture.notes
    again = Capture.from_json(json.loads(json.dumps(capture.to_json())))
    assert seen_in(again) == TRUE
    with pytest.raises(
        SourceError, match=r"camera cam_2 has no picture of frame 2: .* leave the frame out with frames\.range"
    ):
        list(open_source(capture, "pictures").read(1, [1, 2, 3]))


def test_which_frame_of_the_video_is_meant_is_part_of_the_digest(base: Path) -> None:
    other = {**SEEN, 2: [0, 1, 2, 4, 5]}  # the same video, another instant dropped
    before = find(base).pictures
    write_recording(base, other)
    after = find(base).pictures
    assert before[1].files[0].sha256 == after[1].files[0].sha256
    assert after[1].digest([0, 1, 4]) == before[1].digest([0, 1, 4])
    assert after[1].digest([2, 3]) != before[1].digest([2, 3])
    assert after[0].digest([0, 1]) == before[0].digest([0, 1])
    assert after[0].options == {}  # where frame n is frame n of the video, nothing more is kept


def test_everything_is_half_a_pixel_further(base: Path) -> None:
    np.testing.assert_allclose(
        import_capture.imported_pixels(find(base).rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )  # float64 rounding of ~60 px


def test_older_names_are_read(base: Path, tmp_path: Path) -> None:
    write_recording(tmp_path / "old", SEEN, camera="port", times="frame_time_history.csv")
    write_calibration(tmp_path / "old" / "camera_array.toml")
    capture = find(tmp_path / "old")
    assert capture.rig.names == ("port_1", "port_2", "port_10")
    assert list(seen_in(capture).values()) == list(TRUE.values())


def test_some_cameras_have_the_instants_of_theirs(base: Path) -> None:
    capture = find(base, cameras=["cam_10", "cam_2"])
    assert capture.rig.names == ("cam_10", "cam_2")
    assert capture.numbers.tolist() == list(range(FRAMES))
    assert seen_in(capture) == {n: TRUE[n] for n in capture.rig.names}


def test_the_workspace_s_calibration_is_found_and_one_nearer_goes_before(base: Path, tmp_path: Path) -> None:
    write_recording(tmp_path / "space" / "recordings" / "walk", SEEN)
    inside = tmp_path / "space" / "recordings" / "walk"
    with pytest.raises(
        CalibrationError, match=r"no camera_array\.toml in .*walk, below it or in its workspace; calibrate"
    ):
        find(inside)
    write_calibration(tmp_path / "space" / "calibration" / "extrinsic" / "capture_volume" / "camera_array.toml")
    assert any("capture_volume/camera_array.toml" in n for n in find(inside).notes)
    write_calibration(inside / "POSE" / "camera_array.toml")
    assert "calibration: POSE/camera_array.toml" in find(inside).notes
    write_calibration(inside / "HAND" / "camera_array.toml", translation="[0.0, 0.0, 9.0]")
    with pytest.raises(
        CalibrationError,
        match=r"several calibrations fit: HAND/camera_array\.toml, POSE/camera_array\.toml; choose one",
    ):
        find(inside)
    assert find(inside, calibration="HAND/camera_array.toml").rig.world_to_camera[0, 2, 3] == 9
    with pytest.raises(SourceError, match=r"space holds recordings in recordings/walk; give one of these folders"):
        find(tmp_path / "space")


def test_without_times_videos_of_one_length_start_together(base: Path) -> None:
    write_recording(base, {c: list(range(4)) for c in CAMERAS})
    (base / "timestamps.csv").unlink()
    capture = find(base)
    assert seen_in(capture) == {n: {k: k for k in range(4)} for n in NAMES}
    assert "no timestamps.csv: frame n of each video is taken as one instant" in capture.notes
    counting_clip(base / "cam_2.mp4", 3, import_capture.SIZE)
    with pytest.raises(
        SourceError,
        match=r"there is no timestamps\.csv, and the videos have 4 frames \(camera 1\), 3 frames \(camera 2\)",
    ):
        find(base)


def test_the_times_give_the_rate_unless_it_is_set(base: Path) -> None:
    for c, found in SEEN.items():
        counting_clip(base / f"cam_{c}.mp4", len(found), import_capture.SIZE, rate=25)
    capture = find(base)
    # mean times of a group move by the cameras that lack it: 7 ms over 5 periods of 33 ms
    assert capture.frame_rate == pytest.approx(RATE, rel=0.03)
    assert any("frames/s, the videos 25; the times are believed" in n for n in capture.notes)
    assert find(base, frame_rate=12.5).frame_rate == 12.5


def test_a_frame_between_two_instants_is_left_out(base: Path) -> None:
    write_recording(base, SEEN, index=False)
    text = (base / "timestamps.csv").read_text()
    counting_clip(base / "cam_10.mp4", 5, import_capture.SIZE, rate=RATE)
    (base / "timestamps.csv").write_text(text + f"10,{7.25 + 2.45 / RATE}\n")
    capture = find(base)
    assert seen_in(capture)["cam_10"] == {1: 0, 2: 1, 3: 3, 4: 4}
    assert "camera 10: 1 frames lie between two instants and are left out" in capture.notes


def test_boards_are_no_joints_and_turned_cameras_are_told(base: Path) -> None:
    (base / "xy.csv").write_text("sync_index,cam_id\n")
    write_calibration(base / "camera_array.toml", rotation_count="1")
    notes = find(base).notes
    assert "corners of the calibration board are no joints and are left out: xy.csv" in notes
    assert "camera cam_1 is shown turned by 90 degrees in Caliscope; its pictures are used as filmed" in notes


def write_landmarks(
    base: Path, tracker: str, joints: int, first: int = 0, index: int = 0, columns: str = "cam_id,point_id"
) -> None:
    """Landmark j of video frame k of a camera at (10 j + camera, k);
    instants are numbered from `first`, frames from `index`."""
    camera, point = columns.split(",")
    rows = [f"sync_index,{camera},frame_index,frame_time,{point},img_loc_x,img_loc_y"]
    for c, found in SEEN.items():
        for k, n in enumerate(found):
            place = f"{first + n},{c},{index + k},{7.25 + n / RATE + LATE[c]!r}"
            rows += [f"{place},{j},{10 * j + c},{k}" for j in [*range(joints), 100, 200] if j != 3]
    (base / tracker).mkdir()
    (base / tracker / f"xy_{tracker}.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize(
    ("tracker", "id", "joints"), [("POSE", "blazepose33", 33), ("ONNX_rtmpose_t_halpe26", "halpe26", 26)]
)
@pytest.mark.parametrize("numbered", [{}, {"first": 35, "index": 400, "columns": "port,keypoint_id"}])
@pytest.mark.parametrize("index", [True, False])
def test_landmarks_become_joints_of_their_instant(
    base: Path, tracker: str, id: str, joints: int, numbered: dict[str, int], index: bool
) -> None:
    write_recording(base, SEEN, index=index)
    write_landmarks(base, tracker, joints, **numbered)
    capture = find(base)
    assert f"2D joints: landmarks of {tracker}, joint set {id}" in capture.notes
    reader = open_source(Capture.from_json(json.loads(json.dumps(capture.to_json()))), "joints")
    assert reader.joint_set == id
    for v, c in enumerate(CAMERAS):
        for n in range(FRAMES):
            people = reader.read(v, n)
            assert len(people) == (n in SEEN[c])
            if len(people):
                np.testing.assert_array_equal(
                    people[0, [0, 2], :],
                    [[c + 0.5, SEEN[c].index(n) + 0.5, 1], [20 + c + 0.5, SEEN[c].index(n) + 0.5, 1]],
                )
                assert people[0, 3, 2] == 0
                assert people.shape == (1, joints, 3)


def test_landmarks_without_times_go_by_the_frame_of_the_video(base: Path) -> None:
    write_recording(base, {c: list(range(6)) for c in CAMERAS})
    write_landmarks(base, "POSE", 33, first=7)
    (base / "timestamps.csv").unlink()
    assert [len(open_source(find(base), "joints").read(1, n)) for n in range(6)] == [1, 1, 1, 1, 1, 0]
    write_landmarks(base, "HOLISTIC", 33, index=3)
    with pytest.raises(
        SourceError,
        match=(
            r"xy_HOLISTIC\.csv: camera 1 has landmarks at frame_index 6, where its video has no frame; track this"
            r" recording again"
        ),
    ):
        find(base, tracker="HOLISTIC")


def test_trackers_that_are_not_known_are_told_and_several_need_a_choice(base: Path) -> None:
    write_landmarks(base, "HAND", 21)
    capture = find(base)
    assert not capture.joints
    assert any(
        n.startswith("landmarks of HAND are left out: which joints it numbers is not known") for n in capture.notes
    )
    with pytest.raises(SourceError, match="option tracker: which joints HAND numbers is not known; name a joint set"):
        find(base, tracker="HAND")
    assert open_source(find(base, tracker="HAND", joint_set="coco17"), "joints").joint_set == "coco17"
    with pytest.raises(SourceError, match=r"option tracker: no FACE/xy_FACE\.csv in .*; there are HAND"):
        find(base, tracker="FACE")
    write_landmarks(base, "POSE", 33)
    write_landmarks(base, "HOLISTIC", 33)
    with pytest.raises(
        SourceError, match="landmarks of several trackers fit: HOLISTIC, POSE; choose one with the option tracker"
    ):
        find(base)
    assert any("landmarks of POSE" in n for n in find(base, tracker="POSE").notes)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("7.25,", "9.0,", r"xy_POSE\.csv: camera 1 has landmarks at frame_time 9, where its video has no frame"),
        ("frame_time,", "time,", r"xy_POSE\.csv lacks the columns frame_time; track the recording"),
        ("7.25,", "soon,", r"xy_POSE\.csv line 2: could not convert"),
    ],
)
def test_wrong_landmarks_get_a_sentence(base: Path, old: str, new: str, sentence: str) -> None:
    write_landmarks(base, "POSE", 33)
    path = base / "POSE" / "xy_POSE.csv"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(SourceError, match=sentence):
        find(base)


def add(base: Path, text: str) -> None:
    with (base / "timestamps.csv").open("a") as f:
        f.write(text)


WRONG = {
    "no videos": (lambda b: [p.unlink() for p in b.glob("*.mp4")], r"no video cam_N\.mp4 in"),
    "two of one number": (
        lambda b: counting_clip(b / "port_2.mp4", 5, import_capture.SIZE),
        r"two videos are camera 2: cam_2\.mp4 and port_2\.mp4; take one out",
    ),
    "no table": (
        lambda b: counting_clip(b / "cam_3.mp4", 5, import_capture.SIZE),
        r"camera cam_3 has no calibration in .*camera_array\.toml, which holds cameras\.1, cameras\.2, cameras\.10",
    ),
    "ignored": (lambda b: write_calibration(b / "camera_array.toml", ignore="true"), "camera cam_1 is set to ignore"),
    "no extrinsics": (
        lambda b: write_calibration(b / "camera_array.toml", rotation=""),
        "camera cam_1: its calibration has no rotation",
    ),
    "other size": (
        lambda b: write_calibration(b / "camera_array.toml", size="[128, 128]"),
        "camera cam_1: pictures are 64x48 px, the calibration is for 128x128 px",
    ),
    "other recording": (
        lambda b: counting_clip(b / "cam_2.mp4", 3, import_capture.SIZE),
        (
            r"timestamps\.csv has 5 rows of camera 2, its video .*cam_2\.mp4 has 3 frames; put the file of this"
            r" recording there"
        ),
    ),
    "columns": (
        lambda b: (b / "timestamps.csv").write_text("camera,time\n"),
        r"timestamps\.csv has the columns camera, time; it needs cam_id and frame_time",
    ),
    "empty times": (lambda b: (b / "timestamps.csv").write_text(""), r"has the columns \(none\)"),
    "text": (lambda b: add(b, "60,1,soon\n"), r"timestamps\.csv line 17: could not convert string to float: 'soon'"),
    "short line": (lambda b: add(b, "60\n"), r"timestamps\.csv line 17: "),
    "NaN": (lambda b: add(b, "60,1,nan\n"), r"timestamps\.csv line 17: frame_time nan must be finite"),
    "index twice": (
        lambda b: (counting_clip(b / "cam_1.mp4", 7, import_capture.SIZE), add(b, "40,1,99.0\n")),
        r"camera 1 has sync_index 40 after 40 in order of frame_time; each must come once and ascend",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base: Path, case: str) -> None:
    change, sentence = WRONG[case]
    change(base)
    with pytest.raises(UserError, match=sentence):
        find(base)


def test_a_layout_that_does_not_read_the_times_says_so_and_what_does(base: Path) -> None:
    """Pose2Sim's importer takes Caliscope's calibration, too."""
    write_recording(base, {c: list(range(FRAMES)) for c in CAMERAS})
    said = [n for n in find_capture("pose2sim", base, {}).notes if "timestamps.csv" in n]
    unread = "timestamps.csv is not read by this layout, so frames are not matched by its times;"
    assert said == [f"{unread} posegaussian import caliscope {base} reads it"]
    (base / "camera_array.toml").rename(base / "cameras.toml")
    said = [n for n in find_capture("pose2sim", base, {}).notes if "timestamps.csv" in n]
    assert said == [f"{unread} the layout caliscope reads it, beside videos cam_N.mp4 and with a camera_array.toml"]
    (base / "timestamps.csv").unlink()
    assert not [n for n in find_capture("pose2sim", base, {}).notes if "timestamps.csv" in n]
