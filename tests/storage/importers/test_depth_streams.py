"""Depth maps of the user's: apart from a simulator's truth, in metres, of the picture's field;
a sentence for everything else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.images import write_exr
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers.test_images import cameras
from tests.support import import_capture


@pytest.fixture
def base(tmp_path: Path) -> Path:
    import_capture.pictures(tmp_path / "images")
    import_capture.dump(tmp_path / "cameras.json", cameras())
    return tmp_path


def ramp(height: int = 48, width: int = 64) -> np.ndarray:
    return np.linspace(2, 3, height * width, dtype=np.float32).reshape(height, width)


def write(base: Path, depth: np.ndarray, name: str = import_capture.NAMES[0], number: int = 0) -> None:
    folder = base / "depth_maps" / name
    folder.mkdir(parents=True, exist_ok=True)
    if depth.dtype == np.uint16:
        assert oiio.ImageBuf(np.ascontiguousarray(depth[..., None])).write(str(folder / f"{number:06d}.png"))
    else:
        write_exr(folder / f"{number:06d}.exr", depth)


def find(base: Path, **options: object) -> Capture:
    return find_capture("images", base, options)


def test_maps_are_read_and_are_no_truth(base: Path) -> None:
    write(base, ramp())
    capture = find(base)
    assert not capture.has("depth")
    assert [s is not None for s in capture.depth_maps] == [True] + [False] * (len(import_capture.NAMES) - 1)
    assert any(f"camera {import_capture.NAMES[1]} has no depth maps" in n for n in capture.notes)
    assert any(f"camera {import_capture.NAMES[0]} lacks depth maps of" in n for n in capture.notes)
    (depth,) = open_source(capture, "depth_maps").read(0, [0])
    np.testing.assert_array_equal(depth, ramp())
    with pytest.raises(SourceError, match="has no depth maps of frame 1"):
        list(open_source(capture, "depth_maps").read(0, [1]))
    assert Capture.from_json(capture.to_json()).to_json() == capture.to_json()


def test_a_capture_that_was_registered_before_there_were_depth_maps_is_read(base: Path) -> None:
    old = find(base).to_json()
    del old["depth_maps"]
    assert Capture.from_json(old).depth_maps == ()
    assert replace(find(base), depth_maps=()).to_json() == find(base).to_json()


def test_millimetres_need_a_scale_and_get_one(base: Path) -> None:
    write(base, (ramp() * 1000).astype(np.uint16))
    with pytest.raises(SourceError, match=r"holds integers.*--option depth_scale=0\.001"):
        find(base)
    (depth,) = open_source(find(base, depth_scale=0.001), "depth_maps").read(0, [0])
    np.testing.assert_allclose(depth, ramp(), atol=1.001e-3)  # cut to whole millimetres
    with pytest.raises(SourceError, match="depth_scale"):
        find(base, depth_scale=0)


@pytest.mark.parametrize("scale", [1000.0, 0.01])
def test_a_median_that_is_no_distance_is_refused(base: Path, scale: float) -> None:
    write(base, ramp() * np.float32(scale))
    with pytest.raises(
        SourceError, match=r"the median of depth map .* is .* m, which is not between 0.2 and 200 m.*depth_scale"
    ):
        find(base)


def test_what_is_not_finite_is_no_surface_and_what_is_negative_is_refused(base: Path) -> None:
    depth = ramp()
    depth[0, :3] = np.nan, np.inf, 0
    write(base, depth)
    (read,) = open_source(find(base), "depth_maps").read(0, [0])
    assert read[0, :3].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(read[0, 3:], depth[0, 3:])
    write(base, -ramp())
    with pytest.raises(SourceError, match=r"holds -3 m; depth along the optical axis must not be negative"):
        find(base)


def test_another_resolution_is_taken_and_another_shape_refused(base: Path) -> None:
    write(base, ramp(24, 32))
    capture = find(base)
    assert any(
        "depth maps are 32x24 px, pictures 64x48 px; both are taken to show the same field" in n for n in capture.notes
    )
    write(base, ramp(), number=1)
    with pytest.raises(SourceError, match="is 64x48 px, the first one is 32x24 px"):
        find(base)
    (base / "depth_maps" / import_capture.NAMES[0] / "000001.exr").unlink()
    write(base, ramp(24, 24))
    with pytest.raises(SourceError, match="is 24x24 px, its picture is 64x48 px, which is another shape"):
        find(base)


def test_a_scale_without_maps_is_refused(base: Path) -> None:
    with pytest.raises(SourceError, match=r"depth_scale=0\.001: .*depth_maps has no depth maps .*leave the option out"):
        find(base, depth_scale=0.001)
    write(base, ramp(), number=99)
    with pytest.raises(SourceError, match="no depth maps of these pictures"):
        find(base, depth_scale=1)
