"""Settings of the device and batch size of simulations. Pydantic and the standard library only."""

from pydantic import Field

from slipstitch.config.section import Section


class ComputeSettings(Section):
    """Device and batch size of simulations: results are equal up to rounding."""

    device: str = Field(
        "cpu",
        pattern=r"^(cpu|cuda(:\d+)?)$",
        description="where forces and stiffness are evaluated: cpu, cuda, cuda:1 ...; linear "
        "systems are always solved on the CPU",
    )
    batch: int = Field(
        1,
        ge=1,
        le=256,
        description="simulations in one job, evaluated as one batch: for cuda; on the CPU, one "
        "per job is faster, since jobs run in parallel",
    )
