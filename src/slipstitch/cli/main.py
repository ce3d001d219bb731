"""The command line: ``slipstitch VERB ...``; each verb is a module in this package.

A verb's module is imported only when that verb runs: ``slipstitch --help`` stays fast and works
even without bpy or torch. The summaries are read from the sources, not by importing.
A verb has ``SUMMARY``, ``EXAMPLE``, ``configure(parser)`` and ``run(arguments)``, which may return
an exit code.
"""

import argparse
import ast
import difflib
import importlib
import os
import resource
import sys
from pathlib import Path
from typing import NoReturn

from slipstitch import __version__
from slipstitch.base.errors import BadInput, SlipstitchError, refused_by_the_machine
from slipstitch.base.threads import use_one_thread
from slipstitch.cli.options import refuse_overwriting

# In the order of the chain.
VERBS = (
    "doctor",
    "init",
    "calibrate",
    "simulate",
    "render",
    "sample",
    "train",
    "instrument",
    "evaluate",
    "ablate",
    "report",
    "status",
    "publish",
    "release",
    "audit",
    "capture",
    "measure",
    "criticise",
    "predict",
    "protocol",
)
# Only called by the workflow and the Makefile; hidden.
WORKFLOW_VERBS = ("grid", "convergence", "schema")

# Bytes; mostly for the libraries of Blender, Warp and PyTorch, even if unused.
LEAST_ADDRESS_SPACE = 2 * 2**30


class _Parser(argparse.ArgumentParser):
    """A parser that reports bad usage in one line instead of the whole usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def summary(verb: str) -> str:
    """The verb's ``SUMMARY``, read from its source without importing it."""
    source = Path(__file__).with_name(f"{verb}.py").read_text(encoding="utf-8")
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and any(
            isinstance(target, ast.Name) and target.id == "SUMMARY" for target in node.targets
        ):
            return str(ast.literal_eval(node.value))
    return ""


def _overview() -> str:
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {summary(verb)}" for verb in VERBS]
    return "\n".join(
        [
            "usage: slipstitch VERB [options]",
            "",
            "Measure the friction coefficient of cloth from video.",
            "",
            "verbs:",
            *lines,
            "",
            "slipstitch VERB --help shows a verb's options and an example;",
            "snakemake --cores 2 all runs the whole chain.",
        ]
    )


def _parser(verb: str, module) -> argparse.ArgumentParser:
    example = getattr(module, "EXAMPLE", "")
    parser = _Parser(
        prog=f"slipstitch {verb}",
        description=getattr(module, "SUMMARY", ""),
        epilog=f"example:\n  {example}" if example else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.configure(parser)
    return parser


def _one_line(error: BaseException) -> str:
    """The message of an error as one printable line."""
    words = " ".join(str(error).split()) or type(error).__name__
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in words)


def _refuse_tight_memory() -> None:
    """Refuse to work in less address space than the libraries require.

    Otherwise OpenBLAS would retry a failed allocation for ever.
    """
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST_ADDRESS_SPACE:
        raise SlipstitchError(
            f"not enough memory: the limit is {limit // 2**20} MiB (ulimit -v), at least "
            f"{LEAST_ADDRESS_SPACE // 2**20} MiB are required"
        )


def _say_cpu_time() -> None:
    """What the job took, with the killed attempts that it went on from."""
    from slipstitch.base.provenance import earlier_attempts

    wall_s, cpu_s = earlier_attempts()
    if wall_s:
        print(f"wall time of earlier attempts: {wall_s:.2f} s", file=sys.stderr)
    print(f"CPU time: {sum(os.times()[:4]) + cpu_s:.2f} s", file=sys.stderr)


def main(arguments: list[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    arguments : list of str, optional
        The words after ``slipstitch``; those of the process by default.

    Returns
    -------
    int
        0 success, 2 bad input, 1 anything else. Unexpected exceptions are
        raised: their traceback reports a bug. Errors of the machine (disk, memory,
        permission) are reported in one line, too.
    """
    for stream in (sys.stdout, sys.stderr):  # file names may not be valid text
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else list(arguments)
    if not words or words[0] in ("-h", "--help"):
        print(_overview(), file=sys.stdout if words else sys.stderr)
        return 0 if words else 2
    if words[0] == "--version":
        print(f"slipstitch {__version__}")
        return 0
    verb = words[0]
    if verb not in VERBS + WORKFLOW_VERBS:
        close = difflib.get_close_matches(verb, VERBS, n=1)
        hint = f"did you mean {close[0]}?" if close else f"verbs: {', '.join(VERBS)}"
        print(f"slipstitch: error: unknown verb {verb!r}; {hint}", file=sys.stderr)
        return 2
    use_one_thread()
    try:
        module = importlib.import_module(f"slipstitch.cli.{verb}")
        parser = _parser(verb, module)
        parsed = parser.parse_args(words[1:])
        refuse_overwriting(parser, parsed)
        _refuse_tight_memory()
        status = module.run(parsed)
        sys.stdout.flush()
        if "SLIPSTITCH_CPU_TIME" in os.environ:  # a job of the workflow: for its log
            _say_cpu_time()
        return int(status or 0)
    except SystemExit as stop:  # argparse: --help (0) or bad usage (2)
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BadInput as error:
        print(f"slipstitch {verb}: error: {_one_line(error)}", file=sys.stderr)
        return 2
    except SlipstitchError as error:
        print(f"slipstitch {verb}: failed: {_one_line(error)}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # `slipstitch ... | head`: not an error, and nothing left to flush to
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"slipstitch {verb}: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        refused = refused_by_the_machine(error)
        if refused is None:
            raise
        reason = _one_line(SlipstitchError(refused))
        print(f"slipstitch {verb}: failed: {reason}; no partial output is left", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
