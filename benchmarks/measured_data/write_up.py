"""The write-up of the measured data sets, as Markdown with pictures."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
import paper_on_paper
import pushes as push_data
from matplotlib.figure import Figure
from paper_case import write_paper_case

from slipstitch import __version__
from slipstitch.criticise.case import read_case
from slipstitch.criticise.covariates import COVARIATES
from slipstitch.criticise.inference.analysis import Analysis, analyse
from slipstitch.criticise.measurements import assemble
from slipstitch.criticise.report.verdict_pictures import EXTENDED_COLOUR, FAINT, INK, NULL_COLOUR
from slipstitch.criticise.verdict import sentence, verdict_of

SEED = 1
# What each step of the ladder repairs.
FAILS = {
    1: "one coefficient for all runs",
    2: "static friction equal to kinetic friction",
    3: "a slider without inertia",
    4: "a friction that is constant along the track",
}


def write_up(data: Path, out: Path) -> dict:
    """Criticise both data sets and write the page.

    Returns
    -------
    dict
        All numbers that the page shows; ``verdicts`` holds one word a question.
    """
    out.mkdir(parents=True, exist_ok=True)
    pictures = out / "pictures"
    pictures.mkdir(exist_ok=True)
    runs = paper_on_paper.read_runs(data / "paper_on_paper_stick_slip")
    answers = [
        paper_on_paper.drops_against_speed(runs),
        paper_on_paper.ageing(runs, np.random.default_rng(SEED)),
        paper_on_paper.same_track(runs),
        paper_on_paper.level_against_speed(runs),
    ]
    ladder = paper_on_paper.held_out(runs)
    table = push_data.read_pushes(data / "planar_push_force")
    boards = {
        surface: analyse(push_data.measurements(table[table["surface"] == surface]), seed=SEED)
        for surface in ("wood", "other")
    }
    cells = push_data.by_surface_and_support(table)
    with matplotlib.rc_context({"svg.hashsalt": "slipstitch", "font.size": 10}):
        _trace_picture(runs, pictures / "paper_traces.svg")
        _drop_picture(answers[0], pictures / "paper_drops.svg")
        _ladder_picture(ladder, pictures / "paper_gain.svg")
        _board_picture(boards, pictures / "board_place.svg")
    as_case = paper_verdict(data / "paper_on_paper_stick_slip")
    text = _page(answers, ladder, boards, cells, table, as_case)
    (out / "criticism_measured.md").write_text(text, encoding="utf-8")
    return {
        "verdicts": {
            **{a.question: a.verdict for a in answers},
            "paper as a case": as_case["verdict"],
            **{f"board '{s}'": a.verdict for s, a in boards.items()},
        },
        "answers": [a.numbers for a in answers],
        "ladder": ladder,
    }


def paper_verdict(data: Path) -> dict:
    """What ``slipstitch criticise`` says of the paper traces as a spring-slider case."""
    with TemporaryDirectory() as folder:
        write_paper_case(data, Path(folder))
        case = read_case(folder)
    return verdict_of(case, analyse(assemble(case), seed=SEED), SEED, __version__)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, bbox_inches="tight", metadata={"Date": None})


def _bare(axes):
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _trace_picture(runs, path):
    figure = Figure(figsize=(7.2, 5.2))
    axes = figure.subplots(3, 3, sharex=True, sharey=True)
    order = sorted(runs, key=lambda r: (r.slider.spring_N_m, r.slider.speed_m_s))
    for cell, r in zip(axes.flat, order, strict=False):
        step = max(len(r.trace) // 4000, 1)
        cell.plot(1e3 * r.trace_place_m[::step], r.trace[::step], color=EXTENDED_COLOUR, lw=0.5)
        cell.set_title(
            f"{r.slider.spring_N_m:g} N/m, {1e3 * r.slider.speed_m_s:g} mm/s", fontsize=9
        )
        _bare(cell)
    axes[1, 0].set_ylabel("spring force / weight", color=INK)
    axes[2, 1].set_xlabel("place of the slider (mm)", color=INK)
    figure.tight_layout()
    _save(figure, path)


def _drop_picture(answer, path):
    figure = Figure(figsize=(5.6, 3.6))
    axes = figure.add_subplot()
    rows = answer.numbers["rows"]
    for k, colour in zip(
        sorted({row[1] for row in rows}), (NULL_COLOUR, EXTENDED_COLOUR, "#7a8f3c"), strict=True
    ):
        mine = sorted((row for row in rows if row[1] == k), key=lambda row: row[2])
        speed = [row[2] for row in mine]
        axes.plot(speed, [row[3] for row in mine], "o", color=colour, label=f"{k:g} N/m")
        axes.plot(speed, [row[4] for row in mine], "-", color=colour, lw=1)
        axes.axhline(mine[0][3], color=colour, lw=0.6, ls=":")
    axes.set_xscale("log")
    axes.set_xlabel("drive speed (mm/s)", color=INK)
    axes.set_ylabel("median drop / weight", color=INK)
    axes.legend(frameon=False, title="measured (points), with inertia (lines)", title_fontsize=9)
    _bare(axes)
    _save(figure, path)


def _ladder_picture(ladder, path):
    figure = Figure(figsize=(6.4, 2.6))
    axes = figure.add_subplot()
    place = np.arange(len(ladder))[::-1]
    axes.barh(place, [100 * m["rmse"] for m in ladder], color=FAINT, height=0.6)
    axes.set_yticks(place, [m["model"] for m in ladder])
    axes.set_xlabel("error on held-out millimetres (% of the weight)", color=INK)
    _bare(axes)
    _save(figure, path)


def _board_picture(boards: dict[str, Analysis], path):
    figure = Figure(figsize=(7.2, 3.2))
    for cell, (surface, a) in zip(figure.subplots(1, 2, sharey=True), boards.items(), strict=True):
        rows = a.measurements.rows
        for support, colour in (("whole face", EXTENDED_COLOUR), ("three points", NULL_COLOUR)):
            mine = (rows["operator"] == support).to_numpy()
            cell.plot(
                rows["pos_x_mm"][mine],
                1e-3 * rows["y"][mine],
                "o",
                ms=4,
                color=colour,
                alpha=0.7,
                label=support,
            )
        cell.set_title(f"board '{surface}'", fontsize=10)
        cell.set_xlabel("place on the board (mm)", color=INK)
        _bare(cell)
        if surface == "wood":
            cell.set_ylabel("push force / weight", color=INK)
            cell.legend(frameon=False)
    _save(figure, path)


def _strongest(a: Analysis, most: int = 3) -> list[str]:
    outcome = a.null_outcome
    best: dict[str, int] = {}
    for i, test in enumerate(outcome.tests):
        if not np.isfinite(outcome.log_p[i]):
            continue
        key = test.mechanism or test.covariate
        if key not in best or outcome.log_p[i] > outcome.log_p[best[key]]:
            best[key] = i
    order = sorted(best.values(), key=lambda i: outcome.adjusted[i])[:most]
    names = {"operator": "support (whole face or three points)"}
    lines = []
    for i in order:
        test = outcome.tests[i]
        what = test.mechanism or names.get(test.covariate) or COVARIATES[test.covariate].title
        shape = test.shape or "the mechanism's own shape"
        lines.append(f"| {what} | {shape} | {outcome.adjusted[i]:.2g} |")
    return lines


def _board_words(surface: str, a: Analysis) -> str:
    if a.verdict == "none":
        return (
            f"On the board '{surface}' plain Coulomb friction with scatter between logs and pushes "
            f"holds (family-wise p = {a.global_p:.2g})."
        )
    if a.verdict == "unknown":
        return (
            f"On the board '{surface}' plain Coulomb friction fails (family-wise p = "
            f"{a.global_p:.2g}), and no mechanism of the library takes it up."
        )
    named = " or ".join(" + ".join(c) for c in (a.alternatives or [a.causes]))
    return f"On the board '{surface}' the verdict is {a.verdict}: {named} (p = {a.global_p:.2g})."


def _interval(middle: float, low: float, high: float) -> str:
    return f"{middle:+.2f} [{low:+.2f}, {high:+.2f}]"


def _case_words(verdict: dict) -> str:
    gain, excess = verdict["gain"], verdict["parameters"].get("static_kinetic")
    low, high = gain["ci95"]
    words = f"{sentence(verdict)} Gain on left-out runs: {gain['estimate']:.2f} [{low:.2f}, "
    words += f"{high:.2f}] in log score a reading, {gain['n_groups']} runs."
    if excess:
        low, high = excess["ci95"]
        words += f" Static excess {excess['estimate']:.3f} [{low:.3f}, {high:.3f}]."
    return words


def _page(answers, ladder, boards, cells, table, as_case) -> str:
    steps = "\n".join(
        f"| {m['model']} | {m['log_score']:.2f} | "
        + (
            ""
            if i == 0
            else f"{m['step']:+.2f} [{m['step_ci95'][0]:+.2f}, {m['step_ci95'][1]:+.2f}]"
        )
        + f" | {100 * m['rmse']:.1f} |"
        for i, m in enumerate(ladder)
    )
    questions = "\n\n".join(f"**{a.question}** *{a.verdict}.* {a.words}" for a in answers)
    drops = "\n".join(
        f"| {row[1]:g} | {row[2]:g} | {row[3]:.3f} | {row[4]:.3f} |"
        for row in answers[0].numbers["rows"]
    )
    order = sorted(range(1, len(ladder)), key=lambda i: -ladder[i]["step"])
    failing = "; ".join(FAILS[i] for i in order if ladder[i]["step_ci95"][0] > 0)
    cell_lines = "\n".join(
        f"| {c.surface} | {c.support} | {c['mean']:.3f} | {c['std']:.3f} | {c['count']} |"
        for _, c in cells.iterrows()
    )
    kept = int(cells["count"].sum())
    wood, other = boards["wood"], boards["other"]
    return f"""# Real measurements: what plain Coulomb friction gets wrong

