"""The measuring instrument: its network, error bars and alarm."""

from slipstitch.design.trainable import (
    check_calibration_datasets,
    check_instrument_can_train,
    check_starting_weights,
)


rule instrument:
    input:
        expand(
            "results/instrument/{split}/seed{seed}/{file}",
            split=CONFIG.train.splits,
            seed=CONFIG.instrument.seeds,
            file=["instrument.safetensors", "instrument.json", "history.csv"],
        ),
        # Of several trainings, their average too.
        expand(
            "results/instrument/{split}/ensemble/{file}",
            split=CONFIG.train.splits if len(CONFIG.instrument.seeds) > 1 else [],
            file=[
                "instrument.safetensors",
                "instrument.json",
                "calibration.parquet",
                "readings.parquet",
            ],
        ),


rule instrument_one:
    input:
        unless_refused(check_instrument_can_train, rules.sample.input),
        start=unless_refused(
            check_starting_weights,
            expand(
                "{folder}/instrument.safetensors",
                folder=[one for one in [CONFIG.instrument.starts_from] if one is not None],
            ),
        ),
    output:
        weights="results/instrument/{split}/seed{seed}/instrument.safetensors",
        card="results/instrument/{split}/seed{seed}/instrument.json",
        history=report(
            "results/instrument/{split}/seed{seed}/history.csv",
            caption="../workflow/report/training.rst",
            category="Training",
            labels={"split": "{split}", "network": "instrument", "seed": "{seed}"},
        ),
    log:
        "results/logs/instrument/{split}_seed{seed}.log",
    benchmark:
        "results/benchmarks/instrument/{split}_seed{seed}.tsv"
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("instrument", CONFIG),
        runtime=job_runtime_min("instrument", CONFIG),
    params:
        *settings(
            "instrument",
            also=("sample.frames",),
            instrument={"seeds", "calibration_datasets"},
        ),
        views=VIEW_ORDER,
        code=code_of("instrument"),
        config=CONFIG_FILE,
        folder=subpath(output.weights, parent=True),
    message:
        "Train the instrument, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        "slipstitch instrument --config {params.config} --dataset results/sample"
        " --split {wildcards.split} --seed {wildcards.seed} --threads {threads}"
        " --out-dir {params.folder} > {log} 2>&1"


rule instrument_ensemble:
    input:
        members=lambda wildcards: expand(
            "results/instrument/{split}/seed{seed}/instrument.safetensors",
            split=wildcards.split,
            seed=CONFIG.instrument.seeds,
        ),
        dataset=rules.sample.input,
        further=unless_refused(
            check_calibration_datasets,
            expand("{folder}/manifest.parquet", folder=CONFIG.instrument.calibration_datasets),
        ),
    output:
        weights="results/instrument/{split}/ensemble/instrument.safetensors",
        card="results/instrument/{split}/ensemble/instrument.json",
        calibration="results/instrument/{split}/ensemble/calibration.parquet",
        readings="results/instrument/{split}/ensemble/readings.parquet",
    log:
        "results/logs/instrument/{split}_ensemble.log",
    benchmark:
        "results/benchmarks/instrument/{split}_ensemble.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("evaluate", CONFIG),
        runtime=job_runtime_min("instrument", CONFIG),
    params:
        code=code_of("instrument"),
        config=CONFIG_FILE,
        members=lambda wildcards, input: [os.path.dirname(name) for name in input.members],
        folder=subpath(output.weights, parent=True),
        further=[
            word
            for folder in CONFIG.instrument.calibration_datasets
            for word in ("--calibration-datasets", folder)
        ],
    message:
        "Average the instruments of split {wildcards.split}"
    shell:
        "slipstitch instrument --config {params.config} --dataset results/sample"
        " --split {wildcards.split} --members {params.members} {params.further:q} --threads {threads}"
        " --out-dir {params.folder} > {log} 2>&1"
