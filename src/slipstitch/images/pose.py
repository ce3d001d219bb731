"""What is known of where a camera stands, beside its calibrated viewpoint."""

#: What a network may be told of a camera, see `slipstitch.images.bench_camera.relative_pose`.
POSE = ("yaw_deg", "pitch_deg", "roll_deg", "log_distance")
