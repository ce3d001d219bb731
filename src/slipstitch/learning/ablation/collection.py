"""Reading the results of all questions and seeds, writing their summary and its page."""

import os
from pathlib import Path
from typing import Any

from slipstitch.base.errors import BadInput
from slipstitch.base.provenance import (
    provenance_record,
    read_json,
    start_clock,
    write_json,
    write_text,
)
from slipstitch.config import Config
from slipstitch.learning.ablation.ablations_page import ablations_page
from slipstitch.learning.ablation.summary import summarise

KEYS = {"question", "seed", "asks", "left_out", "dataset_digest", "variants", "predictions"}


def write_summary(
    config: Config,
    folder: str | os.PathLike,
    out: str | os.PathLike,
    page: str | os.PathLike | None = None,
) -> dict[str, Any]:
    """Sum up ``{question}/seed{seed}.json`` of the configured questions and seeds.

    Raises
    ------
    BadInput
        If an answer is missing, damaged, or of another question, seed or dataset.
    """
    started = start_clock()
    paths = [
        Path(folder) / question / f"seed{seed}.json"
        for question in config.ablate.asked
        for seed in config.ablate.seeds
    ]
    summary = summarise([_answer(path) for path in paths], config.evaluate.friction_step)
    record = provenance_record(
        "ablate",
        inputs=paths,
        config=config.model_dump(mode="json", include={"ablate", "evaluate"}),
        started=started,
    )
    write_json(out, summary, record)
    if page is not None:
        write_text(page, ablations_page(summary), record)
    return summary


def _answer(path: Path) -> dict[str, Any]:
    """One answer; BadInput if it does not match its path."""
    content = read_json(path)
    if not isinstance(content, dict) or not set(content) >= KEYS:
        raise BadInput(f"{path}: not a result of `slipstitch ablate`")
    if (content["question"], f"seed{content['seed']}") != (path.parent.name, path.stem):
        raise BadInput(
            f"{path}: answers {content['question']} with seed {content['seed']}: "
            "does not match its path"
        )
    return content
