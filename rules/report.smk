"""The page that a person reads."""


rule report:
    input:
        "results/report/index.html",


rule report_page:
    input:
        calibration=rules.calibrate.input,
        simulations=rules.simulate.input,
        grid="results/grid.parquet",
        previews=rules.render.input.previews,
        verification=rules.render.input.verification,
        dataset=rules.sample.input,
        networks=rules.train.input,
        instruments=rules.instrument.input,
        evaluation=rules.evaluate.input,
        criticism=rules.criticise.input,
        audit=rules.audit.input,
    output:
        report(
            "results/report/index.html",
            caption="../workflow/report/page.rst",
            category="Report",
        ),
    log:
        "results/logs/report/report.log",
    benchmark:
        "results/benchmarks/report/report.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("report"),
        runtime=job_runtime_min("report", CONFIG),
    params:
        *settings(*type(CONFIG).model_fields),
        code=code_of("report"),
        shown=digests_if_there(
            "results/captures/metrics.json",
            "results/captures/predictions.parquet",
            "results/convergence/convergence.json",
            "results/convergence/convergence.png",
            "results/published/convergence/convergence.json",
            "results/published/convergence/convergence.png",
        ),
        config=CONFIG_FILE,
    message:
        "Write the report"
    shell:
        "slipstitch report --config {params.config} --results results --out {output} > {log} 2>&1"
