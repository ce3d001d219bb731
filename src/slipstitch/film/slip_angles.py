"""Reference friction of a pair from repeated slip angles on an inclined plane, with its error.

A specimen slips where tan(angle) = mu (Amontons-Coulomb). Of the values y = tan(angle),

    y = mu + orientation + position + scatter,

orientations are fixed and sum to zero (the pair's mu is their plain mean), positions are drawn from
all places of the substrate with standard deviation tau, repeats scatter with sigma. tau and sigma
follow by restricted maximum likelihood (Patterson & Thompson 1971), tau^2 not held to be positive:
in a balanced table this is analysis of variance, and with Satterthwaite's (1946) degrees of freedom
the interval is then exactly Student's, of the positions' means. The bench's error is the same in
all measurements and uniform within its bound: its own 95 % half-width is added in quadrature to
Student's. With 3 to 7 degrees of freedom, and a bound of 0 to 8 standard errors, the sum covers
94.4 to 95.9 %; the effective degrees of freedom of JCGM 100:2008 (GUM, G.4) 93.8 to 99.4 %.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib
import numpy as np
import pandas
from matplotlib.figure import Figure
from scipy import optimize, stats

from slipstitch.base.errors import BadInput
from slipstitch.base.page.figures import plain_text, save_figure
from slipstitch.base.page.palette import BLACK, FIXED_IDS, INTERVAL, SERIES
from slipstitch.base.provenance import provenance_record, recorded_path, start_clock, write_json
from slipstitch.base.tables import in_radians
from slipstitch.film.captures_table import REFERENCE_COLUMNS
from slipstitch.film.csv_table import TableColumn, name, number, read_table, whole_number

COVERAGE = 0.95
_FEWEST = 3
_OF_MEASUREMENT = ["material", "substrate", "position", "orientation", "repeat"]
_LARGEST_CONDITION = 1e10


@dataclass(frozen=True)
class SlipAngles:
    """All measurements of one pair of fabric and substrate."""

    material: str
    substrate: str
    # of each measurement: the place on the substrate, the direction of the fabric
    position: list[str]
    orientation: list[str]
    angle_rad: np.ndarray  # (n,): at which the specimen slipped
    bench_error_rad: float  # the largest error of the bench's angle, the same in all measurements


def read_angles(path: str | Path) -> list[SlipAngles]:
    """Slip angles by pair, in the table's order; BadInput if a cell is wrong or given twice."""
    columns = [
        *(TableColumn(title, name) for title in _OF_MEASUREMENT[:-1]),
        TableColumn("repeat", whole_number(9999)),
        TableColumn("angle_deg", number(0, 85, open_ends=True)),
        TableColumn("bench_error_deg", number(0, 10)),
    ]
    rows = pandas.DataFrame(read_table(path, columns))
    for _, same in rows.groupby(_OF_MEASUREMENT, sort=False):
        if len(same) > 1:
            first, again, *_ = same["line"]
            raise BadInput(f"{path} line {again}: duplicates line {first}")
    found = []
    for (material, substrate), measured in rows.groupby(_OF_MEASUREMENT[:2], sort=False):
        pair, bench_error_deg = f"{material} on {substrate}", measured["bench_error_deg"]
        for line in measured["line"][bench_error_deg != bench_error_deg.iloc[0]]:
            raise BadInput(
                f"{path} line {line}: {pair} differs in bench_error_deg from line "
                f"{measured['line'].iloc[0]}"
            )
        if in_radians(measured["angle_deg"]):
            raise BadInput(f"{path}: {pair}: no angle_deg reaches 2; angles in radians?")
        found.append(
            SlipAngles(
                str(material),
                str(substrate),
                measured["position"].tolist(),
                measured["orientation"].tolist(),
                np.radians(measured["angle_deg"].to_numpy()),
                float(np.radians(bench_error_deg.iloc[0])),
            )
        )
    return found


@dataclass(frozen=True)
class Reference:
    """Friction of a pair."""

    material: str
    substrate: str
    # the interval mu +- error holds the pair's friction with 95 % probability
    mu: float
    error: float
    # of mu, without the bench's error
    standard_error: float
    degrees_of_freedom: float
    bench_error: float  # largest error of mu by the bench alone
    # tau (0 where the estimate of tau^2 is negative; None with one position, or one measurement at
    # each) and sigma (of both together then)
    position_sd: float | None
    repeat_sd: float
    # probability of means as different as these if all were equal (F test); None with one
    position_p: float | None
    orientation_p: float | None
    # name -> mean, and number of measurements
    by_position: dict[str, tuple[float, int]]
    by_orientation: dict[str, tuple[float, int]]
    measurements: int


