"""Tables of the documentation: published files, closed forms and the cost model alone."""

import json

import model_card
import numpy as np
import pandas
from scipy.stats import binomtest
from solver_cost_page import page

from slipstitch.config import load_config
from slipstitch.config.train import split_of
from slipstitch.dataset.probes import SIGNIFICANCE, chance_of, is_probed
from slipstitch.design.cost import MEMORY_MIB, job_memory_mb
from slipstitch.design.stage_path import SIDE_M, StagePath
from slipstitch.learning.evaluation import paper as printed
from slipstitch.learning.instrument.calibration_answers import FILE, read_answers
from slipstitch.learning.instrument.calibration_readings import kept_readings
from slipstitch.learning.instrument.conformal import covered, grouped_quantile
from slipstitch.learning.instrument.measuring import load_instrument
from slipstitch.physics.calibration.choice import describe
from slipstitch.physics.theory import flexible_strip_drag

# Head of what `_scores` gives.
SCORES = "mean error of μ|within 0.1|in the 90 % interval|its mean width"


def _read(root, name):
    return json.loads((root / "results" / "published" / name).read_text(encoding="utf-8"))


def _table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _mm(metres):
    return f"{1e3 * metres:.2f} mm" if metres < 9.95e-4 else f"{1e3 * metres:.1f} mm"


def convergence(root):
    """The settings of the simulations against finer stepping and a finer mesh."""
    study = _read(root, "convergence/convergence.json")
    side = study["settings"]["convergence"]["vertices_per_side"][-1]
    rows = []
    for case in study["summary"]:
        for kind, finer in (("time_step", "finer stepping"), ("mesh", f"{side} × {side} vertices")):
            if (found := case[kind]) is None:
                continue
            sizes = ("mean_m", "mean_largest_m", "shifted_largest_m", "steady_largest_m")
            rows.append(
                [
                    f"{case['material']}, {case['friction']:g}",
                    finer,
                    *(_mm(found[size]) for size in sizes),
                    found["verdict"],
                ]
            )
    head = "fabric, μ|compared with|mean|worst moment|the same, shifted in time"
    return _table([*head.split("|"), "steadily dragged", "verdict"], rows)


def sweep(root):
    """The pushed strip with every setting that was tried."""
    strip = _read(root, "paper/calibration.json")["strip"]
    rows = []
    for trial in strip["trials"]:
        failed = sum(run["failure"] is not None for run in trial["runs"])
        remark = "does not meet it"
        if trial["meets"]:
            remark = "meets it" if trial["may_be_chosen"] else "meets it, not to be chosen"
        if trial["settings"] == strip["chosen"]["settings"]:
            remark = "chosen"
        rows.append(
            [
                describe(trial),
                f"{trial['strain_error']:.4f}",
                f"{trial['friction_error']:.4f}",
                f"{trial['wrong_regimes']} of {len(trial['runs'])}"
                + (f" ({failed} not solved)" if failed else ""),
                f"{trial['work'] / 1e6:.2f} · 10⁶",
                remark,
            ]
        )
    head = "setting|largest error of ε|of μ|wrong regimes|iterations × vertices|demand"
    return _table(head.split("|"), rows)


def checks(root):
    """The other known answers with the chosen settings: the worst of each kind."""
    worst = {}
    for check in _read(root, "paper/calibration.json")["checks"]:
        kept = worst.setdefault(check["name"], {**check, "number": 0})
        kept["number"] += 1
        kept["error"] = max(kept["error"], check["error"])
    rows = []
    for name, check in worst.items():
        unit = " %" if check["relative"] else " µm" if name.endswith("creep") else " mm"
        scale = {" %": 1e2, " µm": 1e6, " mm": 1e3}[unit]
        shown = [
            "yes or no" if check["demand"] == 0 else f"{scale * check['demand']:g}{unit}",
            "none" if check["error"] == 0 else f"{scale * check['error']:.2g}{unit}",
        ]
        rows.append([name.replace("-", " "), str(check["number"]), *shown])
    return _table(["experiment, compared", "cases", "demand", "largest error"], rows)


