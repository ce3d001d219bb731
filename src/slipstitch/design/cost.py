"""Estimated cost of a configuration: jobs, CPU time, disk; from measured costs per item.

The table `COSTS` is the only place with measured numbers; the rest scales them.
"""

import math
from collections import Counter
from dataclasses import dataclass

from slipstitch.base.page.wording import aligned, size
from slipstitch.config.calibrate import KEYS
from slipstitch.config.catalogue import FLOORS
from slipstitch.config.model import Config
from slipstitch.design.grid import films, floors_of, simulations, viewpoint_ids
from slipstitch.design.trainable import instrument_views, trainings

STRIP_FABRICS = 2  # that the pushed strip is made of


@dataclass(frozen=True)
class Cost:
    """A measured cost of one item and where the number comes from."""

    value: float
    unit: str
    source: str


# One core of a 2-core x86-64 virtual machine unless the source says otherwise.
COSTS = {
    "calibrate_s": Cost(
        20.0, "CPU s", "5 s in the smoke chain, coarse; an allowance for finer ones"
    ),
    "strip_s": Cost(
        1.2, "CPU s per push of the strip at steps of 20 ms or more", "demo: mean, busy machine"
    ),
    "simulate_step_s": Cost(
        0.022,
        "CPU s a time step of 41 x 41 vertices, no self-contact",
        "demo, 24 simulations of the drop and one stroke, busy machine: 1060 CPU s, 48600 steps",
    ),
    "self_contact_step_s": Cost(
        0.040,
        "CPU s a nominal time step of 83 ms, 41 x 41 vertices that may touch themselves",
        "the paper's grid, 300 frames, 1488 steps, two at a time: mean 60 CPU s",
    ),
    # Sparse Cholesky alone, of the order of V^1.5 operations for V vertices, would make it 3.
    "simulate_size": Cost(
        2.3,
        "power of the vertices per side",
        "166 simulations of 38 s at 21 x 21, 5.3 CPU s in the mean, beside 8 of 131 s at 41 x 41",
    ),
    "trajectory_bytes": Cost(
        1.0, "bytes per vertex and frame", "mean of the paper's 160 simulations, the mesh included"
    ),
    "render_start_s": Cost(
        1.0, "CPU s a Blender process", "smoke chain: 1.8 s with 8 frames at 32 px"
    ),
    "render_frame_s": Cost(
        0.14,
        "CPU s per frame at 112 px, 1 sample: traced, separated, smoothed, packed",
        "busy machine: 0.145, 0.222, 0.075 by view",
    ),
    "mirror_factor": Cost(2.0, "of render_frame_s on a reflective floor", "two paths for one"),
    "pack_bytes": Cost(8.0, "bytes per pixel", "112 px, matte"),
    "compose_start_s": Cost(0.6, "CPU s per simulation", "imports, textures drawn"),
    "look_frame_s": Cost(0.025, "CPU s per frame", "112 px: 0.017, 0.043, 0.009 by view"),
    "texture_s": Cost(0.0045, "CPU s per image", "112 px: 2.0 to 6.6 ms, composed and encoded"),
    "direct_pixel_s": Cost(
        2.5e-4,
        "CPU s per pixel at 256 samples; four times as many on a reflective floor",
        "about 1 M camera samples per second and core",
    ),
    "image_bytes": Cost(
        1.15,
        "bytes per pixel of PNG",
        "64 px, 810 images of one simulation in nine textures: calibrated 1.16, frontal 1.47, side "
        "0.68; the paper's nine viewpoints have seven like the first; 1.7 at 32 px",
    ),
    "preview_s": Cost(0.8, "CPU s per simulation", "smoke chain: mean of 4"),
    "preview_bytes": Cost(75e3, "bytes per simulation", "smoke chain, 32 px: mean of 4"),
    "sample_s": Cost(0.0003, "CPU s per image", "demo: 2.1 s for 6480 images"),
    "train_frame_s": Cost(
        0.0022,
        "CPU s per frame, forward and backward, 64 px, a quarter of the paper's width",
        "Table 1's network, bfloat16, 92,160 passes of 30 frames: 1.68 CPU h",
    ),
    "train_fixed_share": Cost(
        0.065, "of train_frame_s that pixels do not scale", "the same passes at 32 px: 0.50 CPU h"
    ),
    "instrument_frame_s": Cost(
        0.0008, "CPU s per frame, forward and backward, 64 px", "112 px: 0.0020; busy machine"
    ),
    "criticise_s": Cost(
        40.0, "CPU s per case", "24 runs simulated again twice: 26 s; an allowance"
    ),
    "forward_share": Cost(1 / 3, "of train_frame_s", "validation and evaluation: forward only"),
    "report_s": Cost(10.0, "CPU s", "5 s in the smoke chain; an allowance for more"),
    "release_s": Cost(
        0.0003, "CPU s per image", "112 px: 4.5 CPU s for 11520 images, 1 s of it start"
    ),
    "release_start_s": Cost(2.0, "CPU s", "smoke chain: 2 s, most of it imports"),
    "audit_s": Cost(0.00045, "CPU s per image", "112 px: 23 CPU s for 51 840 images"),
    "audit_start_s": Cost(2.0, "CPU s", "smoke chain"),
    "release_bytes": Cost(2.5e6, "bytes", "smoke chain: card, records, previews, sources"),
    "record_bytes": Cost(8e3, "bytes per simulation or image shard", "smoke chain"),
    "ingest_film_s": Cost(1.5, "CPU s per video", "97 frames of 160 px: 1.3 s, 1 s of it start"),
    "film_bytes": Cost(0.1, "bytes per pixel", "H.264 at quality 26, noise 0.02; an allowance"),
    "report_bytes": Cost(5e6, "bytes", "0.6 MB in the smoke chain; an allowance for more"),
}

