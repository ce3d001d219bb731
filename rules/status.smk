"""Hooks of a run: write the configuration and the journal, show failures last."""

from snakemake.exceptions import WorkflowError
from snakemake.logging import logger

from slipstitch.report.status import Journal, Progress, last_failures, plan_of

# What `slipstitch status` and the report read; the processes of single jobs do not write to it.
JOURNAL = Journal()
if workflow.is_main_process:
    logger.addHandler(JOURNAL)


def refuse_unwritable(jobs):
    """Stop before the first job if a folder of results cannot be written to."""
    for folder in sorted({Path(file).parent for job in jobs for file in job.output}):
        if folder.exists() and not os.access(folder, os.W_OK):
            raise WorkflowError(
                f"{folder}: not writable (read-only file system or missing permission)"
            )


# The configuration file is written when the first job starts: neither a dry run nor a changed key
# that a stage does not use modifies anything. The rules carry the values as parameters instead.
onstart:
    refuse_unwritable(workflow.dag.needrun_jobs())
    write_config(CONFIG, CONFIG_FILE)
    JOURNAL.begin(workflow.dag)
    if sys.stderr.isatty():
        logger.addHandler(Progress(plan_of(workflow.dag), CONFIG))
    # Snakemake 9's limit of jobs started a second sets a timer with every job, which sets the next
    # for ever: after 250 jobs they took a third of a core. Cluster profiles limit jobs otherwise.
    workflow.scheduler.job_rate_limiter = None


onsuccess:
    JOURNAL.end(success=True)


# The end of a failed job's log is the last thing on the screen.
onerror:
    JOURNAL.end(success=False)
    print(last_failures("results"), file=sys.stderr)