def graph(root):
    """What Snakemake needs to plan the jobs."""
    rows = [
        [
            f"{one['jobs']} jobs ({one['simulations']} simulations)",
            f"{one['cpu_s']:.1f}",
            f"{one['memory_mib']:.0f} MiB",
        ]
        for one in _read(root, "scale/dag.json")["building"]
    ]
    return _table(["job graph (`snakemake -n all`)", "CPU s", "memory"], rows)


def _instrument(root, network="instrument_ensemble"):
    return _read(root, "instrument/details.json")["by_simulation"][network]


def instrument(root):
    """The instrument that ships, and the trainings of which it is the average, held out."""
    rows = []
    for network, words in (
        ("instrument_ensemble", "the average, which ships"),
        ("instrument", "a single training"),
    ):
        found = _instrument(root, network)
        mean, spread = found["mean"], found["spread"] or {}
        parts = found["by"]["texture"].values()
        near = sum(part["n"] * part["within_0_1"] for part in parts)
        error = f"{mean['mean_absolute_error']:.3f}"
        if spread:
            error += f" ± {spread['mean_absolute_error']:.3f}"
        rows.append(
            [
                words,
                f"{found['n']} of {found['simulations']}",
                error,
                f"{near / sum(part['n'] for part in parts):.0%}",
                f"{mean['coverage_90']:.0%}",
                f"{mean['interval_width']:.2f}",
                f"{mean['material_top1']:.0%}",
                f"{mean['alarm_rate']:.0%}",
            ]
        )
    head = f"|videos of simulations|{SCORES}"
    return _table([*head.split("|"), "fabric right", "alarms"], rows)


def instrument_parts(root):
    """The average part by part."""
    kinds = {
        "yaw_deg": "camera turned by, to the nearest 5°",
        "material": "fabric",
        "friction": "μ",
        "floor": "floor",
        "texture": "texture",
        "pitch_deg": "camera raised by, to the nearest 4°",
        "farther_percent": "camera farther by, to the nearest 10 %",
    }
    parts = _instrument(root)["by"]
    rows = []
    for kind, words in kinds.items():
        of_kind = parts[kind].items()
        if kind not in ("material", "floor", "texture"):
            of_kind = sorted(of_kind, key=lambda item: float(item[0]))
        for value, part in of_kind:
            rows.append(
                [
                    f"{words}: {value}",
                    str(part["simulations"]),
                    f"{part['mean_absolute_error']:.3f}",
                    f"{part['within_0_1']:.0%}",
                    f"{part['coverage_90']:.0%}",
                ]
            )
    head = "part|simulations|mean error of μ|within 0.1|in the 90 % interval"
    return _table(head.split("|"), rows)


def calibration(root):
    """What calibrates the intervals of the instrument that ships, and how many of each part hold.

    With the factor that its own videos alone would give, and with the one that all give.
    """
    folder = root / "results/published/instrument/models/by_simulation/instrument/ensemble"
    shipped = load_instrument(folder)
    coverage = shipped.settings.coverage
    held, elsewhere = read_answers(folder / FILE), kept_readings(folder)
    own = shipped.needed_stretch(shipped.spread_out(held.probabilities), held.friction)
    fabrics = _read(root, "instrument/config.json")["sample"]["validation_materials"]
    unseen = np.array([row["material"] in fabrics for row in held.rows])
    groups = np.array(held.groups)
    parts = {
        "pairs held out": (own[~unseen], groups[~unseen]),
        "an unseen fabric": (own[unseen], groups[unseen]),
        "other benches, fabrics, coefficients and cloths": (
            np.array([row["stretch"] for row in elsewhere.rows]),
            np.array(elsewhere.groups),
        ),
    }
    rows = []
    for words, (needed, of) in parts.items():
        cells = []
        for factor in (grouped_quantile(own, held.groups, coverage), shipped.factor):
            # An interval holds that is stretched by as much as it needs, or more.
            nothing = np.zeros(len(needed))
            share, error = covered(nothing, nothing + factor, needed, of)
            cells.append(f"{share:.0%} ± {error:.0%}")
        rows.append([words, f"{len(needed)} of {len(set(of))}", *cells])
    head = "|videos of simulations|hold, calibrated on the first two rows alone|hold, on all"
    return _table(head.split("|"), rows)


