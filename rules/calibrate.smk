"""Settings chosen with a pushed strip, one job per swept setting, and checked against theory."""

from slipstitch.config.simulation import BASE, KEYS
from slipstitch.physics.calibration.sweep import sweep_inputs


rule calibrate:
    input:
        "results/calibrate/calibration.json",
        "results/calibrate/calibration.png",
        "results/calibrate/strip.png",
        "results/calibrate/settings.png",


rule calibrate_sweep:
    output:
        "results/calibrate/sweep/{swept}.json",
    log:
        "results/logs/calibrate/sweep_{swept}.log",
    benchmark:
        "results/benchmarks/calibrate/sweep_{swept}.tsv"
    wildcard_constraints:
        swept="|".join((BASE, *KEYS)),
    threads: 1
    resources:
        mem_mb=job_memory_mb("calibrate"),
        runtime=job_runtime_min("calibrate", CONFIG),
    params:
        inputs=lambda wildcards: [
            f"{key}: {json.dumps(value)}"
            for key, value in sweep_inputs(
                wildcards.swept, CONFIG.calibrate, CONFIG.simulation
            ).items()
        ],
        code=code_of("calibrate.sweep"),
        config=CONFIG_FILE,
    message:
        "Sweep {wildcards.swept} with the pushed strip"
    shell:
        "slipstitch calibrate --config {params.config} --sweep {wildcards.swept} --out {output} > {log} 2>&1"


rule calibrate_settings:
    input:
        expand("results/calibrate/sweep/{swept}.json", swept=(BASE, *KEYS)),
    output:
        "results/calibrate/calibration.json",
    log:
        "results/logs/calibrate/calibration.log",
    benchmark:
        "results/benchmarks/calibrate/calibration.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("calibrate"),
        runtime=job_runtime_min("calibrate", CONFIG),
    params:
        *settings("simulation", "calibrate"),
        code=code_of("calibrate.calibration"),
        config=CONFIG_FILE,
    message:
        "Choose settings, check the simulator against theory"
    shell:
        "slipstitch calibrate --config {params.config} --sweeps {input} --out {output}"
        " --only-failures --picture results/calibrate/calibration.png"
        " --strip-picture results/calibrate/strip.png"
        " --settings-picture results/calibrate/settings.png > {log} 2>&1"


# A job of its own: nothing is simulated again for want of a picture.
rule calibrate_pictures:
    input:
        rules.calibrate_settings.output,
    output:
        picture=report(
            "results/calibrate/calibration.png",
            caption="../workflow/report/calibration.rst",
            category="Physics",
        ),
        strip=report(
            "results/calibrate/strip.png",
            caption="../workflow/report/strip.rst",
            category="Physics",
        ),
        settings=report(
            "results/calibrate/settings.png",
            caption="../workflow/report/settings.rst",
            category="Physics",
        ),
    log:
        "results/logs/calibrate/pictures.log",
    benchmark:
        "results/benchmarks/calibrate/pictures.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("calibrate"),
        runtime=job_runtime_min("calibrate", CONFIG),
    params:
        code=code_of("calibrate.pictures"),
    message:
        "Draw the calibration"
    shell:
        "slipstitch calibrate --draw {input} --picture {output.picture}"
        " --strip-picture {output.strip} --settings-picture {output.settings} > {log} 2>&1"
