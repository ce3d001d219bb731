"""Tables and predictions of the trained networks."""


rule evaluate:
    input:
        "results/evaluate/metrics.json",
        "results/evaluate/predictions.parquet",
        "results/evaluate/details.json",


rule evaluate_all:
    input:
        dataset=rules.sample.input,
        networks=rules.train.input,
        instruments=rules.instrument.input,
    output:
        metrics=report(
            "results/evaluate/metrics.json",
            caption="../workflow/report/evaluation.rst",
            category="Tables",
        ),
        predictions="results/evaluate/predictions.parquet",
        details="results/evaluate/details.json",
    log:
        "results/logs/evaluate/evaluate.log",
    benchmark:
        "results/benchmarks/evaluate/evaluate.tsv"
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("evaluate", CONFIG),
        runtime=job_runtime_min("evaluate", CONFIG),
    params:
        *settings(also=("sample.frames",)),
        code=code_of("evaluate"),
        shipped=Path(SHIPPED, "SHA256SUMS").read_text(),
        config=CONFIG_FILE,
    message:
        "Evaluate the networks"
    shell:
        "slipstitch evaluate --config {params.config} --dataset results/sample"
        " --models results/train --instruments results/instrument --out {output.metrics} --predictions {output.predictions}"
        " --details {output.details} --threads {threads} > {log} 2>&1"
