"""Write docs/results.md, docs/config.md, the rules of the verdict, the shipped model's card.

From published files and from the configuration's schema alone.

python benchmarks/results_page.py [--check]
"""

import argparse
import json
import math
from pathlib import Path

import numpy
import pandas
from results_pictures import pictures, tail_moves_m
from scipy.stats import norm

from slipstitch.base.provenance import read_parquet
from slipstitch.config import load_config
from slipstitch.criticise.verdict import RULES
from slipstitch.design.grid import simulations
from slipstitch.design.stage_path import StagePath
from slipstitch.film.captures_scores import label, model_and_split
from slipstitch.film.measure import SHIPPED
from slipstitch.film.measure.clamp_height import ClampHeight
from slipstitch.learning.evaluation import paper as printed
from slipstitch.learning.evaluation.scores import CALIBRATED
from slipstitch.learning.evaluation.scores import SHIPPED as SHIPPED_MODEL
from slipstitch.learning.instrument import calibration
from slipstitch.learning.instrument.distribution import grouped_quantile
from slipstitch.learning.instrument.measuring import COVERAGE, HALF_WIDTH, load_instrument
from slipstitch.physics.simulation.drop_and_drag import draw_perturbation
from slipstitch.report.scores import SPLIT_NAMES, Scores, model_title

ROOT = Path(__file__).parents[1]
PUBLISHED = ROOT / "results" / "published"
PAGE = ROOT / "docs" / "results.md"
PICTURES = PAGE.with_name("pictures")
CRITICISM = ROOT / "docs" / "how" / "criticism.md"
CONFIG_PAGE = ROOT / "docs" / "config.md"
SCHEMA = ROOT / "workflow/schemas/config.schema.json"
CARD = ROOT / "src/slipstitch/film/measure/shipped/MODEL_CARD.md"
FRICTION = 0.5  # at which relative errors are told
DRAGGED = 0.5  # from here on, coefficients share a row: all cloths are dragged
INTERVAL_SCORES = "mean error of μ|within 0.1|90 % intervals that hold|their mean width"
NETWORKS = {
    "material_baseline": "fabric",
    "friction_baseline": "μ, without the fabric",
    "friction_conditional": "μ, conditioned on the predicted fabric",
}
METRICS = {
    "material_top1": "right",
    "material_top2": "among the first two",
    "friction_lt_0.1": "error below 0.1",
    "friction_lt_0.2": "error below 0.2",
}
# ARGUS, the paper's simulator, measured: seconds a step of 0.5 ms, 41 × 41 vertices, one thread.
ARGUS_STEP_S, ARGUS_STEPS_PER_S = (0.098, 0.122), 2000


def read(name):
    """Return a published JSON file."""
    return json.loads((PUBLISHED / name).read_text(encoding="utf-8"))


