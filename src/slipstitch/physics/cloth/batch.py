"""Tasks that drive one sheet each, taking turns so that the device works for all at once.

A task is ordinary code around a :class:`solver.ClothSolver`. Each has a thread,
but only one thread runs at a time: it runs until its sheet needs the device, then the next one's
turn comes; when all tasks that still run have asked, the device does what they asked for. So
the order of everything is fixed, nothing needs a lock, and each task computes what it computes
alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from enum import Enum, auto
from typing import Any

from slipstitch.base.errors import NotConverged


class Work(Enum):
    """The requests of a sheet."""

    FORCES = auto()  # out-of-balance forces at the placed positions
    STIFFNESS = auto()  # entries of the tangent there
    STRAINS = auto()  # strains there become those that damping refers to
    ACCEPT = auto()  # likewise, and the floor's friction remembers the step


class _Cancelled(BaseException):
    """Ends a task's thread when the others cannot go on."""


class _Turn:
    """A task's thread, which stands still unless it is resumed."""

    def __init__(self, task: Callable[[], Any]):
        self._task = task
        self._go, self._stopped = threading.Semaphore(0), threading.Semaphore(0)
        self._cancelled = False
        self.asked: Work | None = None  # what it waits for; None once it has ended
        self.outcome: Any = None
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._wait()
            self.outcome = self._task()
        except NotConverged as error:
            self.outcome = error
        except _Cancelled:
            pass
        except BaseException as error:
            self.error = error
        self.asked = None
        self._stopped.release()

    def _wait(self) -> None:
        self._go.acquire()
        if self._cancelled:
            raise _Cancelled

    def ask(self, work: Work) -> None:
        """Stand still until the work is done (called by the task)."""
        self.asked = work
        self._stopped.release()
        self._wait()

    def resume(self) -> None:
        """Let the task run until it asks or ends."""
        self._go.release()
        self._stopped.acquire()
        if self.error is not None:
            raise self.error

    def cancel(self) -> None:
        """End the thread where it stands."""
        self._cancelled = True
        self._go.release()
        self._thread.join()


class Meeting:
    """Synchronisation point of the tasks of sheets.

    Parameters
    ----------
    work_for : callable
        Does one kind of work for some sheets.
    tasks : sequence of callables
        Task k drives sheet k.
    """

    def __init__(
        self, work_for: Callable[[Work, Sequence[int]], None], tasks: Sequence[Callable[[], Any]]
    ):
        self._work_for = work_for
        self._turns = [_Turn(task) for task in tasks]

    def ask(self, work: Work, member: int) -> None:
        """Have work done for a sheet (called by its task)."""
        self._turns[member].ask(work)

    def run(self) -> list[Any]:
        """Run all tasks to their end; what they returned, or the NotConverged they raised."""
        try:
            waiting = list(range(len(self._turns)))
            while waiting:
                for member in waiting:
                    self._turns[member].resume()
                waiting = [member for member in waiting if self._turns[member].asked]
                for work in Work:
                    members = [one for one in waiting if self._turns[one].asked is work]
                    if members:
                        self._work_for(work, members)
            return [turn.outcome for turn in self._turns]
        finally:
            for turn in self._turns:
                turn.cancel()
