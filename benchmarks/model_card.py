"""The card of the instrument that ships, written from what is published of it alone."""

import json
import tomllib

import pandas

from slipstitch.base.provenance import file_digest
from slipstitch.learning.instrument.poses import TITLES, TOLERANCE, shown

SHIPPED = "src/slipstitch/film/measure/shipped"
PLACE = f"{SHIPPED}/MODEL_CARD.md"
FILES = ("instrument.safetensors", "instrument.json", "config.json")
RUN = "results/published/instrument"
MODEL = "models/by_simulation/instrument/ensemble"
TRAINED = "models/by_simulation/instrument/seed0"
RECORD = f"{MODEL}/instrument.safetensors.provenance.json"
# A part of the test is named among the limits beyond this many times the mean error.
BAD = 1.5
INPUTS = {
    "reversed": "played backwards",
    "protocol": "stage at half speed",
    "frozen": "standing still",
    "shuffled": "frames shuffled",
    "empty": "no cloth",
    "object": "another object",
    "upside_down": "upside down",
}


def page(root, whole, calibration, parts, beyond, surrogates):
    """The card, with the tables of all trainings as they are in the docs."""
    run = root / RUN
    read = {
        name: json.loads((run / name).read_text(encoding="utf-8"))
        for name in (
            "config.json",
            "details.json",
            "dataset/digests.json",
            f"{MODEL}/instrument.json",
        )
    }
    card, config = read[f"{MODEL}/instrument.json"], read["config.json"]
    found = read["details.json"]["by_simulation"]["instrument_ensemble"]
    sections = {
        "": _what(card),
        "Use": _use(card),
        "Data": _data(root, card, config, pandas.read_parquet(run / "dataset/manifest.parquet")),
        "Accuracy and coverage": _accuracy(
            card, found, whole, calibration, parts, beyond, surrogates
        ),
        "Limits": _limits(card, config, found, (run / "captures/metrics.json").is_file())
        + _limits_of_bench(root),
        "Licence": _licence(root),
        "Provenance": _provenance(root, card, read["dataset/digests.json"]),
    }
    text = "# The instrument that comes with Slipstitch\n"
    for title, lines in sections.items():
        text += (f"\n## {title}\n" if title else "") + "\n" + "\n".join(lines) + "\n"
    return text


def _what(card):
    return [
        f"`instrument.safetensors`: {card['networks']} networks of {card['parameters']} parameters "
        f"in all, which differ in the seed of their training and whose answers are averaged. They "
        f"estimate the friction coefficient μ of a cloth on a substrate from {card['frames']} "
        f"frames of {card['pixels']} × {card['pixels']} pixels, with a 90 % interval, the fabric "
        "and an alarm. Written from published files by `make shipped-instrument`."
    ]


def _use(card):
    return [
        "Videos of the drop-and-drag protocol, whole, with a camera file: `slipstitch measure "
        "VIDEO --camera CAMERA.json`. Not for other protocols or objects, nor where a wrong μ can "
        "do harm. The card of the weights says: " + card["use"] + "."
    ]


def _data(root, card, config, rows):
    simulations = rows.drop_duplicates("simulation")
    parts = simulations["split_by_simulation"].value_counts()
    simulation = config["simulation"]
    frictions, ideal = card["frictions"], simulation["ideal_replicates"]
    return [
        f"- {len(rows)} simulated videos of {len(simulations)} simulations; {parts['train']} "
        f"trained the networks, {parts['validation']} calibrate the intervals and the "
        f"alarm, {parts['test']} test. The networks saw {card['training_videos']} of the videos.",
        *(
            f"- {one['simulations']} simulations of other benches, fabrics, coefficients and "
            f"cloths stretch the intervals: {one['videos']} videos{_known_as(root, one['digest'])}."
            for one in card.get("calibration_readings", ())
        ),
        f"- Fabrics: {', '.join(card['materials'])}.",
        *(
            f"- For error bars alone: {fabric}."
            for fabric in config["sample"].get("validation_materials", ())
        ),
        *(
            f"- {count} of the training videos show cloths between simulated ones."
            for count in [card.get("interpolated_videos", 0)]
            if count
        ),
        f"- μ: {frictions[0]:g} to {frictions[-1]:g}, {len(frictions)} values.",
        f"- Floors: {', '.join(sorted(rows['floor'].unique()))}; textures: "
        f"{', '.join(sorted(rows['texture'].unique()))}.",
        "- Camera, relative to the calibrated viewpoint:",
        *(
            f"  - {words}: {shown(name, low)} to {shown(name, high)} {unit}"
            for name, (words, unit) in TITLES.items()
            for low, high in [card["pose_range"][name]]
        ),
        f"- Standard deviations of the clamps' yaw {simulation['yaw_sd_deg']:g}°, of their height "
        f"{simulation['height_sd_m']:g} m, of the fabric's parameters "
        f"{simulation['fabric_sd_rel']:g} (relative); simulations of each pair: "
        f"{config['grid']['replicates']}"
        + (
            "."
            if not ideal
            else f", {ideal} of them with straight clamps and the fabric as measured."
        ),
    ]


def _known_as(root, digest):
    """The published file of readings with this digest, in words."""
    found = [
        path.relative_to(root)
        for path in (root / "results/published/camera").glob("*.json")
        if file_digest(path) == digest
    ]
    return "".join(f", read in `{path}`" for path in found)


