"""Nothing is written through a link that somebody else put where results go."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from simgap.cli import main
from simgap.cli.terminal import start_log
from simgap.errors import UserError
from simgap.io.atomic import no_links_below, write_text
from simgap.io.results import table, write_json, write_parquet
from tests.little_cart import write_cart

RECORDING = "t,x,v,F\n" + "".join(f"{k / 100},0,0,0\n" for k in range(20))


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of somebody else's with a case in it, and a file outside that must stay as it is."""
    folder = tmp_path / "here"
    folder.mkdir()
    write_cart(folder, measured={"files": ["run.csv"]})
    (folder / "run.csv").write_text(RECORDING)
    (tmp_path / "victim").write_text("precious")
    monkeypatch.chdir(folder)
    yield folder
    assert (tmp_path / "victim").read_text() == "precious"


WRITERS = {
    "text": lambda path: write_text(path, "x"),
    "document": lambda path: write_json(path, {"x": 1}),
    "table": lambda path: write_parquet(path, table({"x": [1.0]}, {}, {}, {})),
    "log": start_log,
}


@pytest.mark.parametrize("kind", WRITERS)
def test_an_output_that_is_a_link_is_refused(here, kind):
    os.symlink("../victim", "out")
    with pytest.raises(UserError, match=r"^out: is a link"):
        WRITERS[kind](Path("out"))
    assert Path("out").is_symlink()


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("absolute", [False, True])
def test_so_is_one_below_a_folder_that_is_a_link(here, kind, absolute):
    Path("../theirs").mkdir()
    os.symlink("../theirs", "results")
    with pytest.raises(UserError, match="results: is a link"):
        WRITERS[kind]((here if absolute else Path()) / "results/cart/out")
    assert os.listdir("../theirs") == []


def test_a_log_takes_the_place_of_a_file_with_two_names(here):
    os.link("../victim", "a.log")
    start_log(Path("a.log"))
    assert Path("a.log").read_text() == ""


def test_a_log_does_not_wait_for_the_reader_of_a_pipe(here):
    os.mkfifo("a.log")
    with pytest.raises(UserError, match="is a pipe"):
        start_log(Path("a.log"))


@pytest.mark.parametrize("name", ["diagnosis.log", "report.html", "diagnosis.json", ""])
def test_a_diagnosis_writes_through_none(here, capsys, name):
    """The log was emptied before anything else, with a diagnosis that was refused too."""
    if name:
        Path("diagnosis").mkdir()
        os.symlink("../../victim", f"diagnosis/{name}")
    else:
        os.symlink("..", "diagnosis")
    with pytest.raises(SystemExit) as ended:
        main(["diagnose", "cart.yaml", "run.csv"])
    assert ended.value.code == 2
    assert sorted(os.listdir("diagnosis")) == ([name] if name else sorted(os.listdir("..")))
    assert not [name for name in os.listdir("..") if name.startswith(("diagnosis", "report"))]
    assert capsys.readouterr().err.count("\n") == 1


PLACES = {
    "a benchmark": "results/cart/benchmarks/check.tsv",
    "a log": "results/cart/logs/check.log",
    "a record of Snakemake's": ".snakemake/metadata/cmVzdWx0cw==",
    "a run": ".snakemake/simgap/runs/0-1.json",
}


@pytest.mark.parametrize("what", PLACES)
def test_what_others_write_for_a_run_is_looked_at_before(here, what):
    path = Path(PLACES[what])
    path.parent.mkdir(parents=True)
    path.symlink_to(here.parent / "victim")
    with pytest.raises(UserError, match="is a link"):
        no_links_below(Path(path.parts[0]))
    path.unlink()
    no_links_below(Path(path.parts[0]))
    os.mkfifo(path)
    with pytest.raises(UserError, match="neither a file nor a folder"):
        no_links_below(Path(path.parts[0]))


def test_a_benchmark_with_two_names_is_refused(here):
    Path("results/cart/benchmarks").mkdir(parents=True)
    os.link("../victim", "results/cart/benchmarks/check.tsv")
    with pytest.raises(UserError, match="two names"):
        no_links_below(Path("results"))


@pytest.mark.parametrize("name", ["results", "results/cart"])
def test_what_is_no_folder_is_refused_where_results_go_below_it(here, name):
    Path(name).parent.mkdir(exist_ok=True)
    os.mkfifo(name)
    with pytest.raises(UserError, match="is not a folder"):
        no_links_below(Path("results/cart"))


def test_a_run_refuses_it_in_one_line(here):
    """The whole command, and Snakemake's own."""
    Path("results/cart/benchmarks").mkdir(parents=True)
    os.symlink("../../../../victim", "results/cart/benchmarks/check.tsv")
    command = [sys.executable, "-m", "simgap.cli", "run", "cart.yaml", "--until=check"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert "simgap: results/cart/benchmarks/check.tsv: is a link, and nothing is written through one" in done.stderr
    assert "Traceback" not in done.stderr