# Resident memory (RSS) of the largest job, from benchmark files; published: see results/published.
MEMORY_MIB = {
    "calibrate": Cost(302, "MiB", "published; smoke chain 275"),
    "simulate": Cost(391, "MiB", "published; smoke chain 329; convergence, 81 x 81 vertices: 560"),
    "render": Cost(675, "MiB", "published; smoke chain 578"),
    "compose": Cost(692, "MiB", "published; smoke chain 380"),
    "verify": Cost(625, "MiB", "smoke chain"),
    "preview": Cost(323, "MiB", "smoke chain"),
    "sample": Cost(205, "MiB", "smoke chain, 16 videos: 208; all videos come on top"),
    "instrument": Cost(830, "MiB", "published, without the videos; smoke chain 462"),
    "train": Cost(436, "MiB", "smoke chain, 0.4 MiB of videos; the videos come on top"),
    "evaluate": Cost(528, "MiB", "smoke chain; the videos come on top"),
    "criticise": Cost(625, "MiB", "a case of 24 runs; others 411"),
    "report": Cost(512, "MiB", "smoke chain"),
    "release": Cost(236, "MiB", "smoke chain"),
    "audit": Cost(465, "MiB", "smoke chain"),
}
MEMORY_MARGIN = 2.0
SAMPLE_VIDEO_MIB = Cost(
    0.07, "MiB a video", "published: 742 MiB with 8280 videos, 317 with 1920: 0.065, 0.058"
)
# How often a job holds its decoded videos at its peak.
VIDEOS_HELD = {
    "train": Cost(4.2, "times", "published: 1867 MiB; colours are counted as 8-byte numbers"),
    "instrument": Cost(3.2, "times", "published: 7655 MiB; while error bars are calibrated"),
    "evaluate": Cost(1.0, "times", "an allowance: it reads those that test"),
}
VIDEOS_MARGIN = 1.2


@dataclass(frozen=True)
class StageEstimate:
    """Jobs, CPU seconds and disk bytes of one stage."""

    stage: str
    jobs: int
    cpu_s: float
    disk_bytes: float


def _cost(name: str) -> float:
    return COSTS[name].value


def _frames_rendered(config: Config) -> int:
    return (
        config.sample.frames_kept if config.render.frames == "sampled" else config.simulation.frames
    )


def _simulation_cpu_s(config: Config) -> float:
    settings = config.simulation
    steps = settings.frames / settings.frame_rate_hz / settings.time_step_s
    size = (settings.vertices_per_side / 41) ** _cost("simulate_size")
    step = "self_contact_step_s" if settings.self_contact else "simulate_step_s"
    return _cost(step) * steps * size


def _strip_cpu_s(config: Config) -> float:
    """The pushes of the calibration: every setting, fabric and friction coefficient."""
    calibrate, step_s = config.calibrate, config.simulation.time_step_s
    pushes = len(calibrate.strip_frictions) * STRIP_FABRICS
    of_one_value = [len(getattr(calibrate, f"sweep_{key}")) for key in KEYS if key != "time_step_s"]
    steps = [step_s] * (1 + sum(of_one_value)) + list(calibrate.sweep_time_step_s)
    return _cost("strip_s") * pushes * sum(max(1.0, 0.02 / step) for step in steps)


