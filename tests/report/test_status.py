"""`slipstitch status` on journals of made-up runs: states of jobs, cost, time, disk, failures."""

import json
import logging
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from slipstitch.base.page.wording import duration
from slipstitch.cli.main import main
from slipstitch.config import Config, write_config
from slipstitch.design.cost import JOB_KINDS, job_cpu_s
from slipstitch.report.page import page_context, render_page
from slipstitch.report.results import Results
from slipstitch.report.status.journal import Journal, process_identity
from slipstitch.report.status.runs import failures, last_failures, last_lines, read_runs
from slipstitch.report.status.schedule import finish_times_s
from slipstitch.report.status.state import Expectation, Measured, read_benchmark, stage_of, status
from slipstitch.report.status.status_text import text

NAMES = ("m00_f0100_r00", "m00_f0300_r00", "m00_f0600_r00", "m00_f1000_r00")


class Event:
    """Stands for Snakemake's enumeration of events."""

    def __init__(self, value):
        self.value = value


class Job:
    """What the journal needs of one of Snakemake's jobs."""

    threads = 1

    def __init__(self, rule, name=None):
        self.rule = SimpleNamespace(name=rule)
        self.output = [f"results/simulate/{name}.parquet"] if name else []
        self.log = [f"results/logs/simulate/{name}.log"] if name else []
        self.benchmark = f"results/benchmarks/simulate/{name}.tsv" if name else None


def graph(finished_before=()):
    """Stands for Snakemake's graph: a simulation a name, and a rule that makes nothing."""
    jobs = [Job("simulate_one", name) for name in NAMES] + [Job("all")]
    needed = [job for job, name in zip(jobs, NAMES, strict=False) if name not in finished_before]
    dependencies = {job: [] for job in jobs} | {jobs[-1]: jobs[:-1]}
    return SimpleNamespace(
        jobs=jobs, needrun_jobs=lambda: needed, jobid=jobs.index, dependencies=dependencies
    )


class Bench:
    """A results folder and a run of the workflow in it, told event by event."""

    def __init__(self, folder):
        self.results = folder / "results"
        self.results.mkdir()
        self.journal = Journal(self.results / "status")

    def begin(self, cores=2, **options):
        self.journal.begin(graph(**options), cores)
        return self

    def tell(self, event, **what):
        record = logging.LogRecord("snakemake", logging.INFO, "", 0, "", (), None)
        vars(record).update(what, event=Event(event))
        self.journal.emit(record)

    def start(self, number):
        self.tell("job_info", jobid=number)

    def finish(self, number, wall_s=10.0, cpu_s=8.0):
        self.write(f"simulate/{NAMES[number]}.parquet", "x" * 1000)
        row = f"s\th:m:s\tmax_rss\tcpu_time\n{wall_s}\t0:00:10\t300.0\t{cpu_s}\n"
        self.write(f"benchmarks/simulate/{NAMES[number]}.tsv", row)
        self.tell("job_finished", job_id=number)

    def fail(self, number, log="first line\n\nlast line\n"):
        name = NAMES[number]
        self.write(f"logs/simulate/{name}.log", log)
        self.tell(
            "job_error",
            jobid=number,
            rule_name="simulate_one",
            output=[f"results/simulate/{name}.parquet"],
            log=[f"results/logs/simulate/{name}.log"],
        )

    def write(self, file, content):
        path = self.results / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_every_job_is_done_running_failed_or_still_to_do(bench):
    bench.begin()
    for number in (0, 1, 2):
        bench.start(number)
    bench.finish(0)
    bench.fail(1)
    (stage,) = status(bench.results, None).stages
    assert (stage.name, stage.jobs) == ("simulate", 4)
    assert (stage.done, stage.running, stage.failed, stage.waiting) == (1, 1, 1, 1)
    assert stage.cpu_s == 8.0
    assert stage.disk_bytes == 1000


def test_what_an_earlier_run_made_is_done_and_what_was_deleted_is_not(bench):
    bench.begin()
    bench.finish(0)
    bench.finish(1)
    bench.journal.end(success=False)
    bench.begin(finished_before=NAMES[:2])
    assert status(bench.results, None).stages[0].done == 2
    (bench.results / f"simulate/{NAMES[0]}.parquet").unlink()
    assert status(bench.results, None).stages[0].done == 1


