"""Do pictures have the size that their calibration is for?"""

from __future__ import annotations

from collections.abc import Collection

from posegaussian.storage.model.capture import Capture


def unexplained_sizes(capture: Capture, crops: Collection[str]) -> list[str]:
    """Sentences about cameras whose pictures have another size than their calibration, and nothing says how they
    relate: archives made before imports found that out. `crops`: cameras whose crop is set."""
    known, rig = {*capture.crops, *crops}, capture.rig
    sizes = {n: (tuple(capture.pictures[v].size), tuple(map(int, rig.size[v]))) for v, n in enumerate(rig.names)}
    return [
        f"camera {n}: pictures are {w}x{h} px, the calibration is for {cw}x{ch} px; import the capture again, which"
        " finds out how they relate, or say it with frames.crop"
        for n, ((w, h), (cw, ch)) in sizes.items()
        if (w, h) != (cw, ch) and n not in known
    ]
