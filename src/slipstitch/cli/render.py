"""Images of simulations, their verification, and previews."""

import sys
from functools import partial
from pathlib import Path

from click import argument, option

from slipstitch.cli import options

# What each way to run needs and what it takes besides; all else is refused.
MODES = {
    "--preview": (("shards",), ("out_sheet", "out_video")),
    "--verify": (("trajectories", "packs", "out", "shards"), ()),
    "--from-shading": (("trajectory", "out_dir"), ()),
    "--shading": (("trajectory", "viewpoint"), ()),
    "rendering": (("trajectory", "viewpoint", "out"), ()),
}


@options.verb(
    "slipstitch render --config config.yaml --trajectory results/simulate/m05_f0300_r00.parquet "
    "--viewpoint v00 --out results/render/m05_f0300_r00_v00.parquet"
)
@options.config_files("YAML or JSON configuration (default: built-in)", False, one_each=True)
@option("--trajectory", type=options.FILE, help="trajectory written by simulate")
@options.several("--viewpoint", metavar="ID", help="id v00 ... or name; several with --shading")
@option(
    "--out",
    type=options.Output(".parquet", ".json"),
    help="image shard to write (Parquet); with --verify: comparisons (JSON)",
)
@options.several(
    "--shading", type=options.PARQUET, help="first of two steps: a shading pack of each viewpoint"
)
@options.several("--from-shading", type=options.FILE, help="second step: texture these packs")
@option("--out-dir", type=options.FOLDER, help="with --from-shading: folder for the image shards")
@options.switch("--verify", "render a random sample of the images in SHARDS directly and compare")
@option("--trajectories", type=options.DIR, help="with --verify: folder of the simulations")
@option("--packs", type=options.DIR, help="with --verify: folder of the shading packs")
@options.switch("--preview", "write previews of SHARDS, without Blender")
@option("--out-sheet", type=options.Output(".png"), help="with --preview: contact sheet (PNG)")
@option("--out-video", type=options.Output(".mp4"), help="with --preview: video (MP4)")
@argument("shards", nargs=-1, type=options.FILE, metavar="[SHARDS...]", help="image shards")
def render(arguments: options.Arguments) -> None:
    """Render a simulation with every texture; verify images; write previews."""
    runs = {"preview": _preview, "verify": _verify, "from_shading": _compose, "shading": _shade}
    chosen = next((name for name in runs if options.given(arguments, name)), None)
    mode = "rendering" if chosen is None else options.flag(chosen)
    needed, taken = MODES[mode]
    others = [name for names in MODES.values() for group in names for name in group]
    ignored = {*runs, *others} - {chosen, *needed, *taken}
    options.refuse(arguments, sorted(ignored), mode)
    options.require(arguments, needed, mode)
    (runs[chosen] if chosen else _render)(arguments)


def _preview(arguments: options.Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.images.image_shards import preview

    if not (arguments.out_sheet or arguments.out_video):
        raise BadInput("--preview requires --out-sheet or --out-video")
    preview(list(arguments.shards), arguments.out_sheet, arguments.out_video)
    for path in (arguments.out_sheet, arguments.out_video):
        if path:
            print(path)


def _verify(arguments: options.Arguments) -> None:
    from slipstitch.base.progress import progress
    from slipstitch.images.verification import verify

    folders = arguments.trajectories, arguments.packs
    config, shards = options.configuration(arguments), list(arguments.shards)
    done = verify(config, shards, *folders, arguments.out, partial(progress, unit="frame"))
    for image in done:
        print(f"{image.video} frame {image.frame}: {image.psnr_db:.1f} dB, SSIM {image.ssim:.3f}")


def _compose(arguments: options.Arguments) -> None:
    from slipstitch.images.image_shards import render_shards_from_packs

    config = options.configuration(arguments)
    packs, folder = list(arguments.from_shading), arguments.out_dir
    for out, done in render_shards_from_packs(config, arguments.trajectory, packs, folder):
        print(f"{out}: {done['images']} images of {done['frames']} frames, {done['viewpoint']}")


def _shade(arguments: options.Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.base.progress import progress
    from slipstitch.images.packing import write_pack
    from slipstitch.images.view import View

    config, names, files = options.configuration(arguments), arguments.viewpoint, arguments.shading
    if not len(names) == len(set(names)) == len(set(files)) == len(files):
        raise BadInput("--shading requires one file for each --viewpoint, and none twice")
    views = [View.of(config, arguments.trajectory, name) for name in names]
    for view, out in zip(views, files, strict=True):
        pack = write_pack(view, out, partial(progress, unit="frame"))
        _warn(out, pack.metadata["smallest_share_of_cloth_in_image"])
        print(f"{out}: shading of {len(pack.shots)} frames, {view.viewpoint}")


def _render(arguments: options.Arguments) -> None:
    from slipstitch.base.errors import BadInput
    from slipstitch.base.progress import progress
    from slipstitch.images.image_shards import render_shard
    from slipstitch.images.view import View

    if len(arguments.viewpoint) > 1:
        raise BadInput("--out takes images of one --viewpoint")
    view = View.of(options.configuration(arguments), arguments.trajectory, arguments.viewpoint[0])
    done = render_shard(view, arguments.out, progress=partial(progress, unit="frame"))
    _warn(arguments.out, done["smallest_share_of_cloth_in_image"])
    print(f"{arguments.out}: {done['images']} images of {done['frames']} frames, {view.viewpoint}")


def _warn(path: Path, share_inside: float) -> None:
    if share_inside < 1:
        out = f"part of the cloth is outside an image: at least {share_inside:.1%} of its vertices"
        print(f"{path}: {out} are inside", file=sys.stderr)