def test_time_to_come_is_what_the_like_took_shared_among_the_cores(bench):
    bench.begin(cores=2)
    bench.finish(0, wall_s=10.0)
    bench.finish(1, wall_s=30.0)
    # Two more, 20 s each, on two cores.
    assert status(bench.results, None).left_s == pytest.approx(20.0)
    bench.start(2)
    began_s = read_runs(bench.results)[-1].started_s[2]
    found = status(bench.results, None, now_s=began_s + 15.0)
    assert found.left_s == pytest.approx(20.0)  # the one that waits is the longest
    assert found.stages[0].left_s == pytest.approx(5.0 + 20.0)


def test_a_clock_that_was_set_back_makes_no_job_longer(bench):
    bench.begin()
    bench.finish(0, wall_s=10.0)
    bench.start(1)
    found = status(bench.results, None, now_s=0.0)
    assert found.stages[0].left_s == pytest.approx(3 * 10.0)
    assert "for 0 s" in text(bench.results, found, 3, now_s=0.0)


def test_before_any_job_ended_the_cost_model_says_how_long():
    config = Config()
    job = {"rule": "simulate_one"}
    assert Expectation(config, []).wall_s(job) == job_cpu_s("simulate", config)
    assert Expectation(config, []).wall_s({"rule": "render_images"}) == job_cpu_s("compose", config)
    assert Expectation(None, []).wall_s(job) is None
    assert Expectation(config, []).wall_s({"rule": "grid"}) == job_cpu_s("sample", config)
    assert Expectation(config, []).wall_s({"rule": "all"}) is None


def test_the_cost_model_is_corrected_by_what_other_jobs_took():
    config = Config()
    slow = 3.0 * job_cpu_s("simulate", config)
    expected = Expectation(config, [({"rule": "simulate_one"}, Measured(slow, slow, 300.0))])
    assert expected.correction == pytest.approx(3.0)
    assert expected.wall_s({"rule": "train_one"}) == pytest.approx(3 * job_cpu_s("train", config))


@pytest.mark.parametrize("kind", JOB_KINDS)
def test_the_cost_model_knows_every_kind_of_job(kind):
    assert 0 < job_cpu_s(kind, Config()) < 1e5


def test_a_run_that_was_killed_is_told_from_one_that_goes_on(bench):
    bench.begin()
    bench.start(0)
    assert status(bench.results, None).alive is True  # this process
    journal = bench.results / "status/journal.jsonl"
    alive = journal.read_text()
    journal.write_text(alive.replace(f'"born": {process_identity()["born"]}', '"born": 1'))
    found = status(bench.results, None)
    assert found.alive is False
    page = text(bench.results, found, 3)
    assert "interrupted; to continue: `snakemake --unlock`" in page
    assert "Interrupted:" in page
    journal.write_text(alive.replace(process_identity()["boot"], "another machine"))
    assert status(bench.results, None).alive is None


def test_a_failure_is_the_first_thing_on_the_page_with_the_end_of_its_log(bench):
    bench.begin()
    bench.start(0)
    bench.fail(0, "\n".join(f"line {k}" for k in range(100)) + "\n\x1b[31mout of thread\n")
    bench.journal.end(success=False)
    page = text(bench.results, status(bench.results, None), 3).splitlines()
    assert page[0] == f"failed: simulate_one, output results/simulate/{NAMES[0]}.parquet"
    assert page[1] == f"  end of results/logs/simulate/{NAMES[0]}.log:"
    assert page[2:5] == ["    line 98", "    line 99", "     [31mout of thread"]
    assert "out of thread" in last_failures(bench.results)


def test_an_attempt_that_was_retried_is_told_from_what_failed_for_good(bench):
    bench.begin()
    for number in (0, 1, 2):
        bench.start(number)
        bench.fail(number)
    bench.start(0)
    bench.finish(0)
    bench.journal.end(success=False)
    assert NAMES[0] not in last_failures(bench.results)
    bench.begin(finished_before=NAMES[:1])
    bench.finish(1)
    found = failures(bench.results, read_runs(bench.results))
    assert [one.then for one in found] == ["retried", "completed later", "not completed"]
    page = text(bench.results, status(bench.results, None), 3)
    assert "2 earlier failed attempts resolved since" in page


def test_the_report_lists_failures_and_retries(bench):
    bench.begin()
    bench.start(0)
    bench.fail(0)
    bench.start(0)
    bench.finish(0)
    config = Config()
    results = Results(bench.results, config)
    results.simulated = lambda: []
    page = render_page(page_context(results, datetime.now(UTC)))
    assert f"results/simulate/{NAMES[0]}.parquet" in page
    assert "retried" in page


def test_a_line_that_a_crash_cut_short_is_left_out(bench):
    bench.begin()
    bench.start(0)
    with open(bench.results / "status/journal.jsonl", "a") as stream:
        stream.write('{"event": "finished", "ti')
    assert status(bench.results, None).stages[0].running == 1


