"""Estimated cost of a configuration: jobs, CPU time, disk and memory, from measured costs an item.

CPU times are of one core of a 2-core x86-64 virtual machine, most of them while it was busy.
"""

import math
from collections import Counter
from dataclasses import dataclass

from slipstitch.base.page.wording import aligned, size
from slipstitch.config.catalogue import FLOORS
from slipstitch.config.model import Config
from slipstitch.config.simulation import KEYS, SimulationSettings
from slipstitch.design.grid import films, floors_of, simulations, viewpoint_ids
from slipstitch.design.trainable import instrument_views, trainings

CALIBRATE_S = 20.0  # 5 s in the smoke chain, coarse; an allowance for finer ones
STRIP_S = 1.2  # a push of the strip at steps of 20 ms or more
STRIP_FABRICS = 2  # that the pushed strip is made of
# A nominal time step of 41 x 41 vertices that touch the floor alone: 1060 s for 48600 steps. With
# vertices that may touch themselves, of 83 ms: the paper's grid, 60 s for 1488 steps.
SIMULATE_STEP_S, SELF_CONTACT_STEP_S = 0.022, 0.040
# Power of the vertices a side: 166 simulations at 21 x 21 beside 8 at 41 x 41. Sparse Cholesky
# alone, of the order of V^1.5 operations for V vertices, would make it 3.
SIMULATE_POWER = 2.3
TRAJECTORY_BYTES = 1.0  # a vertex and frame; mean of the paper's 160 simulations, with the mesh
RENDER_START_S = 3.5  # a Blender process; 6.8 s for 30 frames, each further view 2.9 s
RENDER_FRAME_S = 0.14  # a frame of 112 px, 1 sample: 0.145, 0.222, 0.075 by view
MIRROR_FACTOR = 2.0  # on a reflective floor: two paths for one
PACK_BYTES = 8.0  # a pixel of the packed light
COMPOSE_START_S = 0.6  # a simulation: imports, textures drawn
COMPOSE_FRAME_S, COMPOSE_IMAGE_S = 0.025, 0.0045  # a frame of 112 px; an image of it in a texture
DIRECT_PIXEL_S = 2.5e-4  # 256 samples; four times as many on a reflective floor
IMAGE_BYTES = 1.15  # a pixel of PNG: 1.16, 1.47, 0.68 by view at 64 px
PREVIEW_S, PREVIEW_BYTES = 0.8, 75e3  # a simulation
SAMPLE_S = 0.0003  # an image: 2.1 s for 6480
# A frame forward and backward through Table 1's network, 64 px, a quarter of the width, and the
# share of that which pixels do not scale: 1.68 and 0.50 CPU h at 64 and 32 px, 92,160 passes of 30.
TRAIN_FRAME_S, TRAIN_FIXED_SHARE = 0.0022, 0.065
FORWARD_SHARE = 1 / 3  # validation and evaluation
INSTRUMENT_FRAME_S = 0.0008  # 64 px
CRITICISE_S = 40.0  # a case; 24 runs simulated again twice: 26 s
REPORT_S, REPORT_BYTES = 10.0, 5e6  # 5 s, 0.6 MB in the smoke chain
RELEASE_START_S, RELEASE_IMAGE_S = 2.0, 0.0003  # 4.5 s for 11520 images
RELEASE_BYTES, RECORD_BYTES = 2.5e6, 8e3  # card, previews, sources; a simulation or image shard
AUDIT_START_S, AUDIT_IMAGE_S = 2.0, 0.00045  # 23 s for 51 840 images of 112 px
INGEST_FILM_S, FILM_BYTES = 1.5, 0.1  # a video of 97 frames; a pixel of H.264

