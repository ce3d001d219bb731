"""Time lag: the frame at time t shows the cloth as it was at t - lag."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class TimeLag(BenchMechanism):
    """Time lag: the frame at time t shows the cloth as it was at t - lag."""

    def changes(self, values):
        return {"time_lag_s": values["time_lag"]}


MECHANISM = TimeLag(
    "time_lag",
    "the camera lags behind the stage's clock",
    (Parameter("time_lag", "s", 0.0, 0.1, -2.0, 10.0),),
    needs=("speed_mm_s",),
)
