"""Known-answer experiments in the simulator, each beside what theory says."""

from slipstitch.protocol.registry import PROTOCOLS, run_protocol

__all__ = ["PROTOCOLS", "run_protocol"]
