"""All features of a case in one place, and the model of a set of causes over them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from slipstitch.base.errors import BadInput
from slipstitch.criticise.case import Case
from slipstitch.criticise.causes import (
    BENCH_MECHANISMS,
    MECHANISMS,
    ZEROS,
    Bench,
    DataFinding,
    Zero,
    departures,
)
from slipstitch.criticise.covariates import load_before
from slipstitch.criticise.force_cells import cell_faults
from slipstitch.criticise.plausibility import implausible
from slipstitch.criticise.protocols import INSTRUMENT_QUANTITIES, PROTOCOLS
from slipstitch.criticise.protocols.protocol import Block
from slipstitch.physics.friction_law import Curve, FrictionLaw, Parameter

REMEMBERED = 64  # predictions of a block
# The friction coefficients of the null, of the cloth's face and of a strip's edge.
COEFFICIENTS = tuple(
    Parameter(
        name, "1", np.log(usual), 0.05, np.log(lower), np.log(upper), prior_sd=3.0, coefficient=True
    )
    for name, usual, lower, upper in (("mu_face", 0.3, 0.005, 8.0), ("mu_edge", 0.25, 0.01, 3.0))
)
UNKNOWN_LOG_COEFFICIENT = -1.2
LOG_STEP = 0.01


@dataclass(frozen=True)
class Outlier:
    """A run, or one feature of it, that lies far off what any model says."""

    run_id: str
    reason: str
    features: np.ndarray


@dataclass
class Measurements:
    """Features of every protocol, in one order.

    Attributes
    ----------
    rows : one line a feature (see :class:`Block`), with ``protocol``.
    y, u : (n,) measured values and instrument uncertainties.
    run, specimen : (n,) numbers of the run and of the specimen (unique over protocols).
    astray : (n,) variance of ln mu of runs that lie far off, beyond the others' scatter.
    sound_sensors : no sensor's zero is allowed for.
    further_zeros : (protocol, zero) that are allowed for in this case besides the usual ones.
    implausible : readings or sizes that must be of another unit, a line each.
    findings : what is wrong with the data themselves.
    outliers : those that are allowed for in ``u`` and ``astray``.
    """

    blocks: list[Block]
    rows: pd.DataFrame
    y: np.ndarray
    u: np.ndarray
    run: np.ndarray
    specimen: np.ndarray
    protocol: np.ndarray
    lower_bound: np.ndarray
    astray: np.ndarray
    sound_sensors: bool = False
    further_zeros: tuple[tuple[str, Zero], ...] = ()
    implausible: tuple[str, ...] = ()
    findings: tuple[DataFinding, ...] = ()
    outliers: tuple[Outlier, ...] = ()
    remembered: dict[tuple, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def null_parameters(self) -> tuple[Parameter, ...]:
        """Logarithms of the friction coefficients that the case's protocols have."""
        names = {block.COEFFICIENT for block in self.blocks}
        return tuple(parameter for parameter in COEFFICIENTS if parameter.name in names)

    @cached_property
    def zeros(self) -> list[tuple[str, Zero]]:
        """(protocol, zero of a sensor) of every column of :attr:`zero_columns`."""
        usual = [
            (block.protocol, ZEROS[name])
            for block in self.blocks
            for name in block.READS
            if name in ZEROS and not (self.sound_sensors and ZEROS[name].of_sensor)
        ]
        return [*usual, *self.further_zeros]

    @cached_property
    def zero_columns(self) -> np.ndarray:
        """(n, z) what each zero does to the features when it is one usual size off.

        Sensors add their zeros to what they read: the columns do not depend on the model.
        """
        values = {p.name: p.null for p in self.null_parameters}
        columns = np.zeros((len(self.y), len(self.zeros)))
        for k, (protocol, zero) in enumerate(self.zeros):
            ends = [
                self.predict(values, (), {zero.field: sign * 0.5 * zero.sd * zero.to_si})
                for sign in (1.0, -1.0)
            ]
            columns[:, k] = np.where(self.protocol == protocol, ends[0] - ends[1], 0.0)
        return np.nan_to_num(columns)

    def predict(
        self,
        values: dict[str, float],
        causes: tuple[str, ...],
        zeros: dict[str, float] | None = None,
        curve: Curve | None = None,
    ) -> np.ndarray:
        """What the instruments would read, (n,).

        ``values`` holds the logarithms of mu_face and mu_edge and the causes' parameters,
        ``zeros`` fields of the bench that are off by a sensor's zero, ``curve`` a tabulated factor.
        """
        mechanisms, changes = departures(causes, values)
        bench = Bench(**{**(zeros or {}), **changes})
        laws = {
            p.name: FrictionLaw(
                float(np.exp(values.get(p.name, UNKNOWN_LOG_COEFFICIENT))), mechanisms, curve
            )
            for p in COEFFICIENTS
        }
        return np.concatenate([self._block(i, laws, bench) for i in range(len(self.blocks))])

    def _block(self, i: int, laws: dict[str, FrictionLaw], bench: Bench) -> np.ndarray:
        """One block's prediction; derivatives ask for the same one again and again."""
        block = self.blocks[i]
        law = laws[block.COEFFICIENT]
        mechanisms = tuple((name, *values.values()) for name, values in law.mechanisms.items())
        read = (getattr(bench, name) for name in block.READS)
        key = (i, law.coefficient, mechanisms, law.curve, *read)
        if key not in self.remembered:
            if len(self.remembered) >= REMEMBERED:
                self.remembered.pop(next(iter(self.remembered)))
            self.remembered[key] = block.predict(law, bench)
        return self.remembered[key]

    def sensitivity(self, values: dict[str, float]) -> np.ndarray:
        """d(feature)/d(ln mu) of the null at logarithms of coefficients, (n,)."""
        base = self.predict(values, ())
        moved = self.predict({name: value + LOG_STEP for name, value in values.items()}, ())
        return (moved - base) / LOG_STEP

    @property
    def usual(self) -> np.ndarray:
        """(n,) True for features that are no outliers."""
        usual = np.ones(len(self.y), bool)
        for outlier in self.outliers:
            usual[outlier.features] = False
        return usual

    @property
    def runs(self) -> int:
        """Number of runs: the observations that the BIC counts."""
        return len(np.unique(self.run))

    @property
    def specimens(self) -> int:
        """Number of specimens."""
        return len(np.unique(self.specimen))

    @property
    def of_friction(self) -> np.ndarray:
        """(n,) True where friction acts on the feature, not the instrument alone."""
        return ~self.rows["quantity"].isin(INSTRUMENT_QUANTITIES).to_numpy()

    def _acts(self, cause: str) -> np.ndarray:
        """(n,) True for features that the mechanism can change."""
        mechanism = MECHANISMS[cause]
        acts = self.of_friction
        static = self.rows["static"].to_numpy(bool)
        acts &= np.where(static, mechanism.acts(True), mechanism.acts(False))
        if cause in BENCH_MECHANISMS:
            fields = {parameter.sets for parameter in BENCH_MECHANISMS[cause].parameters}
            reads = [not fields.isdisjoint(block.READS) for block in self.blocks]
            acts &= np.repeat(reads, [len(block.rows) for block in self.blocks])
        return acts

    def unrecorded(self, cause: str) -> np.ndarray:
        """(n,) True where the cause may act but what drives it was not recorded."""
        column = MECHANISMS[cause].covariate
        if column is None:
            return np.zeros(len(self.y), bool)
        return self.rows[column].isna().to_numpy() & self._acts(cause)

    def unrecorded_alias(self, cause: str) -> str | None:
        """The mechanism that would do the same, if what drives it was not recorded.

        A single recorded value (the rest at a reversal) tells as little as none.
        """
        alias = MECHANISMS[cause].aliased_if_unrecorded
        if alias is None or not self.unrecorded(alias).any():
            return None
        driving = self.rows[MECHANISMS[alias].covariate]
        return None if driving[self._acts(alias)].nunique() > 1 else alias


