"""Folders are whole, one process comes after the other, and nothing is replaced but what was written there."""

import json
import os
import threading

import pytest

from optkit.basics import folders
from optkit.basics.errors import InputError
from optkit.basics.files import locked_folder
from optkit.basics.folders import ResultsFolder, publish, set_aside
from optkit.basics.keeper import Form, KeptFiles

KIND = ResultsFolder("told.json", "a test", "results of a test", loose=("times",))


def write(target, **texts):
    contents = {name: text.encode() for name, text in texts.items()}
    publish(target, KIND.files(contents, {"of": "me"}), lambda: KIND.check(target))


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_many_writers_of_one_folder(tmp_path):
    """Whoever comes last stays; none fails, none finds a folder that seems to be interrupted, nothing is left over."""
    target, failed = tmp_path / "report", []

    def work(name):
        try:
            for k in range(15):
                set_aside(target)
                write(target, a=f"{name} {k}", b=f"{name} {k}")
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(name,)) for name in "xyz"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert (target / "a").read_text() == (target / "b").read_text()
    assert os.listdir(tmp_path) == ["report"]


def test_a_folder_that_came_meanwhile_is_asked_about(tmp_path, monkeypatch):
    """Without locks too: another's folder of the same kind is replaced, anything else stays and is named."""
    monkeypatch.setattr("optkit.basics.files.fcntl", None)
    target = tmp_path / "report"
    for name, fails in (("told.json", False), ("diary", True)):
        asked = []

        def replaceable(name=name, asked=asked):
            there = KIND.check(target)
            asked.append(there)
            if len(asked) == 1:  # just now another process was faster
                target.mkdir()
                record = KIND.files({}, {})["told.json"] if name == "told.json" else b"dear diary"
                (target / name).write_bytes(record)
            return there

        if fails:
            with pytest.raises(InputError, match="holds 'diary'"):
                publish(target, {"a": b"1"}, replaceable)
            assert content(target) == {"diary": b"dear diary"}
        else:
            publish(target, KIND.files({"a": b"1"}, {}), replaceable)
            assert asked == [False, True]
            assert (target / "a").read_bytes() == b"1"
            for path in target.iterdir():
                path.unlink()
            target.rmdir()
    assert os.listdir(tmp_path) == ["report"]


@pytest.mark.slow
@pytest.mark.parametrize("locks", [True, False])
def test_several_who_write_into_one_folder_all_end_well(tmp_path, monkeypatch, locks):
    """As two studies with the same --out do at once: each finds what another wrote, and replaces it."""
    if not locks:
        monkeypatch.setattr("optkit.basics.files.fcntl", None)
    failed, kept = [], KeptFiles(tmp_path / "cells", Form("a test", 1, "an entry of a test"))

    def work(number):
        try:
            for _ in range(25):
                KIND.check(tmp_path / "report")
                write(tmp_path / "report", a=str(number), b=str(number))
                kept.put("same", {"x": number})
                assert kept.get("same")["x"] in range(3)
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=[number]) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert kept.damaged == 0
    assert (tmp_path / "report" / "a").read_text() == (tmp_path / "report" / "b").read_text()
    assert sorted(os.listdir(tmp_path)) == ["cells", "report"]


def test_the_lock_is_held_once(tmp_path):
    """Who holds it may ask again; another thread waits."""
    done = []

    def other():
        with locked_folder(tmp_path):
            done.append("other")

    with locked_folder(tmp_path), locked_folder(tmp_path):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join(0.2)
        done.append("mine")
    thread.join()
    assert done == ["mine", "other"]


def test_results_are_replaced_only_as_they_were_written(tmp_path):
    """Any file that was changed, or added, stops it and is named; what was taken away and loose files do not."""
    target = tmp_path / "report"
    write(target, a="1", b="2", times="3")
    (target / "times").write_text("4")
    (target / "b").unlink()
    write(target, a="1", b="2")
    for name in ("a", "b", "told.json", "more"):
        before = content(target)
        text = "mine"
        if name == "told.json":
            told = json.loads((target / name).read_text())
            text = json.dumps(told | {"of": "you"})
        (target / name).write_text(text)
        changed = content(target)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            write(target, a="5")
        assert content(target) == changed
        (target / "more").unlink(missing_ok=True)
        for file, data in before.items():
            (target / file).write_bytes(data)
    write(target, a="5")
    assert content(target)["a"] == b"5"


def test_folders_from_before_digests(tmp_path):
    """What an older version wrote is known by the names of its files."""
    early = ResultsFolder("told.json", "a test", "results of a test", early=("told.json", "a"))
    (tmp_path / "a").write_text("1")
    (tmp_path / "told.json").write_text('{"format": "a test"}')
    assert early.check(tmp_path)
    (tmp_path / "b").write_text("mine")
    with pytest.raises(InputError, match="'b'"):
        early.check(tmp_path)


def test_an_interruption_between_two_renames_is_found(tmp_path, monkeypatch):
    """The old folder is whole where set_aside says, and nothing is written in its place."""
    target = tmp_path / "report"
    write(target, a="1")
    rename, count = os.replace, iter(range(9))

    def stop(source, goal):
        if next(count) > 0:
            raise KeyboardInterrupt
        rename(source, goal)

    monkeypatch.setattr(folders.os, "replace", stop)
    with pytest.raises(KeyboardInterrupt):
        write(target, a="2")
    monkeypatch.undo()
    aside = set_aside(target)
    assert (aside / "a").read_text() == "1"
    with pytest.raises(InputError, match="is missing: writing was interrupted"):
        KIND.check(target)
