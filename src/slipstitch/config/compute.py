"""Settings of where simulations come from. Pydantic and the standard library only."""

from pydantic import Field

from slipstitch.config.section import Section


class ComputeSettings(Section):
    """Device of simulations, and those that are not computed: results are equal up to rounding."""

    device: str = Field(
        "cpu",
        pattern=r"^(cpu|cuda(:\d+)?)$",
        description="where forces and stiffness are evaluated: cpu, cuda, cuda:1 ...; linear "
        "systems are always solved on the CPU",
    )
    handed_out: str | None = Field(
        None,
        description="folder of simulations, or a release: what is there with the same fabric, "
        "coefficient, seed and settings is taken instead of being simulated; null: none",
    )
