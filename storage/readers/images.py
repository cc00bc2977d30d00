"""Pictures, masks and depth maps in and out, through OpenImageIO.

OpenImageIO is imported inside the functions, so that importing this module costs nothing. Alpha is dropped without
premultiplying; the orientation tag of a camera's JPEG is honoured, as OpenCV does; colours are taken as sRGB (8 and 16
bit) or linear (float files). Embedded ICC profiles are not applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.files.write import ask_why, whole_file
from posegaussian.storage.model.documents import reader_of, regular
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.masks import crispness
from posegaussian.storage.model.plausible import check_picture

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr", ".tif", ".tiff", ".bmp", ".webp")
"""File endings that count as pictures, lower case."""

NO_TIME = "1970:01:01 00:00:00"
"""Stands in every EXR for the time of writing, which OpenImageIO would add:
a capture that is made again keeps its digests."""
MOST_CHANNELS = 4
"""Channels that are read: colour and alpha; float files may carry a hundred more."""
_WITH_ALPHA = (2, MOST_CHANNELS)
"""Channels of a file whose last one is alpha, behind grey or colour."""
_SAME_COLOUR = 8
"""Levels within which a pixel has the colour of the background, which compression changes beside outlines."""
_STEPS, _RISE = 0.5, 1.5
"""Pixels by which masks with sharp edges are blurred before they are enlarged, and times their contrast grows by, over
the factor of their size: against exact masks of two people, halved and quartered, their error falls from 0.032 and
0.072 of the mask to 0.006 and 0.013."""
_HALF_MAX = float(np.finfo(np.float16).max)


def picture_size(path: str | Path) -> tuple[int, int]:
    """(width, height) in px of a picture as `read_picture` returns it, without decoding it. Raises SourceError."""
    source, spec = _open(path)
    source.close()
    turned = spec.getattribute("Orientation") in (5, 6, 7, 8)
    return (spec.height, spec.width) if turned else (spec.width, spec.height)


def read_picture(path: str | Path) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of an 8- or 16-bit file, or float16 linear of a float file.

    Grey is repeated over the three channels. Float values beyond float16 are clipped to its largest, 65504; NaN raises
    SourceError, as does a file that cannot be read to its end.
    """
    values = _read(path)
    rgb = np.repeat(values[..., :1], 3, axis=2) if values.shape[2] < 3 else values[..., :3]
    if values.dtype == np.float32:
        if np.isnan(rgb).any():
            raise SourceError(
                f"picture {path} holds NaN in {np.isnan(rgb).any(axis=2).sum()} pixels; write it again without NaN"
            )
        return np.clip(rgb, -_HALF_MAX, _HALF_MAX).astype(np.float16)
    return _to_bytes(rgb)


def read_mask(path: str | Path, alpha: bool = False) -> np.ndarray:
    """[h, w] uint8 of a mask: the largest channel of its colour, or its alpha where the colour is the same everywhere
    and the alpha is not opaque; with `alpha` that of a picture.

    8 bit as it is, 16 bit scaled, but 0 and 1 as they are where nothing is larger, float 0..1 scaled to 0..255. Raises
    SourceError.
    """
    values = _read(path)
    if alpha and values.shape[2] not in _WITH_ALPHA:
        raise SourceError(f"picture {path} has {values.shape[2]} channels and no alpha, unlike others of its camera")
    return _mask_bytes(values[..., -1] if alpha else _subject(values), path)


def read_mask_channels(path: str | Path) -> tuple[np.ndarray, np.ndarray | None]:
    """(colour [h, w, 1 or 3], alpha [h, w] or None) uint8 of a mask's file, scaled as `read_mask` scales. Raises
    SourceError."""
    values = _mask_bytes(_read(path), path)
    return (values[..., :-1], values[..., -1]) if values.shape[2] in _WITH_ALPHA else (values[..., :3], None)


def read_cut_out(path: str | Path, background: Sequence[int]) -> np.ndarray:
    """[h, w] uint8 of a mask that is a picture of the subject before one colour [3]: 255 where it is not that colour,
    else 0. Raises SourceError."""
    return np.where(apart(read_mask_channels(path)[0], background), np.uint8(255), np.uint8(0))


def apart(colour: np.ndarray, background: Sequence[int]) -> np.ndarray:
    """[h, w] bool where a picture [h, w, 3] uint8 is not of the colour [3], as far as compression changes one."""
    off = np.abs(colour.astype(np.int16) - np.array(background, np.int16))
    return np.asarray(off.max(axis=2) > _SAME_COLOUR)