# Resident memory (MiB) of the largest job, from benchmark files of published runs and of the smoke
# chain. Videos come on top: of a manifest (MiB each), and as often as a job holds them at its peak.
MEMORY_MIB = {
    "calibrate": 302,
    "simulate": 391,  # convergence, 81 x 81 vertices: 560
    "render": 675,
    "compose": 692,
    "verify": 625,
    "preview": 323,
    "sample": 205,
    "instrument": 830,
    "train": 436,
    "evaluate": 528,
    "criticise": 625,  # a case of 24 runs; others 411
    "report": 512,
    "release": 236,
    "audit": 465,
}
MEMORY_MARGIN = 2.0
SAMPLE_VIDEO_MIB = 0.07  # 742 MiB with 8280 videos, 317 with 1920
VIDEOS_HELD = {"train": 4.2, "instrument": 3.2, "evaluate": 1.0}
VIDEOS_MARGIN = 1.2


@dataclass(frozen=True)
class StageEstimate:
    """Jobs, CPU seconds and disk bytes of one stage."""

    stage: str
    jobs: int
    cpu_s: float
    disk_bytes: float


def _simulation_s(settings: SimulationSettings) -> float:
    steps = settings.frames / settings.frame_rate_hz / settings.time_step_s
    step_s = SELF_CONTACT_STEP_S if settings.self_contact else SIMULATE_STEP_S
    return step_s * steps * (settings.vertices_per_side / 41) ** SIMULATE_POWER


def _calibration_s(config: Config) -> float:
    calibrate, step_s = config.calibrate, config.simulation.time_step_s
    of_one_value = [len(getattr(calibrate, f"sweep_{key}")) for key in KEYS if key != "time_step_s"]
    steps = [step_s] * (1 + sum(of_one_value)) + list(calibrate.sweep_time_step_s)
    pushes = len(calibrate.strip_frictions) * STRIP_FABRICS
    return CALIBRATE_S + STRIP_S * pushes * sum(max(1.0, 0.02 / step) for step in steps)


def _mirror_share(floors: list[str]) -> float:
    return sum(FLOORS[name].reflectance[1] > 0 for name in floors) / len(floors)


class _Counted:
    """What is counted of a configuration: simulations, image shards, videos, images."""

    def __init__(self, config: Config):
        shown = films(config)
        self.runs, self.shards = len(simulations(config)), len(shown)
        self.videos = sum(map(len, shown.values()))
        of_view = Counter(viewpoint for _, viewpoint in shown)
        # Shards of the viewpoints from which only some simulations are filmed.
        self.drawn_shards = sum(count for count in of_view.values() if count < self.runs)
        mirrors = [_mirror_share(floors_of(config.render, view)) for _, view in shown]
        self.mirrors = sum(mirrors) / len(mirrors)
        self.kept = config.sample.frames_kept
        sampled = config.render.frames == "sampled"
        self.frames = self.kept if sampled else config.simulation.frames
        self.training_videos = self.runs * len(config.render.textures)
        self.networks = sum(len(trainings(config.train, one)) for one in config.train.splits)


def _light_s(pixels: float, samples: int, mirrors: float) -> float:
    """A frame's light, of which half does not depend on the image's size."""
    light_s = RENDER_FRAME_S * (0.5 + 0.5 * (pixels / 112) ** 2 * samples)
    return light_s * (1 + mirrors * (MIRROR_FACTOR - 1))


def _frame_s(config: Config) -> float:
    pixels = config.train.pixels or config.render.pixels
    scaled = TRAIN_FIXED_SHARE + (1 - TRAIN_FIXED_SHARE) * (pixels / 64) ** 2
    return TRAIN_FRAME_S * scaled * (config.train.width / 0.25) ** 2


def _instrument_frame_s(config: Config) -> float:
    return INSTRUMENT_FRAME_S * ((config.instrument.pixels or config.render.pixels) / 64) ** 2


