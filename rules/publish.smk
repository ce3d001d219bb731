"""Scores, predictions, curves, costs, model and origin of a run, not its images; not part of `all`."""

PUBLISHED = f"results/published/{CONFIG.publish.name}"


rule publish:
    input:
        PUBLISHED,


rule publish_folder:
    input:
        calibration=rules.calibrate.input,
        dataset=rules.sample.input,
        networks=rules.train.input,
        instruments=rules.instrument.input,
        evaluation=rules.evaluate.input,
    output:
        directory(PUBLISHED),
    log:
        "results/logs/publish/publish.log",
    benchmark:
        "results/benchmarks/publish/publish.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("report"),
        runtime=15,
    params:
        *settings("publish"),
        study=STUDY,
        optional=digests_if_there(
            "results/captures/metrics.json",
            "results/captures/predictions.parquet",
            "results/ablate/ablate.json",
        ),
        code=code_of("publish"),
        config=CONFIG_FILE,
    message:
        "Publish the run as {CONFIG.publish.name}"
    shell:
        "slipstitch publish --config {params.config} --results results --out-dir {output}"
        " > {log} 2>&1"
