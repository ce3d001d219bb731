"""slipstitch simulate: a drop-and-drag run by hand, or simulations of the grid."""

import argparse

SUMMARY = "simulate a drop-and-drag run of a fabric at a friction coefficient"
EXAMPLE = "slipstitch simulate --material gray-interlock --friction 0.3 --seed 0 --out x.parquet"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--out", required=True, nargs="+", help="Parquet file, one row a frame; one a simulation"
    )
    parser.add_argument("--config", nargs="+", default=[], help="YAML or JSON configuration")
    parser.add_argument("--calibration", help="take the numerical settings that were verified")
    parser.add_argument(
        "--simulation",
        nargs="+",
        metavar="ID",
        help="in the configured grid, e.g. m05_f01_r00; several are simulated at once",
    )
    parser.add_argument(
        "--device",
        help="where forces and stiffness are evaluated: cpu, cuda, cuda:1 ...; "
        "if not given, compute.device of the configuration",
    )
    parser.add_argument("--material", help="a fabric of the catalogue")
    parser.add_argument("--friction", type=float, help="friction coefficient of cloth and floor")
    parser.add_argument("--seed", type=int, default=0, help="of the bench's perturbation")
    parser.add_argument(
        "--model", metavar="FILE", help="extended model that slipstitch criticise --model wrote"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="overrides",
        help="any simulation setting, e.g. time_step_s=0.01; may be repeated",
    )


def run(arguments: argparse.Namespace) -> None:
    """Simulate and write; prints one line on each result."""
    from slipstitch.errors import BadInput, NotConverged
    from slipstitch.provenance import start_clock
    from slipstitch.simulate.drop_and_drag import simulate_batch

    started = start_clock()
    by_hand = arguments.material is not None and arguments.friction is not None
    if by_hand == (arguments.simulation is not None):
        raise BadInput("either --material and --friction, or --simulation with --config")
    config = _configuration(arguments, by_hand)
    runs = [_by_hand(arguments)] if by_hand else _of_the_grid(arguments, config)
    if len(runs) != len(arguments.out):
        raise BadInput(f"{len(arguments.out)} files --out for {len(runs)} simulations: one each")
    device = arguments.device or config.compute.device
    outcomes = simulate_batch([one for one, _ in runs], config.simulation, device=device)
    failed = []
    for (one, ids), out, outcome in zip(runs, arguments.out, outcomes, strict=True):
        if isinstance(outcome, NotConverged):
            failed.append(_with_state_saved(outcome, out))
        else:
            trajectory, columns = outcome
            trajectory.metadata.update(ids, simulated_at_once=len(runs))
            _write(arguments, config, out, one, trajectory, columns, started)
    if failed:
        raise NotConverged("; ".join(map(str, failed)))


def _by_hand(arguments: argparse.Namespace) -> tuple:
    from slipstitch.errors import BadInput
    from slipstitch.simulate.drop_and_drag import DropAndDrag

    if arguments.seed < 0:
        raise BadInput(f"--seed {arguments.seed}: must be at least 0")
    return DropAndDrag(arguments.material, arguments.friction, arguments.seed), {}


def _of_the_grid(arguments: argparse.Namespace, config) -> list[tuple]:
    """The runs, and what their files say about their place in the grid."""
    from slipstitch.config.grid import find_simulation
    from slipstitch.errors import BadInput
    from slipstitch.simulate.drop_and_drag import DropAndDrag

    if not arguments.config:
        raise BadInput("--simulation needs --config")
    found = [find_simulation(config, name) for name in arguments.simulation]
    return [
        (
            DropAndDrag(one.material, one.friction, one.seed),
            {
                "simulation": one.id,
                "material_id": one.material_id,
                "friction_id": one.friction_id,
                "replicate_id": one.replicate_id,
            },
        )
        for one in found
    ]


def _write(arguments, config, out: str, run, trajectory, columns: dict, started) -> None:
    from slipstitch.provenance import provenance_record
    from slipstitch.simulate.trajectory import write_trajectory

    record = provenance_record(
        "simulate",
        inputs=[path for path in (arguments.calibration, config.simulation.model) if path],
        config={"simulation": config.simulation, "catalogue": run.catalogue_entries()},
        seed=run.seed,
        started=started,
    )
    write_trajectory(out, trajectory, record, **columns)
    solver = trajectory.metadata["solver"]
    count = len(arguments.out)
    print(
        f"{out}: {run.material}, friction {run.friction:g}, {len(trajectory.frame)} frames, "
        f"{solver['steps']} steps, {solver['newton_iterations']} iterations, "
        f"{solver['halvings']} halvings, largest residual {solver['largest_residual']:.1e}, "
        f"{record['cpu_s']:.1f} CPU s" + (f" for all {count}" if count > 1 else "")
    )


def _with_state_saved(error, out: str):
    """Keep what the solver had beside where the result would have been."""
    from pathlib import Path

    import numpy as np

    from slipstitch.errors import NotConverged
    from slipstitch.provenance import atomic_path

    if not error.state:
        return error
    path = Path(out).with_suffix(".failed.npz")
    with atomic_path(path) as partial, open(partial, "wb") as stream:
        np.savez_compressed(stream, **error.state)
    return NotConverged(f"{error}; its state is in {path}")


def _configuration(arguments: argparse.Namespace, by_hand: bool):
    """The configuration, then the calibration's settings, then ``--set``."""
    from slipstitch.config.load import calibrated_settings, read_mapping, resolve_config
    from slipstitch.errors import BadInput
    from slipstitch.provenance import load_yaml

    mappings = [read_mapping(path) for path in arguments.config]
    sources = list(arguments.config)
    if arguments.calibration:
        mappings.append({"simulation": calibrated_settings(arguments.calibration)})
        sources.append(arguments.calibration)
    overrides = {}
    for text in arguments.overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise BadInput(f"--set {text}: must be KEY=VALUE, e.g. time_step_s=0.01")
        try:
            overrides[key.strip()] = load_yaml(value, f"--set {text}")
        except BadInput:
            raise BadInput(f"--set {text}: the value cannot be read") from None
    if arguments.model:
        overrides["model"] = arguments.model
    if by_hand:  # nothing is sampled from it: the least that is allowed
        mappings.append({"sample": {"frames": 2}})
        sources.append("sample")
    mappings.append({"simulation": overrides})
    sources.append("--set")
    return resolve_config(*mappings, sources=tuple(sources), words=True)
