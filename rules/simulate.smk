"""One drop-and-drag run a material, friction coefficient and replicate."""


rule simulate:
    input:
        expand("results/simulate/{simulation}.parquet", simulation=SIMULATIONS),


rule simulate_one:
    input:
        calibration="results/calibrate/calibration.json",
        model=CONFIG.simulation.model or [],
    output:
        "results/simulate/{simulation}.parquet",
    log:
        "results/logs/simulate/{simulation}.log",
    benchmark:
        "results/benchmarks/simulate/{simulation}.tsv"
    # The longest jobs first, then those that others wait for: no core idles at the end.
    priority: 2
    threads: 1
    resources:
        mem_mb=job_memory_mb("simulate"),
        runtime=job_runtime_min("simulate", CONFIG),
    params:
        *settings("simulation"),
        simulation=lambda wildcards: str(SIMULATIONS[wildcards.simulation]),
        fabric=lambda wildcards: fabrics(SIMULATIONS[wildcards.simulation].material),
        code=code_of("simulate"),
        config=CONFIG_FILE,
    message:
        "Simulate {wildcards.simulation}"
    shell:
        "slipstitch simulate --config {params.config} --calibration {input.calibration}"
        " --simulation {wildcards.simulation} --out {output} > {log} 2>&1"
