"""What a protocol is to the criticism: its files, its features and their forward model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import pandas as pd

from slipstitch.criticise.protocols.block import Block
from slipstitch.criticise.protocols.columns import Column
from slipstitch.criticise.traces import Signal

Features = Callable[[Mapping[str, pd.DataFrame], Mapping[str, float], bool], Block | None]


@dataclass(frozen=True)
class Quantity:
    """A kind of feature.

    Attributes
    ----------
    name, title : in tables (with the unit) and in pictures.
    instrument : it tells of the instrument alone; no friction acts on it.
    """

    name: str
    title: str
    instrument: bool = False


@dataclass(frozen=True)
class Protocol:
    """One protocol of measurement.

    Attributes
    ----------
    name, letter : name in files and its letter in docs/criticise-your-data.md.
    tables : file (without its ending) -> columns; the first has a row a run, a second one the
        runs' traces.
    nominal : keys of ``meta.json``'s ``nominal`` that it cannot do without.
    quantities : its features, in the order in which they are drawn.
    features : (tables, nominal values, measured) -> features with their forward model, None if no
        run gives any. With ``measured`` False, what a design is predicted for: traces may be absent
        and measured values are not looked at.
    usual_settings : columns of a run where a case does not say what is usual there.
    varied : columns, and levels of them, among which a measurement that separates rivals is sought.
    signals : columns of the traces in which glitches are looked for.
    """

    name: str
    letter: str
    tables: Mapping[str, tuple[Column, ...]]
    nominal: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    features: Features
    usual_settings: Mapping[str, float] = field(default_factory=dict)
    varied: tuple[tuple[str, tuple[float, ...]], ...] = ()
    signals: tuple[Signal, ...] = ()

    @property
    def runs_table(self) -> str:
        """The table with a row a run."""
        return next(iter(self.tables))
