"""``slipstitch render``: images of simulations, their verification, and previews."""

import argparse
import sys
from pathlib import Path

SUMMARY = "render a simulation from one viewpoint with every texture; verify; make previews"
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
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="image shard to write (Parquet); with --verify the comparisons (JSON)",
    )
    halves = parser.add_argument_group("in two steps: the light in Blender, textures without it")
    halves.add_argument(
        "--shading", type=Path, metavar="FILE", help="shading pack to write, instead of images"
    )
    halves.add_argument(
        "--from-shading",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="take the light from these packs of the trajectory, without Blender",
    )
    halves.add_argument(
        "--out-dir", type=Path, metavar="DIR", help="folder of their image shards, named as they"
    )
    verification = parser.add_argument_group("verification, of finished shards")
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
    previews = parser.add_argument_group("previews, from finished shards and without Blender")
    previews.add_argument("--preview", action="store_true", help="make previews of SHARDS")
    previews.add_argument("--out-sheet", type=Path, metavar="FILE", help="contact sheet (PNG)")
    previews.add_argument("--out-video", type=Path, metavar="FILE", help="video (MP4)")
    previews.add_argument("shards", type=Path, nargs="*", metavar="SHARDS", help="image shards")


def run(arguments: argparse.Namespace) -> None:
    if arguments.preview:
        _preview(arguments)
    elif arguments.verify:
        _verify(arguments)
    elif arguments.from_shading:
        _compose(arguments)
    else:
        _render(arguments)


def _needed(arguments: argparse.Namespace, names: list[str], mode: str) -> None:
    from slipstitch.errors import BadInput

    for name in names:
        if not getattr(arguments, name):
            what = "at least one shard" if name == "shards" else f"--{name.replace('_', '-')}"
            raise BadInput(f"{mode} needs {what}")


def _preview(arguments: argparse.Namespace) -> None:
    from slipstitch.errors import BadInput
    from slipstitch.render.preview import preview

    if not arguments.shards:
        raise BadInput("--preview needs at least one shard")
    if not (arguments.out_sheet or arguments.out_video):
        raise BadInput("--preview needs --out-sheet or --out-video")
    _refused(arguments, ["trajectory", "viewpoint", "out", "shading", "from_shading"], "--preview")
    preview(arguments.shards, arguments.out_sheet, arguments.out_video)
    for path in (arguments.out_sheet, arguments.out_video):
        if path:
            print(path)


def _refused(arguments: argparse.Namespace, names: list[str], mode: str) -> None:
    from slipstitch.errors import BadInput

    for name in names:
        if getattr(arguments, name):
            raise BadInput(f"--{name.replace('_', '-')} does not go with {mode}")


def _verify(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.render.verification import verify

    _needed(arguments, ["trajectories", "packs", "out", "shards"], "--verify")
    _refused(arguments, ["trajectory", "viewpoint", "shading", "from_shading"], "--verify")
    done = verify(
        load_config(*(arguments.config or [])),
        arguments.shards,
        arguments.trajectories,
        arguments.packs,
        arguments.out,
        _progress,
    )
    for one in done:
        print(f"{one.video} frame {one.frame}: {one.psnr_db:.1f} dB, SSIM {one.ssim:.3f}")


def _compose(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.provenance import read_metadata
    from slipstitch.render.packing import Job
    from slipstitch.render.shards import render_shard

    _needed(arguments, ["trajectory", "out_dir"], "--from-shading")
    _refused(arguments, ["viewpoint", "shading", "shards", "out"], "--from-shading")
    config = load_config(*(arguments.config or []))
    for pack in arguments.from_shading:
        out = arguments.out_dir / pack.name
        try:
            view = read_metadata(pack).get("viewpoint", {})
        except (OSError, ValueError):
            view = {}  # read_pack says what is wrong with it
        words = (view.get("id", ""), view.get("name", ""))
        job = Job(
            arguments.trajectory, *words, config.render, config.sample.frames_kept, config.seed
        )
        done = render_shard(job, out, pack_path=pack)
        print(f"{out}: {done['images']} images of {done['frames']} frames, {job.viewpoint}")


def _render(arguments: argparse.Namespace) -> None:
    from slipstitch.config import load_config
    from slipstitch.errors import BadInput
    from slipstitch.render.packing import Job, write_pack

    _needed(arguments, ["trajectory", "viewpoint"], "rendering")
    if arguments.shards or arguments.out_sheet or arguments.out_video:
        raise BadInput("shards, --out-sheet and --out-video go with --preview only")
    if not arguments.shading:
        _needed(arguments, ["out"], "rendering")
    elif arguments.out:
        raise BadInput("--out and --shading: one of them; images from a pack: --from-shading")
    config = load_config(*(arguments.config or []))
    job = Job(
        arguments.trajectory,
        *_viewpoint(config.render, arguments.viewpoint),
        config.render,
        config.sample.frames_kept,
        config.seed,
    )
    if arguments.shading:
        pack = write_pack(job, arguments.shading, _progress)
        _warn(arguments.shading, pack.metadata["smallest_share_of_cloth_in_image"])
        print(f"{arguments.shading}: light of {len(pack.shots)} frames, {job.viewpoint}")
        return
    from slipstitch.render.shards import render_shard

    done = render_shard(job, arguments.out, progress=_progress)
    _warn(arguments.out, done["smallest_share_of_cloth_in_image"])
    print(f"{arguments.out}: {done['images']} images of {done['frames']} frames, {job.viewpoint}")


def _viewpoint(settings, given: str) -> tuple[str, str]:
    """Id and name of a viewpoint that is given by either."""
    from slipstitch.catalogue import VIEWPOINTS
    from slipstitch.errors import BadInput

    ids = settings.viewpoint_ids()
    name = ids.get(given, given)
    if name not in VIEWPOINTS:
        known = ", ".join(f"{key} ({value})" for key, value in ids.items())
        raise BadInput(
            f"no viewpoint {given!r}; the configuration has {known}; "
            f"by name there are: {', '.join(VIEWPOINTS)}"
        )
    # A viewpoint given by name keeps its id if the configuration has one.
    return next((key for key, value in ids.items() if value == name), name), name


def _warn(path: Path, share_inside: float) -> None:
    if share_inside < 1:
        print(
            f"{path}: part of the cloth lies outside an image: at least {share_inside:.1%} of its "
            "vertices are inside",
            file=sys.stderr,
        )


def _progress(frames: list):
    from slipstitch.progress import progress

    return progress(frames, unit="frame")
