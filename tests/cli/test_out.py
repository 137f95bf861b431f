"""What the verbs write with --out: nothing is lost on a full disk, and nothing is replaced but what they wrote."""

import resource
import shutil
from contextlib import contextmanager

import pytest
from typer.main import get_command

from optkit.cli.app import app
from optkit.evaluation import main_job, results_folder
from optkit.evaluation.main_job import run_main_job
from optkit.plotting import files
from optkit.plotting.files import figure_bytes
from optkit.studies import grids
from optkit.studies.report import report  # loaded before what it draws with is replaced
from tests.cli.test_instances import MAP, tables
from tests.command_line import optkit

SMALL = ["--set", "split=8,2,2", "--set", "horizon=6"]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with instance sets, offers and a policy, and the study cut down to two cells."""
    folder = tmp_path_factory.mktemp("out")
    optkit("generate", "I.1", *SMALL, "--out", folder / "days", check=0)
    optkit("collect", "I.1", "--set", "horizon=30", "--set", "split=30,0,0", "--out", folder / "log.parquet", check=0)
    optkit("train", "I.1", *SMALL, "--choice", "true", "--out", folder / "p.json", "--quiet", check=0)
    tables(folder)
    (folder / "requests.csv").write_text("request,value,utility\na,30,-10\nb,53,-22\nc,45,-30\n")
    few = grids.Study.cells
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grids.Study, "cells", lambda study: few(study)[:2])
        yield folder


VERBS = {
    "bound": (["bound", "days/test"], "rows.csv"),
    "bound in Parquet": (["bound", "days/test"], "rows.parquet"),
    "certify": (["certify", "days", "--policy", "myopic", "--kinds", "full"], "rows.csv"),
    "certify's figure": (["certify", "days", "--policy", "myopic", "--kinds", "full"], "ladder.png"),
    "certify's figure in PDF": (["certify", "days", "--policy", "myopic", "--kinds", "full"], "ladder.pdf"),
    "price": (["price", "requests.csv"], "rows.csv"),
    "price in Parquet": (["price", "requests.csv"], "rows.parquet"),
    "evaluate": (["evaluate", "p.json", "days"], "rows.parquet"),
    "evaluate in CSV": (["evaluate", "p.json", "days"], "rows.csv"),
    "collect": (["collect", "days"], "offers.parquet"),
    "fit": (["fit", "log.parquet"], "fit.txt"),
    "train": (["train", "days", "--choice", "true"], "policy.json"),
    "run": (["run", "days", "--verify", 0], "results"),
    "generate": (["generate", "I.1", *SMALL, "--overwrite"], "set"),
    "instances": (
        ["instances", "orders.csv", "couriers.csv", *MAP, "--step=15s", "--day-column=date", "--overwrite"],
        "set",
    ),
    "study": (["study", "homogeneous", *SMALL, "--jobs", 1], "studies"),
}
"""What is asked of each verb, and where it is to write."""

FOLDERS = ("run", "generate", "instances", "study")
FILES = [name for name in VERBS if name not in FOLDERS]


def asked(name, place, out):
    """The command line of one of :data:`VERBS` with another place to write."""
    words, _ = VERBS[name]
    words = [place / word if (place / str(word)).exists() else word for word in words]
    return [*words, "--plot" if "figure" in name else "--out", out]


def contents(folder):
    """Bytes of all files, hidden ones too."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextmanager
