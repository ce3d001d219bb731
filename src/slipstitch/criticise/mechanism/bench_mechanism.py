"""Extensions of the bench and of the fabric, in the same form as those of the contact."""

from __future__ import annotations

from collections.abc import Mapping

from slipstitch.friction_law import Mechanism


class BenchMechanism(Mechanism):
    """A mechanism that changes the bench or the fabric, not the contact."""

    def changes(self, values: Mapping[str, float]) -> dict[str, float]:
        """Fields of :class:`Bench` that the parameter values set."""
        raise NotImplementedError
