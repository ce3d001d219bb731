"""The convergence study: ``python -m slipstitch.convergence run | compare | publish``.

``run`` simulates one case, ``compare`` compares them all, ``publish`` puts a finished study where
it is kept, and its summary where simulations look it up for their own record.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from slipstitch.threads import use_one_thread

use_one_thread()


def _run(arguments: argparse.Namespace) -> None:
    from slipstitch.convergence.cases import case_settings, cases
    from slipstitch.errors import BadInput
    from slipstitch.provenance import provenance_record, start_clock
    from slipstitch.simulate.drop_and_drag import simulate_drop_and_drag
    from slipstitch.simulate.trajectory import write_trajectory

    started = start_clock()
    config = _config(arguments)
    case = {one.id: one for one in cases(config)}.get(arguments.case)
    if case is None:
        raise BadInput(
            f"the study has no case {arguments.case!r}: its ids are like {cases(config)[0].id}"
        )
    settings = case_settings(case, config, config.simulation)
    trajectory, columns = simulate_drop_and_drag(
        case.material, case.friction, config.convergence.seed, settings
    )
    trajectory.metadata["case"] = case.id
    record = provenance_record(
        "convergence",
        inputs=[arguments.calibration] if arguments.calibration else [],
        config={"simulation": settings},
        seed=config.convergence.seed,
        started=started,
    )
    write_trajectory(arguments.out, trajectory, record, **columns)
    print(f"{arguments.out}: {record['cpu_s']:.1f} CPU s, {trajectory.metadata['solver']}")


def _compare(arguments: argparse.Namespace) -> None:
    from slipstitch.convergence.cases import cases
    from slipstitch.convergence.distance_figure import convergence_figure
    from slipstitch.convergence.study import describe
    from slipstitch.provenance import atomic_path, provenance_record, start_clock, write_sidecar
    from slipstitch.simulate.trajectory import read_trajectory

    started = start_clock()
    config = _config(arguments)
    files = {case.id: Path(arguments.runs) / f"{case.id}.parquet" for case in cases(config)}
    files = {name: file for name, file in files.items() if file.is_file()}
    study = describe(config, {name: read_trajectory(file) for name, file in files.items()})
    if study["missing"]:
        print(f"not run, and not compared: {', '.join(study['missing'])}", file=sys.stderr)
    record = provenance_record(
        "convergence",
        inputs=files.values(),
        config={"convergence": config.convergence, "simulation": config.simulation},
        started=started,
    )
    with atomic_path(arguments.out) as temporary:
        temporary.write_text(json.dumps(study, allow_nan=False) + "\n", encoding="utf-8")
    write_sidecar(arguments.out, record)
    if arguments.picture:
        with atomic_path(arguments.picture) as temporary:
            convergence_figure(study).savefig(temporary, dpi=110)
        write_sidecar(arguments.picture, record)
    for row in study["summary"]:
        for kind in ("time_step", "mesh"):
            if row[kind] is not None:
                print(
                    f"{row['material']:<20} friction {row['friction']:<4g} {kind:<10} "
                    f"mean {1e3 * row[kind]['mean_m']:7.3f} mm, "
                    f"at the worst moment {1e3 * row[kind]['mean_largest_m']:6.2f} mm, "
                    f"worst vertex {1e3 * row[kind]['worst_m']:7.2f} mm, "
                    f"shifted mean {1e3 * row[kind]['shifted_mean_m']:7.3f} mm, "
                    f"events up to {row[kind]['event_shift_s']:.2f} s apart"
                )


def _publish(arguments: argparse.Namespace) -> None:
    from slipstitch.provenance import atomic_path, read_sidecar
    from slipstitch.simulate.convergence import MEASURED

    source = Path(arguments.study)
    study = json.loads(source.read_text(encoding="utf-8"))
    for name in (source, source.with_suffix(".png")):
        read_sidecar(name)  # nothing without a record of its origin is published
        for file in (name, name.with_name(f"{name.name}.provenance.json")):
            with atomic_path(Path(arguments.out) / file.name) as temporary:
                temporary.write_bytes(file.read_bytes())
    own = study["settings"]["convergence"]
    table = {
        "studied": {
            "time_step_s": study["settings"]["time_step_s"],
            "vertices_per_side": own["vertices_per_side"][0],
            "window_s": own["window_s"],
            "converged_mean_m": own["mean_distance_m"],
            "self_contact": study["settings"]["self_contact"],
        },
        "cases": study["summary"],
    }
    with atomic_path(MEASURED) as temporary:
        temporary.write_text(json.dumps(table, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    print(f"{arguments.out}, {MEASURED.name}: {len(study['summary'])} cases")


def _config(arguments: argparse.Namespace):
    from slipstitch.config.load import calibrated_settings, read_mapping, resolve_config

    sources = list(arguments.config)
    mappings = [read_mapping(path) for path in sources]
    if arguments.calibration:
        mappings.append({"simulation": calibrated_settings(arguments.calibration)})
        sources.append(arguments.calibration)
    return resolve_config(*mappings, sources=tuple(sources))


def main() -> int:
    """Run one case, compare those that were run, or publish the comparison."""
    from slipstitch.errors import BadInput, SlipstitchError

    parser = argparse.ArgumentParser(prog="python -m slipstitch.convergence", description=__doc__)
    verbs = parser.add_subparsers(required=True)
    run, compare = verbs.add_parser("run"), verbs.add_parser("compare")
    for one, action in ((run, _run), (compare, _compare)):
        one.add_argument("--config", required=True, nargs="+", help="YAML or JSON configuration")
        one.add_argument("--calibration", help="take the numerical settings that were verified")
        one.set_defaults(action=action)
    publish = verbs.add_parser("publish")
    publish.add_argument("--study", default="results/convergence/convergence.json")
    publish.add_argument("--out", default="results/published/convergence", help="folder")
    publish.set_defaults(action=_publish)
    run.add_argument("--case", required=True, help="id of the case, e.g. m05_f01_n41_h1")
    run.add_argument("--out", required=True, help="Parquet file, one row a frame")
    compare.add_argument("--runs", required=True, help="folder of the cases' files")
    compare.add_argument("--out", required=True, help="JSON file")
    compare.add_argument("--picture", help="PNG file")
    arguments = parser.parse_args()
    try:
        arguments.action(arguments)
    except BadInput as error:
        print(f"convergence: error: {error}", file=sys.stderr)
        return 2
    except SlipstitchError as error:
        print(f"convergence: error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
