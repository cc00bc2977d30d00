"""The calibration formats. A further one is a file beside this one and its entry here."""

from __future__ import annotations

from posegaussian.storage.importers.anipose import FORMAT as ANIPOSE
from posegaussian.storage.importers.biocv import FORMAT as BIOCV
from posegaussian.storage.importers.calibration_format import CalibrationFormat
from posegaussian.storage.importers.kalibr import FORMAT as KALIBR
from posegaussian.storage.importers.metashape import FORMAT as METASHAPE
from posegaussian.storage.importers.opencv_storage import FORMAT as OPENCV_STORAGE
from posegaussian.storage.importers.realitycapture import FORMAT as REALITYCAPTURE
from posegaussian.storage.importers.vicon import FORMAT as VICON

FORMATS: tuple[CalibrationFormat, ...] = (KALIBR, METASHAPE, REALITYCAPTURE, OPENCV_STORAGE, ANIPOSE, BIOCV, VICON)
"""In the order in which sentences name them."""
