"""A picture in the light of another camera: what a camera's own exposure is, pictures of other cameras cannot know."""

from __future__ import annotations

import numpy as np

from posegaussian.storage.model.masks import foreground


def fitted(picture: np.ndarray, filmed: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """A picture [h, w, 3] of 0 to 255 on black by one gain a channel that fits it to a filmed one, least squares inside
    its mask [h, w], float64; and the gains."""
    truth, inside, drawn = filmed * (mask[..., None] / 255.0), foreground(mask), picture.astype(np.float64)
    gains = [
        float((truth[inside, i] * drawn[inside, i]).sum() / max((drawn[inside, i] ** 2).sum(), 1)) for i in range(3)
    ]
    return np.clip(drawn * gains, 0, 255), gains