def job_costs_s(config: Config) -> dict[str, float]:
    """Kind -> CPU seconds of one of its jobs, the mean where they differ."""
    render, train, sample = config.render, config.train, config.sample
    of, ablations = _Counted(config), estimate_ablate(config)
    light_s = _light_s(render.pixels, render.samples, of.mirrors)
    composed_s = of.frames * (of.shards * COMPOSE_FRAME_S + of.videos * COMPOSE_IMAGE_S)
    composed_s += (of.runs + of.drawn_shards) * COMPOSE_START_S
    direct_s = DIRECT_PIXEL_S * (1 + 3 * of.mirrors) * render.pixels**2
    # Cycles over 1, 2, ... viewpoints, then the calibrated one alone.
    views = len(render.viewpoints)
    passes = train.epochs_per_cycle * views * (views + 1) / 2 + train.fine_tuning_epochs
    trained = 1.0 - sample.test_fraction - sample.validation_fraction * (1 - FORWARD_SHARE)
    frames = of.training_videos * sample.frames
    instrument_frames = config.instrument.epochs * (1.0 - sample.test_fraction) * frames
    tested = of.videos * of.kept * of.networks * max(sample.test_fraction, 1 / of.runs)
    return {
        # One per swept setting, the configured ones, the choice with checks, the pictures.
        "calibrate": _calibration_s(config) / (3 + len(KEYS)),
        "simulate": _simulation_s(config.simulation),
        "render": RENDER_START_S + of.frames * light_s * of.shards / (of.runs + of.drawn_shards),
        "compose": composed_s / of.runs,
        "verify": RENDER_START_S + render.verified_images * 2 * direct_s,
        "preview": PREVIEW_S,
        "sample": of.videos * of.kept * SAMPLE_S,
        "train": passes * trained * frames * _frame_s(config),
        "instrument": instrument_frames * _instrument_frame_s(config),
        "evaluate": tested * FORWARD_SHARE * _frame_s(config),
        "ablate": ablations.cpu_s / ablations.jobs,
        "criticise": CRITICISE_S,
        "release": RELEASE_START_S + of.videos * of.kept * RELEASE_IMAGE_S,
        "audit": AUDIT_START_S + of.videos * of.kept * AUDIT_IMAGE_S,
        "report": REPORT_S,
    }


def estimate(config: Config) -> list[StageEstimate]:
    """Cost of each stage of the chain, in order; jobs as Snakemake counts them but for ``all``."""
    of, one_s = _Counted(config), job_costs_s(config)
    image_bytes = IMAGE_BYTES * config.render.pixels**2
    images_bytes = of.videos * of.kept * image_bytes
    trajectory = TRAJECTORY_BYTES * config.simulation.vertices_per_side**2
    splits, seeds = len(config.train.splits), len(config.instrument.seeds)
    instruments, averages = splits * seeds, splits * (seeds > 1)
    jobs = {
        "calibrate": (3 + len(KEYS), 1e6),
        "simulate": (of.runs, of.runs * trajectory * config.simulation.frames),
        "render": (
            2 * of.drawn_shards + 3 * of.runs + 1,
            of.videos * of.frames * image_bytes
            + of.shards * of.frames * PACK_BYTES * config.render.pixels**2
            + of.runs * PREVIEW_BYTES,
        ),
        "sample": (2, images_bytes),  # the table of ids counts here
        "train": (of.networks, of.networks * 4e6 * (config.train.width / 0.25) ** 2),
        "instrument": (instruments + averages, instruments * 2e6 + averages * 4e6),
        "evaluate": (1, 1e6),
        "criticise": (len(config.criticise.cases), 1e6 * len(config.criticise.cases)),
        "release": (1, RELEASE_BYTES + images_bytes + (of.shards + 2 * of.runs) * RECORD_BYTES),
        "audit": (1, 1e5 + 30.0 * of.videos),
        "report": (1, REPORT_BYTES),
    }
    whole_s = {stage: count * one_s[stage] for stage, (count, _) in jobs.items()}
    whole_s["render"] = (of.runs + of.drawn_shards) * one_s["render"] + one_s["verify"]
    whole_s["render"] += of.runs * (one_s["compose"] + one_s["preview"])
    whole_s |= {"sample": one_s["sample"], "instrument": instruments * one_s["instrument"]}
    return [
        StageEstimate(stage, count, whole_s[stage], disk) for stage, (count, disk) in jobs.items()
    ]


