"""Bending error: true bending stiffness = nominal (1 + e), of the sheet and of the strip."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class BendingError(BenchMechanism):
    """Bending error: true bending stiffness = nominal (1 + e), of the sheet and of the strip."""

    def changes(self, values):
        return {"bending_error": values["bending_error"]}


MECHANISM = BendingError(
    "bending_error",
    "the cloth is stiffer (or softer) than its nominal bending stiffness",
    (Parameter("bending_error", "1", 0.0, 0.1, -0.9, 8.0),),
)
