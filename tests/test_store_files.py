"""Files appear whole or not at all, and appended lines survive being cut off."""

import errno
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from gaitopt.errors import StorageError
from gaitopt.store import LineWriter, Table, csv_text, json_text, read_lines, write_whole
from gaitopt.store.text import parse_csv

ONE_THIRD = 1 / 3


def full_disk(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_file_replaces_the_one_before(tmp_path):
    write_whole(tmp_path / "a.txt", "old")
    write_whole(tmp_path / "a.txt", "new\r\n")
    assert (tmp_path / "a.txt").read_bytes() == b"new\r\n"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


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
    record = {
        "a": ONE_THIRD,
        "b": [np.nan, -np.inf],
        "c": np.array([np.pi, np.nan]),
        "d": np.float64(0.1),
        "e": (1, True),
    }
    assert json.loads(json_text(record), parse_constant=pytest.fail) == {
        "a": ONE_THIRD,
        "b": [None, None],
        "c": [np.pi, None],
        "d": 0.1,
        "e": [1, True],
    }


def test_a_table_is_read_back_to_the_last_digit():
    table = Table(header=("t", "mode", "f_t"), rows=((0.0, "stick", ONE_THIRD), (np.float64(0.1), "stick", np.nan)))
    back = parse_csv(csv_text(table))
    assert back.header == table.header
    assert back.rows[0] == (0.0, "stick", ONE_THIRD)
    assert back.rows[1][:2] == (0.1, "stick")
    assert np.isnan(back.rows[1][2])
    assert "nan" not in csv_text(table)


@pytest.mark.parametrize(("text", "words"), [("t,x\n0,1\n2", "line 3 has 1 cells"), ("t,x\n0,l\n", "line 2: .*'l'")])
def test_a_torn_table_names_its_line(text, words):
    with pytest.raises(ValueError, match=words):
        parse_csv(text)


def test_appended_records_are_read_back_in_order(tmp_path):
    path = tmp_path / "branch.jsonl"
    for start in (0, 2):
        with LineWriter(path) as lines:
            lines.append({"index": start, "value": ONE_THIRD})
            lines.append({"index": start + 1, "value": np.nan})
    records = list(read_lines(path))
    assert [record["index"] for record in records] == [0, 1, 2, 3]
    assert records[0]["value"] == ONE_THIRD
    assert records[1]["value"] is None


@pytest.mark.parametrize("torn", [b'{"index": 1, "val', b'{"index": 1}', b"\0\0\0\0\n", b"\xff\n", b"17\n"])
def test_a_torn_last_line_is_dropped_and_then_overwritten(tmp_path, torn):
    path = tmp_path / "branch.jsonl"
    path.write_bytes(b'{"index": 0}\n' + torn)
    assert list(read_lines(path)) == [{"index": 0}]
    with LineWriter(path) as lines:
        lines.append({"index": 7})
    assert path.read_bytes() == b'{"index": 0}\n{"index": 7}\n'


def test_a_broken_line_in_the_middle_is_named_and_left_alone(tmp_path):
    path = tmp_path / "branch.jsonl"
    text = b'{"index": 0}\n{"ind\n{"index": 2}\n'
    path.write_bytes(text)
    with pytest.raises(StorageError, match=r"branch\.jsonl:2: not a JSON object"):
        list(read_lines(path))
    with pytest.raises(StorageError, match=r"branch\.jsonl:2"), LineWriter(path):
        pass
    assert path.read_bytes() == text


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


def test_a_missing_file_of_lines_is_named(tmp_path):
    with pytest.raises(StorageError, match=r"cannot read .*none\.jsonl: No such file"):
        list(read_lines(tmp_path / "none.jsonl"))
