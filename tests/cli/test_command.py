"""The command line: verbs, exit codes, one line for what is wrong."""

import os
import re
import shutil
import subprocess
import sys
import types
from pathlib import Path

import click
import pytest
from support.refusal import refused

import slipstitch.cli.main as command
from slipstitch.base.errors import BadInput, NotConverged
from slipstitch.cli import calibrate, learning, options, project
from slipstitch.config import simulation, train
from slipstitch.report.cost import SAID_CPU_TIME

ROOT = Path(__file__).parents[2]
VERB = "doctor"  # any verb that exists; it is replaced below


@pytest.fixture
def verb(monkeypatch):
    """Replace the verb; the test says what it does."""
    done = types.SimpleNamespace(run=lambda arguments: None)

    @options.verb("slipstitch doctor --size 3")
    @click.option("--size", type=int)
    @options.several("--files")
    def doctor(arguments):
        """Do what the test says."""
        return done.run(arguments)

    monkeypatch.setattr(project, VERB, doctor)
    return done


def words(text):
    return " ".join(text.split())


def test_overview_and_help_name_every_verb_with_its_summary_and_a_real_example(capsys):
    assert command.main(["--help"]) == 0
    shown = words(capsys.readouterr().out)
    for name in command.VERBS:
        summary = command.program.get_command(click.Context(command.program), name).short_help
        assert f"{name} {words(summary)}" in shown
        assert command.main([name, "--help"]) == 0
        assert f"slipstitch {name}" in words(capsys.readouterr().out.split("example:")[1])


