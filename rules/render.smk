"""One Blender process a simulation and viewpoint, all textures in it; previews."""

# The list of viewpoints decides which shards there are, not what one shard holds.
RENDER_SETTINGS = settings("render", render={"viewpoints", "test_viewpoints"})


def camera_file(wildcards):
    """The camera file that the viewpoint's camera stands by, if one is configured."""
    return CONFIG.render.camera_of(VIEWPOINTS[wildcards.viewpoint]["name"]) or []


rule render:
    input:
        expand(
            "results/render/{simulation}_{viewpoint}.parquet",
            simulation=SIMULATIONS,
            viewpoint=VIEWPOINTS,
        ),
        expand(
            "results/render/preview/{simulation}.{kind}",
            simulation=SIMULATIONS,
            kind=["png", "mp4"],
        ),


rule render_one:
    input:
        trajectory="results/simulate/{simulation}.parquet",
        camera=camera_file,
    output:
        "results/render/{simulation}_{viewpoint}.parquet",
    log:
        "results/logs/render/{simulation}_{viewpoint}.log",
    benchmark:
        "results/benchmarks/render/{simulation}_{viewpoint}.tsv"
    threads: CONFIG.render.threads
    resources:
        mem_mb=job_memory_mb("render"),
        runtime=job_runtime_min("render", CONFIG),
    params:
        settings=RENDER_SETTINGS,
        frames=CONFIG.sample.frames,
        viewpoint=lambda wildcards: VIEWPOINTS[wildcards.viewpoint]["name"],
        code=code_digest("render"),
        config=CONFIG_FILE,
    message:
        "Render {wildcards.simulation} from viewpoint {wildcards.viewpoint}"
    shell:
        "slipstitch render --config {params.config} --trajectory {input.trajectory}"
        " --viewpoint {wildcards.viewpoint} --out {output} > {log} 2>&1"


rule preview_one:
    input:
        expand("results/render/{{simulation}}_{viewpoint}.parquet", viewpoint=VIEWPOINTS),
    output:
        sheet=report(
            "results/render/preview/{simulation}.png",
            caption="../workflow/report/preview.rst",
            category="Simulations",
            labels={"simulation": "{simulation}"},
        ),
        film="results/render/preview/{simulation}.mp4",
    log:
        "results/logs/render/preview_{simulation}.log",
    benchmark:
        "results/benchmarks/render/preview_{simulation}.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("preview"),
        runtime=job_runtime_min("preview", CONFIG),
    params:
        code=code_digest("render"),
    message:
        "Contact sheet and film of {wildcards.simulation}"
    shell:
        "slipstitch render --preview --out-sheet {output.sheet} --out-video {output.film}"
        " {input} > {log} 2>&1"
