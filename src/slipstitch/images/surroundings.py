"""Surroundings of a rendered simulation: appearance of the floor and position of the lamp.

Drawn once a fabric and replicate from the configuration's seed, the same for all viewpoints,
textures and friction coefficients: adding a viewpoint or a simulation changes no other, and no
look tells a coefficient. In the second training set a floor is drawn for each viewpoint besides.
A camera of the family ``bench_1`` ... has a floor and a lamp of its own in every simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slipstitch.config.catalogue import FLOORS, VIEWPOINTS
from slipstitch.config.render import RenderSettings
from slipstitch.design.grid import bench_of, digest, is_reflective, viewpoint_ids

# Half the thickness of a light fabric: the floor lies this far under the cloth's middle surface,
# so that neither is drawn through the other.
_FLOOR_BELOW_M = 0.0004
#: Corners of the substrate.
FLOOR_M = np.array(
    [(x, y, -_FLOOR_BELOW_M) for x, y in ((-0.34, -0.3), (0.64, -0.3), (0.64, 0.3), (-0.34, 0.3))]
)
#: Where the lamp hangs, unless it is moved.
LAMP_POSITION_M = (0.80, -0.50, 1.00)


@dataclass(frozen=True)
class Surroundings:
    """Floor and lamp of one simulation."""

    floor: str = "matte"  # name in the catalogue
    # as drawn, see `slipstitch.config.catalogue.Floor`
    albedo: float = 0.22
    reflectance: float = 0.0
    roughness: float = 0.0
    lamp_position_m: tuple[float, float, float] = LAMP_POSITION_M

    @property
    def reflects(self) -> bool:
        """Whether the floor is reflective."""
        return self.reflectance > 0


#: The floor and lamp of a configuration that varies neither.
MATTE = Surroundings()


def generator(seed: int, *names: str) -> np.random.Generator:
    """Random numbers that depend on the configuration's seed and on these names only."""
    return np.random.default_rng(int.from_bytes(digest(seed, *names)[:8], "big"))


def of_a_family(viewpoint: str) -> bool:
    """Whether a viewpoint of the catalogue is another bench's, with a camera of its own."""
    return viewpoint in VIEWPOINTS and VIEWPOINTS[viewpoint].drawn


def drawn_by(simulation: str, viewpoint: str) -> str:
    """What the looks of a simulation's videos from a viewpoint (by name) are drawn by.

    The bench, so that no look tells the coefficient. For a camera of the family ``bench_1`` ... the
    whole simulation, so that none tells its fabric: harmless where whole simulations are held out,
    the only split that is allowed with such cameras.
    """
    return simulation if of_a_family(viewpoint) else bench_of(simulation)


def draw_surroundings(
    settings: RenderSettings, seed: int, simulation: str, viewpoint_id: str = "v00"
) -> Surroundings:
    """Floor and lamp of a simulation: of its fabric and replicate, or of what `drawn_by` says."""
    view = viewpoint_ids(settings).get(viewpoint_id, "")
    bench = drawn_by(simulation, view)
    rng = generator(seed, bench, *([view] if of_a_family(view) else []), "surroundings")
    floor = _draw_floor(settings.floors, rng)
    lamp_m = LAMP_POSITION_M + rng.uniform(-1, 1, 3) * settings.augmentation.lamp_m
    if is_reflective(settings, viewpoint_id):
        own = generator(seed, bench, view, "reflective floor")
        floor = _draw_floor(settings.reflective_floors, own)
    return Surroundings(*floor, tuple(lamp_m.tolist()))


def _draw_floor(names: Sequence[str], rng: np.random.Generator) -> tuple[str, float, float, float]:
    name = names[int(rng.integers(len(names)))]
    return name, *draw_look(name, rng)


def draw_look(name: str, rng: np.random.Generator) -> tuple[float, float, float]:
    """Albedo, reflectance and roughness of a floor of the catalogue."""
    floor = FLOORS[name]
    albedo, reflectance, roughness = (
        float(rng.uniform(*limits)) for limits in (floor.albedo, floor.reflectance, floor.roughness)
    )
    return albedo, reflectance, roughness