def _mirrors(config: Config) -> float:
    """Share of the image shards whose floor mirrors."""
    shown = [floors_of(config.render, viewpoint) for _, viewpoint in films(config)]
    shares = [
        sum(FLOORS[name].reflectance[1] > 0 for name in floors) / len(floors) for floors in shown
    ]
    return sum(shares) / len(shares)


def _videos(config: Config) -> int:
    return sum(map(len, films(config).values()))


def _drawn_shards(config: Config) -> int:
    """Image shards of the viewpoints from which only some simulations are filmed."""
    full = len(simulations(config))
    counts = Counter(viewpoint for _, viewpoint in films(config))
    return sum(count for count in counts.values() if count < full)


def _render_cpu_s(config: Config) -> float:
    """The light of one image shard, in the mean."""
    images = _frames_rendered(config)
    # Half of it does not depend on the image's size: 0.07 s at 64 px.
    size = 0.5 + 0.5 * (config.render.pixels / 112) ** 2 * config.render.samples
    size *= 1 + _mirrors(config) * (_cost("mirror_factor") - 1)
    return _cost("render_start_s") + images * _cost("render_frame_s") * size


def _compose_cpu_s(config: Config) -> float:
    """One simulation's images from all its viewpoints in their textures, in the mean."""
    shards, runs = len(films(config)), len(simulations(config))
    each = shards * _cost("look_frame_s") + _videos(config) * _cost("texture_s")
    starts = (runs + _drawn_shards(config)) * _cost("compose_start_s")
    return (starts + _frames_rendered(config) * each) / runs


def verification_cpu_s(config: Config) -> float:
    """The images that are rendered directly."""
    pixel = _cost("direct_pixel_s") * (1 + 3 * _mirrors(config))
    image = _cost("render_start_s") + pixel * config.render.pixels**2
    return config.render.verified_images * image


def _image_bytes(config: Config) -> float:
    return _cost("image_bytes") * config.render.pixels**2


def _pack_bytes(config: Config) -> float:
    return _cost("pack_bytes") * config.render.pixels**2


def _frame_factor(config: Config) -> float:
    """Work of the network on one frame, in units of 64 px at a quarter of the width."""
    pixels = config.train.pixels or config.render.pixels
    fixed = _cost("train_fixed_share")
    return (fixed + (1 - fixed) * (pixels / 64) ** 2) * _width2(config)


def _training_cpu_s(config: Config) -> float:
    """One training: cycles over 1, 2, ... viewpoints, then the calibrated one alone."""
    train = config.train
    views = len(config.render.viewpoints)
    passes = train.epochs_per_cycle * views * (views + 1) / 2 + train.fine_tuning_epochs
    validation = config.sample.validation_fraction
    share = 1.0 - config.sample.test_fraction - validation * (1 - _cost("forward_share"))
    videos = len(simulations(config)) * len(config.render.textures) * share
    return passes * videos * config.sample.frames * _cost("train_frame_s") * _frame_factor(config)


def _instrument_cpu_s(config: Config) -> float:
    """One instrument: all epochs on the training videos of one viewpoint."""
    share = 1.0 - config.sample.test_fraction
    videos = len(simulations(config)) * len(config.render.textures) * share
    pixels = config.instrument.pixels or config.render.pixels
    frames = config.instrument.epochs * videos * config.sample.frames
    return frames * _cost("instrument_frame_s") * (pixels / 64) ** 2


