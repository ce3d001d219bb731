"""slipstitch capture surrogate: simulated videos of a bench."""

import argparse
from functools import partial

from slipstitch.cli.options import add_config, output_folder_path, output_path

SUMMARY = "generate surrogate captures: simulated videos, labelled as surrogates"
EXAMPLE = (
    "slipstitch capture surrogate --config results/config.json --film c00_r01 "
    "--out results/captures/bench/c00_r01.mp4"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(parser)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--bench",
        type=output_folder_path,
        metavar="DIR",
        help="folder for the camera files, slip_angles.csv and captures.csv",
    )
    what.add_argument("--film", metavar="ID", help="simulate and render one video: c00_r01 ...")
    parser.add_argument(
        "--out", type=output_path(".mp4"), metavar="FILE", help="with --film: the video (MP4)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the bench's tables, or one film."""
    from slipstitch.base.errors import BadInput
    from slipstitch.config import load_config

    config = load_config(*arguments.config)
    if arguments.bench:
        if arguments.out:
            raise BadInput("--out requires --film")
        from slipstitch.film.surrogate_bench import write_bench

        write_bench(config, arguments.bench)
        print(f"{arguments.bench}: {len(config.captures.surrogate_ids())} surrogate captures")
        return
    from slipstitch.base.progress import progress
    from slipstitch.film.surrogate_bench import find_film
    from slipstitch.film.surrogate_film import make_film

    if not arguments.out:
        raise BadInput("--film requires --out FILE.mp4")
    film = find_film(config, arguments.film)
    count = make_film(config, film, arguments.out, partial(progress, unit="frame"))
    print(
        f"{arguments.out}: {count} frames, {film.pair.material} on {film.pair.substrate}, "
        f"repeat {film.repeat} (surrogate)"
    )
