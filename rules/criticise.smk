"""Measured cases: verdict, extended model, and their runs simulated again."""


def case_folder(case):
    """A case of the configuration: in the working folder, or one that comes with the workflow."""
    places = [Path(case), Path(workflow.basedir) / case]
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise BadInput(f"criticise.cases: {case}: no such folder")
    return found


with one_line_errors():
    MEASURED = {Path(case).name: case_folder(case) for case in CONFIG.criticise.cases}


wildcard_constraints:
    measured=r"\w[\w-]*",


rule criticise:
    input:
        expand(
            "results/criticise/{measured}/{file}",
            measured=MEASURED,
            file=["index.html", "verdict.json", "picture.svg"],
        ),


rule criticise_one:
    input:
        lambda wildcards: sorted(
            path for path in MEASURED[wildcards.measured].rglob("*") if path.is_file()
        ),
    output:
        page="results/criticise/{measured}/index.html",
        picture=report(
            "results/criticise/{measured}/picture.svg",
            caption="../workflow/report/criticism.rst",
            category="Criticism",
            labels={"case": "{measured}"},
        ),
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
        " --picture {output.picture} --model {output.model} --resimulate {output.again} > {log} 2>&1"
