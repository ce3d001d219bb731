"""A single drop-and-drag run, or simulations of the grid."""

import click
from click import option

from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.cli import options


@options.verb(
    "slipstitch simulate --material gray-interlock --friction 0.3 --seed 0 --out x.parquet"
)
@options.several("--out", type=options.PARQUET, required=True, help="a Parquet file per simulation")
@options.config_files(required=False)
@options.calibration_file
@options.several("--simulation", metavar="ID", help="id in the configured grid: m05_f0300_r00 ...")
@option("--device", help="cpu, cuda, cuda:1 ... (default: compute.device of the configuration)")
@option(
    "--handed-out",
    metavar="DIR",
    help="folder of simulations that are taken instead (default: compute.handed_out)",
)
@option("--material", help="a fabric of the catalogue")
@option("--friction", type=float, help="friction coefficient between cloth and floor")
@option("--seed", type=click.IntRange(0), help="seed of the bench's perturbation (default: 0)")
@option("--model", metavar="FILE", help="extended model written by slipstitch criticise --model")
@option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="a simulation setting")
def simulate(arguments: options.Arguments) -> None:
    """Simulate a drop-and-drag run of a fabric at a friction coefficient."""
    from slipstitch.config.section import FRICTION_MAX

    by_hand = None not in (arguments.material, arguments.friction)
    if arguments.simulation:
        options.refuse(arguments, ("material", "friction", "seed"), "--simulation")
        if not arguments.config:
            raise BadInput("--simulation requires --config")
    elif not by_hand:
        raise BadInput("give either --material and --friction, or --simulation with --config")
    elif not 0 <= arguments.friction <= FRICTION_MAX:
        allowed = f"must lie between 0 and {FRICTION_MAX:g}"
        raise BadInput(f"--friction {arguments.friction:g}: {allowed}")
    config = _configuration(arguments, by_hand)

    from slipstitch.physics.simulation.drop_and_drag import DropAndDrag
    from slipstitch.physics.simulation.simulation_files import run_of_the_grid, simulate_to_file

    if by_hand:
        run = DropAndDrag(arguments.material, arguments.friction, arguments.seed or 0)
        runs: list = [(run, {})]
    else:
        runs = [run_of_the_grid(config, name) for name in arguments.simulation]
    out = [str(path) for path in arguments.out]
    if len(runs) != len(out):
        raise BadInput(f"{len(out)} files in --out for {len(runs)} simulations: must be one each")
    if len(set(out)) < len(out):
        raise BadInput("--out: names a file twice")
    failed = []
    given = {name: getattr(arguments, name) for name in ("device", "calibration", "handed_out")}
    for (run, ids), path in zip(runs, out, strict=True):
        try:
            trajectory, record = simulate_to_file(config, run, ids, path, **given)
        except NotConverged as error:  # the others are simulated all the same
            failed.append(str(error))
            continue
        solver, origin = trajectory.metadata["solver"], record.get("handed_out")
        cost = f"handed out as {origin['file']}" if origin else f"{record['cpu_s']:.1f} CPU s"
        print(
            f"{path}: {run.material}, friction {run.friction:g}, {len(trajectory.frame)} frames, "
            f"{solver['steps']} steps, {solver['newton_iterations']} iterations, "
            f"{solver['halvings']} halvings, largest residual {solver['largest_residual']:.1e}, "
            f"{cost}"
        )
    if failed:
        raise NotConverged("; ".join(failed))


def _configuration(arguments: options.Arguments, by_hand: bool):
    """The configuration, then the calibration's settings, then ``--set``."""
    from slipstitch.base.provenance import load_yaml
    from slipstitch.config import load_config

    changes = {}
    for text in arguments.overrides:
        key, equals, value = text.partition("=")
        if not equals:
            raise BadInput(f"--set {text}: must be KEY=VALUE, e.g. time_step_s=0.01")
        try:
            changes[key.strip()] = load_yaml(value, f"--set {text}")
        except BadInput:
            raise BadInput(f"--set {text}: invalid value") from None
    if arguments.model:
        if "model" in changes:
            raise BadInput("--model cannot be combined with --set model")
        changes["model"] = arguments.model
    # A single run is not sampled: use the smallest number allowed.
    overrides = {"sample": {"sample": {"frames": 2}}} if by_hand else {}
    overrides["--set"] = {"simulation": changes}
    how = {"calibration": arguments.calibration, "overrides": overrides}
    return load_config(*arguments.config, **how, words=True)