def _mask_bytes(mask: np.ndarray, path: str | Path) -> np.ndarray:
    """uint8 of a mask's values as its file holds them. Raises SourceError."""
    if mask.dtype != np.float32:
        return mask.astype(np.uint8) if mask.max() <= 1 else _to_bytes(mask)
    if np.isnan(mask).any():
        raise SourceError(f"mask {path} holds NaN in {np.isnan(mask).sum()} pixels; write it again without NaN")
    return np.rint(np.clip(mask, 0, 1) * 255).astype(np.uint8)


def _subject(values: np.ndarray) -> np.ndarray:
    """[h, w] where a mask's subject is, of its channels [h, w, c]: grey or colour, and perhaps alpha behind them."""
    channels = values.shape[2]
    with_alpha = channels in _WITH_ALPHA
    colour = values[..., : channels - with_alpha].max(axis=2)
    if with_alpha and (colour == colour[0, 0]).all():
        alpha = values[..., -1]
        opaque = 1 if alpha.dtype == np.float32 else np.iinfo(alpha.dtype).max
        return alpha if alpha.min() < opaque else colour
    return colour


def resized(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """[h, w] uint8 of (width, height) px that shows what the mask [h', w'] shows, corner to corner: the average of its
    pixels where it is reduced; where it is enlarged an edge stays where it was, and as sharp as it may have been: one
    that rises within a pixel does so again, one that rises over several stays as soft (`crispness`)."""
    if (mask.shape[1], mask.shape[0]) == tuple(size):
        return mask
    import cv2

    if mask.size > size[0] * size[1]:
        return np.asarray(cv2.resize(mask, tuple(size), interpolation=cv2.INTER_AREA))
    crisp, times = crispness(mask), float(np.sqrt(size[0] * size[1] / mask.size))
    values = mask.astype(np.float32)
    # Steps of a mask without soft edges, which would stay steps; soft ones are blurred enough.
    even = (1 - crisp) * values + crisp * cv2.GaussianBlur(values, (0, 0), _STEPS)
    large = cv2.resize(even, tuple(size), interpolation=cv2.INTER_CUBIC)
    contrast = 1 + (_RISE * times - 1) * crisp
    return np.rint(np.clip(127.5 + contrast * (large - 127.5), 0, 255)).astype(np.uint8)


def read_depth(path: str | Path) -> np.ndarray:
    """[h, w] float32 metres of the first channel of a float file; what is not finite means no surface and becomes 0.

    Raises SourceError for integer files, whose unit nobody knows, and for negative depth.
    """
    values = _read(path)[..., 0]
    if values.dtype != np.float32:
        raise SourceError(f"depth {path} holds {values.dtype} values; depth is read from float EXR files in metres")
    depth = np.where(np.isfinite(values), values, np.float32(0))
    if (depth < 0).any():
        raise SourceError(
            f"depth {path} holds {depth.min():g} m; depth along the optical axis must not be negative (0 = no surface)"
        )
    return depth


def read_depth_map(path: str | Path, scale: float, inverse: bool = False) -> np.ndarray:
    """[h, w] float32 metres of the first channel of a float or integer file, `scale` metres a unit, or with `inverse`
    1/metres a unit; 0 and what is not finite mean no surface.

    Raises SourceError for negative depth.
    """
    values = _read(path)[..., 0].astype(np.float32)
    depth = np.where(np.isfinite(values), values, np.float32(0)) * np.float32(scale)
    if inverse:
        depth = np.where(depth == 0, np.float32(0), 1 / np.where(depth == 0, np.float32(1), depth))
    if (depth < 0).any():
        raise SourceError(
            f"depth map {path} holds {depth.min():g} m;"
            " depth along the optical axis must not be negative (0 = no surface)"
        )
    return depth


def has_alpha(path: str | Path) -> bool:
    """Whether a picture's file has alpha behind its grey or colour; it is not decoded. Raises SourceError."""
    source, spec = _open(path)
    source.close()
    return spec.nchannels in _WITH_ALPHA


def largest_of_16_bits(path: str | Path) -> int | None:
    """The largest value of colour in a picture of 16 bits a channel; None of another kind, which is not decoded. Raises
    SourceError."""
    source, spec = _open(path)
    source.close()
    if str(spec.format) != "uint16":
        return None
    values = _read(path)
    with_alpha = values.shape[2] in _WITH_ALPHA
    return int(values[..., : values.shape[2] - with_alpha].max())


def holds_integers(path: str | Path) -> bool:
    """Whether a picture's file holds integers, whose unit nobody knows; it is not decoded. Raises SourceError."""
    source, spec = _open(path)
    source.close()
    return str(spec.format) in ("uint8", "uint16")


def write_png(path: str | Path, picture: np.ndarray) -> None:
    """Write uint8 [h, w] grey, [h, w, 3] RGB or [h, w, 4] RGB
    with straight (not premultiplied) alpha. Raises NotWritten."""
    if picture.dtype != np.uint8:
        raise ValueError(f"a PNG is written from uint8, got {picture.dtype} for {path}")
    _write(path, picture, "uint8", {"oiio:UnassociatedAlpha": 1, "png:compressionLevel": 4})


def write_exr(path: str | Path, picture: np.ndarray) -> None:
    """Write float16 or float32 [h, w] or [h, w, 3] as EXR of that type, without loss;
    equal values give equal bytes. Raises NotWritten."""
    kinds = {np.dtype(np.float16): "half", np.dtype(np.float32): "float"}
    if picture.dtype not in kinds:
        raise ValueError(f"an EXR is written from float16 or float32, got {picture.dtype} for {path}")
    _write(path, picture, kinds[picture.dtype], {"compression": "zip", "DateTime": NO_TIME})


def _is_whole(path: Path) -> bool:
    """Whether a file that was just written can be read to its end."""
    try:
        _read(path)
    except SourceError:
        return False
    return True


def _open(path: str | Path) -> tuple[Any, Any]:
    import OpenImageIO as oiio

    regular(path, "picture")
    hints = oiio.ImageSpec()
    hints["oiio:UnassociatedAlpha"] = 1
    with reader_of(path, "picture"):
        source = oiio.ImageInput.open(str(path), hints)
        cause = oiio.geterror()
    if source is None:
        raise SourceError(f"cannot read picture {path}: {_line(cause)}")
    spec = source.spec()
    check_picture(f"picture {path}", spec.width, spec.height)
    return source, spec


def _line(cause: str) -> str:
    return " ".join(cause.split()) or "unknown format"


def _read(path: str | Path) -> np.ndarray:
    """[h, w, c] uint8, uint16 or float32, the tagged orientation applied."""
    source, spec = _open(path)
    kind = str(spec.format)
    channels = min(spec.nchannels, MOST_CHANNELS)
    with reader_of(path, "picture"):
        values = source.read_image(0, 0, 0, channels, kind if kind in ("uint8", "uint16") else "float")
        cause = source.geterror()
        source.close()
    if values is None or cause:
        raise SourceError(f"cannot read picture {path} to its end: {_line(cause)}; it is damaged or cut off")
    return _oriented(
        np.asarray(values).reshape(spec.height, spec.width, channels), spec.getattribute("Orientation") or 1
    )


def _oriented(values: np.ndarray, orientation: int) -> np.ndarray:
    """Undo the EXIF/TIFF orientation 1..8 (TIFF 6.0, tag 274)."""
    if orientation >= 5:
        values = values.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return np.ascontiguousarray(values)


def _to_bytes(values: np.ndarray) -> np.ndarray:
    """uint16 is 257 times uint8."""
    return (
        np.ascontiguousarray(values)
        if values.dtype == np.uint8
        else ((values.astype(np.uint32) + 128) // 257).astype(np.uint8)
    )


def _write(path: str | Path, picture: np.ndarray, kind: str, attributes: dict[str, Any]) -> None:
    import OpenImageIO as oiio

    values = np.ascontiguousarray(picture if picture.ndim == 3 else picture[..., None])
    height, width, channels = values.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    for name, value in attributes.items():
        spec[name] = value
    out = oiio.ImageOutput.create(str(path))
    if out is None:
        raise ValueError(f"cannot write {path}: {_line(oiio.geterror())}")
    with whole_file(path, values.nbytes) as partial:
        done = out.open(str(partial), spec) and out.write_image(values)
        cause = out.geterror()
        if not (out.close() and done and _is_whole(partial)):  # of a full disk the PNG writer says nothing
            ask_why(partial, values.nbytes, _line(cause))
