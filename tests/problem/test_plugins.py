"""Walkers of other packages: one that is broken is named once and hinders nothing."""

import sys
import types
from importlib.metadata import EntryPoint

import pytest

from gaitopt.cli.main import main
from gaitopt.errors import GaitoptWarning, ProblemError
from gaitopt.model import registry
from gaitopt.model.registry import registered_walkers
from gaitopt.model.walker import Walker
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.problem.problem import load_problem

OWN = [
    EntryPoint("compass_biped", "gaitopt.model.walkers.compass_biped:CompassBiped", registry.ENTRY_POINT_GROUP),
    EntryPoint("rimless_wheel", "gaitopt.model.walkers.rimless_wheel:RimlessWheel", registry.ENTRY_POINT_GROUP),
]


@pytest.fixture
def plugins(monkeypatch):
    """Register further walkers by name and object."""
    module = types.ModuleType("other_walkers")
    monkeypatch.setitem(sys.modules, "other_walkers", module)

    def register(**objects):
        points = [EntryPoint(name, f"other_walkers:{name}", registry.ENTRY_POINT_GROUP) for name in objects]
        for name, value in objects.items():
            if value is not None:
                setattr(module, name, value)
        every = {registry.ENTRY_POINT_GROUP: [*OWN, *points]}
        monkeypatch.setattr(registry, "entry_points", lambda group: every.get(group, []))
        registry._plugins.cache_clear()

    yield register
    registry._plugins.cache_clear()


class Nameless(Walker):
    """States no mechanism."""


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "the plugin other_walkers:broken cannot be imported: AttributeError"),
        (3, "is not a subclass of gaitopt.Walker"),
        (Nameless, "lacks mechanism: define it, or define links"),
        (RimlessWheel, "has the model 'rimless_wheel', but its entry point is called"),
    ],
)
def test_a_broken_plugin_is_named_and_the_others_work(plugins, value, words):
    plugins(broken=value)
    with pytest.warns(GaitoptWarning, match="walker broken: the plugin other_walkers:broken") as caught:
        assert list(registered_walkers()) == ["compass_biped", "rimless_wheel"]
    registered_walkers()
    assert len(caught) == 1
    with pytest.raises(ProblemError, match=r"walker.model: the plugin other_walkers:broken") as refused:
        load_problem("rimless-wheel-stick").replace({"walker.model": "broken"})
    assert words in str(refused.value)


def test_a_plugin_that_ends_the_process_at_import_is_named(plugins, monkeypatch, tmp_path):
    (tmp_path / "leaving_walkers.py").write_text("raise SystemExit(3)")
    monkeypatch.syspath_prepend(tmp_path)
    plugins()
    point = EntryPoint("leaving", "leaving_walkers:Leaving", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [*OWN, point] if group == registry.ENTRY_POINT_GROUP else []
    )
    with pytest.warns(GaitoptWarning, match="plugin leaving_walkers:Leaving cannot be imported: SystemExit: 3"):
        assert list(registered_walkers()) == ["compass_biped", "rimless_wheel"]


def test_a_name_that_is_registered_twice_is_refused_and_never_replaces_one_of_ours(plugins, monkeypatch):
    class Twin(RimlessWheel):
        model = "twin"

    plugins(twin=Twin)
    group = registry.ENTRY_POINT_GROUP
    twins = [EntryPoint("twin", f"{module}:twin", group) for module in ("other_walkers", "second")]
    ours = EntryPoint("compass_biped", "other_walkers:twin", group)
    monkeypatch.setattr(
        registry,
        "entry_points",
        lambda group: [*OWN, *OWN, *twins, ours] if group == registry.ENTRY_POINT_GROUP else [],
    )
    with pytest.warns(GaitoptWarning) as caught:
        assert registered_walkers()["compass_biped"] is CompassBiped
    assert list(registered_walkers()) == ["compass_biped", "rimless_wheel"]
    words = str(caught[0].message)
    assert "walker twin: several plugins have this name, other_walkers:twin and second:twin: uninstall" in words
    assert "walker compass_biped of other_walkers:twin: gaitopt has a walker of this name" in words


def test_commands_name_broken_plugins_on_stderr_alone(plugins, capsys):
    plugins(broken=None, wrong=3)
    assert main(["validate", "rimless-wheel-stick"]) == 0
    out, err = capsys.readouterr()
    assert "warning" not in out
    (line,) = err.splitlines()
    assert line.startswith("gaitopt: warning: not available: walker broken: ")
    assert "; walker wrong: " in line
