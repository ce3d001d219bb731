"""Settings of the grid of simulations."""

from pydantic import Field, model_validator

from slipstitch.config.section import Fabrics, Frictions, Section


class GridSettings(Section):
    """The simulations: every material with every friction coefficient, some times over."""

    materials: Fabrics = Field(
        ("gray-interlock", "11oz-black-denim", "ivory-rib-knit"),
        min_length=1,
        description="fabrics by name; ids m00..m09 are positions in the catalogue of ten",
    )
    frictions: Frictions = Field(
        (0.1, 0.3, 0.6, 1.0),
        min_length=1,
        max_length=100,
        description="friction coefficients, increasing, multiples of 0.001; id f0350 is 0.35",
    )
    replicates: int = Field(
        2,
        ge=1,
        le=100,
        description="simulations of each pair with different perturbations; ids r00..",
    )
    test_frictions: Frictions = Field(
        (),
        max_length=100,
        description="off-grid coefficients, increasing, for testing only, simulated with every "
        "material; ids follow those of `frictions`",
    )
    test_materials: Fabrics = Field(
        (),
        description="unseen fabrics, for testing only, simulated with every coefficient of "
        "`frictions`",
    )
    test_replicates: int = Field(1, ge=1, le=100, description="simulations of each test-only pair")
    own_benches: bool = Field(
        False,
        description="every simulation has clamps, curl and fabric of its own, shared with none at "
        "another coefficient; only where its cameras are its own as well (viewpoints bench_1 "
        "...), so that whole simulations are held out; ideal replicates share theirs",
    )

    @model_validator(mode="after")
    def _training_and_testing_are_apart(self) -> "GridSettings":
        for kind in ("materials", "frictions"):
            both = set(getattr(self, kind)) & set(getattr(self, f"test_{kind}"))
            if both:
                raise ValueError(f"{kind} and test_{kind} share {', '.join(map(str, both))}")
        return self
