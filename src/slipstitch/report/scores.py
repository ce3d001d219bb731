"""Tables of the networks' scores: the paper's tables beside ours, and all test sets."""

from collections.abc import Mapping
from typing import Any

from slipstitch.base.page.wording import NONE, percent, seeds_in_words
from slipstitch.learning.evaluation import paper
from slipstitch.learning.evaluation.metrics import TEST_SETS, Metric, metrics_of
from slipstitch.learning.evaluation.scores import AVERAGE, CALIBRATED, SHIPPED, TRAINING, network_of
from slipstitch.learning.evaluation.test_sets import NETWORK, PREFIX, WHAT
from slipstitch.report.results import Table

SPLIT_TITLES = {
    "by_video": "videos held out",
    "by_simulation": "simulations held out",
    "off_grid": "off-grid friction",
    "by_video_reflective": "videos held out, trained with reflective floors",
}
# The splits that networks are trained on, as short as a figure needs them.
SPLIT_NAMES = {
    "by_video": "by video",
    "by_simulation": "by simulation",
    "by_video_reflective": "by video, reflective floors",
}
NETWORK_TITLES = {
    "material_baseline": "fabric network",
    "friction_baseline": "baseline network",
    "friction_conditional": "conditional network",
    TRAINING: "instrument",
    AVERAGE: "instrument ensemble",
    SHIPPED: "instrument that comes with Slipstitch",
}
TURNED = "view_"
Columns = Mapping[tuple[str, str | None], str]


def model_title(model: str) -> str:
    """Name of a network, or of a row of metrics.json, in words."""
    if model.startswith(PREFIX):
        what = WHAT[model.removesuffix(NETWORK)]
        return f"{'small network' if model.endswith(NETWORK) else 'linear probe'}, {what}"
    base = model.removesuffix(CALIBRATED)
    title = NETWORK_TITLES.get(network_of(base), base.replace("_", " "))
    return title if base == model else f"{title}, fine-tuned on the calibrated view"


def _shares(network: str) -> list[Metric]:
    """The shares of right answers that the paper's tables have of a network."""
    kind = "fabric" if network == "material_baseline" else "friction"
    return [metric for metric in metrics_of(TEST_SETS, kind) if metric.title]


class Scores:
    """The scores of a run, in metrics.json and details.json."""

    def __init__(self, metrics: Mapping[str, Any] | None, details: Mapping[str, Any] | None):
        self.metrics = metrics or {}
        self.details = details or {}

    def detail(self, test_set: str, network: str, viewpoint: str | None = None) -> dict[str, Any]:
        """Entry of details.json of a network, or of its videos from a viewpoint; empty without.

        In the calibrated view, and in those turned from it, of the fine-tuned network, if any.
        """
        of_set = self.details.get(test_set, {})
        found = of_set.get(network) or {}
        if viewpoint is not None or test_set.startswith(TURNED):
            found = of_set.get(network + CALIBRATED) or found
        return found if viewpoint is None else found.get("viewpoints", {}).get(viewpoint) or {}

    def cell(self, test_set: str, network: str, metric: str, viewpoint: str | None = None) -> str:
        """A share in % ± its spread over seeds; a dash where there is none."""
        detail = self.detail(test_set, network, viewpoint)
        mean, spread = (detail.get(name) or {} for name in ("mean", "spread"))
        return percent(mean.get(metric), spread.get(metric))

    def size(self, test_set: str, viewpoint: str | None = None) -> str:
        """Videos, simulations and seeds of a test set, in words."""
        rows = self.metrics.get(test_set, {})
        known = [self.detail(test_set, network, viewpoint) for network in NETWORK_TITLES]
        videos = max(one.get("n") or 0 for one in known)
        simulations = max(one.get("simulations") or 0 for one in known)
        seeds = max((len(row.get("seeds") or ()) for row in rows.values()), default=0)
        words = f"{videos} videos" + (f", {simulations} simulations" if simulations else "")
        return words + (f", {seeds_in_words(seeds)}" if seeds else "")


def beside_paper(
    scores: Scores, columns: Columns, quoted: Mapping[tuple[str, str], float], videos: int
) -> Table | None:
    """The paper's shares, `quoted` by network and metric, beside ours; None if nothing was run.

    Columns that were run have headings, by test set and viewpoint, None for all.
    """
    networks = [*NETWORK_TITLES]
    shown = [key for key in columns if any(scores.detail(key[0], n, key[1]) for n in networks)]
    if not shown:
        return None
    head = ["share of test videos", f"paper ({videos} videos)"]
    head += [f"{columns[key]} ({scores.size(*key)})" for key in shown]
    rows = []
    for network in NETWORK_TITLES:
        for metric in _shares(network):
            cells = [scores.cell(name, network, metric.name, view) for name, view in shown]
            theirs = quoted.get((network, metric.name))
            if theirs is not None or set(cells) != {NONE}:
                what = metric.title.rpartition(", ")[2]
                quote = paper.NOT_PRINTED if theirs is None else percent(theirs)
                rows.append([f"{NETWORK_TITLES[network]}: {what}", quote, *cells])
    return head, rows


