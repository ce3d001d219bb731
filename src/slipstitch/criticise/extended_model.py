"""The extended model as YAML, for a simulation to run with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from slipstitch.base.provenance import write_text
from slipstitch.criticise.causes import BENCH_MECHANISMS, MECHANISMS
from slipstitch.physics.friction_law import CONTACT_MECHANISMS, FrictionLaw


def extended_model(verdict: dict, which: str = "extended") -> dict:
    """Friction laws of face and edge, and what departs from the nominal bench and fabric.

    The laws are in the form of :meth:`FrictionLaw.to_dict`; ``bench`` holds fields of
    :class:`slipstitch.criticise.causes.Bench`. ``which`` may be ``null``. A side whose
    coefficient the data do not tell is left out. Where no mechanism explains the data,
    ``discrepancy`` has the smooth factor on the coefficients. So is a cause with a parameter that
    they do not tell (``not_exported``); without any other, the coefficients are those of no cause.
    """
    model = verdict["models"][which]
    left_out = verdict["not_exported"] if which == "extended" else {}
    causes = [cause for cause in model["causes"] if cause not in left_out]
    unknown = verdict.get("not_identified", {})
    if left_out and not causes:
        model = verdict["models"]["null"]
        unknown = {}  # those are of the fit with the causes
    values = dict(zip(model["parameters"], model["values"], strict=True))
    found = verdict.get("discrepancy") if which == "extended" else None
    table = {}
    if found and found["covariate"]:
        table = {"discrepancy": {key: found[key] for key in ("covariate", "knots", "factors")}}
        values |= {name: np.log(value) for name, value in found["coefficients"].items()}
    mechanisms: dict[str, dict[str, float]] = {}
    bench: dict[str, float] = {}
    for cause in causes:
        own = {p.name: values[p.name] for p in MECHANISMS[cause].parameters}
        if cause in CONTACT_MECHANISMS:
            mechanisms[cause] = own
        else:
            bench |= {k: float(v) for k, v in BENCH_MECHANISMS[cause].changes(own).items()}
    laws = {
        side: FrictionLaw(float(np.exp(values[name])), mechanisms).to_dict()
        for side, name in (("face", "mu_face"), ("edge", "mu_edge"))
        if name in values and name not in unknown
    }
    return {
        "case": verdict["case"],
        "verdict": verdict["verdict"],
        "causes": causes,
        **({"not_exported": left_out} if left_out else {}),
        "friction_law": laws,
        "bench": bench,
        **table,
        "nominal": verdict["nominal"],
    }


def write_extended_model(verdict: dict, path: Path, record: dict[str, Any]) -> None:
    """Write :func:`extended_model` to a YAML file, with its record of provenance."""
    write_text(path, yaml.safe_dump(extended_model(verdict), sort_keys=False), record)
