"""How far from a single source camera a picture is worth looking at."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.geometry.pairs import angle_at
from posegaussian.stages.geometry.subject import middle_rays
from posegaussian.storage.model.cameras import CameraPath, Rig


def cone_notes(
    rig: Rig, view: int, distance: float, what: str, useful: float, paths: Mapping[str, CameraPath]
) -> list[str]:
    """Sentences for the plan of a sequence with a single source view: what its depth can give, and which paths leave
    what is useful.

    Args:
        rig: cameras of the frames grid.
        view: the source view.
        distance: metres along its optical axis to the subject.
        what: what its depth is, as part of a sentence.
        useful: degrees at the subject up to which pictures are worth looking at.
        paths: camera paths that are rendered.
    """
    name = rig.names[view]
    alone = (
        f"{name} is the only source view, so nothing is matched; {what}; the side that faces away stays empty, and"
        f" novel views are worth looking at up to {useful:g} degrees from it"
    )
    notes = [alone]
    subject = rig.centres[view] + distance * middle_rays(rig)[view]
    for path in paths.values():
        centres = -np.einsum("...ji,...j->...i", path.world_to_camera[..., :3, :3], path.world_to_camera[..., :3, 3])[
            path.served
        ]
        farthest = max((angle_at(subject, rig.centres[view], c) for c in centres), default=0.0)
        if farthest > useful + 0.5:
            notes.append(
                f"camera path {path.text!r} goes {farthest:.0f} degrees away from {name}, beyond the {useful:g} that"
                " are worth looking at; `sway` stays within"
            )
    return notes
