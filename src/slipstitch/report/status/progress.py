"""One line on the terminal for every stage of a run that is finished: its share, the time left."""

import logging
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

from slipstitch.base.page.wording import counted, duration
from slipstitch.config import Config
from slipstitch.design.cost import JOB_KINDS, job_cpu_s
from slipstitch.report.status.state import stage_of

# The cost model's kinds of jobs whose rules are not named by them.
KIND = {"render_images": "compose", "render_verification": "verify"}


def modelled_s(rule: str, config: Config) -> float:
    """Return the modelled CPU time (s) of one job of a rule; a second where there is no model."""
    kind = KIND.get(rule, rule.partition("_")[0])
    return job_cpu_s(kind, config) if kind in JOB_KINDS else 1.0


class Progress(logging.Handler):
    """Prints the finished share of a run; a handler of Snakemake's logger.

    Jobs count by their modelled times; the time left is that so far, by the share.

    Parameters
    ----------
    plan : sequence of dict
        The jobs of the run, as of `slipstitch.report.status.journal.plan_of`.
    config : Config
    """

    def __init__(self, plan: Sequence[dict[str, Any]], config: Config):
        super().__init__()
        self._jobs = {job["id"]: job for job in plan if job["needed"]}
        self._cost_s = {one: modelled_s(job["rule"], config) for one, job in self._jobs.items()}
        self._started_s = time.monotonic()
        self._all_s = sum(self._cost_s.values())
        self._done_s = 0.0

    def finished(self, job: int) -> str | None:
        """Return a line if a job was the last one of its stage.

        Parameters
        ----------
        job : int
            Its number in the plan.
        """
        if job not in self._jobs:
            return None
        stage = stage_of(self._jobs.pop(job))
        self._done_s += self._cost_s[job]
        left = Counter(stage_of(one) for one in self._jobs.values())
        if left[stage]:
            return None
        share = self._done_s / self._all_s
        line = f"{stage} is finished: {100 * share:.0f} % of the run"
        if self._jobs:
            left_s = (time.monotonic() - self._started_s) * (1 - share) / share
            line += f", about {duration(left_s, digits=0)} left"
            line += f" ({counted(left.total(), 'job')}: {', '.join(left)})"
        return line

    def emit(self, record: Any) -> None:
        """Print the line of a stage with its last job."""
        event = getattr(getattr(record, "event", None), "value", None)
        line = self.finished(record.job_id) if event == "job_finished" else None
        if line:
            print(line, file=sys.stderr, flush=True)