def full_disk():
    """No file may grow beyond 64 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (64, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_every_verb_that_writes_is_among_them():
    """A verb that learns to write is held to the same."""
    verbs = get_command(app).commands
    assert {words[0] for words, _ in VERBS.values()} == {
        name for name, verb in verbs.items() if any("--out" in one.opts for one in verb.params)
    }


LONG = ("run", "study")
"""They train, simulate and draw."""


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in VERBS])
def test_a_full_disk_loses_nothing(name, place, tmp_path, monkeypatch):
    """What was found is printed, what was there stays, nothing half written is left; then all is written after all."""
    found, drawn = [], {}

    def found_once(*asked, **settings):
        found.append(found[0] if found else run_main_job(*asked, **settings))
        return found[-1]

    def drawn_once(figure, kind):
        drawn[kind] = drawn.get(kind) or figure_bytes(figure, kind)
        return drawn[kind]

    monkeypatch.setattr(main_job, "run_main_job", found_once)
    for module in (files, results_folder):
        monkeypatch.setattr(module, "figure_bytes", drawn_once)
    words = asked(name, place, tmp_path / VERBS[name][1])
    if name == "study":
        monkeypatch.setattr(report, "study_figures", lambda tables, trips: {})  # drawn elsewhere
        optkit(*words, check=0)  # what was worked out is there
        shutil.rmtree(tmp_path / "studies" / "homogeneous")
    before = contents(tmp_path)
    with full_disk():
        done = optkit(*words, check=2)
    assert (done.stderr.count("\n"), "cannot be written" in done.stderr) == (1, True)
    assert str(tmp_path) in done.stderr
    few = name in ("collect", "generate", "instances")  # which have nothing to tell but numbers
    assert few or done.stdout.count("\n") > 3
    assert contents(tmp_path) == before
    told = optkit(*words, check=0).stdout
    written = contents(tmp_path)
    assert written.keys() > before.keys()
    assert told.count("\n") >= done.stdout.count("\n")
    with full_disk():
        optkit(*words, check=2)
    assert contents(tmp_path) == written
    optkit(*words, check=0)  # its own is replaced
    assert contents(tmp_path).keys() == written.keys()


FOREIGN = {
    "a note": b"dear diary\n",
    "JSON": b'{"format": "mine", "precious": 1}',
    "no text": b"\xff\xfe\x00",
    "deep": b"[" * 100_000,
    "a picture": b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    "half a table": b"PAR1PAR1",
    "another table": b"instance,mine\n0,1\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("content", FOREIGN.values(), ids=FOREIGN)
@pytest.mark.parametrize("name", FILES)
def test_what_a_verb_did_not_write_stays(name, content, place, tmp_path):
    """Before any work, in one line; by its own name, through a link, and beside the file that is named."""
    _, file = VERBS[name]
    targets = [tmp_path / file]
    if name == "fit":
        targets.append(tmp_path / "fit.json")
    for target in targets:
        target.write_bytes(content)
        (tmp_path / f"link-{file}").unlink(missing_ok=True)
        (tmp_path / f"link-{file}").symlink_to(tmp_path / file)
        for out in (tmp_path / file, *([tmp_path / f"link-{file}"] if target == targets[0] else [])):
            done = optkit(*asked(name, place, out), check=2)
            assert (done.stdout, done.stderr.count("\n")) == ("", 1)
            assert "exists and holds no " in done.stderr
            assert target.read_bytes() == content
        target.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_of_other_things_stays(name, place, tmp_path):
    """In one line, whether a note lies in the folder, a file is in its place, or a link leads to somebody's folder."""
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "note.txt").write_text("dear diary")
    (tmp_path / "link").symlink_to(tmp_path / "home")
    before = contents(tmp_path)
    inside = {"study": "homogeneous"}.get(name, "")
    for out in ("home", "link", "home/note.txt"):
        target = tmp_path / out
        if inside and target.is_dir():
            (tmp_path / "home" / inside).mkdir(exist_ok=True)
            (tmp_path / "home" / inside / "note.txt").write_text("dear diary")
            before = contents(tmp_path)
        done = optkit(*asked(name, place, target), check=2 if name != "generate" else None)
        assert done.stderr.count("\n") == done.returncode / 2
        assert contents(tmp_path).items() >= before.items()


@pytest.mark.slow
def test_what_is_read_is_not_written_over(place, tmp_path):
    """By its name, by a link, by another name of the same file, and as the JSON that goes beside."""
    rows = optkit("fit", place / "log.parquet", "--out", tmp_path / "fit.txt", check=0)
    assert rows.stdout
    text = tmp_path / "fit.txt"
    (tmp_path / "link.txt").symlink_to(text)
    (tmp_path / "twin.txt").hardlink_to(text)
    before = contents(tmp_path)
    for out in ("fit.txt", "link.txt", "twin.txt"):
        assert "is what is read: choose another" in optkit("fit", text, "--out", tmp_path / out, check=2).stderr
    assert "is what is read" in optkit("fit", tmp_path / "fit.json", "--out", text, check=2).stderr
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_a_summary_that_was_edited_stays(place, tmp_path):
    """What somebody added to a file of ours is theirs."""
    words = ["fit", place / "log.parquet", "--out", tmp_path / "fit.txt"]
    optkit(*words, check=0)
    for file in ("fit.txt", "fit.json"):
        whole = (tmp_path / file).read_text()
        (tmp_path / file).write_text(whole.replace("pickup", "dropup", 1))
        assert "holds no summary of optkit fit" in optkit(*words, check=2).stderr
        (tmp_path / file).write_text(whole)
    optkit(*words, check=0)


@pytest.mark.parametrize("change", [b"mine,1,2\n", b"\n", b" "])
def test_rows_that_somebody_added_to_stay(place, tmp_path, change):
    """A CSV file has no place for a mark: only the very bytes that were written here are written over."""
    words = ["price", place / "requests.csv", "--out", tmp_path / "rows.csv"]
    optkit(*words, check=0)
    optkit(*words, check=0)
    whole = (tmp_path / "rows.csv").read_bytes()
    (tmp_path / "rows.csv").write_bytes(whole + change)
    assert "holds no rows of optkit as it wrote them here" in optkit(*words, check=2).stderr
    assert (tmp_path / "rows.csv").read_bytes() == whole + change


def test_a_checkpoint_is_not_written_over(place, tmp_path):
    """One file for the rows that are kept and for those that are told: it stays, and the report is printed."""
    both = ["--checkpoint", tmp_path / "rows.csv", "--out", tmp_path / "rows.csv"]
    done = optkit("certify", place / "days", "--policy", "myopic", "--kinds", "full", *both, check=2)
    assert "exists and holds no rows of optkit" in done.stderr
    assert "myopic" in done.stdout
    assert (tmp_path / "rows.csv").read_bytes().startswith(b'{"format": "optkit rows"')


def test_an_empty_file_holds_nothing(place, tmp_path):
    """As programs make one to have its name."""
    (tmp_path / "rows.csv").write_bytes(b"")
    optkit("bound", place / "days" / "test", "--out", tmp_path / "rows.csv", check=0)
    assert (tmp_path / "rows.csv").read_text().startswith("instance,")
