"""All features of a case in one place, and the model of a set of causes over them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from slipstitch.criticise.case import Case
from slipstitch.criticise.features.block import Block
from slipstitch.criticise.features.drag import drag_block
from slipstitch.criticise.features.drop_drag import drop_drag_block
from slipstitch.criticise.features.incline import incline_block
from slipstitch.criticise.features.spring_slider import spring_slider_block
from slipstitch.criticise.features.strip import strip_block
from slipstitch.criticise.forward.bench import Bench
from slipstitch.criticise.mechanism import BENCH_MECHANISMS, MECHANISMS
from slipstitch.errors import BadInput
from slipstitch.friction_law import CONTACT_MECHANISMS, FrictionLaw, Parameter

REMEMBERED = 64  # predictions of a block
INSTRUMENT_QUANTITIES = ("relaxed_mN", "stiffness", "lost_motion_mm", "edge_slope")
# What a mechanism must have had recorded, and on which features it would act.
COVARIATE_OF = {
    "load_power": "load_ratio",
    "adhesion": "load_ratio",
    "ageing": "dwell_s",
    "rate": "speed_mm_s",
    "anisotropy": "orientation_deg",
    "nap": "orientation_deg",
    "wear": "repeat_index",
    "humidity": "rh_pct",
    "tilt": "azimuth_deg",
    "time_lag": "speed_mm_s",
}
# A cause that cannot be told from another one whose covariate was not recorded: whether an
# excess at rest grows with the rest, say.
ALIKE_IF_UNRECORDED = {"static_kinetic": "ageing"}


@dataclass
class Measurements:
    """Features of every protocol, in one order.

    Attributes
    ----------
    rows : one line a feature (see :class:`Block`), with ``protocol``.
    y, u : (n,) measured values and instrument uncertainties.
    run, specimen : (n,) numbers of the run and of the specimen (unique over protocols).
    """

    blocks: list[Block]
    rows: pd.DataFrame
    y: np.ndarray
    u: np.ndarray
    run: np.ndarray
    specimen: np.ndarray
    protocol: np.ndarray
    lower_bound: np.ndarray
    remembered: dict[tuple, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def null_parameters(self) -> tuple[Parameter, ...]:
        """Logarithms of the friction coefficients that the case's protocols have."""
        names = {block.protocol for block in self.blocks}
        found = []
        if names - {"strip"}:
            found.append(Parameter("mu_face", "1", np.log(0.3), 0.05, np.log(0.005), np.log(8.0)))
        if "strip" in names:
            found.append(Parameter("mu_edge", "1", np.log(0.25), 0.05, np.log(0.01), np.log(3.0)))
        return tuple(found)

    def predict(self, values: dict[str, float], causes: tuple[str, ...]) -> np.ndarray:
        """What the instruments would read, (n,).

        ``values`` holds the logarithms of mu_face and mu_edge and the causes' parameters.
        """
        mechanisms, changes = {}, {}
        for cause in causes:
            mechanism = MECHANISMS[cause]
            own = {p.name: values[p.name] for p in mechanism.parameters}
            if cause in CONTACT_MECHANISMS:
                mechanisms[cause] = own
            else:
                changes |= BENCH_MECHANISMS[cause].changes(own)
        bench = Bench(**changes)
        face = FrictionLaw(float(np.exp(values.get("mu_face", -1.2))), mechanisms)
        edge = FrictionLaw(float(np.exp(values.get("mu_edge", -1.2))), mechanisms)
        return np.concatenate([self._block(i, face, edge, bench) for i in range(len(self.blocks))])

    def _block(self, i: int, face: FrictionLaw, edge: FrictionLaw, bench: Bench) -> np.ndarray:
        """One block's prediction; derivatives ask for the same one again and again."""
        block = self.blocks[i]
        law = face if block.LAW == "face" else edge
        mechanisms = tuple((name, *values.values()) for name, values in law.mechanisms.items())
        key = (i, law.coefficient, mechanisms, *(getattr(bench, name) for name in block.READS))
        if key not in self.remembered:
            if len(self.remembered) >= REMEMBERED:
                self.remembered.pop(next(iter(self.remembered)))
            self.remembered[key] = block.predict(face, edge, bench)
        return self.remembered[key]

    def unrecorded(self, cause: str) -> np.ndarray:
        """(n,) True where the cause may act but what drives it was not recorded."""
        column = COVARIATE_OF.get(cause)
        if column is None:
            return np.zeros(len(self.y), bool)
        missing = self.rows[column].isna().to_numpy()
        acts = ~self.rows["quantity"].isin(INSTRUMENT_QUANTITIES).to_numpy()
        static = self.rows["static"].to_numpy(bool)
        if cause == "ageing":
            acts &= static
        elif cause == "rate":
            acts &= ~static
        elif cause == "time_lag":
            acts &= (self.rows["protocol"] == "drop_drag").to_numpy()
        return missing & acts

    def unrecorded_double(self, cause: str) -> str | None:
        """The mechanism that would do the same, if what drives it was not recorded.

        A single recorded value (the rest at a reversal) tells as little as none.
        """
        double = ALIKE_IF_UNRECORDED.get(cause)
        if double is None or not self.unrecorded(double).any():
            return None
        acting = self.rows["static"].to_numpy(bool)
        varied = self.rows[COVARIATE_OF[double]][acting].nunique() > 1
        return None if varied else double


def assemble(case: Case, measured: bool = True) -> Measurements:
    """Features of a case; ``measured=False`` gives the quantities to predict for a design.

    Raises
    ------
    BadInput
        If no run of any protocol gives a feature.
    """
    tables, nominal = case.tables, case.nominal
    blocks: list[Block | None] = []
    if "incline" in tables:
        blocks.append(incline_block(tables["incline"], nominal, measured))
    if "strip" in tables:
        blocks.append(strip_block(tables["strip"], nominal, measured))
    if "drag_runs" in tables:
        traces = tables.get("drag") if measured else None
        blocks.append(drag_block(tables["drag_runs"], traces, nominal))
    if "drop_drag_runs" in tables:
        frames = tables.get("drop_drag") if measured else None
        blocks.append(drop_drag_block(tables["drop_drag_runs"], frames, nominal))
    if "spring_slider_runs" in tables:
        traces = tables.get("spring_slider") if measured else None
        blocks.append(spring_slider_block(tables["spring_slider_runs"], traces, nominal))
    kept = [block for block in blocks if block is not None]
    if not kept:
        raise BadInput(f"{case.name}: no run has a usable trace; at least one slip is needed")
    for block in kept:
        block.rows.insert(0, "protocol", block.protocol)
    rows = pd.concat([block.rows for block in kept], ignore_index=True)
    run = pd.factorize(rows["protocol"] + "/" + rows["run_id"])[0]
    specimen = pd.factorize(rows["protocol"] + "/" + rows["specimen_id"])[0]
    return Measurements(
        kept,
        rows,
        rows["y"].to_numpy(float),
        rows["u"].to_numpy(float),
        run,
        specimen,
        rows["protocol"].to_numpy(str),
        rows["lower_bound"].to_numpy(bool),
    )