def _scores(part):
    """Cells of what benchmarks/instrument_reach.py finds: error, within 0.1, coverage, width."""
    error = part["coverage_90_error"]  # 0 where all or none are held, which would mislead
    return [
        f"{part['mean_absolute_error']:.3f}",
        f"{part['within_0_1']:.0%}",
        f"{part['coverage_90']:.0%}" + (f" ± {error:.0%}" if error else ""),
        f"{part['interval_width']:.2f}",
    ]


def interpolation(root):
    """Interpolated cloths against the simulated one between their parents."""
    found = _read(root, "camera/interpolation.json")
    rows = []
    for name, words in (("theory", "the tail of a dragged strip"), ("linear", "friction")):
        part = found[name]
        rows.append(
            [
                words,
                str(found["simulations"]),
                f"{part['median_mm']:.2f} mm",
                f"{part['worst_frame_mm']:.1f} mm",
                f"{part['in_friction']:.3f}",
                f"{part['in_friction_90']:.3f}",
            ]
        )
    head = "weights linear in|simulations|distance of the vertices, median frame|worst frame"
    head += "|the median distance as a difference of μ|90 % of the simulations below"
    return _table(head.split("|"), rows)


def places(root):
    """What the places of nine points tell of friction, by their error."""
    found = _read(root, "camera/places.json")
    rows = [
        [
            f"{row['noise_mm']:g} mm"
            + ("" if row["interpolated"] else ", nothing between simulations")
            + (", taught by ideal benches alone" if row["replicates"] == 1 else ""),
            f"{row['held_out_ideal']:.3f}",
            f"{row['held_out_own']:.3f}",
            f"{row['held_out_worst']:.3f}",
            f"{row['unseen_fabric']:.3f}",
        ]
        for row in found["rows"]
    ]
    head = "errors of the places|mean error of μ, pairs held out, on the paper's bench"
    head += "|on a bench of their own|worst simulation|unseen fabric, on both"
    return _table(head.split("|"), rows)


def reach(root):
    """The instrument that ships where nothing was trained."""
    found = _read(root, "camera/reach.json")
    names = {
        "off_grid": "coefficients between those of the grid",
        "unseen_fabric": "unseen fabrics",
        "far": "cameras 22.5 to 30° aside",
    }
    parts = [(words, found[name], found) for name, words in names.items()]
    parts += [
        (f"the first two rows, cloths in {name}", part, found)
        for name, part in found["textures"].items()
    ]
    single = found["trainings"]
    parts += [
        (f"{words}, by single trainings", single[name], single)
        for name, words in names.items()
        if name in single
    ]
    rows = []
    for words, part, whole in parts:
        rows.append(
            [
                words,
                f"{part['videos'] // whole['instruments']} of {part['simulations']}",
                *_scores(part),
                f"{part['alarms']:.0%}",
            ]
        )
    head = f"|videos of simulations|{SCORES}"
    return _table([*head.split("|"), "alarms"], rows)


def angles(root):
    """The instrument that ships on the same held-out simulations from every side."""
    found = _read(root, "camera/angles.json")
    rows = [
        [
            f"{angle}°",
            f"{part['videos']} of {part['simulations']}",
            *_scores(part),
            f"{part['alarms']:.0%}",
            f"{found['trainings'][angle]['within_0_1']:.0%}",
        ]
        for angle, part in found["angles"].items()
    ]
    head = f"camera turned by|videos of simulations|{SCORES}|alarms|within 0.1, single trainings"
    return _table(head.split("|"), rows)


def clamp_height(root):
    """What clamps at another height do to the reading of the instrument that ships."""
    found = _read(root, "camera/clamp_height.json")
    names = {
        "all": "to either side",
        "first": "to the side to which only cloths of ideal benches sag in training",
        "second": "to the other",
    }
    rows = []
    for side, words in names.items():
        part = found[side]
        rows.append(
            [
                words,
                str(part["simulations"]),
                f"{part['height_sd_mm']:.1f} mm",
                f"{part['error_per_mm']:+.1%} ± {part['error_per_mm_sd']:.1%}",
                f"{part['rms_error']:.1%}",
                f"{part['mean_absolute_error']:.3f}",
            ]
        )
    head = "the cloth sags|simulations|height of the clamps, standard deviation"
    head += "|error of μ a millimetre higher|error of μ, r.m.s. over simulations|mean error of μ"
    return _table(head.split("|"), rows)


