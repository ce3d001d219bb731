"""Backlash: motion lost after the reversal."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class Backlash(BenchMechanism):
    """Backlash: motion lost after the reversal."""

    def changes(self, values):
        return {"backlash_m": 1e-3 * values["backlash"]}


MECHANISM = Backlash(
    "backlash",
    "the stage loses motion at the reversal",
    (Parameter("backlash", "mm", 0.0, 0.2, -2.0, 20.0),),
)
