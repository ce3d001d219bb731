"""Results of the convergence study for runs similar to a given one, for its metadata."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from slipstitch.base.provenance import file_digest
from slipstitch.config.simulation import SimulationSettings

# Written by `slipstitch convergence publish`; only quoted (slipstitch.base.provenance.code.QUOTED).
MEASURED = Path(__file__).with_name("convergence.json")
CONVERGED = "converged"
BUT_FOR_ITS_MOMENT = "converged but for the moment of an event (± {:.2f} s)"
BUT_FOR_ITS_COURSE = "converged but for the course of an event (± {:.2f} s, {:.1f} mm)"
NOT_CONVERGED = "not converged"
# From what says most to what says least.
VERDICTS = (CONVERGED, BUT_FOR_ITS_MOMENT, BUT_FOR_ITS_COURSE, NOT_CONVERGED)
# Settings that may be finer than the studied ones; all others must be the same but for these.
FINER = ("vertices_per_side", "steady_step_s", "step_error_m", "friction_tolerance")
DO_NOT_MATTER = {
    "time_step_s",  # the step that is used divides a frame's interval: compared apart
    "frames",
    "frame_rate_hz",
    "newton_iterations_max",
    "yaw_sd_deg",
    "height_sd_m",
    "fabric_sd_rel",
    "curl_side",
    "ideal_replicates",
}


def worst_verdict(verdicts: Sequence[str]) -> str | None:
    """The verdict that says least; of events the one farthest apart. None of none."""

    def rank(verdict: str) -> tuple[int, list[float]]:
        beginnings = [one.partition("(")[0] for one in VERDICTS]
        apart = [float(number) for number in re.findall(r"\d+\.\d+", verdict)]
        return beginnings.index(verdict.partition("(")[0]), apart

    return max(verdicts, key=rank, default=None)


def studied_settings_that_differ(
    studied: Mapping[str, Any], settings: SimulationSettings
) -> list[str]:
    """Settings for which a study does not speak: other ones, or coarser."""
    own, theirs = settings.model_dump(mode="json"), studied["simulation"]
    differ = [] if settings.step_used_s <= studied["time_step_s"] * (1 + 1e-9) else ["time_step_s"]
    for name in sorted(set(own) - DO_NOT_MATTER):
        if name in FINER and name in theirs:
            finer = own[name] >= theirs[name] if name == FINER[0] else own[name] <= theirs[name]
            differ += [] if finer else [name]
        elif name not in theirs or own[name] != theirs[name]:
            differ.append(name)
    return differ


def read_study(measured: Path = MEASURED) -> dict[str, Any]:
    """The summary of the study that comes with the package."""
    return json.loads(measured.read_text(encoding="utf-8"))


def study_digest(measured: Path = MEASURED) -> str | None:
    """SHA-256 of the table that is quoted, None if there is none."""
    return file_digest(measured) if measured.is_file() else None


def measured_convergence(
    material: str, friction: float, settings: SimulationSettings, measured: Path = MEASURED
) -> dict[str, Any]:
    """What is known of a run's fabric, at its coefficient or those on either side.

    ``differ`` are settings for which the study does not speak, ``verdict`` is the worse one or
    None.
    """
    study = read_study(measured)
    differ = studied_settings_that_differ(study["studied"], settings)
    own = {case["friction"]: case for case in study["cases"] if case["material"] == material}
    below = max((mu for mu in own if mu <= friction + 1e-9), default=None)
    above = min((mu for mu in own if mu >= friction - 1e-9), default=None)
    both = [] if None in (below, above) else dict.fromkeys((below, above))
    cases = [own[mu] for mu in both]
    verdict = None
    if cases and not differ:
        known = [case["verdict"] for case in cases if case["verdict"] is not None]
        worst = worst_verdict(known)
        verdict = worst if len(known) == len(cases) or worst == NOT_CONVERGED else None
    return {
        "table_sha256": study_digest(measured),
        "studied": {name: one for name, one in study["studied"].items() if name != "simulation"},
        "differ": differ,
        "cases": cases,
        "verdict": verdict,
        "note": _note(cases, differ, verdict),
    }


def _note(cases: Sequence[Mapping[str, Any]], differ: Sequence[str], verdict: str | None) -> str:
    if not cases:
        return "this fabric was not studied at this friction: nothing is known"
    if differ:
        return f"other settings than those studied ({', '.join(differ)}): nothing is known"
    parts = []
    for case in cases:
        for key, name in (("time_step", "finest time step"), ("mesh", "finest mesh")):
            found = case[key]
            where = f"at friction {case['friction']:g} "
            if found is None:
                parts.append(f"{where}{name.removeprefix('finest ')} not studied")
            else:
                parts.append(
                    f"{where}{1e3 * found['mean_m']:.2f} mm from the {name} on average, "
                    f"{1e3 * found['mean_largest_m']:.2f} mm at the worst moment "
                    f"({1e3 * found['shifted_largest_m']:.2f} mm if it may be shifted in time)"
                )
    return f"{verdict or 'not known to be converged'}: {'; '.join(parts)}"
