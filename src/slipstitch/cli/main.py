"""The command line: ``slipstitch VERB ...``; each module of this package holds a few verbs.

A verb's module is imported only when that verb, or the overview, needs it, and the module imports
its wing only when the verb runs: ``slipstitch --help`` stays fast and works without bpy or torch.
"""

import difflib
import importlib
import logging
import os
import resource
import sys

import click

from slipstitch import __version__
from slipstitch.base.errors import BadInput, SlipstitchError, refused_by_the_machine
from slipstitch.base.start import use_one_thread

# Verb -> its module, in the order of the chain.
VERBS = {
    "doctor": "project",
    "init": "project",
    "calibrate": "calibrate",
    "simulate": "simulate",
    "render": "render",
    "sample": "dataset",
    "train": "learning",
    "instrument": "learning",
    "evaluate": "learning",
    "ablate": "learning",
    "report": "project",
    "status": "project",
    "publish": "project",
    "release": "dataset",
    "audit": "dataset",
    "capture": "capture",
    "measure": "measure",
    "criticise": "criticise",
    "predict": "criticise",
    "protocol": "calibrate",
}
# Only called by the workflow and the Makefile; hidden.
WORKFLOW_VERBS = {"grid": "project", "convergence": "calibrate", "schema": "project"}

# Bytes; mostly for the libraries of Blender, Warp and PyTorch, even if unused.
LEAST_ADDRESS_SPACE = 2 * 2**30


class _Verbs(click.Group):
    """All verbs, each imported when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        module = (VERBS | WORKFLOW_VERBS).get(cmd_name)
        if module is None:
            return None
        return getattr(importlib.import_module(f"slipstitch.cli.{module}"), cmd_name)

    def resolve_command(self, ctx: click.Context, args: list[str]):
        if args[0] not in VERBS | WORKFLOW_VERBS:
            close = difflib.get_close_matches(args[0], VERBS, n=1)
            hint = f"did you mean {close[0]}?" if close else f"verbs: {', '.join(VERBS)}"
            raise click.UsageError(f"unknown verb {args[0]!r}; {hint}", ctx)
        return super().resolve_command(ctx, args)


program = _Verbs(
    "slipstitch",
    help="Measure the friction coefficient of cloth from video.",
    epilog="slipstitch VERB --help shows a verb's options and an example; "
    "snakemake --cores 2 all runs the whole chain.",
    subcommand_metavar="VERB [options]",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
click.version_option(__version__, prog_name="slipstitch", message="%(prog)s %(version)s")(program)


def _one_line(error: BaseException | str) -> str:
    """The message of an error as one printable line."""
    words = " ".join(str(error).split()) or type(error).__name__
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in words)


def _fit_address_space() -> None:
    """Refuse less address space than the libraries require; where it is limited, take their part.

    OpenBLAS takes memory at its first product, and retries for ever where there is none left.
    """
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return
    if limit < LEAST_ADDRESS_SPACE:
        raise SlipstitchError(
            f"not enough memory: the limit is {limit // 2**20} MiB (ulimit -v), at least "
            f"{LEAST_ADDRESS_SPACE // 2**20} MiB are required"
        )
    import numpy as np
    from scipy.linalg import blas

    # NumPy and SciPy have an OpenBLAS each; small products go without.
    square = np.eye(512)
    square @ square[0]
    blas.dgemv(1.0, square, square[0])


def _say_cpu_time() -> None:
    """What the job took, with the killed attempts that it went on from."""
    from slipstitch.base.provenance import earlier_attempts

    wall_s, cpu_s = earlier_attempts()
    if wall_s:
        print(f"wall time of earlier attempts: {wall_s:.2f} s", file=sys.stderr)
    print(f"CPU time: {sum(os.times()[:4]) + cpu_s:.2f} s", file=sys.stderr)


def _run(words: list[str]) -> int:
    """Parse, run; the verb's exit code."""
    with program.make_context("slipstitch", words) as context:
        _fit_address_space()
        status = program.invoke(context)
        sys.stdout.flush()
        if "SLIPSTITCH_CPU_TIME" in os.environ:  # a job of the workflow: for its log
            _say_cpu_time()
        return int(status or 0)


def main(arguments: list[str] | None = None) -> int:
    """Run one verb, by default that of the process.

    Return 0 for success, 2 for bad input, 3 for an alarm, 1 for anything else. Unexpected
    exceptions are raised, but for errors of the machine (disk, memory, permission).
    """
    for stream in (sys.stdout, sys.stderr):  # file names may not be valid text
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else list(arguments)
    called = f"slipstitch {words[0]}" if words else "slipstitch"
    use_one_thread()
    # Where it cannot write below HOME, matplotlib says so and goes on.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        return _run(words)
    except click.exceptions.Exit as stop:  # --help, --version
        return stop.exit_code
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return 2
    except click.UsageError as error:
        path = error.ctx.command_path if error.ctx else called
        message = _one_line(error.format_message())
        hint = "" if path == "slipstitch" else f" (see {path} --help)"
        print(f"{path}: error: {message}{hint}", file=sys.stderr)
        return 2
    except BadInput as error:
        print(f"{called}: error: {_one_line(error)}", file=sys.stderr)
        return 2
    except SlipstitchError as error:
        print(f"{called}: failed: {_one_line(error)}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # `slipstitch ... | head`: not an error, and nothing left to flush to
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"{called}: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        refused = refused_by_the_machine(error)
        if refused is None:
            raise
        reason = _one_line(refused)
        print(f"{called}: failed: {reason}; no partial output is left", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
