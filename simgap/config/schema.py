"""The JSON schema of case files, generated from the typed sections."""

import json

from simgap.config.case import Case


def schema_text() -> str:
    """The text of configs/schema.json."""
    schema = Case.model_json_schema() | {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
