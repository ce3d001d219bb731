"""`slipstitch status` on journals of made-up runs: jobs by stage, failures, what jobs cost."""

import logging
import os
import re
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest
from support.refusal import refused, run

from slipstitch.base.page.templates import render
from slipstitch.config import Config, write_config
from slipstitch.design.cost import job_costs_s
from slipstitch.report import status as state
from slipstitch.report.cost import benchmarks, read_benchmark
from slipstitch.report.page import TEMPLATE, page_context
from slipstitch.report.results import Results
from slipstitch.report.status import Job, Journal, Progress, failures, read_runs, status

NAMES = ("m00_f0100_r00", "m00_f0300_r00", "m00_f0600_r00", "m00_f1000_r00")


class Planned:
    """What the journal needs of one of Snakemake's jobs."""

    def __init__(self, rule, *names):
        self.rule = SimpleNamespace(name=rule)
        self.output = [f"results/simulate/{name}.parquet" for name in names]
        self.benchmark = next((f"results/benchmarks/simulate/{name}.tsv" for name in names), None)


def graph(finished_before=()):
    """Stands for Snakemake's graph: a simulation a name, and a rule that makes nothing."""
    jobs = [*(Planned("simulate_one", name) for name in NAMES), Planned("all")]
    needed = [job for job, name in zip(jobs, NAMES, strict=False) if name not in finished_before]
    return SimpleNamespace(jobs=jobs, needrun_jobs=lambda: needed, jobid=jobs.index)


class Bench:
    """A results folder and a run of the workflow in it, told event by event."""

    def __init__(self, folder):
        self.results = folder / "results"
        self.results.mkdir()
        self.journal = Journal(self.results / "status")

    def begin(self, **options):
        self.journal.begin(graph(**options))

    def tell(self, event, **what):
        record = logging.LogRecord("snakemake", logging.INFO, "", 0, "", (), None)
        vars(record).update(what, event=SimpleNamespace(value=event))
        self.journal.emit(record)

    def start(self, *numbers):
        for number in numbers:
            self.tell("job_info", jobid=number)

    def finish(self, *numbers):
        for number in numbers:
            self.write(f"simulate/{NAMES[number]}.parquet", "x" * 1000)
            row = "s\th:m:s\tmax_rss\tcpu_time\n10.0\t0:00:10\t300.0\t8.0\n"
            self.write(f"benchmarks/simulate/{NAMES[number]}.tsv", row)
            self.tell("job_finished", job_id=number)

    def fail(self, number, log="first line\n\nlast line\n"):
        name = NAMES[number]
        self.write(f"logs/simulate/{name}.log", log)
        files = {"output": [f"results/simulate/{name}.parquet"]}
        files["log"] = [f"results/logs/simulate/{name}.log"]
        self.tell("job_error", jobid=number, rule_name="simulate_one", **files)

    def write(self, file, content):
        path = self.results / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def jobs(bench):
    """Done, running, failed and waiting jobs of the only stage, as they are printed."""
    (line,) = re.findall(r"^simulate +(.*)$", status(bench.results, 3)[0], re.M)
    return line.split()


def test_every_job_is_done_running_failed_or_still_to_do(bench):
    bench.begin()
    bench.start(0, 1, 2)
    bench.finish(0)
    bench.fail(1)
    with open(bench.results / "status/journal.jsonl", "a") as stream:
        stream.write('{"event": "finished", "ti')  # cut short by a crash
    assert jobs(bench) == ["1/4", "1", "1", "1"]


def test_what_an_earlier_run_made_is_done_and_what_was_deleted_is_not(bench):
    bench.begin()
    bench.finish(0, 1)
    bench.journal.end(success=False)
    bench.begin(finished_before=NAMES[:2])
    assert jobs(bench)[0] == "2/4"
    (bench.results / f"simulate/{NAMES[0]}.parquet").unlink()
    assert jobs(bench)[0] == "1/4"


def test_a_run_that_was_killed_is_told_from_one_that_goes_on(bench):
    bench.begin()
    bench.start(0)
    journal = bench.results / "status/journal.jsonl"
    alive, born = journal.read_text(), f'"born": {state.process_birth(os.getpid())}'
    for text, words, stops in (
        (alive, ": running.", False),  # this process
        (alive.replace(born, '"born": 1'), "interrupted; to continue: `snakemake --unlock`", True),
        (alive.replace(state.boot_identity(), "other"), "started on another machine", False),
    ):
        journal.write_text(text)
        page, stopped = status(bench.results, 3)
        assert words in page and stopped == stops


