"""Provenance of artefacts: atomic writes, code digests, records beside or inside files."""

from slipstitch.provenance.code import code_digest, code_sources
from slipstitch.provenance.files import atomic_path, file_digest
from slipstitch.provenance.reading import (
    check_image,
    check_recorded,
    image_bytes,
    load_yaml,
    open_parquet,
    read_json,
    read_parquet,
    read_yaml,
    reading,
)
from slipstitch.provenance.record import (
    attach_metadata,
    parquet_stream,
    provenance_record,
    read_metadata,
    read_provenance,
    read_sidecar,
    recorded_path,
    start_clock,
    write_json,
    write_parquet,
    write_sidecar,
    write_text,
)

__all__ = [
    "atomic_path",
    "attach_metadata",
    "check_image",
    "check_recorded",
    "code_digest",
    "code_sources",
    "file_digest",
    "image_bytes",
    "load_yaml",
    "open_parquet",
    "parquet_stream",
    "provenance_record",
    "read_json",
    "read_metadata",
    "read_parquet",
    "read_provenance",
    "read_sidecar",
    "read_yaml",
    "reading",
    "recorded_path",
    "start_clock",
    "write_json",
    "write_parquet",
    "write_sidecar",
    "write_text",
]
