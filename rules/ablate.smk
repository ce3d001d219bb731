"""Ablations: training choices changed one at a time; not part of `all`."""


rule ablate:
    input:
        "results/ablate/ablate.json",
        "results/ablate/index.html",


rule ablate_one:
    input:
        rules.sample.input,
    output:
        "results/ablate/{question}/{network}_{variant}_seed{seed}.json",
    log:
        "results/logs/ablate/{question}_{network}_{variant}_seed{seed}.log",
    benchmark:
        "results/benchmarks/ablate/{question}_{network}_{variant}_seed{seed}.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("train", CONFIG),
        runtime=job_runtime_min("ablate", CONFIG),
    params:
        *settings(
            "train",
            "instrument",
            "ablate",
            also=("sample.frames",),
            ablate={"seeds"},
        ),
        views=VIEW_ORDER,
        code=code_of("ablate.run"),
        config=CONFIG_FILE,
    message:
        "Ablation: {wildcards.question}, {wildcards.network} {wildcards.variant}, seed {wildcards.seed}"
    shell:
        "slipstitch ablate --config {params.config} --dataset results/sample"
        " --question {wildcards.question} --network {wildcards.network}"
        " --variant {wildcards.variant} --seed {wildcards.seed} --threads {threads}"
        " --out {output} > {log} 2>&1"


rule ablate_summary:
    input:
        expand("results/ablate/{result}", result=CONFIG.ablate.results),
    output:
        summary="results/ablate/ablate.json",
        page=report(
            "results/ablate/index.html",
            caption="../workflow/report/ablations.rst",
            category="Tables",
        ),
    log:
        "results/logs/ablate/summary.log",
    benchmark:
        "results/benchmarks/ablate/summary.tsv"
    threads: 1
    resources:
        mem_mb=1024,
        runtime=15,
    params:
        *settings("ablate"),
        code=code_of("ablate"),
        config=CONFIG_FILE,
    message:
        "Summarise the ablations"
    shell:
        "slipstitch ablate --config {params.config} --summary results/ablate"
        " --out {output.summary} --page {output.page} > {log} 2>&1"
