"""Picture and page of the solver's benchmark, from its result alone."""

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.figure import Figure

# The paper's simulator: seconds a step of 0.5 ms, 41 x 41 vertices, one thread of a 2-core machine.
ARGUS_STEP_S, ARGUS_STEPS_PER_S = (0.098, 0.122), 2000
ARGUS_TARGET, ARGUS_TARGET_EACH, DESCENT_TARGET = 400, 200, 20
RUN_TARGET_S = 40
COUNTS = ("newton_iterations", "factorisations", "halvings", "memory_mib")


def draw(result, grid, path):
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
    right.plot(grid["friction"], grid["cpu_s"], "o", color="#0072B2", alpha=0.6, mec="none")
    median = grid.groupby("friction")["cpu_s"].median()
    right.plot(median.index, median, "_", color="#1a1a1a", ms=12)
    right.set(
        xlabel="friction coefficient", ylabel="CPU s per simulation of 125 s", ylim=(0, None),
        title="the paper's grid: fabrics, and their median",
    )  # fmt: skip
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _paragraph(*lines):
    """Lines of one paragraph, and the empty line after it."""
    return [" ".join(lines), ""]


def page(result, grid):
    """The page docs/benchmarks.md."""
    parts = ["# Benchmarks", ""]
    parts += _paragraph(
        "Written by `make benchmark` (`benchmarks/solver_cost.py`) from what it measured last, on",
        "one core, and from the published table of the paper's grid. On a machine under other load",
        "(load average above the number of cores), CPU seconds are higher as well.",
    )
    parts += _paragraph(f"Machine: {result.get('host', 'unknown')}.")
    picture = "../results/published/benchmark/benchmark.png"
    parts += _paragraph(f"![Cost against mesh size and friction]({picture})")
    parts += _grid(grid)
    if "steady" in result:
        parts += _steady(result["steady"])
    if "mesh" in result:
        parts += _mesh(result["mesh"])
    if "side-by-side" in result:
        parts += _side_by_side(result["side-by-side"])
    parts += _argus(grid)
    missing = [name for name in ("mesh", "side-by-side", "steady") if name not in result]
    if missing:
        parts += _paragraph(f"Not measured yet: {', '.join(missing)}.")
    return "\n".join(parts).rstrip() + "\n"


def _grid(grid):
    """The table of the paper's simulations, by fabric."""
    cost, median = grid["cpu_s"], grid["cpu_s"].median()
    counted = grid[["steps", *COUNTS]].median()
    dearest = grid.groupby("material")["cpu_s"].median().max()
    lines = [
        f"## The paper's grid: {len(grid)} simulations of "
        f"{grid['simulated_s'].median():.0f} s, "
        "41 × 41 vertices",
        "",
        *_paragraph(
            f"CPU seconds of whole jobs, two at a time on two cores: median {median:.0f}, from",
            f"{cost.min():.0f} to {cost.max():.0f}; {cost.sum() / 3600:.2g} CPU h in all.",
            f"Target: a median of {RUN_TARGET_S}: {_met(median <= RUN_TARGET_S)}. Target: no",
            f"fabric's median above twice that of all: {_met(dearest <= 2 * median)}.",
            f"{(cost > 3 * median).sum()} of {len(grid)} cost more than three times the median.",
            "All, with steps, iterations, factorisations, halvings and residuals:",
            "[simulations.csv](../results/published/benchmark/simulations.csv).",
        ),
        "| fabric | least | median | largest | at μ | median over that of all | steps | iterations "
        "| factorisations | halvings | largest residual |",
        "|---|" + "---|" * 10,
    ]
    for material, rows in grid.groupby("material"):
        largest = rows.loc[rows["cpu_s"].idxmax()]
        middle = rows[["cpu_s", "steps", *COUNTS]].median()
        cells = [
            *(f"{value:.0f}" for value in (rows["cpu_s"].min(), middle["cpu_s"], largest["cpu_s"])),
            f"{largest['friction']:g}",
            f"{middle['cpu_s'] / median:.2f}",
            *(f"{middle[key]:.0f}" for key in ("steps", *COUNTS[:-1])),
            f"{rows['largest_residual'].max():.1e}",
        ]
        lines.append(f"| {material} | {' | '.join(cells)} |")
    return [
        *lines,
        "",
        *_paragraph(
            f"Medians: {counted['steps']:.0f} steps with",
            f"{counted['newton_iterations'] / counted['steps']:.1f} iterations and",
            f"{counted['factorisations'] / counted['steps']:.2f} factorisations each,",
            f"{counted['memory_mib']:.0f} MiB. The residual of every step is below",
            f"{grid['friction_tolerance'].max():g}.",
        ),
    ]


