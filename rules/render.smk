"""One Blender process per simulation; then all textures, without Blender; previews."""

# Viewpoints from which only some simulations are filmed, as a pattern.
DRAWN_VIEWPOINT = "|".join(view for view in VIEWPOINTS if view not in FULL_VIEWPOINTS) or "none"

# The shading depends neither on the set of shards nor on what is applied to it afterwards.
SHADING_SETTINGS = settings(
    "seed",
    "render",
    also=("sample.frames_kept", "render.augmentation.lamp_m"),
    render={
        "viewpoints",
        "test_viewpoints",
        "test_viewpoint_videos",
        "floors",
        "reflective_floors",
        "textures",
        "test_textures",
        "augmentation",
        "verified_images",
    },
)
RENDER_SETTINGS = settings(
    "seed",
    "render",
    render={
        "viewpoints",
        "test_viewpoints",
        "test_viewpoint_videos",
        "verified_images",
    },
)


def shaded(wildcards):
    """The viewpoints that a shading job renders: of the drawn films one, of the others all."""
    return [wildcards.viewpoint] if "viewpoint" in wildcards.keys() else FULL_VIEWPOINTS


def views(wildcards):
    """Name and floors of each viewpoint of a shading job: floors are drawn in their order."""
    return {
        view: [VIEWPOINTS[view]["name"], floors_of(CONFIG.render, view)]
        for view in shaded(wildcards)
    }


def camera_files(wildcards):
    """The camera files of the viewpoints, where any is configured."""
    cameras = [CONFIG.render.camera_of(name) for name, _ in views(wildcards).values()]
    return [file for file in cameras if file]


def shading_catalogue(wildcards):
    """Viewpoints and floors of a shading job."""
    names, floors = zip(*views(wildcards).values())
    return entries(viewpoints=names, floors=set().union(*floors))


def filmed(simulation, viewpoints):
    """The simulation, or the simulations between which the films of it lie, and their weights."""
    shown = [interpolated().get((simulation, viewpoint)) for viewpoint in viewpoints]
    return [one.weights if one else {simulation: 1.0} for one in shown]


def trajectories(simulation, *viewpoints):
    """The trajectories that films of a simulation show, its own first."""
    names = [name for weights in filmed(simulation, viewpoints) for name in weights]
    return [f"results/simulate/{name}.parquet" for name in dict.fromkeys([simulation, *names])]


rule render:
    input:
        shards=expand("results/render/{shard}.parquet", shard=SHARDS),
        previews=expand(
            "results/render/preview/{simulation}.{kind}",
            simulation=SIMULATIONS,
            kind=["png", "mp4"],
        ),
        verification="results/render/verification.json",


rule render_shading:
    input:
        trajectories=lambda wildcards: trajectories(wildcards.simulation, *shaded(wildcards)),
        cameras=camera_files,
    output:
        expand(
            "results/render/shading/{{simulation}}_{viewpoint}.parquet",
            viewpoint=FULL_VIEWPOINTS,
        ),
    log:
        "results/logs/render/shade_{simulation}.log",
    benchmark:
        "results/benchmarks/render/shade_{simulation}.tsv"
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("render"),
        runtime=job_runtime_min("render", CONFIG),
    params:
        *SHADING_SETTINGS,
        viewpoints=shaded,
        views=lambda wildcards: json.dumps(views(wildcards)),
        weights=lambda wildcards: filmed(wildcards.simulation, shaded(wildcards)),
        catalogue=shading_catalogue,
        code=code_of("render.packing"),
        config=CONFIG_FILE,
    message:
        "Render the shading of {wildcards.simulation}"
    shell:
        "slipstitch render --config {params.config} --trajectory {input.trajectories[0]}"
        " --viewpoint {params.viewpoints} --shading {output} > {log} 2>&1"


# Of viewpoints from which only some simulations are filmed.
use rule render_shading as render_shading_drawn with:
    output:
        "results/render/shading/{simulation}_{viewpoint}.parquet",
    log:
        "results/logs/render/shade_{simulation}_{viewpoint}.log",
    benchmark:
        "results/benchmarks/render/shade_{simulation}_{viewpoint}.tsv"
    wildcard_constraints:
        viewpoint=DRAWN_VIEWPOINT,
    message:
        "Render the shading of {wildcards.simulation} from viewpoint {wildcards.viewpoint}"


