"""Violations that axe finds on pages: `python benchmarks/accessibility.py NAME=PAGE.html ...`.

It writes results/accessibility.json; pages of other names keep what stands there.

Chromium opens each page 1400 and 390 pixels wide, in the light and in the dark, with scripts; axe-core checks what it
shows by all its rules. Neither belongs to simgap's environment:

    uv run --with playwright --with axe-playwright-python python benchmarks/accessibility.py case=report.html

with Debian's `chromium`. A page is a file or an address (`mkdocs serve`); `--pictures DIR` keeps pictures. It exits
with 1 if there is a violation; each is printed with the elements concerned.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
RESULT = ROOT / "benchmarks" / "results" / "accessibility.json"
WIDTHS = (1400, 390)
SCHEMES = ("light", "dark")


def look(browser: Any, page: str, width: int, scheme: str, rules: str, picture: Path | None) -> dict[str, Any]:
    """Violations with the elements concerned, pixels beyond the window, and lines on the console of one page."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    shown, said = context.new_page(), []
    shown.on("console", lambda message: said.append(message.text))
    shown.on("pageerror", lambda error: said.append(str(error)))
    shown.goto(page if "://" in page else Path(page).resolve().as_uri())
    beyond = shown.evaluate("document.documentElement.scrollWidth - innerWidth")
    shown.evaluate(rules)
    found = shown.evaluate("axe.run()")
    if picture is not None:
        shown.screenshot(path=picture, full_page=True)
    context.close()
    violations = {v["id"]: [node["html"] for node in v["nodes"]] for v in found["violations"]}
    return {
        "rules_passed": len(found["passes"]),
        "violations": violations,
        "pixels_beyond": beyond,
        "console": len(said),
    }


def main(named: list[str]) -> int:
    """Look at every page and write what was found: -> whether there is a violation."""
    import axe_playwright_python
    from playwright.sync_api import sync_playwright

    folder = Path(named.pop(named.index("--pictures") + 1)) if "--pictures" in named else None
    pages = dict(name.split("=", 1) for name in named if "=" in name)
    rules = Path(axe_playwright_python.__file__).with_name("axe.min.js").read_text()
    (axe,) = re.findall(r"axe v([\d.]+)", rules[:80])
    seen = json.loads(RESULT.read_text())["pages"] if RESULT.is_file() else {}
    result: dict[str, Any] = {"axe_playwright_python": version("axe-playwright-python"), "axe": axe, "pages": seen}
    with sync_playwright() as engine:
        browser = engine.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        result["chromium"] = browser.version
        for name, page in pages.items():
            rows = result["pages"][name] = []
            for width in WIDTHS:
                for scheme in SCHEMES:
                    picture = folder / f"{name}-{width}-{scheme}.png" if folder is not None else None
                    rows.append(
                        {"width": width, "scheme": scheme, **look(browser, page, width, scheme, rules, picture)}
                    )
                    print(name, width, scheme, json.dumps(rows[-1], indent=1))
        browser.close()
    RESULT.write_text(json.dumps(result, indent=1) + "\n")
    return int(any(row["violations"] for rows in result["pages"].values() for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