def drawn_fabrics(root):
    """The instrument that ships on fabrics, coefficients and cloths beside those that train.

    Their intervals are in another table (`calibration`), as these simulations stretch them.
    """
    found = _read(root, "camera/drawn_fabrics.json")
    rows = []
    for name, part in found.items():
        if not isinstance(part, dict):
            continue
        rows.append(
            [
                name if name == "all" else f"μ = {name}",
                f"{part['videos']} of {part['simulations']}",
                f"{part['mean_absolute_error']:.3f}",
                f"{part['within_0_1']:.0%}",
                f"{part['rms_common']:.3f}",
                f"{part['rms_other']:.3f}",
                f"{part['alarms']:.0%}",
            ]
        )
    head = "|videos of simulations|mean error of μ|within 0.1"
    head += "|error common to a simulation's videos, r.m.s.|differing between them, r.m.s.|alarms"
    return _table(head.split("|"), rows)


def surrogates(root):
    """The instrument that ships on surrogate videos, each from a camera of its own."""
    found = _read(root, "camera/surrogates.json")
    names = {
        "all": "all",
        "matte": "on floors that hardly reflect",
        "reflective": "on metals and mirrors",
        "trainings": "all, by single trainings",
    }
    rows = []
    for name, words in names.items():
        part = found[name]
        rows.append(
            [
                words,
                str(part["simulations"]),
                *_scores(part),
                f"{part['fabric_right']:.0%}",
                f"{part['alarms']:.0%}",
            ]
        )
    head = f"surrogate videos|number|{SCORES}"
    return _table([*head.split("|"), "fabric right", "alarms"], rows)


def sides(root):
    """Up to which coefficient a cloth stays on the side to which it sagged."""
    rows = [
        [
            f"{row['friction']:g}",
            f"{row['on_other_sides']} of {row['fabrics']}",
            f"{row['median_mm']:.1f} mm",
        ]
        for row in _read(root, "camera/sides.json")["rows"]
    ]
    return _table(["μ", "fabrics on the other side", "lower edges apart, median"], rows)


def paper_sides(root):
    """The paper's networks on the paper's bench, and on benches of their own."""
    of = {
        (row["friction"], row["bench"], row["split"]): row
        for row in _read(root, "camera/paper_sides.json")["rows"]
    }
    rows = [
        [
            f"{friction:g}",
            *(
                f"{of[friction, bench, split]['right']:.0%}"
                for bench in ("paper", "own")
                for split in ("by_video", "by_simulation")
            ),
            *(
                f"{of[friction, 'own', split]['mean_absolute_error']:.3f}"
                for split in ("by_video", "by_simulation")
            ),
        ]
        for friction in dict.fromkeys(key[0] for key in of)
    ]
    head = "μ|right, paper's bench: trained by video|by simulation|right, the other bench: by video"
    head += "|by simulation|mean error of μ there: by video|by simulation"
    return _table(head.split("|"), rows)


def surrogate_places(root):
    """What misleads an instrument in surrogates: taught by one side of the cloth, and by both."""
    rows = []
    for name, words in (
        ("surrogate_places_one_side", "taught by the paper's bench alone"),
        ("surrogate_places", "taught by either side, the instrument that shipped before"),
    ):
        found = _read(root, f"camera/{name}.json")
        errors = found["errors"]
        rows.append(
            [
                words,
                str(len({row["simulation"] for row in found["readings"]})),
                *(
                    f"{errors[of]:.3f}"
                    for of in ("reading", "from_its_places", "from_ideal_places")
                ),
            ]
        )
    head = "mean error of μ|surrogates|from the video|from the places in its simulation"
    head += "|from those with the paper's clamps, curl and fabric"
    return _table(head.split("|"), rows)


