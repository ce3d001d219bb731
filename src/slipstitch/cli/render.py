"""Images of simulations, their verification, and previews."""

import sys
from functools import partial
from pathlib import Path

from click import argument, option

from slipstitch.cli.checks import flag, given, refuse, require
from slipstitch.cli.options import Arguments, config_files, configuration, several, switch, verb
from slipstitch.cli.parameter_types import DIR, FILE, FOLDER, PARQUET, Output

# What each way to run needs and what it takes besides; all else is refused.
MODES = {
    "--preview": (("shards",), ("out_sheet", "out_video")),
    "--verify": (("trajectories", "packs", "out", "shards"), ()),
    "--from-shading": (("trajectory", "out_dir"), ()),
    "--shading": (("trajectory", "viewpoint"), ()),
    "rendering": (("trajectory", "viewpoint", "out"), ()),
}


@verb(
    "render a simulation with every texture; verify images; write previews",
    "slipstitch render --config config.yaml --trajectory results/simulate/m05_f0300_r00.parquet "
    "--viewpoint v00 --out results/render/m05_f0300_r00_v00.parquet",
)
@config_files(
    "YAML or JSON configuration, later files override earlier ones (default: built-in)",
    required=False,
    one_each=True,
)
@option("--trajectory", type=FILE, help="trajectory written by simulate")
@several(
    "--viewpoint",
    metavar="ID",
    help="id of the configuration (v00 ...) or name of the catalogue (calibrated ...); several "
    "with --shading",
)
@option(
    "--out",
    type=Output(".parquet", ".json"),
    help="image shard to write (Parquet); with --verify: comparisons (JSON)",
)
@several(
    "--shading",
    type=PARQUET,
    help="first of two steps: write a shading pack of each viewpoint, made in Blender, instead of "
    "images",
)
@several(
    "--from-shading",
    type=FILE,
    help="second step: texture the shading of these packs of the trajectory, without Blender",
)
@option(
    "--out-dir",
    type=FOLDER,
    help="with --from-shading: folder for the image shards, named like the packs",
)
@switch("--verify", "render a random sample of the images in SHARDS directly and compare")
@option("--trajectories", type=DIR, help="with --verify: folder of the simulations")
@option("--packs", type=DIR, help="with --verify: folder of the shading packs")
@switch("--preview", "write previews of SHARDS, without Blender")
@option("--out-sheet", type=Output(".png"), help="with --preview: contact sheet (PNG)")
@option("--out-video", type=Output(".mp4"), help="with --preview: video (MP4)")
@argument("shards", nargs=-1, type=FILE, metavar="[SHARDS...]", help="finished image shards")
def render(arguments: Arguments) -> None:
    """Preview, verify, compose or render; print one line on each result."""
    runs = {"preview": _preview, "verify": _verify, "from_shading": _compose, "shading": _shade}
    chosen = next((name for name in runs if given(arguments, name)), None)
    mode = "rendering" if chosen is None else flag(chosen)
    needed, taken = MODES[mode]
    others = [name for names in MODES.values() for group in names for name in group]
    ignored = {*runs, *others} - {chosen, *needed, *taken}
    refuse(arguments, sorted(ignored), mode)
    require(arguments, needed, mode)
    (runs[chosen] if chosen else _render)(arguments)


def _preview(arguments: Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.images.image_shards import preview

    if not (arguments.out_sheet or arguments.out_video):
        raise BadInput("--preview requires --out-sheet or --out-video")
    preview(list(arguments.shards), arguments.out_sheet, arguments.out_video)
    for path in (arguments.out_sheet, arguments.out_video):
        if path:
            print(path)


def _verify(arguments: Arguments) -> None:
    from slipstitch.base.progress import progress
    from slipstitch.images.verification import verify

    done = verify(
        configuration(arguments),
        list(arguments.shards),
        arguments.trajectories,
        arguments.packs,
        arguments.out,
        partial(progress, unit="frame"),
    )
    for image in done:
        print(f"{image.video} frame {image.frame}: {image.psnr_db:.1f} dB, SSIM {image.ssim:.3f}")


def _compose(arguments: Arguments) -> None:
    from slipstitch.images.image_shards import render_shards_from_packs

    config = configuration(arguments)
    packs, folder = list(arguments.from_shading), arguments.out_dir
    for out, done in render_shards_from_packs(config, arguments.trajectory, packs, folder):
        print(f"{out}: {done['images']} images of {done['frames']} frames, {done['viewpoint']}")


def _shade(arguments: Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.base.progress import progress
    from slipstitch.images.packing import write_pack
    from slipstitch.images.view import View

    config, names, files = configuration(arguments), arguments.viewpoint, arguments.shading
    if not len(names) == len(set(names)) == len(set(files)) == len(files):
        raise BadInput("--shading requires one file for each --viewpoint, and none twice")
    views = [View.of(config, arguments.trajectory, name) for name in names]
    for view, out in zip(views, files, strict=True):
        pack = write_pack(view, out, partial(progress, unit="frame"))
        _warn(out, pack.metadata["smallest_share_of_cloth_in_image"])
        print(f"{out}: shading of {len(pack.shots)} frames, {view.viewpoint}")


def _render(arguments: Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.base.progress import progress
    from slipstitch.images.image_shards import render_shard
    from slipstitch.images.view import View

    if len(arguments.viewpoint) > 1:
        raise BadInput("--out takes images of one --viewpoint")
    view = View.of(configuration(arguments), arguments.trajectory, arguments.viewpoint[0])
    done = render_shard(view, arguments.out, progress=partial(progress, unit="frame"))
    _warn(arguments.out, done["smallest_share_of_cloth_in_image"])
    print(f"{arguments.out}: {done['images']} images of {done['frames']} frames, {view.viewpoint}")


def _warn(path: Path, share_inside: float) -> None:
    if share_inside < 1:
        print(
            f"{path}: part of the cloth is outside an image: at least {share_inside:.1%} of its "
            "vertices are inside",
            file=sys.stderr,
        )
