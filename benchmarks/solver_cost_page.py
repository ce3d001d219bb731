"""Picture and page of the solver's benchmark, from its result alone."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

# The paper's simulator: seconds a step of 0.5 ms, 41 x 41 vertices, one thread of a 2-core machine.
ARGUS_STEP_S, ARGUS_STEPS_PER_S = (0.098, 0.122), 2000
ARGUS_TARGET, DESCENT_TARGET = 400, 20
RUN_TARGET_S = 60
COUNTS = ("steps", "iterations_per_step", "factorisations_per_step", "halvings", "memory_mib")


def draw(result, path):
    """Cost against mesh size, and of the fabrics against friction."""
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    mesh = result.get("mesh")
    if mesh:
        vertices = np.array([row["vertices_per_side"] ** 2 for row in mesh["rows"]])
        cost = [row["cpu_s_per_s"] for row in mesh["rows"]]
        left.loglog(vertices, cost, "o", color="#D55E00")
        fit = mesh["cpu_s_per_s_at_1"] * vertices ** mesh["exponent"]
        left.loglog(
            vertices, fit, color="#1a1a1a", lw=1, label=f"vertices$^{{{mesh['exponent']:.2f}}}$"
        )
        left.set_xticks(vertices, [f"{row['vertices_per_side']}²" for row in mesh["rows"]])
        left.minorticks_off()
        left.legend(frameon=False)
    else:
        left.text(0.5, 0.5, "not measured yet", transform=left.transAxes, ha="center")
    left.set(
        xlabel="vertices", ylabel="CPU s per simulated second", title="royal-target, touching down"
    )
    rows = result.get("protocol", {"rows": []})["rows"]
    for friction in sorted({row["friction"] for row in rows}):
        cost = sorted(row["cpu_s"] for row in rows if row["friction"] == friction)
        right.plot([friction] * len(cost), cost, "o", color="#0072B2", alpha=0.6, mec="none")
        right.plot(friction, np.median(cost), "_", color="#1a1a1a", ms=22)
    right.set(
        xlabel="friction coefficient", ylabel="CPU s per run", ylim=(0, None),
        title="dots: fabrics, lines: median",
    )  # fmt: skip
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _paragraph(*lines):
    """Lines of one paragraph, and the empty line after it."""
    return [" ".join(lines), ""]


def page(result):
    """The page docs/benchmarks.md."""
    parts = ["# Benchmarks", ""]
    parts += _paragraph(
        "Written by `make benchmark` (`benchmarks/solver_cost.py`): every figure is from the last",
        "run of that command, on one core. `--full` simulates the whole protocol of 131 s instead",
        "of its first 8 s. CPU seconds are those of the simulation alone. On a machine under other",
        "load (load average above the number of cores), CPU seconds are higher as well.",
    )
    parts += _paragraph(f"Machine: {result.get('host', 'unknown')}.")
    picture = "../results/published/benchmark/benchmark.png"
    parts += _paragraph(f"![Cost against mesh size and friction]({picture})")
    if "protocol" in result:
        parts += _protocol(result["protocol"])
    if "mesh" in result:
        parts += _mesh(result["mesh"])
    if "side-by-side" in result:
        parts += _side_by_side(result["side-by-side"])
    if "protocol" in result:
        parts += _argus(result["protocol"])
    missing = [name for name in ("protocol", "mesh", "side-by-side") if name not in result]
    if missing:
        parts += _paragraph(f"Not measured yet: {', '.join(missing)}.")
    return "\n".join(parts).rstrip() + "\n"


def _protocol(part):
    rows = part["rows"]
    frictions = sorted({row["friction"] for row in rows})
    cost = {(row["material"], row["friction"]): row for row in rows}
    simulated_s, costs = rows[0]["simulated_s"], [row["cpu_s"] for row in rows]
    lines = [
        f"## Drop-and-drag, 41 × 41 vertices, {simulated_s:.0f} s (load {part['load_average']})",
        "",
        *_paragraph(
            f"CPU seconds of whole runs with the default settings, {len(rows)} of",
            f"{part['runs_in_all']} measured. Median {np.median(costs):.0f}, from {min(costs):.0f}",
            f"to {max(costs):.0f}; target {RUN_TARGET_S} without folds.",
        ),
        "| fabric | " + " | ".join(f"μ = {friction:g}" for friction in frictions) + " |",
        "|---|" + "---|" * len(frictions),
    ]
    for material in sorted({row["material"] for row in rows}):
        cells = [cost.get((material, friction)) for friction in frictions]
        shown = [f"{row['cpu_s']:.0f}" if row else "" for row in cells]
        lines.append(f"| {material} | " + " | ".join(shown) + " |")
    median = {key: np.median([row[key] for row in rows]) for key in COUNTS}
    return [
        *lines,
        "",
        *_paragraph(
            f"Medians: {median['steps']:.0f} steps with",
            f"{median['iterations_per_step']:.1f} iterations and",
            f"{median['factorisations_per_step']:.2f} factorisations each,",
            f"{median['halvings']:.0f} steps halved because they did not converge,",
            f"{median['memory_mib']:.0f} MiB.",
        ),
    ]


def _mesh(part):
    lines = [
        f"## Cost against mesh size (load {part['load_average']})",
        "",
        *_paragraph(
            f"royal-target at μ = 0.5 while it touches down, {part['rows'][0]['simulated_s']:g} s.",
            f"CPU time grows with the number of vertices to the power {part['exponent']:.2f}.",
        ),
        "| vertices | CPU s per simulated second | steps | iterations per step "
        "| factorisations per step | memory, MiB |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['vertices_per_side']}² | {row['cpu_s_per_s']:.2f} | {row['steps']} "
        f"| {row['iterations_per_step']:.1f} | {row['factorisations_per_step']:.2f} "
        f"| {row['memory_mib']:.0f} |"
        for row in part["rows"]
    ]
    return [*lines, ""]


def _side_by_side(part):
    ours = part["ours"]
    lines = [
        f"## Comparison with SolverVBD of Newton physics {part['newton']}"
        f" (load {part['load_average']})",
        "",
        *_paragraph(
            "One isotropic sheet (200 N/m, Poisson's ratio 0.3, ke 5 · 10⁻⁵ N/m, 0.2 kg/m²) on one",
            "mesh of 41 × 41 vertices, hung by its tabs and lowered onto the floor. Residual: the",
            "largest out-of-balance force on a free vertex over μ times its weight, for SolverVBD",
            "from its own energy in double precision. Lowest: height of the lowest vertex; the",
            "sheet's edge is at first 0.5 mm above the floor. Ours with the default settings (mean",
            "step), SolverVBD at 20 ms, and at the step and iterations of its own cloth examples.",
            "Both start from our equilibrium state.",
        ),
        "| solver | step, ms | iterations | CPU s per simulated second | ratio to ours | residual "
        "| lowest, mm | mean distance from ours, mm |",
        "|---|---|---|---|---|---|---|---|",
        f"| ours | {1e3 * ours['step_s']:.3g} | {ours['iterations_per_step']:.1f} (Newton) "
        f"| {ours['cpu_s_per_s']:.2f} | 1 "
        f"| {ours['residual']:.0e} | {1e3 * ours['lowest_m']:.2f} | |",
    ]
    lines += [
        f"| SolverVBD | {1e3 * row['step_s']:.3g} | {row['iterations']} | {row['cpu_s_per_s']:.1f} "
        f"| {row['cpu_s_per_s'] / ours['cpu_s_per_s']:.0f} | {row['residual']:.0e} "
        f"| {1e3 * row['lowest_m']:.2f} | {1e3 * row['mean_distance_m']:.1f} |"
        for row in part["descent"]
    ]
    ratios = [row["cpu_s_per_s"] / ours["cpu_s_per_s"] for row in part["descent"]]
    lines += [
        "",
        *_paragraph(
            "SolverVBD does not reach an equal residual: it works in single precision, and",
            "merely rounding our positions to it changes the forces by",
            f"{part['single_precision_residual']:.1g} in the same unit. The rows show the",
            f"residuals that it reaches. Target: {DESCENT_TARGET} times less CPU time; ours takes",
            f"{min(ratios):.0f} to {max(ratios):.0f} times less than the rows above.",
        ),
        *_paragraph(
            "Creep in one second on a plane whose slope is 0.98 times the friction coefficient",
            "(0.5), steps of 20 ms; SolverVBD smooths friction below a speed ε:",
        ),
        "| solver | iterations | ε, m/s | creep |",
        "|---|---|---|---|",
    ]
    for row in part["creep"]:
        epsilon = row.get("friction_epsilon_m_s")
        lines.append(
            f"| {row['solver']} | {row.get('iterations', '')} | "
            f"{'none' if epsilon is None else f'{epsilon:g}'} | {1e6 * row['creep_m']:.3g} µm |"
        )
    return [*lines, ""]


def _argus(part):
    low, high = (ARGUS_STEPS_PER_S * step for step in ARGUS_STEP_S)
    costs = [row["cpu_s_per_s"] for row in part["rows"]]
    median = float(np.median(costs))
    return [
        "## Comparison with the paper's simulator",
        "",
        *_paragraph(
            "ARGUS, measured on this mesh with one thread of a 2-core machine, takes 98-122 ms for",
            f"a step of 0.5 ms: {low:.0f}-{high:.0f} CPU s per simulated second. The median of the",
            f"runs above is {median:.2f}, {low / median:.0f}-{high / median:.0f} times less.",
            f"Target: {ARGUS_TARGET} times less:",
            f"{'met' if low / median >= ARGUS_TARGET else 'not met'}.",
            "At its default tolerance ARGUS slides where converged runs stick; ours sticks.",
        ),
    ]