rule render_images:
    input:
        trajectories=lambda wildcards: trajectories(wildcards.simulation, *FULL_VIEWPOINTS),
        shading=expand(
            "results/render/shading/{{simulation}}_{viewpoint}.parquet",
            viewpoint=FULL_VIEWPOINTS,
        ),
        textures=CONFIG.render.texture_files(),
    output:
        expand("results/render/{{simulation}}_{viewpoint}.parquet", viewpoint=FULL_VIEWPOINTS),
    log:
        "results/logs/render/compose_{simulation}.log",
    benchmark:
        "results/benchmarks/render/compose_{simulation}.tsv"
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("compose"),
        runtime=job_runtime_min("compose", CONFIG),
    params:
        *RENDER_SETTINGS,
        catalogue=entries(textures=texture_ids(CONFIG.render).values()),
        code=code_of("render"),
        config=CONFIG_FILE,
    message:
        "Compose the images of {wildcards.simulation}"
    shell:
        "slipstitch render --config {params.config} --trajectory {input.trajectories[0]}"
        " --from-shading {input.shading} --out-dir results/render > {log} 2>&1"


# In some textures.
rule render_images_drawn:
    input:
        trajectories=lambda wildcards: trajectories(wildcards.simulation, wildcards.viewpoint),
        shading="results/render/shading/{simulation}_{viewpoint}.parquet",
        textures=CONFIG.render.texture_files(),
    output:
        "results/render/{simulation}_{viewpoint}.parquet",
    log:
        "results/logs/render/compose_{simulation}_{viewpoint}.log",
    benchmark:
        "results/benchmarks/render/compose_{simulation}_{viewpoint}.tsv"
    wildcard_constraints:
        viewpoint=DRAWN_VIEWPOINT,
    priority: 1
    threads: 1
    resources:
        mem_mb=job_memory_mb("compose"),
        runtime=job_runtime_min("compose", CONFIG),
    params:
        *RENDER_SETTINGS,
        seed=CONFIG.seed,
        worn=lambda wildcards: SHOWN[wildcards.simulation, wildcards.viewpoint],
        catalogue=lambda wildcards: entries(
            textures=SHOWN[wildcards.simulation, wildcards.viewpoint].values()
        ),
        code=code_of("render"),
        config=CONFIG_FILE,
    message:
        "Compose the images of {wildcards.simulation} from viewpoint {wildcards.viewpoint}"
    shell:
        "slipstitch render --config {params.config} --trajectory {input.trajectories[0]}"
        " --from-shading {input.shading} --out-dir results/render > {log} 2>&1"


rule render_verification:
    input:
        trajectories=rules.simulate.input,
        shards=rules.render.input.shards,
    output:
        "results/render/verification.json",
    log:
        "results/logs/render/verify.log",
    benchmark:
        "results/benchmarks/render/verify.tsv"
    threads: 1
    resources:
        mem_mb=job_memory_mb("verify"),
        runtime=job_runtime_min("verify", CONFIG),
    params:
        *settings("seed"),
        images=CONFIG.render.verified_images,
        code=code_of("render"),
        config=CONFIG_FILE,
    message:
        "Compare {params.images} images with direct renders"
    shell:
        "slipstitch render --config {params.config} --verify --trajectories results/simulate"
        " --packs results/render/shading --out {output} {input.shards} > {log} 2>&1"


rule preview_one:
    input:
        lambda wildcards: [
            f"results/render/{wildcards.simulation}_{viewpoint}.parquet"
            for viewpoint in VIEWPOINTS
            if (wildcards.simulation, viewpoint) in SHOWN
        ],
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
        code=code_of("render"),
    message:
        "Preview {wildcards.simulation}: contact sheet and video"
    shell:
        "slipstitch render --preview --out-sheet {output.sheet} --out-video {output.film}"
        " {input} > {log} 2>&1"
