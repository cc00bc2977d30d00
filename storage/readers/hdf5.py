"""What an HDF5 file holds of one camera, frame by frame: pictures, masks and 2D joints.

`data` is a path in the file: of a group with an encoded picture a frame, named by its number, or of an array whose
first axis is the frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posegaussian.storage.formats.joint_files import Detections, joint_rows
from posegaussian.storage.formats.plain_hdf5 import Hdf5File
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers.encoded import decode, is_jpeg

HALF_WHITE = 128
"""From where a pixel of a mask kept as JPEG counts: its noise reaches everywhere."""


def read_picture(file: Hdf5File, data: str, index: int) -> np.ndarray:
    """[h, w, 3] uint8 sRGB. Raises SourceError."""
    place = f"{data}/{index}"
    return decode(file.encoded(place), f"picture {place} of {file.path}")


def read_mask(file: Hdf5File, data: str, index: int) -> np.ndarray:
    """[h, w] uint8, 0..255 foreground: an encoded picture's largest channel, or an array [frame, h, w] in which all but
    0 is the subject. Raises SourceError."""
    place = f"{data}/{index}"
    if file.has(place):
        raw = file.encoded(place)
        mask = decode(raw, f"mask {place} of {file.path}").max(axis=2)
        return np.where(mask >= HALF_WHITE, np.uint8(255), np.uint8(0)) if is_jpeg(raw) else mask
    found = file.row(data, index)
    if found.ndim != 2:
        raise SourceError(f"{file.path}: {data} has entries of shape {found.shape}; masks [h, w] are expected")
    return np.where(found != 0, np.uint8(255), np.uint8(0))


def read_joints(file: Hdf5File, data: str, index: int, picked: Sequence[int]) -> Detections:
    """The one person of a frame, of an array [frame, J, 3] or [frame, 3 J] (x, y, score) with pixel centres at
    integers: the joints `picked` of its J, in that order. Raises SourceError."""
    found = joint_rows(file.row(data, index), file.path, data, half=False)
    if any(not 0 <= j < len(found) for j in picked):
        raise SourceError(f"{file.path}: {data} has {len(found)} joints a frame, of which {max(picked)} is none")
    return Detections(found[list(picked)][None], np.zeros((1, 5)))
