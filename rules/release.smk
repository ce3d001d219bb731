"""The dataset as a folder to distribute."""


rule release:
    input:
        "results/release",


rule release_folder:
    input:
        rules.calibrate_settings.output,
        rules.simulate.input,
        rules.render.input.shards,
        rules.sample.input,
        rules.render.input.verification,
        grid="results/grid.parquet",
    output:
        # Regenerated when its inputs change; publish a copy.
        directory("results/release"),
    log:
        "results/logs/release/release.log",
    benchmark:
        "results/benchmarks/release/release.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("release"),
        runtime=job_runtime_min("release", CONFIG),
    params:
        *settings("seed", "release"),
        code=code_of("release"),
        config=CONFIG_FILE,
        project=workflow.basedir,
    message:
        "Write the release"
    shell:
        "slipstitch release --config {params.config} --results results --out-dir {output}"
        " --project {params.project} > {log} 2>&1"
