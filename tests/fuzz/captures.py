"""The whole captures and files that variants are made of: small, complete, and read without a complaint."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.cameras import rotation_matrix
from posegaussian.storage.readers.images import write_exr, write_png
from tests.storage.importers import (
    test_actorshq,
    test_caliscope,
    test_dna_rendering,
    test_easymocap,
    test_genebody,
    test_gps_gaussian,
    test_humman,
    test_images,
    test_llff,
    test_mvhumannet,
    test_nerfstudio,
    test_panoptic,
    test_people_snapshot,
    test_pose2sim,
    test_qualisys,
    test_videos,
    test_zju_mocap,
)
from tests.support import colmap_files, import_capture
from tests.support.video_clips import counting_clip, planes

FRAMES = 3


def pose2sim(base: Path) -> None:
    """Videos, a TOML calibration, OpenPose joints and a TRC file."""
    (base / "videos").mkdir(parents=True)
    for name in import_capture.NAMES:
        counting_clip(base / "videos" / f"{name}.mp4", FRAMES, import_capture.SIZE)
    test_pose2sim.write_calibration(base)
    test_pose2sim.write_joints(base, frames=FRAMES)
    trc(base / "pose-3d" / "walk.trc")


def trc(path: Path) -> None:
    """A person of 21 markers, as Pose2Sim writes it."""
    from posegaussian.storage.model.joint_sets import JOINT_SETS

    names = JOINT_SETS["trc21"].names
    head = [
        "PathFileType\t4\t(X/Y/Z)\twalk.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
    ]
    head += [
        f"30\t30\t{FRAMES}\t{len(names)}\tm\t30\t1\t{FRAMES}",
        "Frame#\tTime\t" + "\t\t\t".join(names),
        "\t\t" + "\t".join(f"{a}{i}" for i in range(len(names)) for a in "XYZ"),
    ]
    rows = [
        "\t".join(
            [
                str(f + 1),
                f"{f / 30:.3f}",
                *(f"{0.02 * m + 0.3 * a + 0.01 * f:.4f}" for m in range(len(names)) for a in range(3)),
            ]
        )
        for f in range(FRAMES)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*head, *rows]) + "\n")


def qualisys(base: Path) -> None:
    """Videos, and the same cameras as Qualisys writes them."""
    toml = base.with_name("toml")
    pose2sim(toml)
    rig = find_capture("pose2sim", toml, {}).rig
    (base / "videos").mkdir(parents=True)
    for name in import_capture.NAMES:
        counting_clip(base / "videos" / f"{name}.mp4", FRAMES, import_capture.SIZE)
    cameras = "".join(test_qualisys.camera(rig, v) for v in range(len(rig)))
    (base / "own.qca.txt").write_text(f"<calibration><cameras>{cameras}</cameras></calibration>")


def caliscope(base: Path) -> None:
    """Videos, times, cameras and the landmarks of a tracker."""
    test_caliscope.write_recording(base, test_caliscope.SEEN)
    test_caliscope.write_calibration(base / "camera_array.toml")
    rows = [
        f"{35 + n},{c},{k},{7.25 + n / test_caliscope.RATE + test_caliscope.LATE[c]!r},{j},{20.5 + j},{11.25 + n}"
        for c, found in test_caliscope.SEEN.items() for k, n in enumerate(found) for j in range(33)
    ]  # fmt: skip
    (base / "POSE").mkdir()
    (base / "POSE" / "xy_POSE.csv").write_text(
        "\n".join(["sync_index,cam_id,frame_index,frame_time,point_id,img_loc_x,img_loc_y", *rows]) + "\n"
    )


def easymocap(base: Path) -> None:
    """Pictures, intri.yml and extri.yml, masks and annots."""
    import_capture.pictures(base / "images", test_easymocap.NAMES)
    test_easymocap.write_calibration(base)
    test_easymocap.write_joints(base)
    masks(base / "masks", test_easymocap.NAMES)


def colmap(form: str, base: Path) -> None:
    """Pictures, masks and a model of COLMAP."""
    import_capture.pictures(base / "images")
    colmap_files.WRITE[form](base / "sparse" / "0", colmap_files.rig())
    masks(base / "masks", import_capture.NAMES)


def nerfstudio(base: Path) -> None:
    """transforms.json with pictures, masks and depth maps in millimetres."""
    import_capture.pictures(base / "images")
    data = test_nerfstudio.transforms()
    masks(base / "masks", import_capture.NAMES)
    for f in data["frames"]:
        f["mask_path"] = f["file_path"].replace("images/", "masks/")
        f["depth_file_path"] = f["file_path"].replace("images/", "depths/")
        (base / f["depth_file_path"]).parent.mkdir(parents=True, exist_ok=True)
        millimetres(base / f["depth_file_path"])
    import_capture.dump(base / "transforms.json", data)


def llff(base: Path) -> None:
    """poses_bounds.npy, pictures and masks."""
    base.mkdir(parents=True)
    np.save(base / "poses_bounds.npy", test_llff.poses())
    import_capture.pictures(base / "images")
    masks(base / "masks", import_capture.NAMES)


def gps_gaussian(base: Path) -> None:
    """One sample of five views."""
    test_gps_gaussian.write_sample(base, "0000_000", 0.0)


def zju_mocap(base: Path) -> None:
    """A capture of the data set's."""
    test_zju_mocap.write(base)


def dna_rendering(base: Path) -> None:
    """A capture of the data set's."""
    test_dna_rendering.write(base)


def people_snapshot(base: Path) -> None:
    """A capture of the data set's."""
    test_people_snapshot.write(base)


