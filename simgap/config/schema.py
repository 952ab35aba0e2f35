"""The JSON schema of case files, generated from the typed sections."""

import json

from simgap.config.case import Case


def schema_text() -> str:
    """The text of configs/schema.json."""
    schema = Case.model_json_schema() | {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Another case file of this folder: sections that are not given here are taken from it, null "
        "leaves one out.",
    }
    own = [name for name in schema.pop("required") if name != "plant"]
    schema["anyOf"] = [{"required": [*own, "plant"]}, {"required": [*own, "extends"]}]
    return json.dumps(schema, indent=1, sort_keys=True) + "\n"
