"""The command line as a list: every command in one group, answers for programs, misspelt options."""

import json
import shutil

import pytest
import typer

from simgap.cli import app, main
from simgap.cli.commands import GROUPS


def run(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*map(str, arguments)])
    said = capsys.readouterr()
    return ended.value.code, said.out, said.err


def test_every_command_is_in_one_group():
    named = [name for names in GROUPS.values() for name in names]
    assert sorted(named) == sorted(typer.main.get_command(app).commands)
    assert len(named) == len(set(named))


def test_help_lists_every_command_in_its_group(capsys):
    _, whole, _ = run(["--help"], capsys)
    for title, names in GROUPS.items():
        assert f"{title}:" in whole
        assert all(f"\n  {name} " in whole for name in names)
    assert "..." not in whole.replace("[ARGS]...", "")  # no sentence is cut


def test_no_words_are_a_wish_for_help(capsys):
    assert run([], capsys) == run(["--help"], capsys)


def test_json_is_the_whole_of_stdout(root, tmp_path, capsys):
    status, out, _ = run(["check", root / "configs/cases/pendulum.yaml", "--json"], capsys)
    assert status == 0
    assert {cost["stage"] for cost in json.loads(out)["costs"]} >= {"rollouts", "synthesis"}
    status, out, _ = run(["effects", root / "configs/cases/pendulum.yaml", "--json"], capsys)
    (viscous,) = (e for e in json.loads(out)["effects"] if e["effect"] == "viscous_friction")
    assert (status, viscous["parameters"][0]["unit"]) == (0, "N m s/rad")
    jobs = tmp_path / "results/case/benchmarks"
    jobs.mkdir(parents=True)
    (jobs / "gap.tsv").write_text("s\th:m:s\tmax_rss\tcpu_time\n2.5\t0:00:02\t100.0\t2.0\n")
    status, out, _ = run(["times", tmp_path / "results", "--json"], capsys)
    assert [(job["case"], job["job"], job["wall"]) for job in json.loads(out)] == [("case", "gap", 2.5)]


def test_a_misspelt_option_is_named(root, tmp_path, capfd, monkeypatch):
    case = shutil.copy(root / "configs/cases/pendulum.yaml", tmp_path / "pendulum.yaml")
    shutil.copytree(root / "configs/models", tmp_path.parent / "models", dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for words in (["check", case, "--jsn"], ["run", case, "--coers", "2"]):
        status, _, err = run(words, capfd)
        option = next(w for w in words if str(w).startswith("--"))
        assert status in (1, 2)
        assert option in err, words
