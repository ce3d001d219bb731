"""The typed configuration of simulation, rendering and learning, and their scale.

Stages get their section; ids and seeds come from `slipstitch.design.grid`.
"""

from slipstitch.config.load import load_config, read_mapping, resolve_config, write_config
from slipstitch.config.model import Config
from slipstitch.config.simulation import GridSettings
