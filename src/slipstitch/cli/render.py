"""``slipstitch render``: images of simulations, their verification, and previews."""

import argparse
import sys
from functools import partial
from pathlib import Path

from slipstitch.cli.options import (
    add_config,
    flag,
    output_folder_path,
    output_path,
    refuse,
    require,
)

SUMMARY = "render a simulation from one viewpoint with every texture; verify images; write previews"
EXAMPLE = (
    "slipstitch render --config config.yaml --trajectory results/simulate/m05_f0300_r00.parquet "
    "--viewpoint v00 --out results/render/m05_f0300_r00_v00.parquet"
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_config(
        parser,
        "YAML or JSON configuration, later files override earlier ones (default: built-in)",
        required=False,
        one_each=True,
    )
    parser.add_argument(
        "--trajectory", type=Path, metavar="FILE", help="trajectory written by simulate"
    )
    parser.add_argument(
        "--viewpoint",
        metavar="ID",
        help="id of the configuration (v00 ...) or name of the catalogue (calibrated ...)",
    )
    parser.add_argument(
        "--out",
        type=output_path(".parquet", ".json"),
        metavar="FILE",
        help="image shard to write (Parquet); with --verify: comparisons (JSON)",
    )
    halves = parser.add_argument_group("in two steps: shading in Blender, then textures without it")
    halves.add_argument(
        "--shading",
        type=output_path(".parquet"),
        metavar="FILE",
        help="write a shading pack instead of images",
    )
    halves.add_argument(
        "--from-shading",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="use the shading of these packs of the trajectory, without Blender",
    )
    halves.add_argument(
        "--out-dir",
        type=output_folder_path,
        metavar="DIR",
        help="folder for the image shards, named like the packs",
    )
    verification = parser.add_argument_group("verification of finished shards")
    verification.add_argument(
        "--verify",
        action="store_true",
        help="render a random sample of the images in SHARDS directly and compare",
    )
    verification.add_argument(
        "--trajectories", type=Path, metavar="DIR", help="folder of the simulations"
    )
    verification.add_argument(
        "--packs", type=Path, metavar="DIR", help="folder of the shading packs"
    )
    previews = parser.add_argument_group("previews of finished shards, without Blender")
    previews.add_argument("--preview", action="store_true", help="write previews of SHARDS")
    previews.add_argument(
        "--out-sheet", type=output_path(".png"), metavar="FILE", help="contact sheet (PNG)"
    )
    previews.add_argument(
        "--out-video", type=output_path(".mp4"), metavar="FILE", help="video (MP4)"
    )
    previews.add_argument("shards", type=Path, nargs="*", metavar="SHARDS", help="image shards")


# What each way to run needs and what it takes besides; all else is refused.
MODES = {
    "--preview": (("shards",), ("out_sheet", "out_video")),
    "--verify": (("trajectories", "packs", "out", "shards"), ()),
    "--from-shading": (("trajectory", "out_dir"), ()),
    "--shading": (("trajectory", "viewpoint"), ()),
    "rendering": (("trajectory", "viewpoint", "out"), ()),
}


def run(arguments: argparse.Namespace) -> None:
    """Preview, verify, compose or render; print one line on each result."""
    runs = {"preview": _preview, "verify": _verify, "from_shading": _compose, "shading": _render}
    chosen = next((name for name in runs if getattr(arguments, name)), None)
    mode = "rendering" if chosen is None else flag(chosen)
    needed, taken = MODES[mode]
    others = [name for names in MODES.values() for group in names for name in group]
    ignored = {*runs, *others} - {chosen, *needed, *taken}
    refuse(arguments, sorted(ignored), mode)
    require(arguments, needed, mode)
    (runs[chosen] if chosen else _render)(arguments)


def _preview(arguments: argparse.Namespace) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.images.preview import preview

    if not (arguments.out_sheet or arguments.out_video):
        raise BadInput("--preview requires --out-sheet or --out-video")
    preview(arguments.shards, arguments.out_sheet, arguments.out_video)
    for path in (arguments.out_sheet, arguments.out_video):
        if path:
            print(path)


def _verify(arguments: argparse.Namespace) -> None:
    from slipstitch.base.progress import progress
    from slipstitch.config import load_config
    from slipstitch.images.verification import verify

    done = verify(
        load_config(*arguments.config),
        arguments.shards,
        arguments.trajectories,
        arguments.packs,
        arguments.out,
        partial(progress, unit="frame"),
    )
    for image in done:
        print(f"{image.video} frame {image.frame}: {image.psnr_db:.1f} dB, SSIM {image.ssim:.3f}")


def _compose(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.images.image_shards import render_shards_from_packs

    config = load_config(*arguments.config)
    packs, folder = arguments.from_shading, arguments.out_dir
    for out, done in render_shards_from_packs(config, arguments.trajectory, packs, folder):
        print(f"{out}: {done['images']} images of {done['frames']} frames, {done['viewpoint']}")


def _render(arguments: argparse.Namespace) -> None:
    from slipstitch.base.progress import progress
    from slipstitch.config import load_config
    from slipstitch.images.image_shards import render_shard
    from slipstitch.images.packing import write_pack
    from slipstitch.images.view import View

    config = load_config(*arguments.config)
    bar = partial(progress, unit="frame")
    view = View.of(config, arguments.trajectory, arguments.viewpoint)
    if arguments.shading:
        pack = write_pack(view, arguments.shading, bar)
        _warn(arguments.shading, pack.metadata["smallest_share_of_cloth_in_image"])
        print(f"{arguments.shading}: shading of {len(pack.shots)} frames, {view.viewpoint}")
        return
    done = render_shard(view, arguments.out, progress=bar)
    _warn(arguments.out, done["smallest_share_of_cloth_in_image"])
    print(f"{arguments.out}: {done['images']} images of {done['frames']} frames, {view.viewpoint}")


def _warn(path: Path, share_inside: float) -> None:
    if share_inside < 1:
        print(
            f"{path}: part of the cloth is outside an image: at least {share_inside:.1%} of its "
            "vertices are inside",
            file=sys.stderr,
        )
