"""What comes from files is shown on a terminal, and never obeyed by it."""

import io

import pytest

from gaitopt.cli.console import ResultConsole
from gaitopt.cli.printable import printable

ATTACK = "\x1b]0;title\x07\x1b[31mred\x9b2J\r\x08\x7f‮⁦ 한국 ñ\n\ttab"
SHOWN = r"\x1b]0;title\x07\x1b[31mred\x9b2J\r\x08\x7f\u202e\u2066 한국 ñ" + "\n\ttab"
PROBLEM = """name: "evil\\e[31m"
about: "\\e]0;owned\\a and \\e[2J"
walker: {model: rimless_wheel, spokes: 6, radius: 1, mass: 1, inertia_ratio: 0.5, gravity: 9.81, slope: 13 deg}
friction: 1.0
control: {type: none}
gait:
  phases: [stick]
  impact: stick
  guess: {state: {dtheta: 0.9}}
"""


def test_control_characters_are_shown_as_escapes():
    assert printable(ATTACK) == SHOWN
    assert printable(SHOWN) == SHOWN


def test_lone_surrogates_are_shown_too():
    assert printable("\udc80") == r"\udc80"


@pytest.mark.parametrize("terminal", [True, False])
def test_console_shows_them_in_texts_and_tables(terminal):
    from gaitopt.library.tables import table

    written = io.StringIO()
    console = ResultConsole(file=written, force_terminal=terminal, width=200, markup=False, color_system=None)
    console.print(ATTACK)
    console.print(table(("a\x1b[1m", "b"), [("\x1b[31mred", "\x07")]))
    assert not set(written.getvalue()) & set("\x1b\x07\x9b\r\x08\x7f‮⁦")
    assert r"\x1b[31mred" in written.getvalue()


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize(
    "command",
    [
        ("show",),
        ("validate",),
        ("solve", "--json"),
        ("solve",),
        ("simulate",),
        ("validate", "--set", "objective=\x1b[31m"),
    ],
)
def test_commands_print_no_sequence_of_a_problem_file(run, empty_folder, command):
    (empty_folder / "evil.yaml").write_text(PROBLEM)
    _, out, err = run(command[0], "evil.yaml", *command[1:])
    assert not set(out + err) & set("\x1b\x07")


@pytest.mark.usefixtures("empty_folder")
def test_a_file_with_a_sequence_where_a_name_belongs_is_refused_in_print(run, empty_folder):
    (empty_folder / "evil.yaml").write_text(PROBLEM + 'objective: "\\e[31mred"\n')
    code, _, err = run("validate", "evil.yaml", "--debug")
    assert code == 3
    assert "\x1b" not in err
    assert r"\x1b[31mred" in err