def estimate(config: Config) -> list[StageEstimate]:
    """Cost of each stage of the chain, in its order.

    The jobs are those that Snakemake counts, without its ``all``.
    """
    runs, shards = len(simulations(config)), len(films(config))
    videos = _videos(config)
    sampled = videos * config.sample.frames_kept
    networks = sum(len(trainings(config.train, one)) for one in config.train.splits)
    instruments = len(config.train.splits) * len(config.instrument.seeds)
    averages = len(config.train.splits) * (len(config.instrument.seeds) > 1)
    vertices = config.simulation.vertices_per_side**2
    trajectory = _cost("trajectory_bytes") * vertices * config.simulation.frames
    evaluated = sampled * networks * max(config.sample.test_fraction, 1 / runs)
    return [
        # Jobs: one per swept setting, the configured ones, the choice with checks, the pictures.
        StageEstimate("calibrate", 3 + len(KEYS), _cost("calibrate_s") + _strip_cpu_s(config), 1e6),
        StageEstimate("simulate", runs, runs * _simulation_cpu_s(config), runs * trajectory),
        StageEstimate(
            "render",
            shards + _drawn_shards(config) + 2 * runs + 1,
            shards * _render_cpu_s(config)
            + runs * (_compose_cpu_s(config) + _cost("preview_s"))
            + verification_cpu_s(config),
            videos * _frames_rendered(config) * _image_bytes(config)
            + shards * _frames_rendered(config) * _pack_bytes(config)
            + runs * _cost("preview_bytes"),
        ),
        # The table of ids counts here.
        StageEstimate("sample", 2, sampled * _cost("sample_s"), sampled * _image_bytes(config)),
        StageEstimate(
            "train", networks, networks * _training_cpu_s(config), networks * 4e6 * _width2(config)
        ),
        StageEstimate(
            "instrument",
            instruments + averages,
            instruments * _instrument_cpu_s(config),
            instruments * 2e6 + averages * 4e6,
        ),
        StageEstimate(
            "evaluate",
            1,
            evaluated * _cost("forward_share") * _cost("train_frame_s") * _frame_factor(config),
            1e6,
        ),
        StageEstimate(
            "criticise",
            len(config.criticise.cases),
            len(config.criticise.cases) * _cost("criticise_s"),
            1e6 * len(config.criticise.cases),
        ),
        _release(config),
        StageEstimate(
            "audit", 1, _cost("audit_start_s") + sampled * _cost("audit_s"), 1e5 + 30.0 * videos
        ),
        StageEstimate("report", 1, _cost("report_s"), _cost("report_bytes")),
    ]


def _release(config: Config) -> StageEstimate:
    images = _videos(config) * config.sample.frames_kept
    shards = len(films(config)) + 2 * len(simulations(config))
    return StageEstimate(
        "release",
        1,
        _cost("release_start_s") + images * _cost("release_s"),
        _cost("release_bytes") + images * _image_bytes(config) + shards * _cost("record_bytes"),
    )


def _training_simulations(config: Config) -> float:
    """Those that neither test nor watch."""
    held = config.sample.validation_fraction + config.sample.test_fraction
    grid = config.grid
    return len(grid.materials) * len(grid.frictions) * grid.replicates * (1.0 - held)


def estimate_ablate(config: Config) -> StageEstimate:
    """Cost of the ablations, were all answered; they are not part of the chain.

    In units of one network passing once through one video of each training simulation: three ways
    to condition and a material network, two schedules of all viewpoints, three initialisations,
    twice two variants of about as many videos with either network.
    """
    ablate = config.ablate
    trained = config.train.model_copy(update=ablate.train)
    looked = config.instrument.model_copy(update=ablate.instrument)
    textures_each = ablate.textures_per_simulation or len(config.render.textures)
    frames = _training_simulations(config) * textures_each * config.sample.frames
    factor = _frame_factor(config.model_copy(update={"train": trained}))
    lrcn = frames * ablate.passes * _cost("train_frame_s") * factor
    side = (looked.pixels or config.render.pixels) / 64
    instrument = frames * ablate.instrument_passes * _cost("instrument_frame_s") * side**2
    networks = {
        "diversity": (2, 2),
        "conditioning": (4, 0),
        "schedule": (2 * len(config.render.viewpoints), 0),
        "initialisation": (3, 0),
        "floors": (2, 2),
    }
    asked = [networks[name] for name in ablate.asked]
    of_kind = [sum(column) for column in zip(*asked, strict=True)]
    cpu_s = sum(
        count * cost
        for count, cost, name in zip(
            of_kind, (lrcn, instrument), ("lrcn", "instrument"), strict=True
        )
        if name in ablate.networks
    )
    seeds = len(ablate.seeds)
    return StageEstimate("ablate", len(ablate.results) + 1, seeds * cpu_s, seeds * 16 * 4e6)