def found_places(root):
    """What the published instruments err in places and in friction, from videos and simulations."""
    names = {
        "train": "that train",
        "test": "held out",
        "unseen_fabric": "of a fabric that never trains",
    }
    found = _read(root, "camera/found_places.json")["parts"]
    rows = [
        [
            f"{words}: {part['videos']} of {part['simulations']}",
            f"{part['lower_edge_off_mm']:.1f} mm",
            f"{part['reading']:.3f}",
            f"{part['from_true_places']:.3f}",
        ]
        for name, words in names.items()
        for part in [found[name]]
    ]
    head = "videos of simulations|lower edge off along the track|mean error of μ, from the video"
    return _table([*head.split("|"), "from the places in its simulation"], rows)


def edge_bands(root):
    """Mean errors of the shipped instrument in ginghams that differ by one thing each."""
    names = {
        "gingham": "white and green gingham, the lower edge in a white band",
        "shifted_half_a_band": "shifted by half a band, the lower edge in half a green one",
        "colours_exchanged": "white and green exchanged, the lower edge in a green band",
        "turned_45": "turned by 45°",
        "half_as_large": "half as large, the lower edge in a white band",
        "plain_white": "plain white",
        "plain_grey": "plain grey",
        "plain_black": "plain black",
    }
    textures = _read(root, "camera/edge_bands.json")["textures"]
    frictions = sorted(textures["gingham"], key=float)
    rows = [
        [words, *(f"{textures[name][friction]['mean_error']:+.3f}" for friction in frictions)]
        for name, words in names.items()
    ]
    return _table(["mean error of μ at", *(f"{float(one):g}" for one in frictions)], rows)


def hidden_effect(root):
    """A camera's readings under the surrogate case's effect, before and after it is found."""
    found = _read(root, "camera/hidden_effect.json")
    rows = []
    for direction in ("warp", "weft"):
        for when, words in (("before", "as read"), ("after", "with the law found")):
            part = found[direction][when]
            rows.append(
                [
                    direction,
                    words,
                    f"{part['videos'] // found['instruments']} of {part['simulations']}",
                    f"{part['mean_error']:+.3f} ± {part['standard_deviation']:.3f}",
                    f"{part['mean_absolute_error']:.3f}",
                ]
            )
    head = "dragged along|reading|videos of simulations|mean error of μ, simulations' deviation"
    return _table([*head.split("|"), "mean size of the error"], rows)


# Of the paper's tables: what each network is asked, and the metric's words.
COUNTED = {
    "material_baseline": "fabric",
    "friction_baseline": "μ, fabric not told",
    "friction_conditional": "μ, fabric estimated first",
}
METRICS = {
    "material_top1": "right",
    "material_top2": "among the first two",
    "friction_lt_0.1": "class right (< 0.1)",
    "friction_lt_0.2": "or its neighbour (< 0.2)",
}
PROBE = "probe_middle_frame"


def _of_view(details, test, network, viewpoint):
    found = details.get(test, {}).get(network) or {}
    return found if viewpoint is None else found.get("viewpoints", {}).get(viewpoint) or {}


def _cell(details, test, network, metric, viewpoint=None):
    found = _of_view(details, test, network, viewpoint)
    if metric not in found.get("mean", {}):
        return "–"
    text = f"{100 * found['mean'][metric]:.1f}"
    return text + (f" ± {100 * found['spread'][metric]:.1f}" if found["spread"] else "")


def wilson(share, number):
    """Wilson's (1927) 90 % interval of a share of so many independent videos, in %, as text."""
    found = binomtest(round(share * number), number).proportion_ci(0.9, "wilson")
    return f"({100 * found.low:.0f} ... {100 * found.high:.0f})"


def paper(root):
    """The paper's Table 2 and ours, beside what one frame tells a linear probe."""
    details = _read(root, "paper/details.json")
    tests = ("by_video", "by_simulation")
    rows = []
    for (network, metric), share in printed.TABLE_2.items():
        cells = [f"{100 * share:.1f}"]
        for test in tests:
            cells += [_cell(details, test, network, metric, view) for view in (None, "calibrated")]
            asked = network == "friction_baseline"
            cells.append(_cell(details, test, PROBE, metric) if asked else "")
        rows.append([f"{COUNTED[network]}: {METRICS[metric]}", *cells])
    ours = ("all three views", "the calibrated one", "from one frame")
    head = [f"{test}: {words}" for test in ("by video", "simulations held out") for words in ours]
    return _table(["%", "the paper", *head], rows)