def _accuracy(card, found, whole, calibration, parts, beyond, surrogates):
    own, alarms = found["mean"], found["alarms"]["ensemble"]
    detected = [f"{words} {alarms[name]:.0%}" for name, words in INPUTS.items() if name in alarms]
    return [
        f"These weights, on {found['simulations']} simulations held out: mean error of μ "
        f"{own['mean_absolute_error']:.3f}, {own['coverage_90']:.0%} of the intervals hold, their "
        f"mean width is {own['interval_width']:.2f}; the fabric is right in "
        f"{own['material_top1']:.0%}. Alarms: {alarms['good']:.1%} of good videos; "
        f"{', '.join(detected)}.",
        "",
        "Beside the trainings of which it is the average, each with error bars of its own:",
        "",
        whole,
        "",
        "How many intervals hold on the simulations that calibrate these weights:",
        "",
        calibration,
        "",
        "These weights part by part, on the simulations held out:",
        "",
        parts,
        "",
        "Where nothing was trained, on fresh simulations, cameras, floors and lamps (fabrics: of "
        "other mass and bending rigidity than any that it was trained on):",
        "",
        beyond,
        "",
        "On surrogate videos, which are simulated as a bench would film: other textures, a finer "
        "mesh, a lens, drifting exposure, compression:",
        "",
        surrogates,
    ]


def _limits(card, config, found, real):
    error = found["mean"]["mean_absolute_error"]
    promised = card["settings"]["coverage"]
    worst = [
        f"{words} {value}"
        for kind, words in (
            ("yaw_deg", "camera turned by"),
            ("material", "fabric"),
            ("friction", "μ ="),
            ("floor", "floor"),
            ("pitch_deg", "camera raised by"),
            ("farther_percent", "camera farther by, in %,"),
        )
        for value, part in found["by"][kind].items()
        if part["mean_absolute_error"] > BAD * error or part["coverage_90"] < promised - 0.05
    ]
    untested = []
    if not config["grid"]["test_materials"]:
        untested.append("a measured fabric that it was not trained on")
    if not any(config["simulation"][name] for name in ("yaw_sd_deg", "height_sd_m")):
        untested.append("clamps that hang askew")
    if not real:
        untested.append("a real bench")
    lines = [
        f"- The intervals promise {promised:.0%} on average over all simulations that calibrate "
        "them, half of which are like those that train and half of other benches: not for each "
        "half, fabric, μ or camera, nor for a bench that differs more.",
        "- `measure` refuses a camera beyond the poses above by more than "
        f"{TOLERANCE['yaw_deg']:g}° about the vertical, {TOLERANCE['pitch_deg']:g}° in elevation, "
        f"{TOLERANCE['roll_deg']:g}° of roll or {TOLERANCE['log_distance']:.0%} of the distance "
        "(`slipstitch capture check`); what `--force` measures has no valid interval.",
    ]
    if worst:
        lines.append(
            f"- Mean error over {BAD:g} times the average, or fewer than "
            f"{promised - 0.05:.0%} of the intervals hold: {', '.join(worst)}."
        )
    if untested:
        lines.append(f"- Not tested: {', '.join(untested)}.")
    return lines


def _limits_of_bench(root):
    """What other fabrics and clamps a little high or low do to it."""
    drawn, clamps = (
        json.loads((root / "results/published/camera" / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("drawn_fabrics", "clamp_height")
    )
    part = drawn["all"]
    return [
        f"- Fabrics that differ by a quarter from those above, coefficients and cloths between and "
        f"beside them: mean error {part['mean_absolute_error']:.3f}.",
        "- Clamps that hang a millimetre higher than they should are read as "
        f"{-clamps['all']['error_per_mm']:.0%} less μ.",
    ]


def _licence(root):
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [f"{project['license']}, as the rest of Slipstitch."]


def _provenance(root, card, dataset):
    run = root / RUN
    record = json.loads((run / RECORD).read_text(encoding="utf-8"))
    shipped = root / SHIPPED
    followed = (run / "dataset/lineage.json").is_file()
    reached = "simulations" if followed else "files of images"
    digests = {
        **{f"`{name}`": shipped / name for name in FILES},
        **{
            f"{words}: `{RUN}/{name}`": run / name
            for words, name in (
                ("averaging and calibration", RECORD),
                ("training", f"{TRAINED}/instrument.safetensors.provenance.json"),
                ("scores", "details.json"),
                ("videos", "dataset/manifest.parquet"),
                ("files of images", "dataset/digests.json"),
                ("renders and simulations", "dataset/lineage.json"),
            )
            if (run / name).is_file()
        },
    }
    trained = json.loads(
        (run / TRAINED / "instrument.safetensors.provenance.json").read_text(encoding="utf-8")
    )
    changed = ", with uncommitted changes" if trained["git_dirty"] else ""
    seeds = ", ".join(map(str, card["seeds"]))
    return [
        "| | SHA-256 |",
        "| --- | --- |",
        *(f"| {words} | `{file_digest(path)}` |" for words, path in digests.items()),
        f"| dataset | `{card['dataset_digest']}` |",
        f"| code of the trainings | `{trained['code_digest']}` |",
        f"| code that averaged and calibrated | `{record['code_digest']}` |",
        "",
        f"Trained with the first code{changed}, seeds {seeds}, on {len(trained['inputs']) - 1} of "
        f"the {len(dataset['files'])} files of images; averaged and calibrated with the second. "
        f"`slipstitch audit {RUN}` follows the weights to the digests of their {reached}.",
    ]
