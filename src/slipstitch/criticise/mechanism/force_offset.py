"""Force offset: the cell reads this at no force."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class ForceOffset(BenchMechanism):
    """Force offset: the cell reads this at no force."""

    def changes(self, values):
        return {"force_offset_N": 1e-3 * values["force_offset"]}


MECHANISM = ForceOffset(
    "force_offset",
    "the force cell has an offset",
    (Parameter("force_offset", "mN", 0.0, 0.5, -500.0, 500.0),),
)
