"""``slipstitch render``: images of a simulation from one viewpoint, and previews of images."""

import argparse
import sys
from pathlib import Path

SUMMARY = "render a simulation from one viewpoint with every texture; make previews"
EXAMPLE = (
    "slipstitch render --config config.yaml --trajectory results/simulate/m05_f01_r00.parquet "
    "--viewpoint v00 --out results/render/m05_f01_r00_v00.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        type=Path,
        action="append",
        metavar="FILE",
        help="YAML or JSON configuration, later files override earlier ones (default: built-in)",
    )
    parser.add_argument("--trajectory", type=Path, metavar="FILE", help="what simulate wrote")
    parser.add_argument(
        "--viewpoint",
        metavar="ID",
        help="id of the configuration (v00 ...) or name of the catalogue (calibrated ...)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="image shard to write (Parquet)")
    previews = parser.add_argument_group("previews, from finished shards and without Blender")
    previews.add_argument("--preview", action="store_true", help="make previews of SHARDS")
    previews.add_argument("--out-sheet", type=Path, metavar="FILE", help="contact sheet (PNG)")
    previews.add_argument("--out-video", type=Path, metavar="FILE", help="video (MP4)")
    previews.add_argument("shards", type=Path, nargs="*", metavar="SHARDS", help="image shards")


def run(arguments: argparse.Namespace) -> None:
    if arguments.preview:
        _preview(arguments)
    else:
        _render(arguments)


def _needed(arguments: argparse.Namespace, names: list[str], mode: str) -> None:
    from slipstitch.errors import BadInput

    for name in names:
        if not getattr(arguments, name):
            raise BadInput(f"{mode} needs --{name.replace('_', '-')}")


def _preview(arguments: argparse.Namespace) -> None:
    from slipstitch.errors import BadInput
    from slipstitch.render.preview import preview

    if not arguments.shards:
        raise BadInput("--preview needs at least one shard")
    if not (arguments.out_sheet or arguments.out_video):
        raise BadInput("--preview needs --out-sheet or --out-video")
    for name in ("trajectory", "viewpoint", "out"):
        if getattr(arguments, name):
            raise BadInput(f"--{name} does not go with --preview")
    preview(arguments.shards, arguments.out_sheet, arguments.out_video)
    for path in (arguments.out_sheet, arguments.out_video):
        if path:
            print(path)


def _render(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.errors import BadInput
    from slipstitch.render.catalogue import VIEWPOINTS

    _needed(arguments, ["trajectory", "viewpoint", "out"], "rendering")
    if arguments.shards or arguments.out_sheet or arguments.out_video:
        raise BadInput("shards, --out-sheet and --out-video go with --preview only")
    config = load_config(*(arguments.config or []))
    ids = config.render.viewpoint_ids()
    given = arguments.viewpoint
    name = ids.get(given, given)
    if name not in VIEWPOINTS:
        known = ", ".join(f"{key} ({value})" for key, value in ids.items())
        raise BadInput(
            f"no viewpoint {given!r}; the configuration has {known}; "
            f"by name there are: {', '.join(VIEWPOINTS)}"
        )
    # A viewpoint given by name keeps its id if the configuration has one.
    identity = next((key for key, value in ids.items() if value == name), name)
    from slipstitch.render.shards import render_shard

    done = render_shard(
        arguments.trajectory,
        arguments.out,
        settings=config.render,
        viewpoint_id=identity,
        viewpoint=name,
        frames_sampled=config.sample.frames,
        progress=_progress,
    )
    if done["smallest_share_of_cloth_in_image"] < 1:
        print(
            f"{arguments.out}: part of the cloth lies outside an image: at least "
            f"{done['smallest_share_of_cloth_in_image']:.1%} of its vertices are inside",
            file=sys.stderr,
        )
    print(f"{arguments.out}: {done['images']} images of {done['frames']} frames, {name}")


def _progress(frames: list):
    from tqdm import tqdm

    return tqdm(frames, unit="frame", disable=not sys.stderr.isatty(), file=sys.stderr)
