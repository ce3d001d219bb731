"""The configuration, checked; what all rules share."""

import json
import os
import sys

from slipstitch.config import resolve_config, write_config
from slipstitch.doctor.cost import estimate_line, job_memory_mb, job_runtime_min
from slipstitch.config.grid import batches, simulations, textures, viewpoints
from slipstitch.errors import BadInput
from slipstitch.provenance import code_digest, file_digest

CONFIG_FILE = "results/config.json"

try:
    CONFIG = resolve_config(config, sources=("configuration",), words=True)
except BadInput as error:
    print(f"snakemake: error: {error}", file=sys.stderr)
    sys.exit(2)

# Only the main process compares a job's parameters with those that its files were made with.
if not workflow.is_main_process:
    code_digest = str

# The slipstitch beside this Python, also where the virtual environment is not active.
os.environ["PATH"] = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]

SIMULATIONS = {simulation.id: simulation for simulation in simulations(CONFIG)}
VIEWPOINTS = {viewpoint["id"]: viewpoint for viewpoint in viewpoints(CONFIG)}


wildcard_constraints:
    simulation=r"m\d\d_f\d\d_r\d\d",
    viewpoint=r"v\d\d",
    split="|".join(CONFIG.train.splits),
    seed=r"\d+",


def settings(*sections, **exclude):
    """Sections of the configuration as a rule's parameter: the rule reruns when they change."""
    return json.dumps(CONFIG.model_dump(mode="json", include=set(sections), exclude=exclude))


def digest_if_there(path):
    """A file that a rule shows where there is one, as its parameter: the rule reruns with it."""
    return file_digest(path) if os.path.exists(path) else None


rule grid:
    output:
        "results/grid.parquet",
    log:
        "results/logs/grid.log",
    params:
        settings=settings("seed", "grid"),
        textures=json.dumps(textures(CONFIG)),
        viewpoints=json.dumps(viewpoints(CONFIG)),
        config=CONFIG_FILE,
    message:
        "Table of ids and seeds"
    shell:
        "slipstitch grid --config {params.config} --out {output} > {log} 2>&1"