def _steady(part):
    """What long steps save, and what they change."""
    rows = part["rows"]
    ratios = [row["after"]["cpu_s"] / row["before"]["cpu_s"] for row in rows]
    steps = [row["after"]["steps"] / row["before"]["steps"] for row in rows]
    cost = np.median([row["after"]["cpu_s"] for row in rows[1:]])  # the first is the dearest
    worst = max(row["after"]["cpu_s"] / row["simulated_s"] for row in rows)
    low, high = (ARGUS_STEPS_PER_S * step / worst for step in ARGUS_STEP_S)
    return [
        f"## Long steps where the motion is steady (load {part['load_average']})",
        "",
        *_paragraph(
            "Simulations of the grid with steps of 83 ms at most (before) and with steps of up to",
            "0.42 s where the motion is steady (after, the default), one after the other in one",
            "process: the dearest of the grid, and one of every fabric. The published grid above",
            "was made with the default, on another day. Together they cost",
            f"{np.sum([row['after']['cpu_s'] for row in rows]):.0f} instead of",
            f"{np.sum([row['before']['cpu_s'] for row in rows]):.0f} CPU s; ratios from",
            f"{min(ratios):.2f} to {max(ratios):.2f}, median {np.median(ratios):.2f}, that of",
            f"steps {np.median(steps):.2f}. Median of the ten fabrics after: {cost:.0f} CPU s",
            f"(target: {RUN_TARGET_S}; {_met(cost <= RUN_TARGET_S)}). The dearest takes",
            f"{low:.0f}-{high:.0f} times less than ARGUS (target: {ARGUS_TARGET_EACH};",
            f"{_met(low >= ARGUS_TARGET_EACH)}). Distance: between the two, mean over",
            "the vertices: over time, and while both are steadily dragged (largest).",
        ),
        "| fabric | μ | CPU s before | after | steps before | after | iterations before | after "
        "| distance, mm | steadily dragged, mm |",
        "|---|" + "---|" * 9,
        *(
            f"| {row['material']} | {row['friction']:g} "
            + "".join(
                f"| {row['before'][key]:.0f} | {row['after'][key]:.0f} "
                for key in ("cpu_s", "steps", "newton_iterations")
            )
            + f"| {1e3 * row['mean_m']:.3f} | {1e3 * row['steady_largest_m']:.3f} |"
            for row in rows
        ),
        "",
    ]


def _met(is_met):
    return "met" if is_met else "**missed**"


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


def _argus(grid):
    low, high = (ARGUS_STEPS_PER_S * step for step in ARGUS_STEP_S)
    each = grid["cpu_s"] / grid["simulated_s"]
    median, worst = each.median(), each.max()
    return [
        "## Comparison with the paper's simulator",
        "",
        *_paragraph(
            "ARGUS, measured on this mesh with one thread of a 2-core machine, takes 98-122 ms for",
            f"a step of 0.5 ms: {low:.0f}-{high:.0f} CPU s per simulated second. The median of the",
            f"paper's grid is {median:.2f}, {low / median:.0f}-{high / median:.0f} times less",
            f"(target: {ARGUS_TARGET}; {_met(low / median >= ARGUS_TARGET)}). The dearest",
            f"simulation takes {worst:.2f}, {low / worst:.0f}-{high / worst:.0f} times less",
            f"(target: {ARGUS_TARGET_EACH}; {_met(low / worst >= ARGUS_TARGET_EACH)}).",
            "At its default tolerance ARGUS slides where converged runs stick; ours sticks.",
        ),
    ]
