"""Effects that say where a captured pixel lies:
undistortion, crop and scale, shared by all who look at pictures or joints."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.imaging import facts
from posegaussian.stages.imaging.camera_mapping import distort, reach, switched, undistorted, unreduced_size
from posegaussian.storage.model.cameras import Rig

GRID = 33
"""Points a side at which a lens is looked at."""


def undistorted_as_set(rig: Rig, source_rig: Rig, captured: np.ndarray, crops: np.ndarray, not_off: Facts) -> Rig:
    """The cameras `undistorted`; lenses and crops [V, 3] whose effect is off do not count."""
    source_rig, crops = switched(source_rig, crops, not_off)
    return undistorted(rig, source_rig, captured, crops)


def lens_displacement(rig: Rig, source_rig: Rig) -> np.ndarray:
    """[V] px of `frames/*`: how far each lens moves the picture of a point, at most.

    Points lie on a grid over the whole picture, edges included, as far as the lens model is one-to-one.
    """
    out = np.zeros(len(rig))
    for v in range(len(rig)):
        k, distortion = rig.intrinsics[v], source_rig.distortion[v]
        if not distortion.any():
            continue
        u = np.stack(np.meshgrid(*(np.linspace(0.0, n, GRID) for n in rig.size[v])), axis=-1).reshape(-1, 2)
        ideal = (u - k[:2, 2]) @ np.linalg.inv(k[:2, :2]).T
        ideal = ideal[np.linalg.norm(ideal, axis=1) <= reach(distortion)]
        moved = (distort(ideal, distortion) - ideal) @ k[:2, :2].T
        out[v] = np.linalg.norm(moved, axis=1).max(initial=0.0)
    return out


def crop_displacement(rig: Rig, source_rig: Rig, captured_size: np.ndarray, crops: np.ndarray) -> np.ndarray:
    """[V] px of `frames/*`: how far crop and scale move the corner of a captured picture, at most."""
    corners = captured_size[:, None, :] * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])  # [V, 4, 2]
    moved = corners * crops[:, None, :1] + crops[:, None, 1:] - corners
    return np.linalg.norm(moved * (rig.size / unreduced_size(rig, source_rig))[:, None], axis=-1).max(axis=-1)


def _undistortion(evidence: Evidence, bound: float) -> Decision:
    moved = lens_displacement(evidence.rig, evidence.source_rig)
    worst = int(moved.argmax())
    if not moved[worst]:
        return Decision(False, 0.0, bound, "the calibration has no lens distortion")
    return Decision(
        bool(moved[worst] > bound),
        float(moved[worst]),
        bound,
        f"the lens of {evidence.rig.names[worst]} moves a point by up to {moved[worst]:.2f} px",
    )


def _crop_scale(evidence: Evidence, bound: float) -> Decision:
    moved = crop_displacement(
        evidence.rig, evidence.source_rig, evidence.captured_size, evidence.captured_to_calibrated
    )
    # Pictures that reach beyond the calibrated one have to be cut though none of their pixels moves.
    reduced = evidence.rig.size / unreduced_size(evidence.rig, evidence.source_rig)
    other = np.abs(evidence.captured_size - evidence.source_rig.size) * reduced
    moved = np.maximum(moved, other.max(axis=1))
    worst = int(moved.argmax())
    if not moved[worst]:
        return Decision(False, 0.0, bound, "the captured pixels are the calibrated ones: no crop and no other size")
    return Decision(
        bool(moved[worst] > bound),
        float(moved[worst]),
        bound,
        f"crop and scale move a corner of {evidence.rig.names[worst]} by up to {moved[worst]:.2f} px",
    )


def _crop_refusal(evidence: Evidence) -> str | None:
    for name, captured, calibrated in zip(
        evidence.rig.names, evidence.captured_size, evidence.source_rig.size, strict=True
    ):
        if (captured != calibrated).any():
            return (
                f"effects.crop_scale is off, but pictures of {name} are {captured[0]}x{captured[1]} px and its"
                f" calibration is for {calibrated[0]}x{calibrated[1]}; set it to auto"
            )
    return None


UNDISTORTION = Effect(
    facts.UNDISTORTION,
    "Undo the lens distortion of pictures, masks and joints.",
    "largest displacement by a lens",
    # A tenth of the 1 px to which calibrations and joints are good at best; resampling costs more sharpness than that.
    0.1,
    "px",
    _undistortion,
)
CROP_SCALE = Effect(
    facts.CROP_SCALE,
    "Bring captured pixels to the calibrated ones by the crop that the import found, or frames.crop.",
    "largest displacement by crop and scale",
    0.1,
    "px",
    _crop_scale,
    refusal=_crop_refusal,
)
