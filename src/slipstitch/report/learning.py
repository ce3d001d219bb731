"""The networks' tables beside the paper's."""

from typing import Any

from slipstitch.config import Config
from slipstitch.evaluate import paper

SPLIT_TITLES = {
    "by_video": "videos held out (the paper’s split)",
    "by_simulation": "whole simulations held out",
    "off_grid": "friction off the grid",
    "unseen_texture": "texture never trained on",
    "unseen_fabric": "fabric never trained on",
}
MODEL_TITLES = {
    "lrcn_baseline": "baseline network",
    "lrcn_conditional": "network given the material",
    "instrument": "instrument",
}
NETWORKS = {"lrcn_baseline": "friction_baseline", "lrcn_conditional": "friction_conditional"}


def headline(config: Config, metrics, details) -> dict[str, Any] | None:
    """The result that counts: friction on simulations that no network has seen."""
    for split in ("by_simulation", "by_video"):
        rows = (metrics or {}).get(split, {})
        scored = {name: row for name, row in rows.items() if row.get("friction_lt_0.1") is not None}
        if not scored:
            continue
        best = max(scored, key=lambda name: scored[name]["friction_lt_0.1"])
        detail = details.get(split, {}).get(NETWORKS.get(best, best), {})
        chance = detail.get("chance", {})
        return {
            "split": SPLIT_TITLES[split],
            "model": MODEL_TITLES.get(best, best),
            "share": scored[best]["friction_lt_0.1"],
            "error": scored[best].get("mean_absolute_error"),
            "chance": chance.get("uniform", 1.0 / len(config.grid.frictions)),
            "majority": chance.get("majority"),
            "chance_error": chance.get("mean_absolute_error"),
            "n": scored[best]["n"],
            "simulations": detail.get("simulations"),
            "classes": len(config.grid.frictions),
        }
    return None


def table_2(metrics) -> list[dict[str, Any]]:
    """The paper's Table 2 with ours for both splits."""
    rows = []
    for network, model, measure, title in (
        ("material_baseline", "lrcn_baseline", "material_top1", "Material, first guess"),
        ("material_baseline", "lrcn_baseline", "material_top2", "Material, first two guesses"),
        (
            "friction_baseline",
            "lrcn_baseline",
            "friction_lt_0.1",
            "Friction, error < 0.1, baseline",
        ),
        (
            "friction_baseline",
            "lrcn_baseline",
            "friction_lt_0.2",
            "Friction, error < 0.2, baseline",
        ),
        (
            "friction_conditional",
            "lrcn_conditional",
            "friction_lt_0.1",
            "Friction, error < 0.1, given the material",
        ),
        (
            "friction_conditional",
            "lrcn_conditional",
            "friction_lt_0.2",
            "Friction, error < 0.2, given the material",
        ),
    ):
        rows.append(
            {
                "title": title,
                "paper": paper.TABLE_2.get((network, measure)),
                **{
                    split: ((metrics or {}).get(split, {}).get(model) or {}).get(measure)
                    for split in ("by_video", "by_simulation")
                },
            }
        )
    return rows


def test_sets(metrics, details) -> list[dict[str, Any]]:
    """Every test set of metrics.json with its models, and what chance would give."""
    groups = []
    for split, models in (metrics or {}).items():
        rows = []
        trained_on = None
        for model, row in models.items():
            network = NETWORKS.get(model, model)
            detail = details.get(split, {}).get(network, {})
            trained_on = detail.get("trained_on")
            quoted = paper.UNSEEN_TEXTURE if split == "unseen_texture" else {}
            rows.append(
                {
                    "model": MODEL_TITLES.get(model, model).replace("network", "").strip(),
                    **row,
                    "simulations": detail.get("simulations"),
                    "seeds": len(row.get("seeds") or []) or None,
                    "chance": detail.get("chance", {}),
                    "paper": {
                        measure: quoted.get((network, measure))
                        for measure in ("friction_lt_0.1", "friction_lt_0.2")
                    },
                }
            )
        groups.append(
            {
                "split": SPLIT_TITLES.get(split, split.replace("_", " ")),
                "trained_on": trained_on.replace("_", " ")
                if trained_on and trained_on != split
                else None,
                "rows": rows,
            }
        )
    return groups


def alarms(details) -> list[dict[str, Any]]:
    """How often the instruments' alarm is raised, a row an instrument."""
    return [
        {"split": SPLIT_TITLES[split], "seed": seed, "shares": shares}
        for split in ("by_simulation", "by_video")
        for seed, shares in details.get(split, {}).get("instrument", {}).get("alarms", {}).items()
    ]