def assemble(case: Case, measured: bool = True) -> Measurements:
    """Features of a case; ``measured=False`` gives the quantities to predict for a design.

    Raises BadInput if no run of any protocol gives a feature.
    """
    odd = tuple(implausible(case)) if measured else ()
    findings: tuple[DataFinding, ...] = case.findings
    if measured:
        case, faults, fatal = cell_faults(case)
        findings, odd = findings + faults, (*odd, *fatal)
    blocks = [
        protocol.features(case.tables, case.nominal, measured)
        for protocol in PROTOCOLS.values()
        if protocol.runs_table in case.tables
    ]
    kept = [block for block in blocks if block is not None]
    if not kept:
        why = " ".join(odd) or "at least one slip is needed"
        raise BadInput(f"{case.name}: no run has a usable trace; {why}")
    found = measurements_of(kept)
    found.implausible, found.findings = odd, findings
    return found


def measurements_of(blocks: list[Block]) -> Measurements:
    """Measurements from blocks."""
    for block in blocks:
        block.rows.insert(0, "protocol", block.protocol)
    rows = pd.concat([block.rows for block in blocks], ignore_index=True)
    rows["load_before"] = load_before(rows)
    return Measurements(
        blocks,
        rows,
        rows["y"].to_numpy(float),
        rows["u"].to_numpy(float),
        pd.factorize(rows["protocol"] + "/" + rows["run_id"])[0],
        pd.factorize(rows["protocol"] + "/" + rows["specimen_id"])[0],
        rows["protocol"].to_numpy(str),
        rows["lower_bound"].to_numpy(bool),
        np.zeros(len(rows)),
    )