def paper_unseen(root):
    """The paper's Sec. 6.2.1 and Table 3, and ours, with intervals where videos are independent."""
    details = _read(root, "paper/details.json")
    network, metrics = "friction_conditional", ("friction_lt_0.1", "friction_lt_0.2")
    texture = [printed.UNSEEN_TEXTURE[network, metric] for metric in metrics]
    of_texture = printed.UNSEEN_TEXTURE_VIDEOS
    tests = [
        ("unseen texture, calibrated view", "unseen_texture", "calibrated", of_texture, texture),
        ("unseen texture, all three views", "unseen_texture", None, None, (None, None)),
    ]
    for turn, shares in printed.TABLE_3.items():
        words = f"camera turned by {turn:+d}°"
        tests.append((words, f"view_{turn:+d}", None, printed.TABLE_3_VIDEOS, shares))
    rows = []
    for words, test, view, of_paper, shares in tests:
        theirs = ["–", "–", "–"]
        if of_paper is not None:
            theirs = [str(of_paper), *(f"{100 * share:.1f}" for share in shares)]
        ours = []
        for each in (network, "friction_baseline"):
            found = _of_view(details, test, each, view)
            for metric in metrics:
                cell = _cell(details, test, each, metric, view)
                # Three views of one motion are right or wrong together.
                if found and of_paper is not None:
                    cell += " " + wilson(found["mean"][metric], found["n"])
                ours.append(cell)
        number = str(_of_view(details, test, network, view).get("n", "–"))
        rows.append([words, *theirs, number, *ours])
    head = "%|the paper's videos|< 0.1|< 0.2|our videos|< 0.1|< 0.2|fabric not told, < 0.1|< 0.2"
    return _table(head.split("|"), rows)


def paper_probes(root):
    """From which share on a probe would have had the paper's dataset refused, and what they had."""
    details = _read(root, "paper/details.json")
    folder = root / "results" / "published" / "paper" / "dataset"
    every = pandas.read_parquet(folder / "manifest.parquet").to_dict("records")
    titles = {
        "by_video": "by video",
        "by_simulation": "simulations held out",
        "by_video_reflective": "by video, reflective floors",
    }
    kinds = {
        "first frame, background, file size": ("first_frame", "background", "file_size"),
        "order": ("order",),
    }
    rows = []
    for split, words in titles.items():
        videos = [row for row in every if is_probed(row, split)]
        labels = np.unique([row["friction_id"] for row in videos], return_inverse=True)[1]
        names = np.array([row["simulation"] for row in videos])
        sides = np.array([row[f"split_{split_of(split)}"] for row in videos])
        by_order = np.flatnonzero(sides == "train")[1::2]
        for kind, probes in kinds.items():
            test = by_order if kind == "order" else sides == "test"
            tested = np.unique(names[test])
            least = next(
                count
                for count in range(len(tested) + 1)
                if chance_of(np.isin(names[test], tested[:count]), labels[test], names[test])
                < SIGNIFICANCE
            )
            found = [
                details[split][f"probe_{probe}{learner}"]["mean"]["friction_lt_0.1"]
                for probe in probes
                for learner in ("", "_network")
                if split in details
            ]
            _, first = np.unique(names[test], return_index=True)
            guess = np.bincount(labels[test][first]).max() / len(tested)
            rows.append(
                [
                    words,
                    kind,
                    f"{len(labels[test])} of {len(tested)}",
                    f"{guess:.1%}",
                    f"{least} of {len(tested)} ({least / len(tested):.0%})",
                    f"{min(found):.1%} to {max(found):.1%}" if found else "not yet",
                ]
            )
    head = "split|probe|videos of simulations|guessing|refused from, simulations right"
    head += "|found, videos right"
    return _table(head.split("|"), rows)


def _confusion(details, test, network):
    found = details[test][network]
    return found["classes"], found["confusion"]