def test_no_verb_and_an_unknown_one_are_bad_usage(capsys):
    assert command.main([]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("Usage")
    assert "unknown verb 'simulat'; did you mean simulate?" in refused(capsys, "simulat")
    assert command.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("slipstitch 0.")


def test_an_option_takes_several_values_as_it_would_be_repeated(verb):
    seen = []
    verb.run = lambda arguments: seen.append(arguments.files)
    assert command.main([VERB, "--files", "a", "b", "--size", "1", "--files", "c"]) == 0
    assert seen == [("a", "b", "c")]


OUTCOMES = [
    *((code, code or 0, "") for code in (None, 0, 1, 3)),
    (BadInput("friction\nis -1"), 2, "slipstitch doctor: error: friction is -1\n"),
    (NotConverged("step 3"), 1, "slipstitch doctor: failed: step 3\n"),
    (KeyboardInterrupt(), 130, "slipstitch doctor: interrupted\n"),
]


@pytest.mark.parametrize(("outcome", "code", "line"), OUTCOMES)
def test_exit_code_is_the_verb_s_and_errors_a_user_may_meet_are_one_line(
    verb, capsys, outcome, code, line
):
    def run(arguments):
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    verb.run = run
    assert command.main([VERB]) == code
    captured = capsys.readouterr()
    assert (captured.err, captured.out) == (line, "")


def test_fault_of_the_program_keeps_its_traceback_and_bad_usage_is_one_line(verb, capsys):
    verb.run = lambda arguments: 1 / 0
    with pytest.raises(ZeroDivisionError):
        command.main([VERB])
    for bad in ("--size big", "--sise 3", "stray"):
        assert refused(capsys, f"{VERB} {bad}").startswith("slipstitch doctor: error: ")


def test_a_job_of_the_workflow_states_its_cpu_time_last(verb, capsys, monkeypatch):
    verb.run = lambda arguments: print("done", file=sys.stderr)
    assert command.main([VERB]) == 0
    assert capsys.readouterr().err == "done\n"
    monkeypatch.setenv("SLIPSTITCH_CPU_TIME", "1")
    assert command.main([VERB]) == 0
    said = capsys.readouterr().err.removeprefix("done\n")
    told_s = float(SAID_CPU_TIME.fullmatch(said.rstrip())[1])
    assert 0 < told_s < sum(os.times()[:4]) + 0.01  # which it is rounded to


def test_only_the_command_line_knows_of_options_and_nothing_depends_on_it():
    package = Path(command.__file__).parents[1]
    sources = {path.relative_to(package).as_posix(): path for path in package.rglob("*.py")}
    known = r"(import (argparse|click)|(from|import) slipstitch\.cli)"
    knowing = {name for name, path in sources.items() if re.search(known, path.read_text())}
    assert {name.partition("/")[0] for name in knowing} == {"cli", "__main__.py"}


def test_names_to_choose_from_are_those_of_the_configuration():
    assert tuple(learning.SPLIT.choices) == train.TRAINED_ON
    assert tuple(learning.NETWORK.choices) == train.NETWORKS
    assert tuple(learning.QUESTION.choices) == train.QUESTIONS
    assert calibrate.SWEPT.split() == [simulation.BASE, *simulation.KEYS]


def test_overview_imports_nothing_heavy():
    code = "import sys; from slipstitch.cli.main import main; main(['--help']); print(*sys.modules)"
    shown = subprocess.check_output([sys.executable, "-c", code], text=True)
    heavy = {"numpy", "torch", "bpy", "warp", "pyarrow", "pydantic"}
    assert not heavy & set(shown.splitlines()[-1].split())


def test_installed_program_and_module_are_the_same():
    for start in ([sys.executable, "-m", "slipstitch"], [f"{sys.prefix}/bin/slipstitch"]):
        answer = subprocess.run([*start, "nonsense"], capture_output=True, text=True)
        assert answer.returncode == 2
        assert answer.stderr.startswith("slipstitch: error: unknown verb 'nonsense'")


def test_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -m slipstitch doctor --help | head -c 1"
    answer = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert (answer.returncode, answer.stderr) == (0, "")


def test_too_tight_a_memory_limit_is_one_line_and_not_a_hang(tmp_path):
    """Without memory, OpenBLAS would retry for ever."""
    words = f"slipstitch protocol incline --out {tmp_path}/x.json"
    command = f"ulimit -v 600000; {sys.executable} -m {words}"
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert (answer.returncode, answer.stderr.count("\n")) == (1, 1)
    assert "the limit is 585 MiB (ulimit -v), at least 2048 MiB are required" in answer.stderr


UNWRITABLE = [
    ("criticise {folder} --out {folder}", "is a folder; must be a file"),
    ("criticise {folder} --out /dev/full", "is a device or a pipe; must be a file"),
    ("report --config x.yaml --out {file}/x.html", "{file} is a file, not a folder"),
    ("predict x.json {folder} --out {file}/a/x.csv", "{file} is a file"),
    ("report --config x.yaml --out x.png", "x.png: must end in .html or .htm"),
    ("capture reference x.csv --out x.txt", "x.txt: must end in .csv"),
    ("ablate --config x --summary x --out x", "x: must end in .json"),
    ("sample --config x.yaml --out-dir {file} x.parquet", "is a file; must be a folder"),
    ("capture check camera.json --picture /proc/x.png", "/proc/x.png: cannot be written: "),
    ("capture reference {folder}/a.csv --out {folder}/x/../a.csv", ": the command reads this file"),
    ("criticise {folder} --out v.json --resimulate ./v.json", "v.json: is the file of --out, too"),
    ("audit {folder} --config c.json --json c.json", "--json c.json: the command reads this file"),
]


@pytest.mark.parametrize(("words", "reason"), UNWRITABLE)
def test_what_cannot_be_written_is_refused_before_any_work(words, reason, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("kept")
    named = {"folder": tmp_path, "file": file}
    said = refused(capsys, [word.format(**named) for word in words.split()])
    assert reason.format(**named) in said
    assert (list(tmp_path.iterdir()), file.read_text()) == ([file], "kept")


BY_HAND = "simulate --material gray-interlock --friction 0.3 --out x.parquet"
CONFIG = "--config config.yaml"
OF_GRID = f"simulate {CONFIG} --out x.parquet --simulation m05_f0300_r00"
RENDERED = f"render {CONFIG} --trajectory config.yaml --out a.parquet"
TWO_VIEWS = f"render {CONFIG} --trajectory config.yaml --viewpoint v00 v01"
BOARD = "capture camera --squares 10x7 --square-mm 20 --out c.json view.png"
CAPTURES = (
    f"evaluate --captures {CONFIG} --dataset d --models m --out o.json --predictions p.parquet"
)
MEASURE = "measure a.mp4 --camera c.json --model m"
CONTRADICTIONS = [
    ("calibrate --draw c.json --out o.json", "--out cannot be combined with --draw"),
    ("calibrate --draw c.json", "--draw requires --picture"),
    (f"calibrate {CONFIG} --out o.json --only-failures", "--only-failures requires a picture"),
    (f"calibrate {CONFIG} --out o.json --sweep base --picture p.png", "combined with --sweep"),
    (f"{BY_HAND} --simulation m05_f0300_r00", "--material cannot be combined with --sim"),
    (f"{OF_GRID} --seed 0", "--seed cannot be combined with --simulation"),
    (f"{OF_GRID} m05_f0600_r00 --out x.parquet", "--out: names a file twice"),
    (f"{BY_HAND} --model m.yaml --set model=n.yaml", "--model cannot be combined"),
    ("render --preview --verify x.parquet", "--verify cannot be combined with --pre"),
    ("render --verify --out-dir d x.parquet", "--out-dir cannot be combined with"),
    (RENDERED, "rendering requires --viewpoint"),
    (f"{RENDERED} --viewpoint v00 --out-sheet a.png", "cannot be combined with rendering"),
    (f"{TWO_VIEWS} --shading a.parquet a.parquet", "--shading requires one file for each"),
    (f"{TWO_VIEWS} --out a.parquet", "--out takes images of one --viewpoint"),
    (f"{CAPTURES} --details d.json", "--details cannot be combined with --captures"),
    ("audit r --explain c --rebuild c", "--rebuild cannot be combined with --ex"),
    ("audit r --rebuild c --page a.html", "--page cannot be combined with --re"),
    ("criticise case --out v.json --power --model m.yaml", "--model cannot be combined with --po"),
    ("criticise case --out - --validate new", "-: must end in .json"),
    (f"{BOARD} --place-mm 0 0", "--place-mm requires --stage-view"),
    (f"{BOARD} --dictionary DICT_4X4_50", "--dictionary cannot be combined with --board check"),
    (f"{MEASURE} b.mp4 --start-s 0", "--start-s cannot be combined with several videos"),
    ("measure", "no video: give one, --captures or --example"),
    ("measure film.mp4", "--camera FILE is required"),
    ("measure --example film.mp4", "--example has its own video and camera: give neither with it"),
    (f"{MEASURE} --frame-rate-hz 0", "--frame-rate-hz 0: must be greater than 0"),
    ("protocol incline --friction 1 --slope-deg 90 --out x.json", "--slope-deg must be at least 0"),
]


@pytest.mark.parametrize(("words", "reason"), CONTRADICTIONS)
def test_options_that_contradict_are_refused_before_any_work(
    words, reason, tmp_path, monkeypatch, capsys
):
    shutil.copy(ROOT / "config.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert reason in refused(capsys, words)
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]
