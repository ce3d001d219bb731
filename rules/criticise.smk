"""Measured cases: verdict, extended model, and their runs simulated again; not part of `all`."""

MEASURED = {Path(case).name: Path(workflow.basedir) / case for case in CONFIG.criticise.cases}


wildcard_constraints:
    measured=r"\w[\w-]*",


rule criticise:
    input:
        expand("results/criticise/{measured}/index.html", measured=MEASURED),


rule criticise_one:
    input:
        lambda wildcards: sorted(
            path for path in MEASURED[wildcards.measured].rglob("*") if path.is_file()
        ),
    output:
        page="results/criticise/{measured}/index.html",
        verdict="results/criticise/{measured}/verdict.json",
        model="results/criticise/{measured}/extended_model.yaml",
        again="results/criticise/{measured}/resimulation.json",
    log:
        "results/logs/criticise/{measured}.log",
    benchmark:
        "results/benchmarks/criticise/{measured}.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("criticise"),
        runtime=job_runtime_min("criticise", CONFIG),
    params:
        case=lambda wildcards: MEASURED[wildcards.measured],
        code=code_of("criticise"),
    message:
        "Criticise {wildcards.measured}"
    shell:
        "slipstitch criticise {params.case} --out {output.verdict} --report {output.page}"
        " --model {output.model} --resimulate {output.again} > {log} 2>&1"
