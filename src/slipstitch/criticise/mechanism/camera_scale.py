"""Camera scale: what the camera measures is the true length times this."""

from slipstitch.criticise.mechanism.bench_mechanism import BenchMechanism
from slipstitch.friction_law import Parameter


class CameraScale(BenchMechanism):
    """Camera scale: what the camera measures is the true length times this."""

    def changes(self, values):
        return {"camera_scale": values["camera_scale"]}


MECHANISM = CameraScale(
    "camera_scale",
    "the camera's scale is off",
    (Parameter("camera_scale", "1", 1.0, 0.02, 0.5, 2.0),),
)