This page is written by `make criticise-measured`; every number in it is computed by that command
from the files in `data/measured/` (sources and licences in the READMEs there). **Neither data set
is of cloth.** The first is paper on paper, a fibrous sheet pulled by a spring; the second is a
rigid block on boards. They show what the criticism does with data that nobody simulated.

## Paper on paper, pulled by a spring

Nine force traces (Colas et al. 2019): three springs, three drive speeds, one run for each of the
nine pairs, the load always the slider's own weight.

![Nine traces](pictures/paper_traces.svg)

Plain Coulomb friction predicts a constant force. What is added below is judged on track that it
has not seen: every second millimetre of a run is held out, and its peaks and troughs are predicted
from the rest (block by block; {ladder[0]["blocks"]} blocks, 95 % t-intervals of the step from the
line above).

| model | log score an event | step | error (% of weight) |
|---|---|---|---|
{steps}

![Error on held-out track](pictures/paper_gain.svg)

What fails, in the order of the gain of repairing it: {failing}.

{questions}

| spring (N/m) | speed (mm/s) | median drop / weight | with inertia |
|---|---|---|---|
{drops}

![Drops against speed](pictures/paper_drops.svg)

In closed form, a slip under constant kinetic friction swings the spring by
±√((F_s − F_k)² + V² k m) about F_k: the drops grow with the speed V though no friction does. The
static excess is taken from the slow runs, where the last term vanishes; the fast runs are then
predicted. The forecast exceeds the drops of the stiffest springs at the highest speed: damping,
which the model has not, takes some of the swing.