def paper_fabrics(root):
    """The pairs of fabrics that the paper's material network confuses most, in both splits."""
    details = _read(root, "paper/details.json")
    rows = []
    for test, words in (("by_video", "by video"), ("by_simulation", "simulations held out")):
        classes, counts = _confusion(details, test, "material_baseline")
        names = [of_class["name"] for of_class in classes]
        pairs = [(counts[i][j] + counts[j][i], i, j) for i in range(len(names)) for j in range(i)]
        wrong = sum(together for together, _, _ in pairs)
        for together, i, j in sorted(pairs, reverse=True)[:3]:
            rows.append(
                [
                    words,
                    f"{names[j]}, {names[i]}",
                    f"{together} of {wrong}",
                    *(
                        f"{counts[a][b]} of {sum(counts[a])}" if sum(counts[a]) else "not tested"
                        for a, b in ((j, i), (i, j))
                    ),
                ]
            )
    head = "split|two fabrics|taken for one another, of all wrong|first for second|second for first"
    return _table(head.split("|"), rows)


def paper_coefficients(root):
    """How often each coefficient is read right, and how far theory moves the tail to the next."""
    details = _read(root, "paper/details.json")
    height_m = StagePath().start_height_m - StagePath().drop_m
    columns = [
        _confusion(details, test, network)
        for test in ("by_video", "by_simulation")
        for network in ("friction_conditional", "friction_baseline")
    ]
    rows = []
    for k, of_class in enumerate(columns[0][0]):
        tail_m, next_m = (
            flexible_strip_drag(friction, SIDE_M, height_m).holder_ahead_of_tail_m
            for friction in (of_class["value"], of_class["value"] + 0.1)
        )
        rows.append(
            [
                f"{of_class['value']:g}",
                f"{1e3 * (next_m - tail_m):.1f} mm",
                *(f"{counts[k][k]} of {sum(counts[k])}" for _, counts in columns),
            ]
        )
    classes = columns[0][0]
    for half in (range(len(classes) // 2), range(len(classes) // 2, len(classes))):
        sums = [
            f"{sum(counts[k][k] for k in half)} of {sum(sum(counts[k]) for k in half)}"
            for _, counts in columns
        ]
        ends = [f"{classes[k]['value']:g}" for k in (half[0], half[-1])]
        rows.append([" to ".join(ends), "", *sums])
    head = "μ|the tail, to the next 0.1|by video: right, fabric estimated first|fabric not told"
    head += "|simulations held out: right, fabric estimated first|fabric not told"
    return _table(head.split("|"), rows)


def memory(root):
    """What jobs took and what is declared for them, at two scales."""
    demo = load_config(root / "config.yaml")
    paper_grid = load_config(root / "config.yaml", root / "config" / "paper.yaml")
    rows = [
        [
            kind,
            f"{cost.value:.0f}",
            str(job_memory_mb(kind, demo)),
            str(job_memory_mb(kind, paper_grid)),
            cost.source,
        ]
        for kind, cost in MEMORY_MIB.items()
    ]
    head = "job|measured, MiB|declared, MB: demo|the paper's scale|measured with"
    return _table(head.split("|"), rows)


TABLES = {
    "paper": paper,
    "paper_unseen": paper_unseen,
    "paper_probes": paper_probes,
    "paper_fabrics": paper_fabrics,
    "paper_coefficients": paper_coefficients,
    "convergence": convergence,
    "sweep": sweep,
    "checks": checks,
    "graph": graph,
    "instrument": instrument,
    "instrument_parts": instrument_parts,
    "calibration": calibration,
    "interpolation": interpolation,
    "places": places,
    "reach": reach,
    "angles": angles,
    "clamp_height": clamp_height,
    "drawn_fabrics": drawn_fabrics,
    "surrogates": surrogates,
    "sides": sides,
    "paper_sides": paper_sides,
    "surrogate_places": surrogate_places,
    "found_places": found_places,
    "edge_bands": edge_bands,
    "hidden_effect": hidden_effect,
    "memory": memory,
}
PAGES = {
    "docs/benchmarks.md": lambda root: page(
        _read(root, "benchmark/benchmark.json"),
        pandas.read_csv(root / "results/published/benchmark/simulations.csv"),
    ),
    model_card.PLACE: lambda root: model_card.page(
        root,
        instrument(root),
        calibration(root),
        instrument_parts(root),
        reach(root),
        surrogates(root),
    ),
}