def table(head, rows):
    """Return a Markdown table; `head` separates its cells with bars."""
    head = head.split("|")
    lines = [head, ["---"] * len(head), *([str(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def percent(found, metric, digits=1):
    """Return a mean score in %, with its spread over seeds where there are several."""
    if metric not in found.get("mean", {}):
        return "–"
    spread = f" ± {100 * found['spread'][metric]:.{digits}f}" if found.get("spread") else ""
    return f"{100 * found['mean'][metric]:.{digits}f}{spread}"


def share_with_interval(found, metric):
    """Return `percent` with Wilson's 90 % interval over the independent videos of one seed."""
    share, weight = found["mean"][metric], norm.ppf(0.95) ** 2 / found["n"]
    centre = (share + weight / 2) / (1 + weight)
    half = math.sqrt(weight * share * (1 - share) + weight**2 / 4) / (1 + weight)
    return f"{percent(found, metric, 0)} ({100 * (centre - half):.0f}–{100 * (centre + half):.0f})"


def seeds():
    """Return with how many seeds the paper's networks are trained, in words."""
    details = Scores({}, read("paper/details.json"))
    counts = {
        len(details.detail(split, network)["seeds"])
        for split in ("by_video", "by_simulation")
        for network in NETWORKS
    }
    return " to ".join(map(str, sorted({min(counts), max(counts)})))


def paper_table_2():
    """Return Table 2 of the paper beside ours."""
    details = Scores({}, read("paper/details.json"))
    rows = []
    for (network, metric), share in printed.TABLE_2.items():
        cells = [
            percent(details.detail(split, network, view), metric)
            for split in ("by_video", "by_simulation")
            for view in (None, "calibrated")
        ]
        rows.append([f"{NETWORKS[network]}: {METRICS[metric]}", f"{100 * share:.1f}", *cells])
    for probe, words in (
        ("probe_middle_frame", "linear probe of one frame"),
        ("probe_middle_frame_network", "small network on one frame"),
    ):
        cells = [
            percent(details.detail(split, probe, view), "friction_lt_0.1")
            for split in ("by_video", "by_simulation")
            for view in (None, "calibrated")
        ]
        rows.append([f"{words}: error below 0.1", "", *cells])
    head = "%|the paper|videos at random: three views|calibrated view"
    return table(head + "|whole simulations held out: three views|calibrated view", rows)


def paper_unseen():
    """Return section 6.2.1 and Table 3 of the paper beside ours."""
    details = Scores({}, read("paper/details.json"))
    network, metrics = "friction_conditional", ("friction_lt_0.1", "friction_lt_0.2")
    angles = read("camera/angles.json")["angles"]
    by_texture = details.detail("unseen_texture", "instrument_shipped")["by"]["texture"]
    (shipped,) = (part["within_0_1"] for part in by_texture.values())
    quoted = [printed.UNSEEN_TEXTURE[network, metric] for metric in metrics]
    of_texture = "calibrated", printed.UNSEEN_TEXTURE_VIDEOS, quoted, shipped
    tests = [("unseen texture", "unseen_texture", *of_texture)]
    tests += [
        (f"camera turned by {turn:+d}°", f"view_{turn:+d}", None, printed.TABLE_3_VIDEOS, shares,
         angles[f"{turn:+d}"]["within_0_1"])
        for turn, shares in printed.TABLE_3.items()
    ]  # fmt: skip
    rows = []
    for words, split, view, number, shares, shipped in tests:
        found = details.detail(split, network, view)
        ours = [
            share_with_interval(found, metric) if found else "not trained" for metric in metrics
        ]
        theirs = [f"{100 * share:.1f}" for share in shares]
        rows.append([words, number, *theirs, found.get("n", "–"), *ours, f"{100 * shipped:.0f}"])
    return table("%|the paper's videos|< 0.1|< 0.2|our videos|< 0.1|< 0.2|instrument ≤ 0.1", rows)


def paper_captures():
    """Return how many pairs of surrogate films are read to a tenth, beside real ones."""
    matte, reflective = (
        read(f"{run}/captures/metrics.json") for run in ("paper", "paper_reflective")
    )
    subsets, score = ("all", "matte", "reflective"), "median_within_0.1"
    rows = []
    for words, names in (
        ("the paper", subsets),
        ("the paper, reflective training", ["all, reflective training", "", ""]),
    ):
        shares = [printed.CAPTURES.get(name, {}).get(score) for name in names]
        cells = ["" if one is None else f"{100 * one:.1f}" for one in shares]
        rows.append([words, printed.CAPTURES_PAIRS, *cells])
    ours = [
        matte[name] | reflective[name] for name in (f"surrogate_{subset}" for subset in subsets)
    ]
    for labelled in sorted(ours[0], key=lambda one: one.startswith(SHIPPED_MODEL)):
        model, split = model_and_split(labelled)
        if label({"model": model + CALIBRATED, "trained_on": split}) in ours[0]:
            continue  # captures show the view that it was fine-tuned on
        title = model_title(model.removesuffix(CALIBRATED))
        words = title if model == SHIPPED_MODEL else f"{title}, {SPLIT_NAMES[split]}"
        of_all = ours[0][labelled]
        cells = [f"{100 * of_subset[labelled][score]:.1f}" for of_subset in ours]
        rows.append([words, of_all["pairs"], *cells])
    each = of_all["n"] // of_all["pairs"]
    return table(f"%; ours: {each} simulated films|pairs|all|not reflective|reflective", rows)


def paper_coefficients():
    """Return how often coefficient and fabric are right, beside how little there is to see.

    That is the tail's move that theory gives, and how far the simulated fabrics most alike differ.
    """
    nearest_mm = read("camera/left_out_fabric.json")["nearest_fabric_mm"]
    details = read("paper/details.json")["by_video"]["friction_conditional"]
    predictions = read_parquet(PUBLISHED / "paper" / "predictions.parquet").to_pandas()
    of_split = predictions[predictions["split"] == "by_video"]
    of_friction = of_split["simulation"].str.split("_").str[1]
    right = of_split["true"] == of_split["predicted"]
    values = {one["id"]: one["value"] for one in details["classes"]}
    dragged = [value for value in values.values() if value >= DRAGGED]
    groups = [*((value,) for value in values.values() if value < DRAGGED), dragged]
    rows = []
    for group in groups:
        mine = of_friction.map(values).isin(group)
        share = right[mine].groupby(of_split["network"]).mean()
        ends = sorted({group[0], group[-1]})
        rows.append(
            [" … ".join(f"{value:g}" for value in ends),
             " … ".join(f"{1e3 * tail_moves_m(value):.1f}" for value in ends),
             f"{share['friction_conditional']:.0%}",
             f"{numpy.mean([nearest_mm[f'{value:g}'] for value in group]):.1f}",
             f"{share['material_baseline']:.0%}"]
        )  # fmt: skip
    heads = "tail's move per 0.1 of μ, mm|μ right|nearest fabric, mm|fabric right"
    return f"{table(f'μ|{heads}', rows)}\n\n{larger_images()}"


def larger_images():
    """Return what a network of fabrics gains that is trained on, with larger images too."""
    found = read("camera/larger_images.json")
    told = ", ".join(
        f"{pixels} pixels {one['right']:.1%} ({one['cpu_s'] / 60:.0f})"
        for pixels, one in found["trained_on"].items()
    )
    return (
        f"The fabric network of seed 0 ({found['before']['right']:.1%} right) trained on for "
        f"{sum(found['epochs'].values())} epochs (CPU minutes): {told} "
        "(`studies/larger_images.py`)."
    )


def scored(readings):
    """Return the scores of readings; a simulation counts once for the error of the coverage."""
    error = (readings["reading"] - readings["friction"]).abs()
    holds = readings["friction"].between(readings["low"], readings["high"])
    return {
        "mean_absolute_error": error.mean(),
        "within_0_1": (error <= 0.1).mean(),
        "coverage_90": holds.mean(),
        "coverage_90_error": holds.groupby(readings["simulation"]).mean().sem(),
        "interval_width": (readings["high"] - readings["low"]).mean(),
    }


def scores(part):
    """Return the cells of `INTERVAL_SCORES`."""
    error = part.get("coverage_90_error")
    return [
        f"{part['mean_absolute_error']:.3f}",
        f"{part['within_0_1']:.0%}",
        f"{part['coverage_90']:.0%}" + (f" ± {error:.0%}" if error else ""),
        f"{part['interval_width']:.2f}",
    ]


def instrument_domains():
    """Return the instrument's scores in its own domain and outside."""
    details = read("instrument/details.json")["by_simulation"]["instrument_ensemble"]
    textures = details["by"]["texture"].values()
    inside = dict(details["mean"]) | {
        "within_0_1": sum(part["n"] * part["within_0_1"] for part in textures) / details["n"]
    }
    reach, surrogates = read("camera/reach.json"), read("camera/surrogates.json")["all"]
    drawn, altered = read("camera/drawn_fabrics.json")["all"], reach["unseen_fabric"]
    parts = [
        ("held out: known fabrics, own clamps and cameras", details, inside),
        ("coefficients between those of the grid", reach["off_grid"], reach["off_grid"]),
        ("four fabrics, altered mass and bending", altered, altered),
        (
            "other fabrics, clamps, coefficients and cloths",
            drawn,
            drawn | scored(shipped_intervals()),
        ),
        ("cameras 22.5 to 30° aside", reach["far"], reach["far"]),
        ("surrogate films, one camera each", surrogates, surrogates),
    ]
    rows = [
        [words, counted.get("videos", counted.get("n")), counted["simulations"], *scores(part),
         f"{part.get('alarms', part.get('alarm_rate')):.0%}"]
        for words, counted, part in parts
    ]  # fmt: skip
    return table(f"|videos|simulations|{INTERVAL_SCORES}|alarms", rows)


def instrument_angles():
    """Return the instrument's scores from every side."""
    rows = [
        [f"{angle}°", *scores(part), f"{part['alarms']:.0%}"]
        for angle, part in read("camera/angles.json")["angles"].items()
    ]
    return table(f"camera turned by|{INTERVAL_SCORES}|alarms", rows)


def instrument_fabrics():
    """Return the instrument's scores by fabric and by coefficient."""
    by = read("instrument/details.json")["by_simulation"]["instrument_ensemble"]["by"]
    coefficients = sorted(by["friction"].items(), key=lambda item: float(item[0]))
    parts = [*by["material"].items(), *((f"μ = {value}", part) for value, part in coefficients)]
    rows = [
        [name, part["simulations"], f"{part['mean_absolute_error']:.3f}",
         f"{part['within_0_1']:.0%}", f"{part['coverage_90']:.0%}"]
        for name, part in parts
    ]  # fmt: skip
    return table("|simulations|mean error of μ|within 0.1|90 % intervals that hold", rows)


def clamp_height():
    """Return what clamps at another height do to a measurement."""
    found = read("camera/clamp_height.json")
    part = found["all"]
    measured = f"{part['error_per_mm']:+.1%} ± {part['error_per_mm_sd']:.1%}"
    rows = [[f"{part['simulations']} simulations, μ from 0.5 to 1.25", measured]]
    theory = [f"{error:+.1%}" for error in found["theory_error_per_mm"].values()]
    rows.append(["theory of a heavy flexible strip, the same", f"{theory[0]} to {theory[-1]}"])
    return table("|relative error of μ per millimetre that the clamps hang higher", rows)


def film_height():
    """Return how well rendered films tell the height of the clamps."""
    found = read("camera/film_height.json")
    rows = [
        [words, f"{part['estimates']} of {part['estimates'] + part['would_not_correct']}",
         *(f"{part[key]:.2f}" for key in ("bias_mm", "rms_mm", "largest_mm", "stated_rms_mm"))]
        for words, part in (
            ("camera known exactly", found["camera_known"]),
            ("camera calibrated with a board on the floor", found["camera_calibrated"]),
        )
    ]  # fmt: skip
    return table("|films that correct|bias, mm|root mean square, mm|largest, mm|stated, mm", rows)


def bench_tolerances():
    """Return what each part of a bench, as exact as it may be, adds to the error of μ."""
    per_mm = abs(read("camera/clamp_height.json")["all"]["error_per_mm"])
    angles, reach = read("camera/angles.json")["angles"], read("camera/reach.json")
    aside = max(angles[turn]["mean_absolute_error"] for turn in ("-15", "+15"))
    turned = read("camera/hidden_effect.json")["warp"]["before"]["mean_absolute_error"]
    altered = reach["unseen_fabric"]["mean_absolute_error"]
    by_film_mm = read("camera/film_height.json")["camera_calibrated"]["rms_mm"]
    rows = [
        [words, tolerance, f"{FRICTION * per_mm * away_mm:.3f}"]
        for words, tolerance, away_mm in (
            ("height, not measured", "± 1 mm", 1.0),
            ("height, told by the film", f"± {by_film_mm:.1f} mm", by_film_mm),
            ("height, set with a gauge block", "± 0.2 mm", 0.2),
            ("one clamp higher than the other", "0.5 mm", 0.25),
        )
    ]
    slope, incline = (math.tan(math.radians(degrees)) for degrees in (0.2, 0.3))
    rows += [
        ["substrate slopes", "0.2°", f"{slope:.3f}"],
        ["reference on an inclined plane", "± 0.3°", f"{(1 + FRICTION**2) * incline:.3f}"],
    ]
    rows += [
        [words, tolerance, f"{error:.3f} in all"]
        for words, tolerance, error in (
            ("camera aside", "15°", aside),
            ("fabric, mass and bending altered", "", altered),
            ("friction of warp and weft differs", "25 %", turned),
        )
    ]
    return table("what|tolerance|error of μ", rows)


def drawn_benches():
    """Return the readings of drawn fabrics behind drawn clamps, and by how much these differ.

    Of the fabrics and the clamps of each simulation, the logarithms of ``areal density``,
    ``stretching`` and ``bending`` over those of the catalogue, the millimetres ``higher``, and
    ``askew``, the square of the degrees by which the clamps are turned about the vertical.
    """
    names = ("paper", "instrument", "error_bars")
    config = load_config(*(ROOT / "config" / f"{name}.yaml" for name in names))
    benches = [
        {
            "simulation": one.id,
            "areal density": math.log(bench.density_factor),
            "stretching": math.log(bench.stretching_factor),
            "bending": math.log(bench.bending_factor),
            "higher": 1e3 * bench.height_m,
            "askew": bench.yaw_deg**2,
        }
        for one in simulations(config)
        for bench in [draw_perturbation(config.simulation, one.seed, one.replicate)]
    ]
    return shipped_intervals().merge(pandas.DataFrame(benches))


def shipped_intervals():
    """Return readings of drawn fabrics; the intervals of each simulation calibrated without it."""
    readings = pandas.DataFrame(read("camera/drawn_fabrics.json")["readings"])
    instrument = load_instrument(SHIPPED)
    folder = PUBLISHED / "instrument/models/by_simulation/instrument/ensemble"
    held, drawn = read_parquet(folder / calibration.ANSWERS), calibration.kept_readings(folder)
    scales, groups = map(numpy.array, calibration.pooled_scales(instrument, held, drawn))
    scale = {
        group.split()[-1]: grouped_quantile(scales[others], groups[others], COVERAGE)
        for group in set(calibration.groups_of(drawn))
        for others in [groups != group]
    }
    stretch = readings["simulation"].map(scale) / instrument.card["recalibrated_from"]["factor"]
    for end in ("low", "high"):
        moved = readings["reading"] + stretch * (readings[end] - readings["reading"])
        readings[end] = moved.clip(0, instrument.settings.friction_max)
    return readings


def effects(readings, names):
    """Return a linear fit of columns to the logarithm of readings at the right height.

    That is coefficients, their standard errors, and a prediction of each simulation from the
    others.
    """
    error = numpy.log(readings["reading"] / readings["friction"])
    means = readings.assign(error=error).groupby("simulation")[[*names, "error"]].mean()
    columns = numpy.column_stack([numpy.ones(len(means)), means[names]])
    inverse = numpy.linalg.inv(columns.T @ columns)
    sizes = inverse @ columns.T @ means["error"]
    left = means["error"] - columns @ sizes
    own = numpy.einsum("ij,jk,ik->i", columns, inverse, columns)
    variance = inverse.diagonal() * (left @ left) / (len(means) - columns.shape[1])
    return sizes[1:], numpy.sqrt(variance[1:]), means["error"] - left / (1 - own)


def knowledge_of_the_bench():
    """Return what it is worth to know clamps and fabric, in fabrics that no network was taught."""
    readings = drawn_benches()
    readings = readings[readings["higher"].abs() <= 2]  # further off, nothing is corrected
    protocol_mm = 1e3 * StagePath().lowered_height_m
    random = numpy.random.default_rng(0)

    def corrected(error_mm):
        """Return readings where each film's height is known up to a standard error."""
        told_mm = readings["higher"] + random.normal(0.0, error_mm, len(readings))
        told_m = 1e-3 * (protocol_mm + told_mm.clip(-2, 2))
        heights = [ClampHeight(each, 1e-3 * error_mm, 1e-3 * protocol_mm) for each in told_m]
        return times(
            readings,
            numpy.array([height.factor for height in heights]),
            numpy.array([height.relative_error for height in heights]),
        )

    def times(part, factor, relative_error=0.0):
        """Return readings times a factor, their intervals wider by its error."""
        reading = part["reading"] * factor
        low, high = (
            reading + sign * numpy.hypot(factor * (part[end] - part["reading"]), added)
            for added in [HALF_WIDTH * relative_error * reading]
            for sign, end in ((-1, "low"), (1, "high"))
        )
        return part.assign(reading=reading, low=low, high=high)

    film_mm = read("camera/film_height.json")["camera_calibrated"]["rms_mm"]
    with_height = corrected(0.2)
    fabric = ["areal density", "stretching", "bending"]
    _, _, of_fabric = effects(with_height, fabric)
    sizes, errors, of_all = effects(with_height, [*fabric, "askew"])

    def without(expected):
        """Return readings at the right height without what a fit expects of each simulation."""
        return times(with_height, numpy.exp(-with_height["simulation"].map(expected)))

    rows = [
        [words, *scores(scored(part))]
        for words, part in (
            ("nothing", readings),
            (f"height, by the film (± {film_mm:.1f} mm)", corrected(film_mm)),
            ("height, by a gauge block (± 0.2 mm)", with_height),
            ("and areal density, stretching and bending", without(of_fabric)),
            ("and how far askew the clamps hang", without(of_all)),
        )
    ]
    words = [*(f"10 % more {name}" for name in fabric), "clamps 1° askew"]
    changes = [
        [name, f"{step * size:+.1%} ± {step * error:.1%}"]
        for name, step, size, error in zip(words, (0.1, 0.1, 0.1, 1), sizes, errors, strict=True)
    ]
    known = table(f"known|{INTERVAL_SCORES}", rows)
    return f"{known}\n\n{table('what|changes μ by', changes)}\n\n{left_out_fabric()}"


def left_out_fabric():
    """Return what it is worth to tell the bending length of a fabric that nothing learnt from."""
    found = read("camera/left_out_fabric.json")["noise_mm"]["0.5"]
    known, untold, told = (
        f"{found[case]:.3f}"
        for case in ("fabric known", "fabric left out, nothing", "fabric left out, bending length")
    )
    return (
        "The paper's simulations from μ = 0.3, keypoints with 0.5 mm noise, mean error of μ: of a "
        f"fabric left out {untold} (known: {known}), its bending length told {told} "
        "(`studies/left_out_fabric.py`)."
    )


def processors():
    """Return what another kind of processor changes."""
    found = read("camera/processors.json")
    rows = [
        ["videos, of simulations", f"{found['videos']}, {found['simulations']}"],
        ["videos with the same pixels", f"{found['same_pixels']:.0%}"],
        [
            "difference of the measured μ: mean, largest",
            f"{found['mean_difference']:.4f}, {found['largest_difference']:.3f}",
        ],
    ]
    return table("the same simulations|", rows)


def known_answers():
    """Return the worst difference from theory of each known answer."""
    worst = {}
    for check in read("paper/calibration.json")["checks"]:
        kept = worst.setdefault(check["name"], check | {"number": 0})
        kept["number"] += 1
        kept["error"] = max(kept["error"], check["error"])
    rows = []
    for name, check in worst.items():
        unit = " %" if check["relative"] else " µm" if name.endswith("creep") else " mm"
        scale = {" %": 1e2, " µm": 1e6, " mm": 1e3}[unit]
        demand = "yes or no" if check["demand"] == 0 else f"{scale * check['demand']:g}{unit}"
        error = "none" if check["error"] == 0 else f"{scale * check['error']:.2g}{unit}"
        rows.append([name.replace("-", " "), check["number"], demand, error])
    return table("experiment, compared|cases|allowed|largest error", rows)


def convergence():
    """Return distances from finer stepping and a finer mesh, worst coefficient of each fabric."""
    kinds = {"time_step": "finer stepping", "mesh": "81 × 81 vertices"}
    sizes = {"mean_m": "mean", "steady_largest_m": "steady", "mean_largest_m": "worst"}
    by_fabric = {}
    for case in read("convergence/convergence.json")["summary"]:
        by_fabric.setdefault(case["material"], []).append(case)

    def largest_mm(cases, kind, size):
        found = [1e3 * one[kind][size] for one in cases if one[kind]]
        return f"{max(found):.1f}" if found else ""

    rows = [
        [fabric, *(largest_mm(cases, kind, size) for kind in kinds for size in sizes)]
        for fabric, cases in by_fabric.items()
    ]
    head = "|".join(f"{words}: {size}" for words in kinds.values() for size in sizes.values())
    return table(f"fabric|{head}", rows)


def simulation_cost():
    """Return the CPU seconds of the paper's grid, by fabric, and of other simulators."""
    grid = pandas.read_csv(PUBLISHED / "benchmark/simulations.csv")
    rows = [
        [name, *(f"{value:.0f}" for value in (part.min(), part.median(), part.max()))]
        for name, part in grid.groupby("material")["cpu_s"]
    ]
    cost = grid["cpu_s"]
    rows.append(["all", f"{cost.min():.0f}", f"{cost.median():.0f}", f"{cost.max():.0f}"])
    each = (grid["cpu_s"] / grid["simulated_s"]).median()
    side = read("benchmark/benchmark.json")["side-by-side"]
    ours = side["ours"]["cpu_s_per_s"]
    others = [["ours, median of the grid", "to its tolerance", f"{each:.2f}", ""]]
    others += [
        [
            "ARGUS, steps of 0.5 ms",
            "default",
            f"{low:.0f} to {high:.0f}",
            f"{low / each:.0f} to {high / each:.0f}",
        ]
        for low, high in [tuple(ARGUS_STEPS_PER_S * step for step in ARGUS_STEP_S)]
    ]
    others.append(["ours, one sheet landing", f"{side['ours']['residual']:.0e}", f"{ours:.2f}", ""])
    others += [
        [f"SolverVBD, {row['iterations']} iterations of {1e3 * row['step_s']:.3g} ms",
         f"{row['residual']:.0e}", f"{row['cpu_s_per_s']:.1f}", f"{row['cpu_s_per_s'] / ours:.0f}"]
        for row in side["descent"]
    ]  # fmt: skip
    head = "simulator|largest residual|CPU s per simulated second|times ours"
    return table("fabric|least CPU s|median|most", rows) + "\n\n" + table(head, others)


def measured_cases():
    """Return the verdicts on the measured data that come with Slipstitch."""
    rows = [[name, one["sentence"]] for name, one in read("criticise/measured.json").items()]
    return table("case|verdict", rows)


def simulated_campaigns():
    """Return how often the verdicts on campaigns of known truth are right."""
    return read("criticise/campaigns.json")["table"]


SECTIONS = {
    "The paper's networks": (
        "160 simulations; 3072 training videos of 32 pixels; a quarter of the paper's width (full "
        "width takes a GPU: not trained). ±: {seeds} seeds. "
        "Three views: before fine-tuning; calibrated view: after.",
        paper_table_2,
    ),
    "Unseen textures and turned cameras": (
        "±: {seeds} seeds; in brackets: Wilson's 90 % interval. < 0.1: the right class; ≤ 0.1 "
        "compares with < 0.2. Turned, the instrument sees its own simulations.",
        paper_unseen,
    ),
    "Surrogate captures": (
        "Pairs of fabric and floor whose median is within 0.1 of the reference. The paper: five "
        "real films each.",
        paper_captures,
    ),
    "Where coefficients and fabrics are hard": (
        "![True against predicted fabrics and coefficients](pictures/confusions.svg)\n\n"
        "Videos at random, {seeds} seeds. Up to 0.2 the cloth is pushed and keeps one "
        "shape, in which fabrics differ least: median distance of keypoints to the nearest one.",
        paper_coefficients,
    ),
    "The instrument, domain by domain": (
        "Coverage counts each simulation once. Row four calibrates, too: its intervals leave out "
        "the simulation itself.",
        instrument_domains,
    ),
    "The instrument from every side": ("The same held-out simulations.", instrument_angles),
    "The instrument by fabric and coefficient": (
        "![Mean error against friction, two limits](pictures/error_by_friction.svg)\n\n"
        "Simulations held out.",
        instrument_fabrics,
    ),
    "Height of the clamps": ("`--clamp-height-mm` corrects by the first row.", clamp_height),
    "Height of the clamps, as a film tells it": (
        "Rendered films of 480 pixels, clamps at 148 to 152 mm, other cameras, cloths and floors "
        "(`studies/clamp_height.py`).",
        film_height,
    ),
    "What a tolerance of the bench costs": (
        "At μ = 0.5, besides the instrument's own error; “in all”: with it, over all μ.",
        bench_tolerances,
    ),
    "What it is worth to know the bench": (
        "Other fabrics (± 25 %) and clamps (height ± 1 mm, within 2 mm; ± 1.5° askew), as above. "
        "Fabric and angle: linear fits to the other simulations.",
        knowledge_of_the_bench,
    ),
    "Another processor": ("", processors),
    "The simulator against theory": (
        "With the settings of the grid, before the grid.",
        known_answers,
    ),
    "Convergence": (
        "Distance of the vertices in mm, largest over three coefficients: mean, dragged "
        "steadily, at the worst moment.",
        convergence,
    ),
    "What a simulation costs": ("The whole protocol, 41 × 41 vertices, one core.", simulation_cost),
    "Criticism of measured data": ("None of the cases is of cloth.", measured_cases),
    "Criticism of simulated campaigns": (
        "Campaigns of forward models of their own, of known truth, at seeds that no constant was "
        "chosen on (`benchmarks/criticise.py`). λ says how clearly the planted effect shows (its "
        "noncentrality), separation how clearly it differs from its closest rival. With faults: "
        "zeros, delays, tails, gaps, noise above what is stated. In brackets: Wilson's 95 % "
        "interval.",
        simulated_campaigns,
    ),
}


def results_page():
    """Return the text of docs/results.md."""
    text = "# Results\n\nMeasured numbers, from the files in `results/published`. "
    text += "Written by `make results`; records say how.\n"
    count = seeds()
    for title, (words, make) in SECTIONS.items():
        words = words.replace("{seeds}", count)
        text += f"\n## {title}\n\n" + (f"{words}\n\n" if words else "") + f"{make()}\n"
    return text


def keys_of(schema, definitions, prefix):
    """Yield name, default and description of every key below a section of the schema."""
    for name, key in schema.get("properties", {}).items():
        inner = key.get("$ref") or next(
            (one["$ref"] for one in key.get("anyOf", ()) if "$ref" in one), None
        )
        section = definitions[inner.rpartition("/")[2]] if inner else {}
        if section.get("properties"):
            yield from keys_of(section, definitions, f"{prefix}{name}.")
        else:
            default = json.dumps(key["default"]) if "default" in key else "required"
            default = "…" if len(default) > 40 else default.replace("|", "\\|")
            yield f"{prefix}{name}", default, key.get("description", "").replace("|", "\\|")


def config_page():
    """Return the text of docs/config.md: every key, its default and meaning."""
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    rows = [
        [f"`{name}`", f"`{default}`", words]
        for name, default, words in keys_of(schema, schema["$defs"], "")
    ]
    return (
        "# Configuration\n\nEvery key, from the schema; bounds are in "
        "`workflow/schemas/config.schema.json`. Written by `make results`.\n\n"
        + table("key|default|meaning", rows)
        + "\n"
    )


def criticism_page():
    """Return the text of docs/how/criticism.md, its rules of the verdict as the code has them."""
    before, title, rest = CRITICISM.read_text(encoding="utf-8").partition(
        "## The rules of the verdict\n"
    )
    rows = [[rule.name, f"`{rule.verdict}`", rule.says] for rule in RULES]
    words = "The first rule that applies decides (`criticise/verdict.py`).\n\n"
    following = rest.index("## ")
    return (
        f"{before}{title}\n{words}{table('rule|verdict|applies where', rows)}\n\n{rest[following:]}"
    )


def model_card():
    """Return the text of the card of the instrument that ships."""
    card = read("instrument/models/by_simulation/instrument/ensemble/instrument.json")
    found = read("instrument/details.json")["by_simulation"]["instrument_ensemble"]["mean"]
    frictions = card["frictions"]
    return f"""# The instrument that comes with Slipstitch

`instrument.safetensors`: {card["networks"]} networks of {card["parameters"]} parameters in all, \
trained with different seeds; their predictions are averaged. Input: {card["frames"]} frames of \
{card["pixels"]} × {card["pixels"]} pixels and the pose of the camera. Output: a distribution over \
the friction coefficient μ, a 90 % interval, the most similar fabric, an out-of-distribution alarm.

## Use

`slipstitch measure VIDEO --camera CAMERA.json`, for films of the whole drop-and-drag protocol \
([docs/measure-a-film.md](../../../../../docs/measure-a-film.md)). No real film has been measured \
yet. Not for other protocols, nor where a wrong μ can do harm.

## Training data

- Simulated videos: {card["training_videos"]} trained the networks.
- Fabrics: {", ".join(card["materials"])}.
- μ: {len(frictions)} values from {frictions[0]:g} to {frictions[-1]:g}.
- Intervals: conformal, also calibrated on 50 simulations of other fabrics, clamps and cloths.

## Accuracy

Held out: mean error of μ {found["mean_absolute_error"]:.3f}; {found["coverage_90"]:.0%} of the \
90 % intervals hold; fabric right in {found["material_top1"]:.0%}.

{instrument_domains()}

{instrument_angles()}

{instrument_fabrics()}

## Limits

- Other fabrics behind other clamps: see the table; fewer intervals hold.
- Height of the clamps:

{clamp_height()}

## Origin

Weights: SHA-256 `{card["weights_sha256"]}`. Dataset: `{card["dataset_digest"]}`. The chain of \
records behind them is in `results/published/instrument`, which `slipstitch audit` follows.

## Licence

GPL-3.0-or-later. The fabrics are those of Wang, O'Brien and Ramamoorthi (2011).
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if a page differs")
    check = parser.parse_args().check
    pages = {
        PAGE: results_page(),
        CONFIG_PAGE: config_page(),
        CRITICISM: criticism_page(),
        CARD: model_card(),
    }
    of_instrument = read("instrument/details.json")["by_simulation"]["instrument_ensemble"]
    by_friction = of_instrument["by"]["friction"].items()
    known = {float(value): part["mean_absolute_error"] for value, part in by_friction}
    readings = pandas.DataFrame(read("camera/drawn_fabrics.json")["readings"])
    drawn = pictures(known, readings, read("paper/details.json"))
    pages |= {PICTURES / name: text for name, text in drawn.items()}
    there = {path: path.read_text(encoding="utf-8") if path.exists() else "" for path in pages}
    stale = [path for path, text in pages.items() if there[path] != text]
    for path in stale:
        print(f"{path.relative_to(ROOT)}: not the published numbers" if check else f"wrote {path}")
        if not check:
            path.write_text(pages[path], encoding="utf-8")
    raise SystemExit(bool(stale) and check)


if __name__ == "__main__":
    main()
