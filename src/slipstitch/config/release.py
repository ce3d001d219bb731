"""Settings of the release stage. Pydantic and the standard library only."""

from pydantic import Field

from slipstitch.config.section import Section


class ReleaseSettings(Section):
    """Name and layout of a released dataset."""

    name: str = Field(
        "slipstitch-cloth-friction",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="name of the dataset: letters, digits, dot, dash, underscore",
    )
    version: str = Field(
        "0.1.0", pattern=r"^\d+\.\d+\.\d+$", description="version of the dataset, MAJOR.MINOR.PATCH"
    )
    shard_mb: float = Field(256.0, gt=0.0, le=5000.0, description="maximum size of an image shard")
    unseen_share: float = Field(
        0.2,
        gt=0.0,
        lt=1.0,
        description="share of the fabrics, and of the friction coefficients between the lowest "
        "and the highest, held out by unseen_fabric and unseen_friction; at least one",
    )
