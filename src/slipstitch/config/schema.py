"""The JSON schema of the configuration, for editors and readers: keys, meaning, bounds.

``slipstitch schema > workflow/schemas/config.schema.json`` regenerates it.
"""

import json

from slipstitch.config.model import Config


def schema_text() -> str:
    """The schema as the file in ``workflow/schemas`` shall hold it."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Config.model_json_schema(),
    }
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
