"""The workflow run in a folder of its own, from a copy of the project that may be edited."""

import contextlib
import io
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from slipstitch.base.provenance import code

ROOT = Path(__file__).parents[2]
PARTS = (
    *("Snakefile", "config.yaml", "config", "profiles", "rules", "src", "data/cases"),
    *("LICENSE", "CITATION.cff"),
)


@contextmanager
def digests_of(root: Path):
    """Code digests of the sources below `root`, for the time of the block.

    They are remembered: all copies hold the same sources, but while they are edited.
    """
    running, code.RUNNING = code.RUNNING, root
    try:
        yield
    finally:
        code.RUNNING = running


def forget_digests() -> None:
    """Compute the digests of code anew."""
    code.code_digest.cache_clear()
    code._contents.cache_clear()


@contextmanager
def replaced(path: Path, content: str):
    """A source with other content, for the time of the block."""
    before = path.read_text(encoding="utf-8")
    path.write_text(content, encoding="utf-8")
    forget_digests()
    try:
        yield
    finally:
        path.write_text(before, encoding="utf-8")
        forget_digests()


def source_with(folder: Path, text: str) -> tuple[Path, str]:
    """The one file below `folder` that holds `text`, and its content."""
    contents = {
        path: path.read_text(encoding="utf-8")
        for path in folder.rglob("*")
        if path.suffix in (".py", ".json", ".j2", ".css")
    }
    (found,) = (path for path, content in contents.items() if text in content)
    return found, contents[found]


class Workflow:
    """A copy of the project and a folder that its results go to; those that are there are kept."""

    def __init__(self, folder: Path, scale: str | None = None):
        self.more_python_path: list[Path] = []
        self.project = folder / "project"
        self.folder = folder / "run"
        self.scale = scale
        if self.project.exists():
            forget_digests()  # its sources may be others
            return
        self.folder.mkdir(parents=True)
        self.project.mkdir()
        ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
        for part in PARTS:
            source, target = ROOT / part, self.project / part
            if source.is_dir():
                shutil.copytree(source, target, ignore=ignore)
            else:
                shutil.copy2(source, target)

    def run(self, program: str, *words: str) -> subprocess.CompletedProcess:
        """Run a program of the virtual environment in the run folder, on the copied sources."""
        where = {"cwd": self.folder, "env": self.environment()}
        return subprocess.run([program, *words], **where, capture_output=True, text=True)

    def environment(self) -> dict[str, str]:
        """Environment variables of a program that is to see the copied sources."""
        sources = [self.project / "src", *self.more_python_path]
        return os.environ | {
            "PYTHONPATH": os.pathsep.join(map(str, sources)),
            "PATH": os.pathsep.join([f"{sys.prefix}/bin", os.environ["PATH"]]),
        }

    def snakemake(self, *words: str, scale: str | None = None) -> subprocess.CompletedProcess:
        """Run snakemake, at the scale that was given."""
        return self.run(*self.snakemake_words(*words, scale=scale))

    def plan(self, *words: str, scale: str | None = None) -> subprocess.CompletedProcess:
        """Run snakemake in this process, which spares its start: dry runs and summaries only.

        The workflow's files and the digests of code are those of the copy; the code that plans is
        that of the tests.
        """
        from snakemake.cli import main

        _, *arguments = self.snakemake_words(*words, scale=scale)
        out, err, status = io.StringIO(), io.StringIO(), 0
        kept = dict(os.environ)
        with (
            contextlib.chdir(self.folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            digests_of(self.project / "src"),
        ):
            try:
                main(arguments)
            except SystemExit as end:
                status = int(end.code or 0)
            finally:
                os.environ.clear()
                os.environ.update(kept)
        return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())

    def snakemake_words(self, *words: str, scale: str | None = None) -> list[str]:
        """The command line of `snakemake`."""
        scale = scale or self.scale
        files = ["--configfile", str(self.project / scale)] if scale else []
        return [
            "snakemake", "--snakefile", str(self.project / "Snakefile"),
            *files, "--directory", str(self.folder), "--cores", "2", *words,
        ]  # fmt: skip

    def pending(self, *words: str, reloaded: bool = False) -> set[str]:
        """Files below results/ that snakemake would make (again) for its target all.

        `reloaded`: ask a process of its own, which imports the copied sources.
        """
        ask = self.snakemake if reloaded else self.plan
        answer = ask("--summary", *words, "--", "all")
        assert answer.returncode == 0, answer.stderr
        head, *lines = (line.split("\t") for line in answer.stdout.splitlines() if "\t" in line)
        rows = [dict(zip(head, line, strict=True)) for line in lines]
        made = [row["output_file"] for row in rows if row["plan"] != "no update"]
        return {file.removeprefix("results/") for file in made}

    def edited(self, file: str, text: str = "\nEDITED = True\n"):
        """The copied source `file` with `text` appended, for the time of the block."""
        path = self.project / "src/slipstitch" / file
        return replaced(path, path.read_text(encoding="utf-8") + text)

    def reworded(self, old: str, new: str):
        """The sources with `old`, which one of them holds, replaced for the time of the block."""
        file, before = source_with(self.project / "src", old)
        return replaced(file, before.replace(old, new, 1))

    @contextmanager
    def without(self, file: str):
        """The result `file` taken away, for the time of the block."""
        path, aside = self.folder / "results" / file, self.folder / "aside"
        path.rename(aside)
        try:
            yield
        finally:
            aside.rename(path)
