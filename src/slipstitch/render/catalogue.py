"""The viewpoints and the cloth textures there are, by name.

Standard library only: the configuration and the workflow load it without numpy or Blender.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Viewpoint:
    """A fixed camera on the bench, aimed at the middle of the stage's travel.

    Attributes
    ----------
    azimuth_deg : float
        Angle about the vertical axis; 0 looks against the drag direction (the camera stands
        ahead of the stage), 90 looks along +y (the camera stands beside the track, at -y).
    elevation_deg : float
        Angle of the optical axis below the horizontal.
    distance_m : float
        From the camera to the point it is aimed at.
    test_only : bool
        True where the viewpoint exists to test networks on views they have not seen.
    """

    azimuth_deg: float
    elevation_deg: float
    distance_m: float
    test_only: bool = False


_CALIBRATED = Viewpoint(azimuth_deg=40.0, elevation_deg=24.0, distance_m=1.4)

VIEWPOINTS: dict[str, Viewpoint] = {
    "calibrated": _CALIBRATED,
    "frontal": Viewpoint(azimuth_deg=0.0, elevation_deg=24.0, distance_m=1.4),
    "side": Viewpoint(azimuth_deg=90.0, elevation_deg=12.0, distance_m=1.4),
    **{
        f"calibrated_{turn:+d}": Viewpoint(
            azimuth_deg=_CALIBRATED.azimuth_deg + turn,
            elevation_deg=_CALIBRATED.elevation_deg,
            distance_m=_CALIBRATED.distance_m,
            test_only=True,
        )
        for turn in (-15, -10, -5, 5, 10, 15)
    },
}

#: Name -> seed of the texture's random choices. The last one is the paper's "unseen texture": it
#: may be used to test a network, never to train one.
TEXTURES: dict[str, int] = {
    "stripes": 101,
    "checks": 102,
    "tartan": 103,
    "dots": 104,
    "houndstooth": 105,
    "floral": 106,
    "denim": 107,
    "linen": 108,
    "chevron": 109,
}
TEST_ONLY_TEXTURES: frozenset[str] = frozenset({"chevron"})