def test_cpu_times_are_those_that_the_jobs_state_of_all_their_attempts(bench):
    """Snakemake samples every 30 s, and knows of the last attempt only."""
    bench.begin()
    bench.finish(0, 1)  # the second's log says nothing
    (silent,) = benchmarks(bench.results)
    log = f"logs/simulate/{NAMES[0]}.log"
    bench.write(log, "x.parquet: 3 halvings, 1.0 CPU s\nCPU time: 9.50 s\n")
    (reported,) = benchmarks(bench.results)
    assert (silent.cpu_s, reported.cpu_s, reported.jobs) == (16.0, 17.5, 2)
    bench.write(log, "written\nwall time of earlier attempts: 100.25 s\nCPU time: 90.50 s\n")
    measured = read_benchmark(bench.results / f"benchmarks/simulate/{NAMES[0]}.tsv")
    assert (measured.wall_s, measured.cpu_s) == (110.25, 90.5)


def test_a_failure_is_the_first_thing_on_the_page_with_the_end_of_its_log(bench):
    bench.begin()
    bench.start(0)
    bench.fail(0, "\n".join(f"line {k}" for k in range(100)) + "\n\x1b[31mout of thread\n")
    bench.journal.end(success=False)
    assert status(bench.results, 3)[0].splitlines()[:5] == [
        f"failed: simulate_one, output results/simulate/{NAMES[0]}.parquet",
        f"  end of results/logs/simulate/{NAMES[0]}.log:",
        *("    line 98", "    line 99", "     [31mout of thread"),
    ]
    assert "out of thread" in state.last_failures(bench.results)


def test_an_attempt_that_was_retried_is_told_from_what_failed_for_good(bench):
    bench.begin()
    for number in (0, 1, 2):
        bench.start(number)
        bench.fail(number)
    bench.start(0)
    bench.finish(0)
    bench.journal.end(success=False)
    assert NAMES[0] not in state.last_failures(bench.results)
    bench.begin(finished_before=NAMES[:1])
    bench.finish(1)
    found = failures(bench.results, read_runs(bench.results))
    assert [then for _, then in found] == ["retried", "completed later", "not completed"]
    assert "2 earlier failed attempts resolved since" in status(bench.results, 3)[0]
    results = Results(bench.results, Config())
    results.simulated = lambda: []
    page = render(TEMPLATE, **page_context(results, datetime.now(UTC)))
    assert f"results/simulate/{NAMES[0]}.parquet" in page and "retried" in page


def test_the_end_of_a_log_is_short_and_a_stage_the_folder_below_results(tmp_path):
    log = tmp_path / "log"
    log.write_bytes(b"\xff\x00" * 1_000_000 + b"\n\rlast\n")
    assert state.last_lines(log, 2)[-1] == "last"
    assert state.last_lines(tmp_path / "none") == ["(no log: No such file or directory)"]
    for name, stage in (("render/preview/a.png", "render"), ("grid.parquet", "grid"), ("a", "a")):
        job = Job(id=1, rule="a_rule", output=[f"results/{name}"], needed=True)
        assert job.stage == stage


def test_the_verb_fails_where_the_run_failed_and_says_where_nothing_was_run(bench, capsys):
    command = f"status --results {bench.results}"
    assert "no such folder" in refused(capsys, f"{command}/none")
    assert run(command) == 0
    assert "no snakemake run has started a job here" in capsys.readouterr().out
    bench.begin()
    bench.fail(0)
    bench.journal.end(success=False)
    write_config(Config(), bench.results / "config.json")
    assert run(command) == 1
    assert "last line" in capsys.readouterr().out
    bench.write("status/plan.json", '{"jobs": [{}]}')
    assert "plan.json: damaged" in refused(capsys, command)


def test_the_last_job_of_a_stage_says_the_share_of_the_run_and_the_time_left():
    config = Config()
    jobs = {"simulate_one": ("simulate/a", "simulate/b"), "evaluate_all": ("evaluate/metrics",)}
    made = [(rule, f"results/{name}.json") for rule, names in jobs.items() for name in names]
    plan = [Job(id=k, rule=r, output=[name], needed=True) for k, (r, name) in enumerate(made)]
    progress = Progress(plan, config)
    assert progress.finished(0) is None and progress.finished(7) is None
    line = progress.finished(1)
    cost_s = job_costs_s(config)
    simulated = 2 * cost_s["simulate"]
    share = 100 * simulated / (simulated + cost_s["evaluate"])
    assert line.startswith(f"simulate is finished: {share:.0f} % of the run, about ")
    assert line.endswith("left (1 job: evaluate)")
    assert progress.finished(2) == "evaluate is finished: 100 % of the run"
