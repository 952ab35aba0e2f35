"""Plug-ins: found by name, in a file beside a case or offered by a distribution; their keys checked like any others."""

from importlib import metadata
from typing import Annotated

import pytest
from pydantic import BaseModel, ValidationError

from simgap import plugins
from simgap.config.base import Section
from simgap.config.plugged import INNER, Plugged
from simgap.errors import UserError

MINE = """
from typing import Literal
from simgap.config.base import Section

class Mine(Section):
    engine: str
    gain: float = 1.0
"""


class Holder(BaseModel):
    simulator: Annotated[Section, Plugged("engines", "engine")]


def test_a_file_beside_the_case_is_a_plug_in(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    held = Holder.model_validate({"simulator": {"engine": "mine.py:Mine", "gain": 2.0}}, context={"folder": tmp_path})
    assert held.simulator.gain == 2.0
    assert held.model_dump()["simulator"] == {"engine": "mine.py:Mine", "gain": 2.0}
    assert plugins.source(type(held.simulator)) == tmp_path / "mine.py"


def test_a_changed_file_is_another_plug_in(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    first = plugins.find("engines", "mine.py:Mine", tmp_path)
    (tmp_path / "mine.py").write_text(MINE.replace("1.0", "3.0"))
    second = plugins.find("engines", "mine.py:Mine", tmp_path)
    assert (first(engine="a").gain, second(engine="a").gain) == (1.0, 3.0)


def test_errors_inside_keep_their_place(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    with pytest.raises(ValidationError) as caught:
        Holder.model_validate({"simulator": {"engine": "mine.py:Mine", "gian": 2.0}}, context={"folder": tmp_path})
    (error,) = caught.value.errors()
    assert (error["type"], error["loc"]) == (INNER, ("simulator",))
    (inner,) = error["ctx"]["errors"]
    assert (inner["type"], inner["loc"]) == ("extra_forbidden", ("gian",))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.py:Mine", "does not exist"),
        ("../outside.py:Mine", "outside the case's folder"),
        ("mine.py:Yours", "no class 'Yours'"),
        ("broken.py:Mine", "does not run: ZeroDivisionError"),
        ("nothing", "Known:"),
    ],
)
def test_what_cannot_be_found_is_told(tmp_path, name, words):
    folder = tmp_path / "cases"
    folder.mkdir()
    (tmp_path / "outside.py").write_text(MINE)
    (folder / "mine.py").write_text(MINE)
    (folder / "broken.py").write_text("1 / 0")
    with pytest.raises(UserError) as caught:
        plugins.find("engines", name, folder)
    assert words in str(caught.value)


def test_a_distribution_offers_plug_ins(monkeypatch):
    point = metadata.EntryPoint("theirs", "collections:OrderedDict", "simgap.engines")
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point] if group == "simgap.engines" else [])
    plugins._offered.cache_clear()
    try:
        assert plugins.find("engines", "theirs").__name__ == "OrderedDict"
        assert "theirs" in plugins.names("engines")
    finally:
        plugins._offered.cache_clear()
