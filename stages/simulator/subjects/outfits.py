"""Who may be filmed and what they wear: builds, skins and hair of the baked subjects, and outfits. Only data.

Colours are sRGB bytes. Lengths of sleeves and legs are shares of the limb: 1 reaches the elbow or knee, 2 wrist or
ankle.
"""

from __future__ import annotations

from dataclasses import dataclass

Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class Garment:
    """One piece of cloth."""

    pattern: str
    """Name in `patterns.PATTERNS`."""
    colors: tuple[Rgb, Rgb, Rgb]
    """Ground, second and third colour."""
    length: float
    """Of sleeves or legs, share of the limb."""
    loose: float = 0.010
    """Metres between cloth and skin, at the trunk; more towards the ends."""
    scale: float = 0.05
    """Period of the pattern, metres."""
    gloss: float = 0.02
    """Share of light mirrored face-on."""
    exponent: float = 20.0
    """Sharpness of the highlight."""
    sheen: float = 0.0
    """Share of Fresnel's reflection that is left."""
    folds: float = 0.0
    """Metres that folds stand out."""


@dataclass(frozen=True)
class Outfit:
    """What a person wears."""

    upper: Garment
    lower: Garment
    shoes: Rgb
    sole: Rgb


@dataclass(frozen=True)
class Appearance:
    """A subject's skin and hair."""

    skin: Rgb
    hair: Rgb
    style: str
    """short, bob or long."""


def _plain(color: Rgb, length: float, **more: float) -> Garment:
    return Garment("plain", (color, color, color), length, **more)


_WHITE, _BLACK = (232, 230, 226), (26, 26, 30)
_DENIM = Garment("denim", ((52, 70, 104), (126, 148, 182), (0, 0, 0)), 1.95, 0.012)

OUTFITS: dict[str, Outfit] = {
    "dark": Outfit(_plain((34, 34, 40), 1.9), _plain((28, 30, 36), 1.95, loose=0.012), _BLACK, (40, 40, 42)),
    "stripes": Outfit(
        Garment("stripes", ((226, 226, 222), (34, 52, 110), _BLACK), 1.9, scale=0.045), _DENIM, _WHITE, (200, 200, 200)
    ),
    "checks": Outfit(
        Garment("checks", ((176, 44, 40), (60, 24, 30), (226, 214, 170)), 1.85, 0.014, 0.075),
        _plain((150, 128, 92), 1.95, loose=0.014),
        (92, 58, 34),
        (48, 32, 24),
    ),
    "sport": Outfit(
        _plain((198, 52, 44), 0.62, loose=0.018),
        Garment("camouflage", ((58, 62, 70), (98, 104, 112), (30, 32, 36)), 0.92, 0.022, 0.05),
        (220, 224, 60),
        (240, 240, 240),
    ),
    "grey": Outfit(
        _plain((128, 130, 134), 1.92, loose=0.016), _plain((50, 52, 60), 1.95), (70, 70, 76), (210, 208, 204)
    ),
    "dots": Outfit(
        Garment("dots", ((30, 92, 108), (238, 226, 190), _BLACK), 0.7, 0.016, 0.042),
        Garment("denim", ((88, 104, 132), (150, 168, 196), _BLACK), 1.95, 0.011),
        (206, 70, 70),
        _WHITE,
    ),
    "floral": Outfit(
        Garment("floral", ((238, 224, 204), (204, 62, 90), (46, 106, 66)), 1.45, 0.018, 0.05),
        _plain((36, 44, 82), 1.93, loose=0.016),
        (120, 84, 60),
        (70, 50, 40),
    ),
    "camouflage": Outfit(
        Garment("camouflage", ((104, 112, 70), (62, 70, 44), (150, 134, 96)), 1.93, 0.020, 0.06),
        _plain((38, 38, 40), 1.95, loose=0.013),
        (112, 84, 54),
        (40, 34, 30),
    ),
}
LOOKS: dict[str, Appearance] = {
    "anna": Appearance((224, 178, 152), (92, 58, 34), "long"),
    "boris": Appearance((206, 158, 130), (58, 42, 30), "short"),
    "chiara": Appearance((214, 170, 142), (150, 146, 142), "bob"),
    "dayo": Appearance((112, 74, 52), (24, 20, 20), "short"),
    "emil": Appearance((220, 176, 154), (196, 194, 190), "short"),
    "fatima": Appearance((136, 92, 66), (28, 22, 22), "bob"),
    "gao": Appearance((210, 168, 130), (26, 24, 26), "short"),
    "hana": Appearance((226, 188, 158), (34, 26, 26), "long"),
    "ines": Appearance((176, 126, 94), (44, 30, 24), "bob"),
}
