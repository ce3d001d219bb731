"""The available fabrics, viewpoints, cloth textures and floors, by name.

Standard library only: the configuration and the workflow load it without numpy or Blender.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

FABRICS_FILE = Path(__file__).with_name("fabrics.json")


@cache
def fabric_names() -> tuple[str, ...]:
    """Return the names of the fabrics: position k is material id ``m{k:02d}``."""
    return tuple(json.loads(FABRICS_FILE.read_text(encoding="utf-8"))["fabrics"])


@dataclass(frozen=True)
class Viewpoint:
    """A fixed camera on the bench, aimed at the middle of the stage's travel."""

    # Angle about the vertical axis; 0 looks against the drag direction (the camera stands ahead of
    # the stage), 90 looks along +y (from a camera beside the track, at -y)
    azimuth_deg: float
    elevation_deg: float  # angle of the optical axis below the horizontal
    distance_m: float  # from the camera to the point it is aimed at
    # True where the viewpoint exists to test networks on views they have not seen
    test_only: bool = False
    # True of a family: every bench has a camera of its own near this viewpoint, and its images are
    # rectified into the calibrated one (`slipstitch.images.calibrated_view`)
    drawn: bool = False


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
    **{f"bench_{member}": replace(_CALIBRATED, drawn=True) for member in range(1, 9)},
}

#: Name -> seed of the texture's random choices. The last one is the paper's "unseen texture": it
#: may be used to test a network, never to train one.
TEXTURES: dict[str, int] = {
    **{"stripes": 101, "checks": 102, "tartan": 103, "dots": 104, "houndstooth": 105},
    **{"floral": 106, "denim": 107, "linen": 108, "chevron": 109},
}
TEST_ONLY_TEXTURES: frozenset[str] = frozenset({"chevron"})
#: Textures drawn anew for every film: pattern, scale, colours and contrast.
TEXTURE_FAMILY: tuple[str, ...] = tuple(f"cloth_{member}" for member in range(1, 9))


def is_texture_file(name: str) -> bool:
    """Whether a texture's name is that of an image file."""
    return name.lower().endswith((".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"))


@dataclass(frozen=True)
class Floor:
    """Appearance of a substrate: a rough specular layer over a grey Lambertian body.

    Each pair is a range from which every simulation draws its own value.
    """

    albedo: tuple[float, float]  # of the body
    # Specular, at normal incidence; it grows towards grazing incidence (Schlick 1994)
    reflectance: tuple[float, float] = (0.0, 0.0)
    # As Blender has it: the width of the distribution of slopes (GGX) is its square
    roughness: tuple[float, float] = (0.0, 0.0)

    @property
    def reflects_plainly(self) -> bool:
        """Whether the paper's tests would set it apart as reflective: metals and mirrors."""
        return self.reflectance[1] > 0.1


#: The paper's substrates, and two generic ones. Reflectances at normal incidence are those
#: of the materials (aluminium 0.91, steel 0.58, a refractive index of 1.5: 0.04) less what a film
#: or a worn surface takes; roughness and albedo are estimates of what such plates look like.
FLOORS: dict[str, Floor] = {
    "matte": Floor(albedo=(0.22, 0.22)),
    "reflective": Floor((0.08, 0.3), (0.04, 0.5), (0.1, 0.5)),
    "aluminium": Floor((0.02, 0.06), (0.7, 0.9), (0.3, 0.5)),
    "aluminium-pet": Floor((0.02, 0.06), (0.6, 0.8), (0.2, 0.35)),
    "ceramic": Floor((0.45, 0.65), (0.035, 0.055), (0.1, 0.25)),
    "rough-glass": Floor((0.15, 0.3), (0.035, 0.05), (0.4, 0.6)),
    "smooth-glass": Floor((0.1, 0.25), (0.035, 0.05), (0.02, 0.08)),
    "polyester-mirror": Floor((0.01, 0.03), (0.75, 0.9), (0.02, 0.1)),
    "stainless-steel": Floor((0.02, 0.06), (0.5, 0.62), (0.2, 0.4)),
}


def catalogue_entries(
    viewpoints: Iterable[str] = (), textures: Iterable[str] = (), floors: Iterable[str] = ()
) -> dict[str, dict[str, Any]]:
    """The catalogue entries of these names, compared to determine what is up to date.

    Return ``viewpoints``, ``textures`` and ``floors``, each name -> plain values, as JSON gives
    them back; None for what is not in the catalogue, such as a texture's file. With any viewpoint
    goes the calibrated one, which others are turned from. Kinds without a name are left out.
    """
    viewpoints = list(viewpoints)
    seen = sorted({"calibrated", *viewpoints}) if viewpoints else []
    entries: dict[str, dict[str, Any]] = {
        "viewpoints": {name: VIEWPOINTS.get(name) for name in seen},
        "textures": {name: TEXTURES.get(name) for name in sorted(textures)},
        "floors": {name: FLOORS.get(name) for name in sorted(floors)},
    }
    return json.loads(json.dumps({kind: of for kind, of in entries.items() if of}, default=asdict))
