"""The file ``results/grid.parquet``: what the ids mean, and the seeds."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from slipstitch.base.provenance.record import provenance_record, start_clock, write_parquet
from slipstitch.design.grid import grid_rows

if TYPE_CHECKING:
    from slipstitch.config.model import Config


def grid_table(config: Config):
    """`grid_rows` as a pyarrow table."""
    import pyarrow as pa

    text = ["kind", "id", "name", "role", "floor_role"]
    text += ["material_id", "friction_id", "replicate_id", "material"]
    schema = pa.schema(
        [(name, pa.string()) for name in text]
        + [("value", pa.float64()), ("friction", pa.float64()), ("seed", pa.int64())]
    )
    return pa.Table.from_pylist(grid_rows(config), schema=schema)


def write_grid(config: Config, path: str | os.PathLike) -> None:
    """Write ``grid.parquet``."""
    started = start_clock()
    table = grid_table(config)
    keys = config.model_dump(mode="json", include={"seed", "grid", "render"})
    record = provenance_record("grid", config=keys, seed=config.seed, started=started)
    write_parquet(table, path, record=record)
