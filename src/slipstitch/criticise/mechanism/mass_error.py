"""Mass error: true areal mass = nominal (1 + e)."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class MassError(BenchMechanism):
    """Mass error: true areal mass = nominal (1 + e)."""

    def changes(self, values):
        return {"mass_error": values["mass_error"]}


MECHANISM = MassError(
    "mass_error",
    "the cloth is heavier (or lighter) than its nominal mass",
    (Parameter("mass_error", "1", 0.0, 0.05, -0.6, 2.0),),
)
