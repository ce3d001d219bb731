"""slipstitch audit: verify a release, trace or regenerate one of its clips."""

import argparse
import os
import re
from pathlib import Path

from slipstitch.cli.options import add_config, output_json, output_page, refuse, writing

SUMMARY = (
    "verify a release down to the pixels, trace the origin of a clip, regenerate a clip; without "
    "--verify or --expect, it finds accidents, not a deliberate forger"
)
EXAMPLE = "slipstitch audit results/release --json audit.json --page audit.html"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "release",
        type=Path,
        metavar="RELEASE_DIR",
        help="folder of a release, or one that slipstitch publish wrote: its models are followed "
        "to their simulations",
    )
    add_config(
        parser,
        "current configuration, to report what it would change",
        required=False,
        one_each=True,
    )
    parser.add_argument(
        "--expect", metavar="DIGEST", help="SHA-256 of SHA256SUMS as stated by the publisher"
    )
    parser.add_argument(
        "--explain", metavar="CLIP", help="instead: trace one clip back to its origin"
    )
    parser.add_argument(
        "--verify",
        type=Path,
        metavar="ALLOWED_SIGNERS",
        help="allowed signers: a file with lines NAME PUBLIC_KEY, as for ssh-keygen -Y",
    )
    parser.add_argument(
        "--rebuild",
        metavar="CLIP",
        help="instead: simulate and render one clip from its record and compare the pixels",
    )
    parser.add_argument(
        "--allow-stale",
        action="store_true",
        help="exit with 0 if only code or configuration has changed since",
    )
    parser.add_argument(
        "--json",
        type=_json_or_stdout,
        metavar="FILE",
        help="write the findings as JSON; - for stdout",
    )
    parser.add_argument(
        "--page", type=output_page, metavar="FILE", help="write the findings as an HTML page"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=min(8, os.cpu_count() or 1),
        help="threads (default: %(default)s)",
    )


@writing
def _json_or_stdout(text: str) -> str:
    return text if text == "-" else output_json(text)


def run(arguments: argparse.Namespace) -> int:
    """Return 0 for an intact release or an identical clip, else 1."""
    from slipstitch.base.errors import BadInput
    from slipstitch.dataset.audit.contents import read_contents
    from slipstitch.dataset.audit.published import INDEX

    ignored = ("config", "expect", "verify", "allow_stale", "page")
    if arguments.explain:
        refuse(arguments, ("rebuild", "json", *ignored), "--explain")
    elif arguments.rebuild:
        refuse(arguments, ignored, "--rebuild")
    if arguments.jobs < 1:
        raise BadInput(f"--jobs {arguments.jobs}: must be at least 1")
    for path in (arguments.json, arguments.page):
        if path not in (None, "-") and _inside(Path(path), arguments.release):
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
        from slipstitch.dataset.audit.audit_page import printable
        from slipstitch.dataset.audit.explain import explain

        story = explain(read_contents(arguments.release), arguments.explain)
        print("\n".join(map(printable, story.split("\n"))))
        return 0
    if arguments.rebuild:
        return _rebuild(arguments)
    return _audit(arguments)


def _inside(path: Path, folder: Path) -> bool:
    return path.resolve().is_relative_to(folder.resolve())


def _write(text: str, path: str | None) -> None:
    from slipstitch.base.provenance import write_text

    if path == "-":
        print(text)
    elif path is not None:
        write_text(path, text + "\n")


def _rebuild(arguments: argparse.Namespace) -> int:
    from slipstitch.dataset.audit.contents import read_contents
    from slipstitch.dataset.audit.rebuild import as_json, in_words, rebuild

    done = rebuild(read_contents(arguments.release), arguments.rebuild)
    _write(as_json(done), arguments.json)
    if arguments.json != "-":
        print(in_words(done))
    return 0 if done.same else 1


def _published(arguments: argparse.Namespace) -> int:
    import json

    from slipstitch.base.provenance import file_digest
    from slipstitch.dataset.audit.published import audit_published
    from slipstitch.film.measure import SHIPPED

    shipped = file_digest(SHIPPED / "instrument.safetensors")
    audit = audit_published(arguments.release, shipped)
    _write(json.dumps(audit.as_json(), indent=1), arguments.json)
    if arguments.json != "-":
        print(audit.as_text())
    return 1 if audit.findings else 0


def _audit(arguments: argparse.Namespace) -> int:
    import json

    from slipstitch.config import load_config
    from slipstitch.dataset.audit.audit_page import as_text, write_page
    from slipstitch.dataset.audit.auditing import audit_release

    config = load_config(*arguments.config) if arguments.config else None
    audit = audit_release(
        arguments.release, config, arguments.expect, arguments.jobs, arguments.verify
    )
    _write(json.dumps(audit.as_json(), indent=1), arguments.json)
    if arguments.page:
        write_page(audit, Path(arguments.page))
    if arguments.json != "-":
        print(as_text(audit))
    good = {"intact", "stale"} if arguments.allow_stale else {"intact"}
    return 0 if audit.verdict in good else 1
