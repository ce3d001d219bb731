"""A release: verify it, trace or regenerate one of its clips."""

import json
import os
import re
from pathlib import Path

import click
from click import argument, option

from slipstitch.base.errors import BadInput
from slipstitch.cli.checks import refuse
from slipstitch.cli.options import Arguments, config_files, configuration, switch, verb
from slipstitch.cli.parameter_types import FILE, PAGE, Output


@verb(
    "verify a release down to the pixels, trace the origin of a clip, regenerate a clip; without "
    "--verify or --expect, it finds accidents, not a deliberate forger",
    "slipstitch audit results/release --json audit.json --page audit.html",
)
@argument(
    "release",
    type=FILE,
    metavar="RELEASE_DIR",
    help="folder of a release, or one that slipstitch publish wrote: its models are followed "
    "to their simulations",
)
@config_files(
    "current configuration, to report what it would change", required=False, one_each=True
)
@option("--expect", metavar="DIGEST", help="SHA-256 of SHA256SUMS as stated by the publisher")
@option("--explain", metavar="CLIP", help="instead: trace one clip back to its origin")
@option(
    "--verify",
    type=FILE,
    metavar="ALLOWED_SIGNERS",
    help="allowed signers: a file with lines NAME PUBLIC_KEY, as for ssh-keygen -Y",
)
@option(
    "--rebuild",
    metavar="CLIP",
    help="instead: simulate and render one clip from its record and compare the pixels",
)
@switch("--allow-stale", "exit with 0 if only code or configuration has changed since")
@option(
    "--json", type=Output(".json", or_stdout=True), help="write the findings as JSON; - for stdout"
)
@option("--page", type=PAGE, help="write the findings as an HTML page")
@option(
    "--jobs",
    type=click.IntRange(1),
    default=min(8, os.cpu_count() or 1),
    show_default=True,
    help="threads",
)
def audit(arguments: Arguments) -> int:
    """Return 0 for an intact release or an identical clip, else 1."""
    from slipstitch.dataset.audit.contents import read_contents
    from slipstitch.dataset.audit.published import INDEX

    ignored = ("config", "expect", "verify", "allow_stale", "page")
    if arguments.explain:
        refuse(arguments, ("rebuild", "json", *ignored), "--explain")
    elif arguments.rebuild:
        refuse(arguments, ignored, "--rebuild")
    for path in (arguments.json, arguments.page):
        inside = path and path.resolve().is_relative_to(arguments.release.resolve())
        if inside and not _is_stdout(path):
            raise BadInput(
                f"{path}: is inside the release, where it would be an unknown file; "
                "choose another folder"
            )
    if arguments.expect and not re.fullmatch(r"[0-9a-fA-F]{64}", arguments.expect):
        raise BadInput(f"--expect {arguments.expect}: must be a SHA-256, 64 hexadecimal digits")
    if (arguments.release / INDEX).is_file():
        refuse(arguments, ("explain", "rebuild", *ignored), "a published folder")
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


def _tell(arguments: Arguments, content: dict, text: str) -> None:
    """Print the text, or its content as JSON; write that where it is wanted."""
    from slipstitch.base.provenance import write_json

    if _is_stdout(arguments.json):
        print(json.dumps(content, indent=1))
        return
    if arguments.json is not None:
        write_json(arguments.json, content, allow_nan=True)
    print(text)


def _rebuild(arguments: Arguments) -> int:
    from slipstitch.dataset.audit.auditing import in_words, rebuild
    from slipstitch.dataset.audit.contents import read_contents

    done = rebuild(read_contents(arguments.release), arguments.rebuild)
    _tell(arguments, vars(done), in_words(done))
    return 0 if done.same else 1


def _published(arguments: Arguments) -> int:
    from slipstitch.base.provenance import file_digest
    from slipstitch.dataset.audit.published import audit_published
    from slipstitch.film.measure import SHIPPED
    from slipstitch.learning.evaluation.scores import recomputed

    shipped = file_digest(SHIPPED / "instrument.safetensors")
    audit = audit_published(arguments.release, shipped, recomputed)
    _tell(arguments, audit.as_json(), audit.as_text())
    return 1 if audit.findings else 0


def _audit(arguments: Arguments) -> int:
    from slipstitch.dataset.audit.auditing import audit_release
    from slipstitch.dataset.audit.findings import as_text, write_page

    config = configuration(arguments) if arguments.config else None
    audit = audit_release(
        arguments.release, config, arguments.expect, arguments.jobs, arguments.verify
    )
    _tell(arguments, audit.as_json(), as_text(audit))
    if arguments.page:
        write_page(audit, arguments.page)
    good = {"intact", "stale"} if arguments.allow_stale else {"intact"}
    return 0 if audit.verdict in good else 1