def table_2(scores: Scores, calibrated: str) -> Table | None:
    """The paper's Table 2: its split of videos, and simulations held out."""
    columns: Columns = {
        ("by_video", None): "ours by video",
        ("by_video", calibrated): "its calibrated view",
        ("by_simulation", None): "ours by simulation",
    }
    return beside_paper(scores, columns, paper.TABLE_2, paper.TABLE_2_VIDEOS)


def unseen_texture(scores: Scores, calibrated: str) -> Table | None:
    """The paper's Sec. 6.2.1, and the same networks on textures that they trained on."""
    columns: Columns = {
        ("unseen_texture", calibrated): "ours, calibrated view",
        ("unseen_texture", None): "ours, all views",
        ("by_video", None): "ours, trained textures",
    }
    if "unseen_texture" not in scores.metrics:
        return None
    return beside_paper(scores, columns, paper.UNSEEN_TEXTURE, paper.UNSEEN_TEXTURE_VIDEOS)


def table_3(scores: Scores, calibrated: str) -> Table | None:
    """The paper's Table 3: shares by the turn of the camera.

    At 0 degrees: the test videos of the split by video, from the calibrated viewpoint.
    """
    turns = [int(name.removeprefix(TURNED)) for name in scores.metrics if name.startswith(TURNED)]
    if not turns:
        return None
    # Test set and viewpoint by turn; an instrument knows the calibrated viewpoint only.
    places: dict[int, tuple[str, str | None]] = {
        turn: (f"{TURNED}{turn:+d}", None) if turn else ("by_video", calibrated)
        for turn in sorted([0, *turns])
    }
    columns = [
        (network, metric)
        for network in NETWORK_TITLES
        for metric in _shares(network)
        if metric.name != "material_top2"
        and any(scores.detail(name, network) for name, view in places.values() if view is None)
    ]
    head = ["rotation", "videos", "paper, < 0.1", "paper, < 0.2"]
    head += [f"{NETWORK_TITLES[network]}, {metric.heading}" for network, metric in columns]
    rows = []
    for turn, (name, view) in places.items():
        videos = max(scores.detail(name, network, view).get("n") or 0 for network in NETWORK_TITLES)
        quoted = paper.TABLE_3.get(turn)
        row = [f"{turn:+d}°".replace("-", "−") if turn else "0°", str(videos or NONE)]
        row += list(map(percent, quoted)) if quoted else [paper.NOT_PRINTED] * 2
        for network, metric in columns:
            of_view = None if network in (TRAINING, AVERAGE, SHIPPED) else view
            row.append(scores.cell(name, network, metric.name, of_view))
        rows.append(row)
    return head, rows


def _better_probes(models: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The rows of a test set, of every probe the one of its two forms with the smaller error."""
    found: dict[str, str] = {}
    for model in models:
        name = model.removesuffix(NETWORK) if model.startswith(PREFIX) else model
        best = found.setdefault(name, model)
        if models[model]["mean_absolute_error"] is not None:
            found[name] = min(best, model, key=lambda one: models[one]["mean_absolute_error"])
    return {model: models[model] for model in found.values()}


def test_sets(scores: Scores) -> Table | None:
    """Every test set of metrics.json but the turned viewpoints, with the better of the probes."""
    columns = metrics_of(TEST_SETS)
    rows: list[list[str]] = []
    for split, models in scores.metrics.items():
        if split.startswith(TURNED):
            continue
        rows.append([SPLIT_TITLES.get(split, split.replace("_", " "))])
        for model, row in _better_probes(models).items():
            spread = scores.detail(split, network_of(model)).get("spread") or {}
            if model.startswith("lrcn_baseline"):  # its row holds the scores of two networks
                fabric = model.replace("lrcn", "material")
                spread = spread | (scores.detail(split, fabric).get("spread") or {})
            cells = [metric.shown(row, spread).removesuffix(" %") for metric in columns]
            rows.append([model_title(model), str(row["n"]), *cells])
    head = ["model", "videos", *(f"{metric.heading}, {metric.unit}" for metric in columns)]
    return (head, rows) if rows else None


def alarms(scores: Scores) -> Table | None:
    """Share of videos that raise the out-of-distribution alarm, a row an instrument."""
    head, rows = [], []
    for split, name in SPLIT_NAMES.items():
        for network in (TRAINING, AVERAGE):
            for seed, rates in (scores.detail(split, network).get("alarms") or {}).items():
                head = ["trained", *(kind.replace("_", " ") for kind in rates)]
                title = f"{NETWORK_TITLES[network]} {name}, seed {seed}"
                rows.append([title, *map(percent, rates.values())])
    return (head, rows) if rows else None
