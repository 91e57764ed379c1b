"""What comes from files is shown on a terminal, and never obeyed by it."""

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from itertools import product
from pathlib import Path

import pytest
from named import named, verification
from samples import sampled

from gaitopt import __version__, load_problem, parse_problem, problem_names
from gaitopt.cli.main import main
from gaitopt.cli.terminal import NARROWEST_WIDTH, console
from gaitopt.errors import printable

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


@pytest.mark.parametrize(("text", "shown"), [(ATTACK, SHOWN), (SHOWN, SHOWN), ("\udc80", r"\udc80")])
def test_control_characters_and_lone_surrogates_are_shown_as_escapes(text, shown):
    assert printable(text) == shown


@pytest.mark.parametrize("terminal", [True, False])
def test_console_shows_them_in_texts_and_tables(terminal, monkeypatch):
    from gaitopt.show.tables import table

    written = io.StringIO()
    written.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stdout", written)
    monkeypatch.setenv("TERM", "dumb")  # no styles, which are sequences of their own
    monkeypatch.setenv("COLUMNS", "200")
    results = console(stderr=False)
    results.print(ATTACK)
    results.print(table(("a\x1b[1m", "b"), [("\x1b[31mred", "\x07")]))
    assert not set(written.getvalue()) & set("\x1b\x07\x9b\r\x08\x7f‮⁦")
    assert r"\x1b[31mred" in written.getvalue()


WIDTHS = ("0", "-5", "abc", "", "\u0663", "9" * 200)


@pytest.mark.parametrize(("columns", "terminal"), sampled(product(WIDTHS, (True, False))))
def test_a_width_that_is_none_hides_nothing(columns, terminal, monkeypatch):
    written = io.StringIO()
    written.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stdout", written)
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", columns)
    assert main(["list"]) == 0
    assert "\nrabbit-hzd-slip " in written.getvalue()


def test_the_narrowest_width_has_room_for_a_column(monkeypatch):
    monkeypatch.setenv("COLUMNS", "1")
    assert console(stderr=False).width == NARROWEST_WIDTH


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize(
    ("command", "options"),
    [("show", ()), ("validate", ()), ("solve", ("--json",)), ("solve", ()), ("simulate", ()),
     ("validate", ("--set", "objective=\x1b[31m"))],
)  # fmt: skip
def test_commands_print_no_sequence_of_a_problem_file(run, empty_folder, command, options):
    (empty_folder / "evil.yaml").write_text(PROBLEM)
    _, out, err = run(command, "evil.yaml", *options)
    assert not set(out + err) & set("\x1b\x07")


@pytest.mark.usefixtures("empty_folder")
def test_a_file_with_a_sequence_where_a_name_belongs_is_refused_in_print(run, empty_folder):
    (empty_folder / "evil.yaml").write_text(PROBLEM + 'objective: "\\e[31mred"\n')
    code, _, err = run("validate", "evil.yaml", "--debug")
    assert code == 3
    assert "\x1b" not in err
    assert r"\x1b[31mred" in err


