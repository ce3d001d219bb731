"""Known-answer checks of the simulator with the configured settings."""


rule calibrate:
    input:
        "results/calibrate/calibration.json",
        "results/calibrate/calibration.png",


rule calibrate_settings:
    output:
        checks="results/calibrate/calibration.json",
        picture=report(
            "results/calibrate/calibration.png",
            caption="../workflow/report/calibration.rst",
            category="Physics",
        ),
    log:
        "results/logs/calibrate/calibration.log",
    benchmark:
        "results/benchmarks/calibrate/calibration.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("calibrate"),
        runtime=job_runtime_min("calibrate", CONFIG),
    params:
        settings=settings("simulation", "calibrate"),
        code=code_digest("calibrate"),
        config=CONFIG_FILE,
    message:
        "Check the simulator against theory"
    shell:
        "slipstitch calibrate --config {params.config} --out {output.checks} --picture {output.picture} > {log} 2>&1"
