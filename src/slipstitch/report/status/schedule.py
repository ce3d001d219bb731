"""Duration of a job graph on a number of cores."""

import heapq
from collections.abc import Collection, Mapping


def finish_times_s(
    duration_s: Mapping[int, float],
    after: Mapping[int, Collection[int]],
    cores: int,
    threads: Mapping[int, int] | None = None,
) -> dict[int, float]:
    """End time of each job if jobs start as soon as they are ready and their cores are free.

    Of several ready jobs, those with the lower number start first; a job with too few free
    cores lets smaller ones overtake it, as in Snakemake.

    Parameters
    ----------
    duration_s : mapping
        By job, in s.
    after : mapping
        Prerequisites; those without a duration are already done.
    cores : int
    threads : mapping, optional
        Cores required by a job, default 1; limited to the number of cores.

    Returns
    -------
    dict
        Seconds from now, by job.
    """
    wanted = {job: min(cores, (threads or {}).get(job, 1)) for job in duration_s}
    waiting = {
        job: sum(before in duration_s for before in after.get(job, ())) for job in duration_s
    }
    followers: dict[int, list[int]] = {}
    for job in duration_s:
        for before in after.get(job, ()):
            followers.setdefault(before, []).append(job)
    ready = [job for job, count in waiting.items() if count == 0]
    heapq.heapify(ready)
    running: list[tuple[float, int]] = []
    ends: dict[int, float] = {}
    now_s, free = 0.0, cores
    while ready or running:
        passed = []
        while ready and free:
            job = heapq.heappop(ready)
            if wanted[job] > free:
                passed.append(job)
                continue
            free -= wanted[job]
            heapq.heappush(running, (now_s + duration_s[job], job))
        for job in passed:
            heapq.heappush(ready, job)
        now_s, job = heapq.heappop(running)
        ends[job] = now_s
        free += wanted[job]
        for follower in followers.get(job, ()):
            waiting[follower] -= 1
            if waiting[follower] == 0:
                heapq.heappush(ready, follower)
    return ends
