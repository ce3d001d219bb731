"""The validated configuration; definitions shared by all rules."""

import hashlib
import json
import os
import sys
from contextlib import contextmanager
from functools import cache
from operator import attrgetter

from slipstitch.config import read_mapping, resolve_config, write_config
from slipstitch.design.grid import (
    films,
    floors_of,
    grid_rows,
    simulations,
    texture_ids,
    viewpoint_ids,
    viewpoints,
)
from slipstitch.design.interpolation import interpolations
from slipstitch.design.trainable import view_order
from slipstitch.design.cost import estimate_line, job_memory_mb, job_runtime_min
from slipstitch.base.errors import BadInput
from slipstitch.film.measure import SHIPPED
from slipstitch.physics.fabric import fabric_digest
from slipstitch.base.provenance import code_digest, file_digest
from slipstitch.physics.simulation.convergence import study_digest
from slipstitch.config.catalogue import catalogue_entries, fabric_names

CONFIG_FILE = "results/config.json"


@contextmanager
def one_line_errors():
    """Bad input ends the run in one line, without Snakemake's traceback."""
    try:
        yield
    except BadInput as error:
        print(f"snakemake: error: {error}", file=sys.stderr)
        sys.exit(2)


with one_line_errors():
    # Snakemake has merged them already; a key given twice is lost by then.
    for file in workflow.configfiles if workflow.is_main_process else ():
        read_mapping(file)
    CONFIG = resolve_config(config, sources=("configuration",), words=True)

# The slipstitch beside this Python, also where the virtual environment is not active.
os.environ["PATH"] = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]

# Each job says what it used at the end of its log (slipstitch.report.cost).
os.environ["SLIPSTITCH_CPU_TIME"] = "1"

SIMULATIONS = {simulation.id: simulation for simulation in simulations(CONFIG)}
VIEWPOINTS = {viewpoint["id"]: viewpoint for viewpoint in viewpoints(CONFIG)}
SHOWN = films(CONFIG)
SHARDS = [f"{simulation}_{viewpoint}" for simulation, viewpoint in SHOWN]
# Viewpoints from which every simulation is filmed; from the others only some are.
FULL_VIEWPOINTS = [
    viewpoint
    for viewpoint in VIEWPOINTS
    if all((simulation, viewpoint) in SHOWN for simulation in SIMULATIONS)
]


wildcard_constraints:
    simulation=r"m\d\d_f\d+_r\d\d",
    viewpoint=r"v\d\d",
    split="|".join(CONFIG.train.splits),
    seed=r"\d+",


@cache
def interpolated():
    """Films of cloths between the simulated ones; a grid that has no split may only be simulated."""
    with one_line_errors():
        return interpolations(CONFIG)


def unless_refused(check, files):
    """Files as a rule's input; what refuses the configuration does so before anything is made."""

    def input_files(wildcards):
        with one_line_errors():
            check(CONFIG)
        return files

    return input_files


def settings(*sections, also=(), **exclude):
    """Sections of the configuration, one parameter per key: the rule reruns when one changes."""
    kept = CONFIG.model_dump(mode="json", include=set(sections), exclude=exclude)
    parameters = []
    for section, values in kept.items():
        if isinstance(values, dict):
            parameters += [f"{section}.{key}: {json.dumps(values[key])}" for key in values]
        else:
            parameters.append(f"{section}: {json.dumps(values)}")
    parameters += [f"{key}: {json.dumps(attrgetter(key)(CONFIG))}" for key in also]
    return parameters


def code_of(stage):
    """Digest of a stage's code as a rule's parameter: the rule reruns when the computation changes.

    Only the main process compares a job's parameters with those that its files were made with; the
    processes of single jobs do not read all sources again.
    """
    return f"code of {stage}: {code_digest(stage)}" if workflow.is_main_process else stage


def fabrics(*names):
    """Measured fabrics as a rule's parameter: additions to the catalogue cause no reruns."""
    return [f"{name}: {fabric_digest(name)}" for name in names]


def entries(**names):
    """Entries of the catalogue, by kind, as a rule's parameter: additions cause no reruns."""
    return json.dumps(catalogue_entries(**names))


def digests_if_there(*paths):
    """Optional files that a rule displays, as its parameter: the rule reruns when one changes."""
    return [f"{path}: {file_digest(path)}" for path in paths if os.path.exists(path)]


# Parameter of the rules that train and evaluate: they rerun when other viewpoints are taken up.
VIEW_ORDER = f"view_order: {json.dumps(view_order(CONFIG))}"

# The convergence study that trajectories quote; which jobs show its verdicts, rerun with it.
STUDY = study_digest()


rule grid:
    output:
        "results/grid.parquet",
    log:
        "results/logs/sample/grid.log",
    benchmark:
        "results/benchmarks/sample/grid.tsv"
    threads: 1
    resources:
        mem_mb=512,
        runtime=15,
    params:
        rows=hashlib.sha256(json.dumps(grid_rows(CONFIG)).encode()).hexdigest(),
        code=code_of("grid"),
        config=CONFIG_FILE,
    message:
        "Write the table of ids and seeds"
    shell:
        "slipstitch grid --config {params.config} --out {output} > {log} 2>&1"
