"""Videos of a bench, or surrogates, evaluated with the trained networks; not part of `all`."""

from slipstitch.film.captures_table import files_named

CAPTURES_TABLE = CONFIG.captures.table or "results/captures/bench/captures.csv"
SLIP_ANGLES = CONFIG.captures.angles or (
    None if CONFIG.captures.table else "results/captures/bench/slip_angles.csv"
)
FILMS = [] if CONFIG.captures.table else CONFIG.captures.surrogate_ids()

CALIBRATED_CAMERA = CONFIG.render.camera_of("calibrated") or []


def filmed_on_the_bench(wildcards):
    """Videos and camera files of a bench's table: replaced ones are ingested again."""
    return files_named(CAPTURES_TABLE) if CONFIG.captures.table else []


def pair_of(film):
    """The fabric and floor of a surrogate video."""
    return CONFIG.captures.pairs[int(film[1:3])]


wildcard_constraints:
    film=r"c\d\d_r\d\d",


rule captures:
    input:
        "results/captures/index.html",


rule surrogate_bench:
    input:
        camera=CALIBRATED_CAMERA,
    output:
        "results/captures/bench/camera.json",
        "results/captures/bench/captures.csv",
        "results/captures/bench/slip_angles.csv",
    log:
        "results/logs/captures/bench.log",
    benchmark:
        "results/benchmarks/captures/bench.tsv"
    threads: 1
    resources:
        mem_mb=1024,
        runtime=15,
    params:
        *settings("seed", "captures", also=("render.camera",)),
        catalogue=entries(
            viewpoints=["calibrated"],
            floors={pair.substrate for pair in CONFIG.captures.pairs},
        ),
        code=code_of("capture"),
        config=CONFIG_FILE,
    message:
        "Set up the surrogate bench"
    shell:
        "slipstitch capture surrogate --config {params.config}"
        " --bench results/captures/bench > {log} 2>&1"


rule surrogate_film:
    input:
        camera=CALIBRATED_CAMERA,
    output:
        "results/captures/bench/{film}.mp4",
    log:
        "results/logs/captures/{film}.log",
    benchmark:
        "results/benchmarks/captures/{film}.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("render"),
        runtime=120,
    params:
        *settings(
            "seed",
            "simulation",
            "captures",
            also=("render.camera", "render.samples"),
        ),
        fabric=lambda wildcards: fabrics(pair_of(wildcards.film).material),
        catalogue=lambda wildcards: entries(
            viewpoints=["calibrated"],
            textures=[pair_of(wildcards.film).texture],
            floors=[pair_of(wildcards.film).substrate],
        ),
        code=code_of("capture"),
        config=CONFIG_FILE,
    message:
        "Simulate and render surrogate {wildcards.film}"
    shell:
        "slipstitch capture surrogate --config {params.config} --film {wildcards.film}"
        " --out {output} > {log} 2>&1"


if SLIP_ANGLES:

    rule captures_reference:
        input:
            SLIP_ANGLES,
        output:
            table="results/captures/reference.csv",
            details="results/captures/reference.json",
            picture=report(
                "results/captures/reference.svg",
                caption="../workflow/report/captures.rst",
                category="Captures",
            ),
        log:
            "results/logs/captures/reference.log",
        benchmark:
            "results/benchmarks/captures/reference.tsv"
        threads: 1
        resources:
            mem_mb=1024,
            runtime=15,
        params:
            code=code_of("capture"),
        message:
            "Compute friction from slip angles"
        shell:
            "slipstitch capture reference {input} --out {output.table} --json {output.details}"
            " --picture {output.picture} > {log} 2>&1"


rule captures_ingest:
    input:
        table=CAPTURES_TABLE,
        films=expand("results/captures/bench/{film}.mp4", film=FILMS),
        bench=filmed_on_the_bench,
        camera=CALIBRATED_CAMERA,
        reference="results/captures/reference.csv" if SLIP_ANGLES else [],
    output:
        "results/captures/dataset/manifest.parquet",
        "results/captures/dataset/captures.parquet",
    log:
        "results/logs/captures/ingest.log",
    benchmark:
        "results/benchmarks/captures/ingest.tsv"
    threads: 1
    resources:
        mem_mb=2048,
        runtime=60,
    params:
        *settings("simulation", "render", "sample"),
        materials=fabric_names(),
        catalogue=entries(viewpoints=["calibrated"]),
        code=code_of("capture"),
        config=CONFIG_FILE,
        reference="--reference results/captures/reference.csv" if SLIP_ANGLES else "",
    message:
        "Ingest the captures"
    shell:
        "slipstitch capture ingest {input.table} --config {params.config} {params.reference}"
        " --out-dir results/captures/dataset > {log} 2>&1"


rule captures_evaluate:
    input:
        dataset=rules.captures_ingest.output,
        networks=rules.train.input,
        instruments=rules.instrument.input,
    output:
        metrics="results/captures/metrics.json",
        predictions="results/captures/predictions.parquet",
        page=report(
            "results/captures/index.html",
            caption="../workflow/report/captures.rst",
            category="Captures",
        ),
    log:
        "results/logs/captures/evaluate.log",
    benchmark:
        "results/benchmarks/captures/evaluate.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("evaluate"),
        runtime=30,
    params:
        *settings("evaluate"),
        code=code_of("evaluate.captures"),
        shipped=Path(SHIPPED, "SHA256SUMS").read_text(),
        config=CONFIG_FILE,
    message:
        "Evaluate networks and instruments on the captures"
    shell:
        "slipstitch evaluate --captures --config {params.config}"
        " --dataset results/captures/dataset --models results/train"
        " --instruments results/instrument --out {output.metrics}"
        " --predictions {output.predictions} --page {output.page} > {log} 2>&1"