def test_disk_to_come_is_foreseen_from_the_model_and_then_from_what_is_there(bench):
    config = Config()
    bench.begin()
    from_model = status(bench.results, config).stages[0].disk_to_come_bytes
    assert from_model > 1e6
    bench.finish(0)
    assert status(bench.results, config).stages[0].disk_to_come_bytes == pytest.approx(3000.0)


def test_cpu_times_are_those_that_the_jobs_state_wherever_they_are_shown(bench):
    """Snakemake samples every 30 s: its benchmark file misses the end of a job."""
    bench.begin()
    bench.finish(0, cpu_s=8.0)
    bench.write(
        f"logs/simulate/{NAMES[0]}.log", "x.parquet: 3 halvings, 1.0 CPU s\nCPU time: 9.50 s\n"
    )
    bench.finish(1, cpu_s=8.0)  # its log says nothing
    assert status(bench.results, None).stages[0].cpu_s == 17.5
    (reported,) = Results(bench.results, Config()).benchmarks()
    assert (reported.cpu_s, reported.jobs) == (17.5, 2)
    bench.write(f"logs/simulate/{NAMES[0]}.log", "x" * 1000)
    assert status(bench.results, None).stages[0].cpu_s == 16.0


def test_cost_of_a_resumed_job_is_that_of_all_attempts(bench):
    """Snakemake knows of the last one only."""
    bench.begin()
    bench.finish(0, cpu_s=8.0)
    before = read_benchmark(bench.results / f"benchmarks/simulate/{NAMES[0]}.tsv")
    bench.write(
        f"logs/simulate/{NAMES[0]}.log",
        "written\nwall time of earlier attempts: 100.25 s\nCPU time: 90.50 s\n",
    )
    measured = read_benchmark(bench.results / f"benchmarks/simulate/{NAMES[0]}.tsv")
    assert (measured.wall_s, measured.cpu_s) == (before.wall_s + 100.25, 90.5)
    assert status(bench.results, None).stages[0].cpu_s == 90.5


def test_the_end_of_a_log_is_short_whatever_the_log_holds(tmp_path):
    log = tmp_path / "log"
    log.write_bytes(b"\xff\x00" * 1_000_000 + b"\n\rlast\n")
    assert last_lines(log, 2)[-1] == "last"
    assert last_lines(tmp_path / "none") == ["(no log: No such file or directory)"]


def test_stages_are_the_folders_below_results():
    assert stage_of({"output": ["results/render/preview/a.png"]}) == "render"
    assert stage_of({"output": ["results/grid.parquet"]}) == "grid"
    assert stage_of({"output": ["results/release"]}) == "release"


def test_the_verb_says_so_where_nothing_was_run_and_where_nothing_is(tmp_path, capsys):
    assert main(["status", "--results", str(tmp_path)]) == 0
    assert "no snakemake run has started a job here" in capsys.readouterr().out
    assert main(["status", "--results", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_the_verb_fails_where_the_run_failed(bench, capsys):
    bench.begin()
    bench.fail(0)
    bench.journal.end(success=False)
    write_config(Config(), bench.results / "config.json")
    assert main(["status", "--results", str(bench.results)]) == 1
    assert "last line" in capsys.readouterr().out
    (bench.results / "status/plan.json").write_text(json.dumps({"jobs": [{}]}))
    assert main(["status", "--results", str(bench.results)]) == 2
    assert "plan.json: damaged" in capsys.readouterr().err


def test_ready_jobs_share_the_cores_and_others_wait_for_what_they_need():
    ends = finish_times_s({1: 10, 2: 10, 3: 5, 4: 1}, {3: [1], 4: [2, 3]}, cores=2)
    assert ends == {1: 10, 2: 10, 3: 15, 4: 16}
    assert max(finish_times_s(dict.fromkeys(range(7), 1.0), {}, cores=3).values()) == 3.0
    # What is done is not waited for; a job that wants more cores than there are gets all.
    assert finish_times_s({1: 2.0}, {1: [7]}, cores=1, threads={1: 8}) == {1: 2.0}


def test_a_small_job_passes_one_that_finds_too_few_cores():
    ends = finish_times_s({1: 10, 2: 4, 3: 3}, {}, cores=2, threads={2: 2})
    assert ends == {1: 10, 3: 3, 2: 14}


def test_durations_read_well():
    assert [duration(value, 0, "?") for value in (None, 5.2, 600, 7200)] == [
        "?",
        "5 s",
        "10 min",
        "2.0 h",
    ]
