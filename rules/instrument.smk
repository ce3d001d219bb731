"""The measuring instrument: its network, error bars and alarm."""

from slipstitch.config.trainable import check_instrument_can_train


rule instrument:
    input:
        expand(
            "results/instrument/{split}/seed{seed}/{file}",
            split=CONFIG.train.splits,
            seed=CONFIG.instrument.seeds,
            file=["instrument.safetensors", "instrument.json", "history.csv"],
        ),


rule instrument_one:
    input:
        unless_refused(check_instrument_can_train, rules.sample.input),
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
    threads: 1
    resources:
        mem_mb=job_memory_mb("instrument", CONFIG),
        runtime=job_runtime_min("instrument", CONFIG),
    params:
        *settings("instrument", also=("sample.frames", "view_order"), instrument={"seeds"}),
        code=code_of("instrument"),
        config=CONFIG_FILE,
        folder=subpath(output.weights, parent=True),
    message:
        "Train the instrument, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        "slipstitch instrument --config {params.config} --dataset results/sample"
        " --split {wildcards.split} --seed {wildcards.seed} --threads {threads}"
        " --out-dir {params.folder} > {log} 2>&1"
