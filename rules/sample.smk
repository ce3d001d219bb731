"""The dataset: sampled frames, splits, manifest."""

from slipstitch.design.splits import sides_of_simulations


rule sample:
    input:
        "results/sample/manifest.parquet",
        expand("results/sample/{simulation}.parquet", simulation=SIMULATIONS),


rule sample_all:
    input:
        grid=unless_refused(sides_of_simulations, "results/grid.parquet"),
        shards=rules.render.input.shards,
    output:
        manifest="results/sample/manifest.parquet",
        videos=expand("results/sample/{simulation}.parquet", simulation=SIMULATIONS),
    log:
        "results/logs/sample/sample.log",
    benchmark:
        "results/benchmarks/sample/sample.tsv"
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("sample", CONFIG),
        runtime=job_runtime_min("sample", CONFIG),
    params:
        *settings("seed", "sample"),
        catalogue=entries(viewpoints=viewpoint_ids(CONFIG.render).values()),
        code=code_of("sample"),
        config=CONFIG_FILE,
    message:
        "Sample frames and draw the splits"
    shell:
        "slipstitch sample --config {params.config} --out-dir results/sample"
        " {input.shards} > {log} 2>&1"
