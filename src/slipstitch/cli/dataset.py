"""The dataset: from rendered images to a release; a release verified, traced, made again."""

import json
import os
import re
from collections import Counter
from pathlib import Path

import click
from click import argument, option

from slipstitch.base.errors import BadInput
from slipstitch.base.project import project_folder
from slipstitch.cli import options


@options.verb(
    "slipstitch sample --config results/config.json --out-dir results/sample "
    "results/render/*_v*.parquet"
)
@options.config_files(one_each=True)
@option("--out-dir", type=options.FOLDER, required=True, help="folder for the dataset")
@argument("shards", nargs=-1, required=True, metavar="SHARD...", help="all shards of the grid")
def sample(arguments: options.Arguments) -> None:
    """Select frames of the rendered videos, draw the splits, write the dataset."""
    from slipstitch.dataset.dataset import write_dataset

    rows = write_dataset(options.configuration(arguments), arguments.shards, arguments.out_dir)
    simulations = {row["simulation"] for row in rows}
    print(f"{len(rows)} videos of {len(simulations)} simulations, {rows[0]['frames']} frames each")
    for split in ("split_by_video", "split_by_simulation"):
        sides = Counter(row[split] for row in rows)
        parts = ", ".join(f"{sides[side]} {side}" for side in ("train", "validation", "test"))
        print(f"{split.removeprefix('split_')}: {parts}")


@options.verb(
    "slipstitch release --config results/config.json --results results --out-dir results/release"
)
@options.config_files("YAML or JSON configuration of the results")
@option("--results", default="results", show_default=True, help="results folder")
@option("--out-dir", type=options.FOLDER, required=True, help="folder that does not exist yet")
@option("--project", default=project_folder, help="the workflow's folder (default: the package's)")
@option("--sign", metavar="KEY", help="SSH key for a signature, as audit --verify checks it")
def release(arguments: options.Arguments) -> None:
    """Write the dataset as a folder to distribute: shards, splits, card, metadata, records."""
    from slipstitch.dataset.release.assembly import write_release

    folders = arguments.results, arguments.out_dir, arguments.project
    done = write_release(options.configuration(arguments), *folders, arguments.sign)
    print(
        f"{arguments.out_dir}: {done['videos']} videos, {done['images']} images, "
        f"{done['files']} files, {done['size_bytes'] / 1e6:.1f} MB"
    )
    print(f"SHA-256 of SHA256SUMS, to be published separately: {done['sums_sha256']}")


@options.verb("slipstitch audit results/release --json audit.json --page audit.html")
@argument("release", type=options.DIR, metavar="RELEASE_DIR", help="as release or publish wrote it")
@options.config_files("current configuration, to compare with", required=False, one_each=True)
@option("--expect", metavar="DIGEST", help="SHA-256 of SHA256SUMS as stated by the publisher")
@option("--explain", metavar="CLIP", help="instead: trace one clip back to its origin")
@option("--verify", type=options.FILE, metavar="SIGNERS", help="file with lines NAME PUBLIC_KEY")
@option("--rebuild", metavar="CLIP", help="instead: make one clip again and compare the pixels")
@options.switch("--allow-stale", "exit with 0 if only code or configuration has changed since")
@option("--json", type=options.Output(".json", or_stdout=True), help="the findings; - for stdout")
@option("--page", type=options.PAGE, help="write the findings as an HTML page")
@option("--jobs", type=click.IntRange(1), default=min(8, os.cpu_count() or 1), help="threads")
def audit(arguments: options.Arguments) -> int:
    """Verify a release down to the pixels, trace the origin of a clip, regenerate a clip.

    Without --verify or --expect, an audit finds accidents, not a deliberate forger. Exit code 0 for
    an intact release or an identical clip, else 1.
    """
    from slipstitch.dataset.audit.contents import read_contents
    from slipstitch.dataset.audit.published import INDEX

    ignored = ("config", "expect", "verify", "allow_stale", "page")
    if arguments.explain:
        options.refuse(arguments, ("rebuild", "json", *ignored), "--explain")
    elif arguments.rebuild:
        options.refuse(arguments, ignored, "--rebuild")
    for path in (arguments.json, arguments.page):
        inside = path and path.resolve().is_relative_to(arguments.release.resolve())
        if inside and not _is_stdout(path):
            problem = "is inside the release, where it would be an unknown file"
            raise BadInput(f"{path}: {problem}; choose another folder")
    if arguments.expect and not re.fullmatch(r"[0-9a-fA-F]{64}", arguments.expect):
        raise BadInput(f"--expect {arguments.expect}: must be a SHA-256, 64 hexadecimal digits")
    if (arguments.release / INDEX).is_file():
        options.refuse(arguments, ("explain", "rebuild", *ignored), "a published folder")
        return _published(arguments)
    if arguments.explain:
        from slipstitch.dataset.audit.auditing import explain
        from slipstitch.dataset.audit.findings import printable

        story = explain(read_contents(arguments.release), arguments.explain)
        print("\n".join(map(printable, story.split("\n"))))
        return 0
    if arguments.rebuild:
        return _rebuild(arguments)
    return _audit(arguments)


def _is_stdout(path: Path | None) -> bool:
    return path == Path("-")


def _tell(arguments: options.Arguments, content: dict, text: str) -> None:
    """Print the text, or its content as JSON; write that where it is wanted."""
    from slipstitch.base.provenance import write_json

    if _is_stdout(arguments.json):
        print(json.dumps(content, indent=1))
        return
    if arguments.json is not None:
        write_json(arguments.json, content, allow_nan=True)
    print(text)


def _rebuild(arguments: options.Arguments) -> int:
    from slipstitch.dataset.audit.auditing import in_words, rebuild
    from slipstitch.dataset.audit.contents import read_contents

    done = rebuild(read_contents(arguments.release), arguments.rebuild)
    _tell(arguments, vars(done), in_words(done))
    return 0 if done.same else 1


def _published(arguments: options.Arguments) -> int:
    from slipstitch.base.provenance import file_digest
    from slipstitch.dataset.audit.published import audit_published
    from slipstitch.film.measure import SHIPPED
    from slipstitch.learning.evaluation.scores import recomputed

    shipped = file_digest(SHIPPED / "instrument.safetensors")
    audit = audit_published(arguments.release, shipped, recomputed)
    _tell(arguments, audit.as_json(), audit.as_text())
    return 1 if audit.findings else 0


def _audit(arguments: options.Arguments) -> int:
    from slipstitch.dataset.audit.auditing import audit_release
    from slipstitch.dataset.audit.findings import as_text, write_page

    config = options.configuration(arguments) if arguments.config else None
    told = arguments.expect, arguments.jobs, arguments.verify
    audit = audit_release(arguments.release, config, *told)
    _tell(arguments, audit.as_json(), as_text(audit))
    if arguments.page:
        write_page(audit, arguments.page)
    good = {"intact", "stale"} if arguments.allow_stale else {"intact"}
    return 0 if audit.verdict in good else 1
