"""A YAML text is read as YAML 1.2 with the place of every key, or refused before anything is built from it."""

from pathlib import Path

import pytest

from gaitopt import load_problem, parse_problem
from gaitopt.errors import ProblemError
from gaitopt.problem.source import MAX_BYTES, MAX_DEPTH, MAX_VALUES, parse_source, parse_value

BOMB = "a: &a [x, x]\n" + "".join(f"{name}: &{name} [*{of}, *{of}]\n" for of, name in ("ab", "bc", "cd", "de"))


def termination(text):
    with pytest.raises(ProblemError) as caught:
        parse_problem(text, Path("gait.yaml"))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_scalars_are_read_as_yaml_1_2():
    known = {"1e-3": 1e-3, "no": "no", "1:30": "1:30", "true": True, "~": None, "0o17": 15, "2020-01-01": "2020-01-01"}
    assert {text: parse_value(text) for text in known} == known


def test_every_key_and_entry_has_its_line_and_column():
    source = parse_source("a: 1\nb:\n  - c: 2\n  - [3, 4]\n", "gait.yaml")
    assert source.data == {"a": 1, "b": [{"c": 2}, [3, 4]]}
    assert source.marks[("b",)] == (2, 1)
    assert source.marks[("b", 0, "c")] == (3, 5)
    assert source.marks[("b", 1, 1)] == (4, 9)


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        (BOMB, "1:4", "anchor 'a' is not allowed"),
        ("a: *b", "1:4", "alias 'b' is not allowed"),
        ("a: 1\nb: !!python/name:os.system x", "2:4", "tag 'tag:yaml.org,2002:python/name:os.system' is not allowed"),
        ("a: 1\n---\nb: 2\n", "2:1", "second document"),
        ("%YAML 1.1\n---\na: 1:30\n", "2:1", "directives are not allowed"),
        ("[" * 100, f"1:{MAX_DEPTH + 1}", f"deeper than {MAX_DEPTH} levels"),
        ("- 1\n" * (MAX_VALUES + 1), f"{MAX_VALUES}:3", f"more than {MAX_VALUES} keys and values"),
        ("name: " + "x" * 5000, "1:7", "5000 characters"),
        ("name: x" + " " * MAX_BYTES, "1:1", "larger than 256 kB"),
        ("<<: {a: 1}", "1:1", "a key must be a plain word"),
        ("[a]: 1", "1:1", "a key must be a plain word"),
        ("a: 1\nb: [1, 2", "2:9", "is not YAML"),
        ("a:\n\tb: 1", "2:1", "is not YAML"),
        ('a: "\\UFFFFFFFF"', "1:1", "is not YAML"),
        ("a: 1\nb: \x07", "2:4", "control character U+0007"),
        ("", "1:1", "the file is not a mapping of keys"),
        ("- 1", "1:1", "the file is not a mapping of keys"),
    ],
)
def test_text_that_is_no_plain_mapping_is_refused_with_its_place(text, place, words):
    message = termination(text)
    assert message.startswith(f"gait.yaml:{place}")
    assert words in message


@pytest.mark.parametrize(
    ("text", "mark", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", (3, 1), "is given twice, first in line 1: keep one"),
        ("a: " + "9" * 50, (1, 1), "too large for an integer"),
        ("a: 0x" + "f" * 3000, (1, 1), "too large for an integer"),
    ],
)
def test_a_repeated_key_and_an_integer_beyond_64_bits_are_faults_with_their_line(text, mark, message):
    source = parse_source(text, "gait.yaml")
    assert source.marks[source.faults[0].path] == mark
    assert message in source.faults[0].message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"name: \xff\n", r"gait\.yaml:1:7: byte 0xff is not UTF-8 text"),
        (b"name: x\nabout: \x80\n", r"gait\.yaml:2:8: byte 0x80 is not UTF-8 text"),
        (b"#" * (MAX_BYTES + 1), r"gait\.yaml:1:1: is larger than 256 kB"),
    ],
)
def test_a_file_that_is_not_utf8_or_too_large_is_refused(tmp_path, content, words):
    (tmp_path / "gait.yaml").write_bytes(content)
    with pytest.raises(ProblemError, match=words):
        load_problem(tmp_path / "gait.yaml")


def test_a_missing_file_and_a_folder_are_refused_without_an_echo_of_control_characters(tmp_path):
    with pytest.raises(ProblemError, match=r"nowhere\.yaml:1:1: no such file; `gaitopt list`"):
        load_problem(tmp_path / "nowhere.yaml")
    with pytest.raises(ProblemError, match="is not a file"):
        load_problem(tmp_path)
    with pytest.raises(ProblemError) as caught:
        load_problem("\x1b[31m\0.yaml")
    assert str(caught.value).isprintable()


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    path = tmp_path / "gait.yaml"
    path.write_text(load_problem("compass-passive-a").text, encoding="utf-8-sig")
    assert load_problem(path).digest == load_problem("compass-passive-a").digest
