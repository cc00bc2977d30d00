"""The layouts by name. A further one is a file of this folder and its entry here."""

from __future__ import annotations

from collections.abc import Mapping

from posegaussian.storage.exporters.layouts.colmap import LAYOUT as COLMAP
from posegaussian.storage.exporters.layouts.declaration import Layout
from posegaussian.storage.exporters.layouts.easymocap import LAYOUT as EASYMOCAP
from posegaussian.storage.exporters.layouts.images import LAYOUT as IMAGES
from posegaussian.storage.exporters.layouts.nerfstudio import LAYOUT as NERFSTUDIO

LAYOUTS: Mapping[str, Layout] = {x.name: x for x in (COLMAP, NERFSTUDIO, EASYMOCAP, IMAGES)}
"""In the order in which the help names them."""
