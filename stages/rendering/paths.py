"""Camera paths under the settings of a run: how far from the sources there is anything to see follows from depth."""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.camera_paths.stretch import best_stretch
from posegaussian.stages.contract.declaration import Paths
from posegaussian.stages.contract.io import Views
from posegaussian.storage.model.cameras import CameraPath, Rig


def path_of(text: str, rig: Rig, views: Views, source_frames: np.ndarray, settings: Any) -> CameraPath:
    """The target cameras of a text; see `make_path`."""
    return make_path(text, rig, views, source_frames, settings.depth.subject_distance, settings.depth.max_angle)


def default_path(rig: Rig, views: Views, settings: Any) -> str:
    """What is rendered unless something else is asked for: the held-out cameras, else between source cameras that
    depth can match, else near one."""
    if views.held_out:
        return "held_out"
    return "sway" if best_stretch(rig, views.sources, settings.depth.max_angle) is None else "between"


PATHS = Paths(path_of, default_path)
"""How the paths of pictures are made."""
