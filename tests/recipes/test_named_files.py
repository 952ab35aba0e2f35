"""Files of configs/ that documents and messages name are there."""

import re


def test_every_file_of_configs_that_is_named_is_there(root):
    texts = [root / "README.md", root / "CONTRIBUTING.md", root / "Snakefile", *root.glob("docs/*.md"),
             *root.glob("simgap/**/*.py"), *root.glob("rules/*.smk")]  # fmt: skip
    named = {
        (str(path.relative_to(root)), name)
        for path in texts
        for name in re.findall(r"configs/[\w./-]+\.(?:yaml|json|urdf|xml)\b", path.read_text())
    }
    assert len(named) > 10
    assert [pair for pair in sorted(named) if not (root / pair[1]).is_file()] == []