def estimate(angles: SlipAngles) -> Reference:
    """Friction of one pair; BadInput if too few angles tell orientations from scatter."""
    where = f"{angles.material} on {angles.substrate}"
    values = np.tan(angles.angle_rad)
    positions, orientations = _levels(angles.position), _levels(angles.orientation)
    needed = max(_FEWEST, orientations.shape[1] + 1)
    if len(values) < needed:
        raise BadInput(f"{where}: {len(values)} slip angle(s); at least {needed} are required")
    if np.ptp(values) == 0:
        raise BadInput(
            f"{where}: all slip angles are equal; repeats must be independent measurements"
        )
    # The first column is the plain mean of the orientations.
    design = np.column_stack([np.ones(len(values)), orientations[:, 1:] - orientations[:, :1]])
    tau2, sigma2 = _variances(values, design, positions)
    mu, standard_error, dof = _mean(values, design, positions, tau2, sigma2, where)
    bench = (1 + mu**2) * angles.bench_error_rad
    student = float(stats.t.ppf((1 + COVERAGE) / 2, dof)) * standard_error
    error = np.hypot(student, COVERAGE * bench)
    everything = np.column_stack([design, positions[:, 1:]])
    return Reference(
        angles.material,
        angles.substrate,
        mu,
        float(error),
        standard_error,
        dof,
        float(bench),
        None if tau2 is None else float(np.sqrt(max(tau2, 0.0))),
        float(np.sqrt(sigma2)),
        _f_test(values, everything, design),
        _f_test(values, everything, positions),
        _means(values, angles.position),
        _means(values, angles.orientation),
        len(values),
    )


def _levels(names: list[str]) -> np.ndarray:
    """The indicator matrix of the levels."""
    known, number = np.unique(names, return_inverse=True)
    return np.eye(len(known))[number]


def _means(values: np.ndarray, names: list[str]) -> dict[str, tuple[float, int]]:
    groups = pandas.Series(values).groupby(np.array(names))
    return {str(name): (float(part.mean()), len(part)) for name, part in groups}


def _f_test(values: np.ndarray, full: np.ndarray, reduced: np.ndarray) -> float | None:
    """Probability of what the columns of `full` beyond `reduced` explain, by chance alone."""
    ranks, squares = [], []
    for design in (full, reduced):
        coefficients, _, rank, _ = np.linalg.lstsq(design, values, rcond=None)
        ranks.append(rank)
        squares.append(float(np.sum((values - design @ coefficients) ** 2)))
    left, extra = len(values) - ranks[0], ranks[0] - ranks[1]
    if extra < 1 or left < 1:
        return None
    if squares[0] <= 0:
        return 0.0
    ratio = (squares[1] - squares[0]) / extra / (squares[0] / left)
    return float(stats.f.sf(ratio, extra, left))


def _variances(
    values: np.ndarray, design: np.ndarray, positions: np.ndarray
) -> tuple[float | None, float]:
    """tau^2 and sigma^2 of y = design b + positions u + e by restricted maximum likelihood.

    None and the variance of both together where they cannot be separated: with one position, or
    one measurement at each.
    """
    counts, free = positions.sum(axis=0), len(values) - design.shape[1]
    if positions.shape[1] < 2 or counts.max() == 1:
        left = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
        return None, float(left @ left) / (len(values) - np.linalg.matrix_rank(design))

    def cost(ratio: float) -> tuple[float, float]:
        """-2 log of the restricted likelihood at tau^2 / sigma^2, and its sigma^2."""
        # (1 + ratio Z Z')^-1 = 1 - Z (ratio / (1 + n ratio)) Z', one n a position.
        scale = 1 + ratio * counts

        def weighted(columns: np.ndarray) -> np.ndarray:
            inner = (positions.T @ columns).T * (ratio / scale)
            return columns - positions @ inner.T

        by_design = weighted(design)
        information = design.T @ by_design
        coefficients = np.linalg.solve(information, by_design.T @ values)
        left: np.ndarray = values - design @ coefficients
        sigma2 = max(float(left @ weighted(left)) / free, 1e-300)
        found = np.log(scale).sum() + np.linalg.slogdet(information)[1] + free * np.log(sigma2)
        return float(found), sigma2

    # sigma^2 + n tau^2 is the variance of a position's mean, times n: it must be positive.
    lowest = -1 / float(counts.max()) + 1e-6
    # On a scale on which the profile of the likelihood is smooth up to large ratios.
    grid = np.concatenate([np.linspace(lowest, 0, 14), np.geomspace(1e-2, 1e4, 22)])
    best = int(np.argmin([cost(ratio)[0] for ratio in grid]))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    found = optimize.minimize_scalar(lambda ratio: cost(ratio)[0], bounds=around, method="bounded")
    sigma2 = cost(found.x)[1]
    return float(found.x) * sigma2, sigma2


