"""Force gain: the cell reads (1 + e) times the force."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class ForceGain(BenchMechanism):
    """Force gain: the cell reads (1 + e) times the force."""

    def changes(self, values):
        return {"force_gain": values["force_gain"]}


MECHANISM = ForceGain(
    "force_gain",
    "the force cell has a wrong gain",
    (Parameter("force_gain", "1", 0.0, 0.03, -0.6, 2.0),),
)