def estimate_ablate(config: Config) -> StageEstimate:
    """Cost of the ablations, were all answered; they are not part of the chain."""
    ablate, sample = config.ablate, config.sample
    train = config.train.model_copy(update=ablate.train)
    instrument = config.instrument.model_copy(update=ablate.instrument)
    changed = config.model_copy(update={"train": train, "instrument": instrument})
    held = sample.validation_fraction + sample.test_fraction
    grid = config.grid
    runs = len(grid.materials) * len(grid.frictions) * grid.replicates * (1.0 - held)
    frames = runs * sample.frames
    lrcn_s = frames * ablate.passes * _frame_s(changed)
    instrument_s = frames * ablate.instrument_passes * _instrument_frame_s(changed)
    cpu_s = 0.0
    for name in ablate.results:
        question, _, variant = name.partition("/")
        views = len(config.render.viewpoints) if question == "schedule" else 1
        cpu_s += views * (lrcn_s if variant.startswith("lrcn") else instrument_s)
    return StageEstimate("ablate", len(ablate.results) + 1, cpu_s, 4e6 * len(ablate.results))


def estimate_captures(config: Config) -> StageEstimate:
    """Cost of surrogate captures and what is made of them; they are not part of the chain."""
    settings, training = config.captures, config.simulation
    if settings.table:
        return StageEstimate("captures", 2 + bool(settings.angles), 0.0, 0.0)
    films = len(settings.pairs) * settings.repeats
    keys = ("vertices_per_side", "time_step_s")
    made = training.model_copy(update={key: getattr(settings, key) for key in keys})
    # The start at the full rate, then every so many-th frame; the image is a square with a margin.
    duration_s = training.frames / training.frame_rate_hz
    frames = 12.0 * (3 + duration_s / settings.later_every)
    mirrors = _mirror_share([pair.substrate for pair in settings.pairs])
    light_s = _light_s(1.12 * settings.width_px, config.render.samples, mirrors)
    each_s = _simulation_s(made) + RENDER_START_S + frames * light_s + INGEST_FILM_S
    each_bytes = frames * FILM_BYTES * settings.width_px**2 * 0.75 + 1e6
    return StageEstimate("captures", films + 4, films * each_s, films * each_bytes)


def _video_bytes(config: Config, kind: str) -> float:
    """The decoded videos, which training and evaluation hold as a whole."""
    shown, pixels = films(config), config.train.pixels
    if kind == "instrument":
        names, wanted = viewpoint_ids(config.render), instrument_views(config)
        shown = {film: worn for film, worn in shown.items() if names[film[1]] in wanted}
        pixels = config.instrument.pixels
    videos, side = sum(map(len, shown.values())), pixels or config.render.pixels
    return 3.0 * videos * config.sample.frames_kept * side**2


def job_memory_mb(kind: str, config: Config | None = None) -> int:
    """Memory (MB) to set aside for one job: twice what was measured, 1.2 times its videos."""
    needed = MEMORY_MARGIN * MEMORY_MIB[kind] * 2**20
    if config is not None and kind == "sample":
        needed += MEMORY_MARGIN * SAMPLE_VIDEO_MIB * _Counted(config).videos * 2**20
    if config is not None and kind in VIDEOS_HELD:
        needed += VIDEOS_MARGIN * VIDEOS_HELD[kind] * _video_bytes(config, kind)
    return 256 * math.ceil(needed / 256e6)


def job_runtime_min(kind: str, config: Config) -> int:
    """Minutes after which a scheduler may end one job: five times the estimate, at least 15."""
    return max(15, math.ceil(5 * job_costs_s(config)[kind] / 60))


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
    rows = [("stage", "jobs", "time", "disk")] + [
        (stage.stage, str(stage.jobs), _time(stage.cpu_s), size(stage.disk_bytes))
        for stage in [*estimate(config), estimate_ablate(config), estimate_captures(config)]
    ]
    return "\n".join([*aligned(rows), estimate_line(config)])
