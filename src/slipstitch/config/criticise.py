"""Settings of the criticise stage. Pydantic and the standard library only."""

import re
from pathlib import PurePath

from pydantic import Field, field_validator

from slipstitch.config.section import Section


class CriticiseSettings(Section):
    """The measured cases."""

    cases: tuple[str, ...] = Field(
        (
            "data/cases/paper_on_paper",
            "data/cases/block_on_wood_board",
            "data/cases/block_on_other_board",
            "data/cases/surrogate_anisotropic",
        ),
        description="case folders (docs/criticise-your-data.md), relative to the working folder, "
        "or included in the workflow; a folder's name is the case's id",
    )

    @field_validator("cases")
    @classmethod
    def _named_apart(cls, cases: tuple[str, ...]) -> tuple[str, ...]:
        names = [PurePath(case).name for case in cases]
        for name in names:
            if not re.fullmatch(r"\w[\w-]*", name):
                raise ValueError(f"case folder {name!r}: may contain only letters, digits, - and _")
        if len(set(names)) != len(names):
            raise ValueError(f"case folders with the same name: {', '.join(sorted(names))}")
        return cases
