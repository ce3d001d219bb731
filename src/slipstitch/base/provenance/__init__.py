"""Provenance of artefacts: atomic writes, code digests, records beside or inside files."""

from slipstitch.base.provenance.code import code_digest
from slipstitch.base.provenance.files import (
    atomic_path,
    check_image,
    check_recorded,
    file_digest,
    image_bytes,
    load_yaml,
    open_parquet,
    read_json,
    read_parquet,
    read_yaml,
    reading,
)
from slipstitch.base.provenance.record import (
    attach_metadata,
    count_earlier_attempts,
    earlier_attempts,
    provenance_record,
    read_metadata,
    read_provenance,
    read_sidecar,
    recorded_path,
    start_clock,
    write_json,
    write_parquet,
    write_row_groups,
    write_sidecar,
    write_text,
)
