"""Pictures in and out: round trips, conversions and refusals."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import OpenImageIO as oiio
import pytest

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers import images

RNG = np.random.default_rng(7)


def write(path, values, kind, **attributes):
    h, w, c = values.shape
    spec = oiio.ImageSpec(w, h, c, kind)
    for name, value in attributes.items():
        spec[name.replace("__", ":")] = value
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec)
    assert out.write_image(values)
    out.close()
    return path


def test_png_round_trip(tmp_path):
    rgb = RNG.integers(0, 256, (5, 7, 3), np.uint8)
    images.write_png(tmp_path / "a.png", rgb)
    np.testing.assert_array_equal(images.read_picture(tmp_path / "a.png"), rgb)
    assert images.picture_size(tmp_path / "a.png") == (7, 5)
    images.write_png(tmp_path / "m.png", rgb[..., 0])
    np.testing.assert_array_equal(images.read_mask(tmp_path / "m.png"), rgb[..., 0])
    np.testing.assert_array_equal(images.read_mask(tmp_path / "a.png"), rgb.max(axis=2))


def test_exr_round_trip(tmp_path):
    linear = RNG.normal(size=(5, 7, 3)).astype(np.float16)
    images.write_exr(tmp_path / "a.exr", linear)
    back = images.read_picture(tmp_path / "a.exr")
    assert back.dtype == np.float16
    np.testing.assert_array_equal(back, linear)
    depth = np.abs(RNG.normal(size=(5, 7))).astype(np.float32)
    images.write_exr(tmp_path / "d.exr", depth)
    np.testing.assert_array_equal(images.read_depth(tmp_path / "d.exr"), depth)


def test_grey_is_repeated_and_alpha_dropped_without_premultiplying(tmp_path):
    rgba = RNG.integers(0, 256, (5, 7, 4), np.uint8)
    images.write_png(tmp_path / "rgba.png", rgba)
    np.testing.assert_array_equal(images.read_picture(tmp_path / "rgba.png"), rgba[..., :3])
    grey_alpha = write(tmp_path / "ga.png", rgba[..., :2].copy(), "uint8", oiio__UnassociatedAlpha=1)
    np.testing.assert_array_equal(images.read_picture(grey_alpha), np.repeat(rgba[..., :1], 3, axis=2))
    assert images.has_alpha(grey_alpha)
    np.testing.assert_array_equal(images.read_mask(grey_alpha, alpha=True), rgba[..., 1])


def test_sixteen_bit_is_scaled(tmp_path):
    eight = RNG.integers(0, 256, (5, 7, 3), np.uint8)
    path = write(tmp_path / "a.png", eight.astype(np.uint16) * 257, "uint16")
    np.testing.assert_array_equal(images.read_picture(path), eight)
    near = write(tmp_path / "b.png", np.full((1, 1, 3), 128, np.uint16), "uint16")
    assert images.read_picture(near).max() == 0  # 128/257 rounds to 0
    np.testing.assert_array_equal(images.read_mask(path), eight.max(axis=2))


def test_float_masks_and_wild_values(tmp_path):
    images.write_exr(tmp_path / "m.exr", np.array([[0.0, 0.5, 1.0, 2.0]], np.float32))
    assert images.read_mask(tmp_path / "m.exr").tolist() == [[0, 128, 255, 255]]
    images.write_exr(tmp_path / "hot.exr", np.full((1, 1, 3), 1e6, np.float32))
    assert images.read_picture(tmp_path / "hot.exr").max() == 65504
    images.write_exr(tmp_path / "nan.exr", np.full((2, 2, 3), np.nan, np.float32))
    with pytest.raises(SourceError, match="NaN in 4 pixels"):
        images.read_picture(tmp_path / "nan.exr")
    images.write_exr(tmp_path / "depth.exr", np.array([[np.inf, np.nan, 2.0]], np.float32))
    assert images.read_depth(tmp_path / "depth.exr").tolist() == [[0, 0, 2]]
    images.write_exr(tmp_path / "behind.exr", np.array([[-1.0]], np.float32))
    with pytest.raises(SourceError, match="-1 m"):
        images.read_depth(tmp_path / "behind.exr")
    images.write_png(tmp_path / "depth.png", np.zeros((2, 2), np.uint8))
    with pytest.raises(SourceError, match="uint8"):
        images.read_depth(tmp_path / "depth.png")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_honoured_as_by_opencv(tmp_path, orientation):
    import cv2

    rgb = np.kron(RNG.integers(0, 256, (2, 3, 3), np.uint8), np.ones((16, 16, 1), np.uint8))
    path = write(tmp_path / "a.jpg", rgb, "uint8", Orientation=orientation)
    picture = images.read_picture(path)
    # both use libjpeg; the tag moves pixels and changes none
    np.testing.assert_array_equal(picture, cv2.imread(str(path))[..., ::-1])
    assert images.picture_size(path) == (picture.shape[1], picture.shape[0])


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.exr"])
def test_cut_off_files_are_refused(tmp_path, name):
    rgb = RNG.integers(0, 256, (50, 70, 3), np.uint8)
    path = (
        write(tmp_path / name, rgb, "uint8")
        if not name.endswith("exr")
        else write(tmp_path / name, rgb.astype(np.float32), "float")
    )
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SourceError, match=f"{name}.*damaged or cut off"):
        images.read_picture(path)


def test_what_is_no_picture_is_refused(tmp_path):
    with pytest.raises(SourceError, match=r"cannot read picture .*none\.png: No such file"):
        images.read_picture(tmp_path / "none.png")
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(SourceError, match=r"text\.png"):
        images.picture_size(tmp_path / "text.png")
    with pytest.raises(ValueError, match="uint8"):
        images.write_png(tmp_path / "x.png", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="float16"):
        images.write_exr(tmp_path / "x.exr", np.zeros((2, 2)))


def test_importing_is_cheap():
    code = (
        "import posegaussian.storage.readers.images, posegaussian.storage.readers.video,"
        " posegaussian.storage.readers.sources, posegaussian.storage.importers.find, sys; print([m for m in ('av',"
        " 'OpenImageIO', 'cv2', 'torch', 'numba') if m in sys.modules])"
    )
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
    )
