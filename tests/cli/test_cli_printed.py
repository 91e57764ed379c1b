"""What comes from files is shown on a terminal, and never obeyed by it."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from named import named, verification
from samples import sampled

from gaitopt import __version__, load_problem, parse_problem, problem_names
from gaitopt.cli.main import main
from gaitopt.errors import printable

ATTACK = "\x1b]0;title\x07\x1b[31mred\x9b2J\r\x08\x7f‮⁦ 한국 ñ\n\ttab"
SHOWN = r"\x1b]0;title\x07\x1b[31mred\x9b2J\r\x08\x7f\u202e\u2066 한국 ñ" + "\n\ttab"
PROBLEM = """name: "evil\\e[31m"
about: ATTACK
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


def on_screen(terminal, *command):
    """What a terminal or a pipe gets on stdout."""
    written = io.StringIO()
    written.isatty = lambda: terminal
    with redirect_stdout(written):
        main(command)
    return written.getvalue()


@pytest.mark.parametrize("columns", sampled(["1", "-5", "abc", "0", "", "\u0663", "9" * 200], 3))
def test_a_width_that_is_none_or_too_small_hides_nothing(columns, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setattr("gaitopt.problem_names", lambda: ["rabbit-hzd", "rabbit-hzd-slip"])
    for terminal in (True, False):
        assert ("\nrabbit-h" if columns == "1" else "\nrabbit-hzd-slip ") in on_screen(terminal, "list")


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize(
    ("command", "options"),
    [("show", ()), ("validate", ()), ("solve", ("--json",)), ("solve", ()), ("simulate", ()),
     ("validate", ("--set", "objective=\x1b[31m", "--debug"))],
)  # fmt: skip
def test_commands_print_no_sequence_of_a_problem_file(empty_folder, capsys, monkeypatch, command, options, terminal):
    (empty_folder / "evil.yaml").write_text(PROBLEM.replace("ATTACK", json.dumps(ATTACK)))
    monkeypatch.setenv("TERM", "dumb")  # no styles, which are sequences of their own
    printed = on_screen(terminal, command, "evil.yaml", *options) + capsys.readouterr().err
    assert not set(printed) & set("\x1b\x07\x9b\r\x08\x7f‮⁦")
    assert r"\x1b[31m" in printed or r"\u001b[31m" in printed


@pytest.mark.parametrize("columns", sampled(["40", "160", "80", "50"]))
def test_no_word_is_lost_however_narrow_the_terminal(run, monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", columns)
    printed = {command: run(*command)[1] for command in (("list",), ("show", "compass-pd-impact-slip"))}
    assert max(len(line) for out in printed.values() for line in out.splitlines()) <= int(columns)
    listed, shown = (set(out.split()) for out in printed.values())
    for name in problem_names():
        problem = load_problem(name)
        assert problem.about
        assert {name, problem.walker.model, *problem.about.split()} <= listed
    assert {"leg_length", "dtheta1", "slip_forward", "compass-passive-b"} <= shown


def test_the_list_says_what_is_known_of_gaits_in_the_store(run, empty_folder, monkeypatch):
    monkeypatch.setattr("gaitopt.problem_names", lambda: ["rimless-wheel-slip", "compass-virtual-constraint-slip"])
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
    ("continue", "ü", "--param", "friction", "--to", "0.99", "--max-points", "2", "-o", "ê"), ("report", "ê"),
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


def test_many_parameters_are_folded_unless_all_are_asked_for(run):
    assert "its parameters 26 --all lists them" in " ".join(run("show", "rabbit-hzd")[1].split())
    assert "reference.swing_knee.5" in run("show", "rabbit-hzd", "--all")[1]
    assert "hip" in run("show", "compass-torque-stick")[1]
