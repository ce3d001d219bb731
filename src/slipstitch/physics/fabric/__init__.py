"""Fabrics and their data-driven elastic law: measured tables, no solver."""

from slipstitch.config.catalogue import fabric_names
from slipstitch.physics.fabric.fabrics import Fabric, fabric_digest, load_fabric, read_fabric_file
from slipstitch.physics.fabric.law import ElasticTables, isotropic_tables

__all__ = [
    "ElasticTables",
    "Fabric",
    "fabric_digest",
    "fabric_names",
    "isotropic_tables",
    "load_fabric",
    "read_fabric_file",
]
