"""Settings of the criticise stage. Pydantic and the standard library only."""

import re
from pathlib import PurePath

from pydantic import Field, field_validator

from slipstitch.config.section import Section


class CriticiseSettings(Section):
    """Which measured cases are judged."""

    cases: tuple[str, ...] = Field(
        (
            "data/cases/surrogate_anisotropic",
            "data/cases/paper_on_paper",
            "data/cases/block_on_wood_board",
            "data/cases/block_on_other_board",
        ),
        description="case folders (docs/measurements.md), from the project's folder on; "
        "a folder's name is the case's id",
    )

    @field_validator("cases")
    @classmethod
    def _named_apart(cls, cases: tuple[str, ...]) -> tuple[str, ...]:
        names = [PurePath(case).name for case in cases]
        for name in names:
            if not re.fullmatch(r"\w[\w-]*", name):
                raise ValueError(f"case folder {name!r}: letters, digits, - and _ only, please")
        if len(set(names)) != len(names):
            raise ValueError(f"two case folders of one name: {', '.join(sorted(names))}")
        return cases
