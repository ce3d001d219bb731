"""Settings of the publish stage. Pydantic and the standard library only."""

from pydantic import Field

from slipstitch.config.section import Section


class PublishSettings(Section):
    """What a published run is called."""

    name: str = Field(
        "demo",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="folder below results/published: letters, digits, dot, dash, underscore",
    )
