"""Decimal digits are the only numbers in every option and file: no 1_0 and no digits of other scripts."""

from pathlib import Path

import pytest

import gaitopt as go
from gaitopt.errors import ProblemError
from gaitopt.model.units import LONGEST_COUNT, parse_count, parse_number

WHEEL = "rimless-wheel-stick"
ARABIC = "\N{ARABIC-INDIC DIGIT ONE}"
WRONG = ("1_0", ARABIC, f"1e{ARABIC}", "0x10", "1e", "", "1 0", "--1", "infinity")

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.mark.parametrize("text", ["1", "-1.5", "+.5", "2.", "1e-3", "1E+3", " 7 ", "inf", "-inf", ".inf"])
def test_decimal_numbers_are_read_as_python_reads_them(text):
    assert parse_number(text) == float(text.replace(".inf", "inf"))


@pytest.mark.parametrize("text", WRONG)
def test_other_texts_are_no_numbers(text):
    with pytest.raises(ValueError, match="is not a number"):
        parse_number(text)


def test_a_count_has_ascii_digits():
    assert parse_count("007") == 7
    assert [parse_count(text) for text in ("1_0", ARABIC, "-1", "1.0", "", "9" * (LONGEST_COUNT + 1))] == [None] * 6


@pytest.mark.parametrize("digits", ["1_0", ARABIC])
@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        (("validate", WHEEL, "--set", "friction={}"), "--set friction"),
        (("validate", WHEEL, "--set", "walker.slope={} deg"), "--set walker.slope"),
        (("sweep", WHEEL, "--over", "friction={}:20:2"), "--over friction"),
        (("sweep", WHEEL, "--over", "friction=0.3:{}:2"), "--over friction"),
        (("sweep", WHEEL, "--over", "friction=0.3:0.4:{}"), "--over friction"),
        (("simulate", WHEEL, "--state", "dtheta={}"), "--state dtheta"),
        (("simulate", WHEEL, "--steps", "{}"), "--steps"),
        (("simulate", WHEEL, "--steps={}"), "--steps"),
        (("find", WHEEL, "--within", "dtheta=0:{}"), "--within dtheta"),
        (("solve", WHEEL, "--spread", "{}"), "--spread"),
        (("replay", WHEEL, "--engine", "mujoco", "--dt", "{}"), "--dt"),
        (("prove", WHEEL, "--set", "friction={}..20"), "--set friction"),
        (("continue", WHEEL, "--param", "friction", "--to", "{}"), "--to"),
        (("continue", WHEEL, "--param", "friction", "--to", "1", "--follow", "doublings={}"), "--follow doublings"),
    ],
)  # fmt: skip
def test_an_option_takes_decimal_digits_only(run, arguments, place, digits):
    code, out, err = run(*(text.format(digits) for text in arguments))
    assert code in (2, 3)
    assert not out
    assert place in err
    assert not list(Path().iterdir())


@pytest.mark.parametrize("digits", ["1_0", ARABIC])
def test_a_file_takes_decimal_digits_only(digits):
    text = go.load_problem(WHEEL).text
    with pytest.raises(ProblemError, match=rf"friction: '?{digits}'? is not a number"):
        go.parse_problem(text.replace("friction: 1.0", f"friction: {digits}"))


class Loose(go.Control):
    """A law whose numbers are plain types of Python, which pydantic converts from texts."""

    type = "loose"

    gain: float = 1.0
    count: int = 1
    gains: dict[str, float] = {}  # noqa: RUF012 - pydantic copies it

    def torques(self, now):
        return {"hip": now.p.gain * now.q.theta2}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("gain: 1_0", "control.gain: '1_0' is not a number"),
        ("gain: '2'", "control.gain: '2' is not a number"),
        ("gain: true", "control.gain: true is not a number"),
        ("count: 1_0", "control.count: '1_0' is not an integer"),
        ("gains: {a: 1_0}", "control.gains.a: '1_0' is not a number"),
        ("count: 1_0, gain: x", "control.count: '1_0' is not an integer"),
    ],
)
def test_numbers_of_a_law_of_ones_own_are_no_texts(keys, words):
    text = go.load_problem("compass-passive-a").text
    with pytest.raises(ProblemError) as caught:
        go.parse_problem(f"{text}control: {{type: loose, {keys}}}\n", controls=[Loose])
    assert words in str(caught.value)