def estimate_captures(config: Config) -> StageEstimate:
    """Cost of surrogate captures and what is made of them; they are not part of the chain."""
    settings, training = config.captures, config.simulation
    duration_s = training.frames / training.frame_rate_hz
    made = training.model_copy(
        update={
            "vertices_per_side": settings.vertices_per_side,
            "time_step_s": settings.time_step_s,
        }
    )
    films = 0 if settings.table else len(settings.pairs) * settings.repeats
    # The start at the full rate, then every so many-th frame; the image is a square with a margin.
    frames = 12.0 * (3 + duration_s / settings.later_every)
    size = 0.5 + 0.5 * (1.12 * settings.width_px / 112) ** 2 * config.render.samples
    mirrors = sum(FLOORS[pair.substrate].reflectance[1] > 0 for pair in settings.pairs)
    size *= 1 + mirrors / len(settings.pairs) * (_cost("mirror_factor") - 1)
    each = _simulation_cpu_s(config.model_copy(update={"simulation": made}))
    each += _cost("render_start_s") + frames * size * _cost("render_frame_s")
    return StageEstimate(
        "captures",
        2 + bool(settings.angles) if settings.table else films + 4,
        films * (each + _cost("ingest_film_s")),
        films * (frames * _cost("film_bytes") * settings.width_px**2 * 0.75 + 1e6),
    )


def _width2(config: Config) -> float:
    return (config.train.width / 0.25) ** 2


JOB_KINDS = tuple(MEMORY_MIB)


def _video_bytes(config: Config, kind: str = "train") -> float:
    """The decoded videos, which training and evaluation hold as a whole."""
    side, videos = config.train.pixels or config.render.pixels, _videos(config)
    if kind == "instrument":
        names = viewpoint_ids(config.render)
        side = config.instrument.pixels or config.render.pixels
        videos = sum(
            len(textures)
            for (_, view), textures in films(config).items()
            if names[view] in instrument_views(config)
        )
    return 3.0 * videos * config.sample.frames_kept * side**2


def job_memory_mb(kind: str, config: Config | None = None) -> int:
    """Memory (MB) for a scheduler to set aside for one job: twice what was measured.

    Of decoded videos, which are counted and not guessed, 1.2 times what they take at the peak.

    Parameters
    ----------
    kind : str
        One of `JOB_KINDS`.
    config : Config, optional
        For kinds whose memory grows with the dataset.
    """
    needed = MEMORY_MARGIN * MEMORY_MIB[kind].value * 2**20
    if config is not None and kind == "sample":
        needed += MEMORY_MARGIN * SAMPLE_VIDEO_MIB.value * _videos(config) * 2**20
    if config is not None and kind in VIDEOS_HELD:
        needed += VIDEOS_MARGIN * VIDEOS_HELD[kind].value * _video_bytes(config, kind)
    return 256 * math.ceil(needed / 256e6)


def job_cpu_s(kind: str, config: Config) -> float:
    """CPU seconds of one job of a kind, the mean where a stage's jobs differ.

    Parameters
    ----------
    kind : str
        One of `JOB_KINDS`: a stage, or ``compose``, ``verify``, ``preview`` of rendering.
    config : Config
    """
    if kind in ("preview", "criticise"):
        return _cost(f"{kind}_s")
    if kind == "render":
        return _render_cpu_s(config)
    if kind == "compose":
        return _compose_cpu_s(config)
    if kind == "verify":
        return verification_cpu_s(config)
    stages = [*estimate(config), estimate_ablate(config)]
    whole = next(stage for stage in stages if stage.stage == kind)
    return whole.cpu_s / whole.jobs


def job_runtime_min(kind: str, config: Config) -> int:
    """Minutes after which a scheduler may end one job: five times the estimate, at least 15."""
    return max(15, math.ceil(5 * job_cpu_s(kind, config) / 60))


def _time(cpu_s: float) -> str:
    if cpu_s >= 3600:
        return f"{cpu_s / 3600:.3g} CPU h"
    return f"{cpu_s / 60:.2g} CPU min" if cpu_s >= 60 else f"{cpu_s:.2g} CPU s"


def estimate_line(config: Config) -> str:
    """The whole chain from nothing, in one line."""
    stages = estimate(config)
    jobs, cpu_s = sum(stage.jobs for stage in stages), sum(stage.cpu_s for stage in stages)
    disk = sum(stage.disk_bytes for stage in stages)
    return f"The whole chain from scratch: {jobs} jobs, about {_time(cpu_s)}, {size(disk)} of disk"


def estimate_table(config: Config) -> str:
    """`estimate` as aligned text; ablations, captures and the line of the whole chain last."""
    apart = [estimate_ablate(config), estimate_captures(config)]
    rows = [("stage", "jobs", "time", "disk")] + [
        (stage.stage, str(stage.jobs), _time(stage.cpu_s), size(stage.disk_bytes))
        for stage in [*estimate(config), *apart]
    ]
    return "\n".join([*aligned(rows), estimate_line(config)])
