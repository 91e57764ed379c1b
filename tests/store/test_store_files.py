"""Files appear whole or not at all, and appended lines survive being cut off."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gaitopt.errors import StorageError
from gaitopt.store import files
from gaitopt.store.files import LineWriter, lines_text, read_lines, write_whole
from gaitopt.store.formats import Table, csv_text, json_text, parse_csv

ONE_THIRD = 1 / 3


def full_disk(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_keeps_the_old_file_and_says_so(tmp_path, monkeypatch):
    write_whole(tmp_path / "a.txt", "old")
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(StorageError, match=r"cannot write .*a\.txt: No space left on device; kept whole in .*: a\.txt"):
        write_whole(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_writer_killed_at_any_moment_leaves_a_whole_file(tmp_path):
    program = (
        "import sys; from pathlib import Path; from gaitopt.store.files import write_whole\n"
        "for k in range(10**6): write_whole(Path(sys.argv[1]), f'{k}\\n' * 20000)"
    )
    path = tmp_path / "a.txt"
    for delay in (0.0, 0.013, 0.031):
        writer = subprocess.Popen([sys.executable, "-c", program, str(path)])
        while not path.exists() and writer.poll() is None:
            time.sleep(0.005)
        time.sleep(delay)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        lines = path.read_text().splitlines()
        assert len(lines) == 20000
        assert len(set(lines)) == 1


def test_json_keeps_every_digit_and_has_no_bare_nan():
    record = {"a": ONE_THIRD, "b": [np.nan, -np.inf], "c": np.array([np.pi, np.nan]), "d": np.float64(0.1)}
    known = {"a": ONE_THIRD, "b": [None, None], "c": [np.pi, None], "d": 0.1, "e": [1, True]}
    assert json.loads(json_text({**record, "e": (1, True)}), parse_constant=pytest.fail) == known


def test_a_table_is_read_back_to_the_last_digit():
    table = Table(header=("t", "mode", "f_t"), rows=((0.0, "stick", ONE_THIRD), (np.float64(0.1), "stick", np.nan)))
    back = parse_csv(csv_text(table))
    assert back.header == table.header
    assert back.rows[0] == (0.0, "stick", ONE_THIRD)
    assert back.rows[1][:2] == (0.1, "stick")
    assert np.isnan(back.rows[1][2])
    assert "nan" not in csv_text(table)


def written(path, *records):
    with LineWriter(path) as lines:
        for record in records:
            lines.append(record)
    return path.read_bytes()


def test_appended_records_are_read_back_in_order(tmp_path):
    path = tmp_path / "branch.jsonl"
    records = [{"index": k, "value": ONE_THIRD if k % 2 == 0 else np.nan} for k in range(4)]
    for start in (0, 2):
        text = written(path, *records[start : start + 2])
    assert text.decode() == lines_text(records)
    assert list(read_lines(path)) == [{"index": k, "value": ONE_THIRD if k % 2 == 0 else None} for k in range(4)]


@pytest.mark.parametrize("kept", [1, 10, -2, -1])
def test_a_torn_last_line_is_dropped_and_then_overwritten(tmp_path, kept):
    path = tmp_path / "branch.jsonl"
    first = written(path, {"index": 0})
    whole = written(path, {"index": 7})
    path.write_bytes(first + whole[len(first) :][:kept])
    assert list(read_lines(path)) == [{"index": 0}]
    assert written(path, {"index": 7}) == whole


DAMAGES = {
    "digit": (2, lambda lines: [lines[0], lines[1].replace(b"1.5", b"1.6"), *lines[2:]]),
    "digit of the last line": (4, lambda lines: [*lines[:3], lines[3].replace(b"3.5", b"3.6")]),
    "digit of a checksum": (2, lambda lines: [lines[0], lines[1][:-4] + b'x"}\n', *lines[2:]]),
    "deleted": (2, lambda lines: [lines[0], *lines[2:]]),
    "first deleted": (1, lambda lines: lines[1:]),
    "doubled": (3, lambda lines: [*lines[:2], lines[1], *lines[2:]]),
    "swapped": (2, lambda lines: [lines[0], lines[2], lines[1], lines[3]]),
    "not an object": (2, lambda lines: [lines[0], b"17\n", *lines[2:]]),
    "without checksum": (2, lambda lines: [lines[0], b'{"index": 1, "value": 1.5}\n', *lines[2:]]),
    "not text": (4, lambda lines: [*lines[:3], b"\xff\n"]),
    "zeros": (4, lambda lines: [*lines[:3], b"\0\0\0\n"]),
    "nested": (2, lambda lines: [lines[0], b"[" * 100_000 + b"\n", *lines[2:]]),
    "blank": (2, lambda lines: [lines[0], b"\n", *lines[1:]]),
}


@pytest.mark.parametrize(("line", "damage"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_line_is_named_and_left_alone(tmp_path, line, damage):
    path = tmp_path / "branch.jsonl"
    written(path, *({"index": k, "value": k + 0.5} for k in range(4)))
    text = b"".join(damage(path.read_bytes().splitlines(keepends=True)))
    path.write_bytes(text)
    with pytest.raises(StorageError, match=rf"branch\.jsonl:{line}: altered, or not in its place"):
        list(read_lines(path))
    with pytest.raises(StorageError, match=rf"branch\.jsonl:{line}"), LineWriter(path):
        pass
    assert path.read_bytes() == text


@pytest.mark.parametrize("deleted", ["unlink", "replaced"])
def test_a_file_of_lines_that_is_deleted_while_it_grows_is_noticed(tmp_path, deleted):
    path = tmp_path / "branch.jsonl"
    with LineWriter(path) as lines:
        lines.append({"index": 0})
        path.unlink()
        if deleted == "replaced":
            path.write_text("")
        with pytest.raises(StorageError, match="was deleted or replaced while this command was writing it") as refused:
            lines.append({"index": 1})
    assert refused.value.exit_code == 6


@pytest.mark.skipif(os.name != "posix", reason="links need rights elsewhere")
def test_planted_links_are_never_written_through(tmp_path, monkeypatch):
    precious = tmp_path / "precious"
    precious.write_text("precious")
    (tmp_path / "report.html").symlink_to(precious)
    (tmp_path / "branch.jsonl").symlink_to(precious)
    monkeypatch.setattr(files.secrets, "token_hex", lambda _: "0" * 16)
    guessed = tmp_path / f".report.html.{os.getpid()}-{'0' * 16}.tmp"
    guessed.symlink_to(precious)
    with pytest.raises(StorageError, match=r"cannot write .*report\.html: File exists"):
        write_whole(tmp_path / "report.html", "page")
    write_whole(tmp_path / "report.html", "page")  # the link has been removed, and is not followed
    assert not (tmp_path / "report.html").is_symlink()
    with pytest.raises(StorageError, match=r"branch\.jsonl"), LineWriter(tmp_path / "branch.jsonl"):
        pass
    (tmp_path / "branch.jsonl").unlink()
    (tmp_path / "branch.jsonl").symlink_to(tmp_path / "nowhere")
    with pytest.raises(StorageError, match="Too many levels of symbolic links"), LineWriter(tmp_path / "branch.jsonl"):
        pass
    assert not (tmp_path / "nowhere").exists()
    assert precious.read_text() == "precious"


def test_names_of_temporary_files_cannot_be_guessed(tmp_path, monkeypatch):
    names, replace = [], Path.replace
    monkeypatch.setattr(Path, "replace", lambda path, target: (names.append(path.name), replace(path, target))[1])
    for text in ("1", "2"):
        write_whole(tmp_path / "a", text)
    assert len(set(names)) == 2
    assert all(files.TEMPORARY_NAME.fullmatch(name) for name in names)


def test_a_full_disk_keeps_the_lines_before(tmp_path, monkeypatch):
    path = tmp_path / "branch.jsonl"
    with LineWriter(path) as lines:
        lines.append({"index": 0})
        monkeypatch.setattr(os, "fsync", full_disk)
        with pytest.raises(StorageError, match="No space left on device; all records before this one are kept"):
            lines.append({"index": 1})
        monkeypatch.undo()
        lines.append({"index": 2})
    assert list(read_lines(path)) == [{"index": 0}, {"index": 2}]
    with pytest.raises(StorageError, match=r"cannot read .*none\.jsonl: No such file"):
        list(read_lines(tmp_path / "none.jsonl"))