def _mean(
    values: np.ndarray, design: np.ndarray, positions: np.ndarray, tau2: float | None,
    sigma2: float, where: str,
) -> tuple[float, float, float]:  # fmt: skip
    """The mean, its standard error, and Satterthwaite's degrees of freedom."""
    parts = [np.eye(len(values)), positions @ positions.T]
    covariance = sigma2 * parts[0] + (tau2 or 0.0) * parts[1]
    parts = parts[: 1 if tau2 is None else 2]
    inverse = np.linalg.inv(covariance)
    spread = np.linalg.inv(design.T @ inverse @ design)
    weights = spread @ design.T @ inverse
    mu, variance = float(weights[0] @ values), float(spread[0, 0])
    # How the variance of mu moves with sigma^2 and tau^2, and how well these are known.
    moves = np.array([weights[0] @ part @ weights[0] for part in parts])
    projection = inverse - inverse @ design @ weights
    known = np.array(
        [[np.trace(projection @ a @ projection @ b) / 2 for b in parts] for a in parts]
    )
    # Also where it is no number: repeats that are equal leave no scatter to compare with.
    if not np.isfinite(known).all() or np.linalg.cond(known) > _LARGEST_CONDITION:
        raise BadInput(
            f"{where}: the effects of positions, orientations and repeats cannot be separated: "
            "measure every orientation at several positions, with independent repeats"
        )
    scatter = float(moves @ np.linalg.solve(known, moves))
    return mu, float(np.sqrt(variance)), 2 * variance**2 / scatter


# Black is the estimate.
_COLOURS = tuple(colour for colour in SERIES if colour != BLACK)


def reference_to_files(
    table: Path, out: Path, details: Path | None, picture: Path | None
) -> list[Reference]:
    """Estimate every pair of a table of slip angles; write a CSV, and JSON and picture if asked."""
    started = start_clock()
    found = [(angles, estimate(angles)) for angles in read_angles(table)]
    references = [pair for _, pair in found]
    record = provenance_record("capture", inputs=[table], started=started)
    rows = [
        asdict(pair)
        | {"positions": len(pair.by_position), "orientations": len(pair.by_orientation)}
        for pair in references
    ]
    with recorded_path(out, record) as temporary:
        content = pandas.DataFrame(rows, columns=list(REFERENCE_COLUMNS))
        content.to_csv(temporary, index=False, float_format="%.6g")
    if details:
        write_json(details, [asdict(pair) for pair in references], record)
    if picture:
        with recorded_path(picture, record) as temporary:
            draw_references(found, temporary, picture.suffix[1:])
    return references


def draw_references(
    measured: Sequence[tuple[SlipAngles, Reference]], path: str | Path, kind: str
) -> None:
    """Draw every slip angle, and the interval of each pair, as PNG or SVG."""
    names = sorted({name for angles, _ in measured for name in angles.orientation})
    colour = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(names)}
    with matplotlib.rc_context(FIXED_IDS | {"font.size": 9}):
        figure = Figure(figsize=(7.5, 1.1 + 0.75 * len(measured)), layout="constrained")
        axes = figure.subplots()
        for row, (angles, reference) in enumerate(measured):
            places = sorted(set(angles.position))
            offset = {name: 0.16 + 0.5 * k / max(len(places), 2) for k, name in enumerate(places)}
            band = [(height + 0.4) / (len(measured) + 0.2) for height in (row - 0.15, row + 0.75)]
            ends = reference.mu - reference.error, reference.mu + reference.error
            axes.axvspan(*ends, *(1 - share for share in band[::-1]), color=INTERVAL)
            axes.plot([reference.mu], [row], "D", color="black", markersize=4, zorder=3)
            for position, orientation, friction in zip(
                angles.position, angles.orientation, np.tan(angles.angle_rad), strict=True
            ):
                height = row + offset[position]
                axes.plot([friction], [height], "o", ms=3.5, alpha=0.75, color=colour[orientation])
            axes.errorbar(
                [reference.mu], [row], xerr=[reference.error], color="black", capsize=3, lw=1.2
            )
        axes.set_yticks(
            range(len(measured)),
            [plain_text(f"{angles.material}\non {angles.substrate}") for angles, _ in measured],
        )
        axes.set_ylim(len(measured) - 0.2, -0.4)
        axes.set_xlabel("friction coefficient (tan of the slip angle)")
        axes.spines[["top", "right"]].set_visible(False)
        handles = [axes.plot([], [], "o", ms=4, color=colour[name])[0] for name in names]
        labels = [plain_text(f"orientation {name}") for name in names]
        axes.legend(handles, labels, frameon=False, fontsize=8, loc="best")
        axes.set_title(
            "Black: estimate with 95 % interval, including the bench's error; dots: slip angles, "
            "one line per position",
            fontsize=9,
            loc="left",
        )
        save_figure(figure, path, kind)
