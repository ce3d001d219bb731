"""Dependence of drop-and-drag on time step and mesh; not part of `all`."""

from slipstitch.physics.convergence.cases import cases

CASES = {case.id: case for case in cases(CONFIG)}


wildcard_constraints:
    case=r"m\d\d_f\d+_n\d+_h\d",


rule convergence:
    input:
        "results/convergence/convergence.json",
        "results/convergence/convergence.png",


rule convergence_run:
    input:
        "results/calibrate/calibration.json",
    output:
        "results/convergence/runs/{case}.parquet",
    log:
        "results/logs/convergence/{case}.log",
    benchmark:
        "results/benchmarks/convergence/{case}.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("simulate"),
        runtime=120,
    params:
        # What this run depends on and no more: a longer list of runs leaves it alone.
        *settings("simulation"),
        case=lambda wildcards: str(CASES[wildcards.case]),
        fabric=lambda wildcards: fabrics(CASES[wildcards.case].material),
        window=CONFIG.convergence.window_s,
        code=code_of("convergence.case_run"),
        config=CONFIG_FILE,
    message:
        "Convergence study: simulate {wildcards.case}"
    shell:
        "slipstitch convergence run --config {params.config} --calibration {input}"
        " --case {wildcards.case} --out {output} > {log} 2>&1"


rule convergence_compare:
    input:
        calibration="results/calibrate/calibration.json",
        runs=expand("results/convergence/runs/{case}.parquet", case=CASES),
    output:
        study="results/convergence/convergence.json",
        picture=report(
            "results/convergence/convergence.png",
            caption="../workflow/report/convergence.rst",
            category="Physics",
        ),
    log:
        "results/logs/convergence/compare.log",
    benchmark:
        "results/benchmarks/convergence/compare.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("simulate"),
        runtime=15,
    params:
        *settings("simulation", "convergence"),
        code=code_of("convergence"),
        config=CONFIG_FILE,
    message:
        "Convergence study: compare the runs"
    shell:
        "slipstitch convergence compare --config {params.config}"
        " --calibration {input.calibration} --runs results/convergence/runs"
        " --out {output.study} --picture {output.picture} > {log} 2>&1"