@pytest.mark.parametrize("columns", sampled(["40", "160", "80", "60"]))
def test_no_word_of_the_list_is_lost_however_narrow_the_terminal(run, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    _, out, _ = run("list")
    assert max(map(len, out.splitlines())) <= int(columns)
    words = set(out.split())
    for name in problem_names():
        problem = load_problem(name)
        assert {name, problem.walker.model, *problem.about.split()} <= words


def test_the_list_says_what_is_known_of_gaits_in_the_store(run, empty_folder, monkeypatch):
    assert "0.755124" not in run("list")[1]
    named("rimless-wheel-slip").save()
    out = run("list")[1]
    assert "0.755124" in out
    assert " stable " in out
    monkeypatch.setenv("COLUMNS", "80")
    assert run("list")[1].splitlines()[0].split() == ["problem", "walker", "about"]  # one table, without these


def test_show_prints_the_file_as_it_is(run):
    code, text, _ = run("show", "compass-passive-a", "--format", "yaml")
    assert code == 0
    assert parse_problem(text).digest == load_problem("compass-passive-a").digest
    assert "# m, from the foot" in text
    assert run("show", "compass-passive-a", "--format", "yaml", "--set", "friction=0.2")[0] == 2


def test_a_gait_is_printed_whole_on_fifty_columns(run, monkeypatch, empty_folder):
    folder = named("rimless-wheel-slip").verified(verification("rimless-wheel-slip").to_record()).save()
    monkeypatch.setenv("COLUMNS", "50")
    _, out, _ = run("verify", str(folder))
    assert max(map(len, out.splitlines()[:-1])) <= 50
    notes = [claim.note for claim in verification("rimless-wheel-slip").claims]
    assert {word for note in notes for word in note.split() if word.isalpha()} <= set(out.split())


def test_the_version_help_and_completion_are_answered(run, monkeypatch):
    assert run("--version")[1] == f"gaitopt {__version__}\n"
    assert run("-h")[0] == 0
    assert run("solve", "-h")[1] == run("solve", "--help")[1]
    monkeypatch.setenv("_GAITOPT_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "gaitopt simu")
    monkeypatch.setenv("COMP_CWORD", "1")
    with pytest.raises(SystemExit):
        main([])


@pytest.mark.parametrize("command", ["solve", "simulate", "plot", "sweep"])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(run, empty_folder, monkeypatch, command):
    (empty_folder / "file").write_text("")
    monkeypatch.setattr("gaitopt.systems.build_system", None)  # whatever would begin to work
    over = ["--over", "friction=0.3:0.4:2"] if command == "sweep" else []
    code, _, err = run(command, "rimless-wheel-slip", *over, "-o", "file/run")
    assert code == 6
    assert "file" in err


@pytest.mark.slow
def test_a_stored_walk_is_drawn_animated_and_reported(run, empty_folder):
    start = ["--state", "theta1=-0.15,dtheta1=0.72", "--steps", "9", "-o", "walk", "--quiet"]
    assert run("simulate", "compass-passive-a", *start)[0] == 0
    code, out, _ = run("plot", "walk")
    assert code == 0
    assert {"section.svg", "portrait.png", "animation.html"} <= {path.rpartition("/")[2] for path in out.split()}
    assert run("report", "walk", "-o", "walk.html")[0] == 0
    assert "no longer upright" in (empty_folder / "walk.html").read_text()


def test_a_walk_of_a_problem_is_compared_with_its_gait_where_that_is_known(run, empty_folder):
    command = ("simulate", "rimless-wheel-slip", "--state", "dtheta=0.7", "--json", "--quiet")
    assert json.loads(run(*command)[1])["gait_states"] == []
    gait = named("rimless-wheel-slip")
    gait.save()
    (state,) = json.loads(run(*command)[1])["gait_states"]
    assert state["dtheta"] == pytest.approx(gait.to_record()["state"]["dtheta"])


UNICODE = PROBLEM.partition("walker:")[2].replace("friction: 1.0", "friction: 1.0  # größer")
UNICODE = f'name: walk\nabout: "Gåit für µ → 走る 🦿"\nwalker:{UNICODE}'
COMMANDS = (
    ("list",), ("schema",), ("show", "ä.yaml"), ("show", "ä.yaml", "--json"), ("validate", "ä.yaml"), ("show", "é"),
    ("solve", "ä.yaml", "-o", "ü"), ("verify", "ü"), ("simulate", "ü", "-o", "ö"), ("plot", "ü", "--what", "ß"),
    ("report", "ü"), ("report", "ö"), ("plot", "ö", "--what", "portrait"), ("solve", "ä.yaml", "--set", "ñ=1"),
    ("sweep", "ä.yaml", "--over", "friction=0.9:1:2", "--workers", "1"), ("--ü",), ("verify", "é/ü"),
    ("continue", "ü", "--param", "friction", "--to", "0.99", "-o", "ê"), ("report", "ê"),
)  # fmt: skip


@pytest.mark.usefixtures("empty_folder")
@pytest.mark.parametrize("encoding", sampled(["utf-16", "ascii", "latin-1", "cp1252"]))
def test_every_command_works_with_any_encoding_of_its_output(encoding):
    Path("ä.yaml").write_text(UNICODE, encoding="utf-8")
    for command in COMMANDS:
        streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
        with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
            code = main(command)
        for stream in streams:
            stream.flush()
        out, err = (stream.buffer.getvalue().decode(encoding) for stream in streams)
        assert "internal error" not in err, (command, err)
        assert code == (2 if {"é", "ß", "--ü", "é/ü"} & {*command} else 3 if "ñ=1" in command else 0), (command, err)
        if command == ("show", "ä.yaml"):
            assert ("走" if encoding == "utf-16" else r"\u8d70\u308b \U0001f9bf") in out
    about = json.loads((Path("ü") / "resolved.json").read_text(encoding="ascii"))["about"]
    assert about == "Gåit für µ → 走る 🦿"
    assert about in (Path("ü") / "report.html").read_text(encoding="utf-8")


def test_many_parameters_are_folded_unless_all_are_asked_for(capsys):
    assert main(["show", "rabbit-hzd"]) == 0
    assert "its parameters 26 --all lists them" in " ".join(capsys.readouterr().out.split())
    assert main(["show", "rabbit-hzd", "--all"]) == 0
    assert "reference.swing_knee.5" in capsys.readouterr().out
    assert main(["show", "compass-torque-stick"]) == 0
    assert "hip" in capsys.readouterr().out