**As a case.** The same traces are a case of the spring-slider protocol
([measurements.md](measurements.md)): `python benchmarks/measured_data --case FOLDER` writes
it, `slipstitch criticise FOLDER` reads it, each run its own specimen. Inertia is in that protocol's
null. The verdict: *{as_case["verdict"]}.* {_case_words(as_case)} A fall of friction with speed
and a static excess both make a slider stick; the runs, one a cell, do not tell them apart.

**What these data cannot decide:** load (never varied), so neither a power of the load nor adhesion;
wear and specimen (one run each); whether the level depends on speed or stiffness (one run a cell).

## A block pushed over boards

500 pushes (Zhou 2015), of which {kept} are near-translations (the block turned by less than
{push_data.LARGEST_TURN_DEG:g}° and moved more than 4 mm); turning lowers the force a push needs, so
the others are left out. A log of 50 pushes is the cluster; support, place, direction in the block,
direction in the room and order are the covariates.

| board | support | force / weight | scatter | pushes |
|---|---|---|---|---|
{cell_lines}

{_board_words("wood", wood)} The strongest traces:

| along | shape | p (family-wise) |
|---|---|---|
{chr(10).join(_strongest(wood))}

{_board_words("other", other)} The strongest traces:

| along | shape | p (family-wise) |
|---|---|---|
{chr(10).join(_strongest(other))}

![Push force against place](pictures/board_place.svg)

Each support was measured in one log a board, so support and whatever else changed between logs are
one and the same; where place and support both show, these data cannot say which of the two it is.
Load, speed and rest were not varied: nothing is said about them. Whether a block that turns a
little less than {push_data.LARGEST_TURN_DEG:g}° needs less force is part of the scatter here
(run-to-run scatter {100 * wood.null_state.scatters["push"].run:.0f} % and
{100 * other.null_state.scatters["push"].run:.0f} %), which is why small effects stay hidden.
"""
