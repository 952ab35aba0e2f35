"""The page of public robot files is what the command found, on the files that its list names."""

import importlib.util
import json


def loaded(root):
    spec = importlib.util.spec_from_file_location("public_models", root / "benchmarks/public_models.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_is_the_results_and_they_are_of_the_list(root):
    own = loaded(root)
    found = json.loads(own.OUT.read_text())
    assert own.page(found["rows"]) == own.PAGE.read_text()
    assert own.counts(found["rows"]) == found["counts"]
    listed = {(package.split("/")[0], name, json.dumps(options)): right for package, name, options, right in own.FILES}
    for row in found["rows"]:
        assert listed[row["package"], row["file"], json.dumps(row["options"])] == row["right"]