def humman(base: Path) -> None:
    """A capture of the data set's."""
    test_humman.write(base)


def actorshq(base: Path) -> None:
    """A capture of the data set's."""
    test_actorshq.write(base)


def genebody(base: Path) -> None:
    """A capture of the data set's."""
    test_genebody.write(base)


def mvhumannet(base: Path) -> None:
    """A capture of the data set's."""
    test_mvhumannet.write(base)


def panoptic(base: Path) -> None:
    """A capture of the data set's."""
    test_panoptic.with_joints(base)


def films_and(calibration: Callable[[Path], None], base: Path) -> None:
    """Videos and one calibration of another program."""
    test_videos.films(base)
    calibration(base)


def millimetres(path: Path) -> None:
    """A 16-bit depth map of a disc at 2.5 m."""
    import cv2

    cv2.imwrite(str(path), np.where(disc() > 0, np.uint16(2500), np.uint16(0)))


def masks(root: Path, names: tuple[str, ...]) -> None:
    for name in names:
        (root / name).mkdir(parents=True)
        for n in range(FRAMES):
            write_png(root / name / f"{n:06d}.png", disc())


def disc() -> np.ndarray:
    """[48, 64] uint8 of a person's place."""
    y, x = np.mgrid[: import_capture.SIZE[1], : import_capture.SIZE[0]]
    return (((x - 32) ** 2 + (y - 24) ** 2 < 200) * 255).astype(np.uint8)


def images(base: Path) -> None:
    """Pictures, masks, COCO joints, depth maps and true depth."""
    import_capture.pictures(base / "images")
    import_capture.dump(base / "cameras.json", test_images.cameras())
    masks(base / "masks", import_capture.NAMES)
    for v, name in enumerate(import_capture.NAMES):
        import_capture.dump(base / "joints" / f"{name}.json", test_images.coco(v))
        for kind in ("depth", "depth_maps"):
            (base / kind / name).mkdir(parents=True)
            for n in range(FRAMES):
                write_exr(
                    base / kind / name / f"{n:06d}.exr", np.where(disc() > 0, np.float32(2.5 + 0.1 * n), np.float32(0))
                )


def pictures_of(suffix: str, base: Path) -> None:
    """The images layout with pictures and masks in another format."""
    import OpenImageIO as oiio

    import_capture.dump(base / "cameras.json", test_images.cameras())
    random = np.random.default_rng(0)
    for v, name in enumerate(import_capture.NAMES):
        for kind in ("images", "masks"):
            (base / kind / name).mkdir(parents=True)
            for n in range(FRAMES):
                values = (
                    random.integers(0, 256, (import_capture.SIZE[1], import_capture.SIZE[0], 3)).astype(np.uint8)
                    if kind == "images"
                    else np.repeat(disc()[..., None], 3, axis=2)
                )
                picture = oiio.ImageBuf(np.ascontiguousarray(values / np.float32(255) if suffix == ".exr" else values))
                for tag, text in {
                    "Artist": f"person {v}",
                    "Copyright": "nobody",
                    "ImageDescription": "a picture",
                    "Software": "made",
                    "DateTime": "2024:01:02 03:04:05",
                }.items():
                    picture.specmod()[tag] = text
                picture.specmod()["Orientation"] = 1
                if not picture.write(str(base / kind / name / f"{n:06d}{suffix}"), "half" if suffix == ".exr" else ""):
                    raise ValueError(picture.geterror())


def videos_of(suffix: str, base: Path) -> None:
    """The pose2sim layout with videos in another container, tags in each of them."""
    import av

    (base / "videos").mkdir(parents=True)
    codec = {".mp4": "libx264", ".mov": "mpeg4", ".mkv": "libx264", ".avi": "mpeg4", ".webm": "libvpx"}[suffix]
    for name in import_capture.NAMES:
        with av.open(str(base / "videos" / f"{name}{suffix}"), "w") as target:
            for key in ("title", "artist", "comment", "copyright", "encoder"):
                target.metadata[key] = f"{key} of {name}"
            stream = target.add_stream(codec, rate=30)
            stream.width, stream.height, stream.pix_fmt = *import_capture.SIZE, "yuv420p"
            stream.metadata["language"] = "eng"
            for n in range(FRAMES):
                target.mux(stream.encode(planes(np.full(import_capture.SIZE[::-1], 16 + 3 * n, np.uint8))))
            target.mux(stream.encode(None))
    test_pose2sim.write_calibration(base)


def depth_maps_of(suffix: str, base: Path) -> None:
    """The images layout with depth maps in millimetres."""
    import OpenImageIO as oiio

    import_capture.pictures(base / "images")
    import_capture.dump(base / "cameras.json", test_images.cameras())
    for name in import_capture.NAMES:
        (base / "depth_maps" / name).mkdir(parents=True)
        for n in range(FRAMES):
            oiio.ImageBuf(np.ascontiguousarray((disc() > 0)[..., None] * np.uint16(2500 + n))).write(
                str(base / "depth_maps" / name / f"{n:06d}{suffix}"), "uint16"
            )


def path_file(base: Path) -> None:
    """A camera path of two cameras, one of one frame."""
    base.mkdir(parents=True)
    body = test_images.cameras("half")
    del body["frame_rate"]
    for n, camera in enumerate(body["cameras"]):  # type: ignore[attr-defined]
        del camera["distortion"]
        camera["R"] = rotation_matrix(import_capture.RODRIGUES[n]).tolist()
        camera |= {"frame": n} if n else {}
    import_capture.dump(base / "path.json", body)
