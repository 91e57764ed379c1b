"""Movies of moving walkers, and figures in the axes and the style of the reader."""

from math import ceil

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from named import named
from PIL import Image, ImageSequence

import gaitopt as go
from gaitopt.cli.main import main
from gaitopt.errors import StorageError, UnknownNameError
from gaitopt.gait.measures import observe
from gaitopt.show import movie
from gaitopt.show.catalogue import figures_of
from gaitopt.show.film import FITS, film, ground_tiles, magnifier, rise, skeleton
from gaitopt.show.motion import motion_of, motion_of_walk
from gaitopt.show.movie import SHOWN_STEP, playing

WHEEL = "rimless-wheel-slip"


def pictures(path):
    with Image.open(path) as file:
        return [np.asarray(frame.convert("L"), dtype=float) for frame in ImageSequence.Iterator(file)]


def test_a_gif_shows_two_steps_in_slow_motion_and_repeats(tmp_path, monkeypatch):
    monkeypatch.setattr(movie, "RATE", RATE := 4)
    gait = named(WHEEL)
    cycles, slower = playing(motion_of(gait))
    assert cycles == 2
    assert gait.period < SHOWN_STEP <= slower * gait.period
    path = gait.animate().save(tmp_path / "walk.gif")
    with Image.open(path) as file:
        assert file.format == "GIF"
        assert file.info["loop"] == 0
        assert file.info["duration"] == 1000 / RATE
    frames = pictures(path)
    assert len(frames) == ceil(cycles * slower * gait.period * RATE)
    apart = [np.abs(one - frames[0]).mean() for one in frames]
    assert max(apart) > 1  # the walker moves
    assert apart[-1] < 2 * apart[1]  # and comes back, as the next picture is the first one


def test_a_low_and_long_walker_is_whole_in_the_picture(tmp_path, monkeypatch):
    """Both masses of the crawler are seen, on two sides of the middle, as discs of the neutral grey."""
    monkeypatch.setattr(movie, "RATE", 1)
    grey = np.abs(pictures(named("crawler").animate().save(tmp_path / "walk.gif"))[0] - 0x75) < 3
    left, right = np.array_split(grey.sum(axis=0) > 20, 2)
    assert left.any()
    assert right.any()


def test_a_leg_keeps_its_colour_through_the_exchange_of_roles():
    motion = motion_of(named("compass-passive-a"))
    frames = list(movie._frames(motion, np.array([0.3, 1.3, 2.3, 3.3]) * motion.period))
    figure, stands = Figure(), []
    for frame in frames:
        axes = figure.add_subplot()
        movie._draw(axes, motion, frame, 0.0, 4.0)
        lowest = min((line for line in axes.lines if line.get_path_effects()), key=lambda line: line.get_ydata().min())
        stands.append(lowest.get_color())
    assert stands[:2] == stands[2:]
    assert stands[0] != stands[1]


@pytest.mark.parametrize(("name", "factor"), [("compass-passive-a", 100), ("compass-passive-stick", 0), ("crawler", 0)])
def test_the_magnifier_shows_every_slip_whole_and_is_not_there_without_a_slip(name, factor):
    motion = motion_of(named(name))
    magnification, closeups = magnifier(motion)
    assert magnification == factor
    if not factor:  # the crawler slips so far that it is seen
        assert set(closeups) == {None}
        return
    for arc, (contact, middle) in zip(motion.steps[0].arcs, closeups, strict=True):
        assert contact == 0
        x = arc.states[:, motion.state_index("x")]
        height = skeleton([arc]).points[..., 1].max()
        assert factor * np.abs(x - middle).max() <= FITS / 2 * height


def test_the_magnifier_follows_the_contact_that_slips():
    motion = motion_of(named("heel-toe-slip"))
    names = motion.walker.contact_names()
    _, closeups = magnifier(motion)
    slipping = [
        [name for name, word in arc.mode.contacts.items() if word.startswith("slip")] for arc in motion.steps[0].arcs
    ]
    followed = [[names[closeup[0]]] for closeup, slips in zip(closeups, slipping, strict=True) if slips]
    assert followed == [slips for slips in slipping if slips] == [["heel"], ["toe"]]


def test_a_hopper_that_stays_where_it_is_has_a_movie(tmp_path, monkeypatch):
    monkeypatch.setattr(movie, "RATE", 4)
    hopper = named("hopper")
    assert abs(motion_of(hopper).steps[0].impact.step_length) < 1e-20  # rounding, by which marks must not be apart
    assert len(pictures(hopper.animate().save(tmp_path / "hop.gif"))) == ceil(2 * hopper.period * 4)


def test_an_ending_that_is_not_written_is_an_error(tmp_path, monkeypatch):
    gait = named(WHEEL)
    monkeypatch.setattr(movie.FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    for name, words in (
        ("walk.avi", "is written as .html, .gif, .mp4"),
        ("walk", "is written as"),
        ("w.mp4", "ffmpeg"),
    ):
        with pytest.raises(UnknownNameError, match=words):
            gait.animate().save(tmp_path / name)
    with pytest.raises(UnknownNameError, match=r"report of .* is written as \.html$"):
        gait.report().save(tmp_path / "report.gif")
    assert not [*tmp_path.iterdir()]


@pytest.mark.skipif(not movie.FFMpegWriter.isAvailable(), reason="needs ffmpeg")
def test_an_mp4_lasts_long_enough_to_be_seen(tmp_path):
    content = named(WHEEL).animate().save(tmp_path / "walk.mp4").read_bytes()
    assert b"ftypisom" in content[:32]
    header = content.index(b"mvhd") + 16  # after version and two dates: units per second, duration in these
    scale, duration = np.frombuffer(content[header : header + 8], ">u4")
    assert movie.SHOWN <= duration / scale < movie.SHOWN + 4 * SHOWN_STEP + 2 / movie.RATE


def test_plot_writes_the_animation_alone_in_a_moving_format(tmp_path, monkeypatch, capsys):
    named(WHEEL).save(tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(movie, "RATE", 2)
    assert main(["plot", "run", "--format", "gif", "-o", "figures", "--quiet"]) == 0
    assert capsys.readouterr().out.split() == ["figures/animation.gif"]
    assert main(["plot", "run", "--format", "gif", "--what", "portrait", "-o", "figures", "--quiet"]) == 2
    assert "portrait does not move; choose from svg, pdf, png" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["portrait", "force", "slip", "multipliers"])
def test_a_figure_is_drawn_into_given_axes_and_nowhere_else(what):
    figure, (first, second) = plt.subplots(1, 2)
    try:
        assert named("compass-passive-a").plot(what, ax=second) is second
        assert second.has_data()
        assert second.get_legend() is not None
        assert not first.has_data()
        assert figure.axes == [first, second]
    finally:
        plt.close(figure)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("folder.gif", "it is a folder; name a file in it, such as .*folder.gif/walk.gif"),
        ("x" * 240 + ".gif", "File name too long; choose another name"),
        ("a\0b.gif", "choose another name"),
        ("file/d.gif", "file is not writable; choose another place|Not a directory"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_a_movie_is_drawn(tmp_path, monkeypatch, name, words):
    (tmp_path / "folder.gif").mkdir()
    (tmp_path / "file").write_text("")
    for number in range(30):
        (tmp_path / "folder.gif" / f"frame-{number}").touch()
    monkeypatch.setattr(movie, "_frames", None)
    with pytest.raises(StorageError, match=words) as caught:
        named(WHEEL).animate().save(tmp_path / name)
    assert "frame-29" not in str(caught.value)


def test_a_walk_is_drawn_as_six_outlined_postures_that_stand_on_the_ground():
    gait = named("compass-passive-a")
    (axes,) = figures_of(go.simulate(gait, steps=2)).draw("postures").axes
    times = [float(text.get_text().split()[0]) for text in axes.texts]
    assert times == pytest.approx(np.linspace(0, 2 * gait.period, 6), abs=0.006)
    legs, ground = [line for line in axes.lines if line.get_path_effects()], axes.lines[-1]
    assert len(legs) == 2 * len(times)
    for leg in legs[1::2]:  # the leg that stands is drawn last
        x, y = min(leg.get_xydata(), key=lambda point: point[1])
        assert y == pytest.approx(np.interp(x, *ground.get_data()), abs=1e-9)
    assert np.ptp(ground.get_ydata()) / np.ptp(ground.get_xdata()) == pytest.approx(np.tan(np.radians(1)))


def test_a_figure_with_several_panels_asks_for_as_many_axes():
    figure, axes = plt.subplots(3, 1)
    try:
        with pytest.raises(ValueError, match=r"this figure has 2 panels, not 1: give ax=plt.subplots\(2, 1"):
            named("slip-run").plot("force", ax=axes[0])
        assert named("slip-run").plot("force", ax=axes[:2]) is axes[0]
        assert not axes[2].has_data()
        with pytest.raises(TypeError, match="must be Matplotlib axes"):
            named("slip-run").plot("force", ax=figure)
    finally:
        plt.close(figure)


def test_figures_follow_the_style_sheet_of_the_reader():
    gait = named(WHEEL)
    with plt.style.context({"axes.facecolor": "black", "axes.grid": False, "font.size": 17}):
        own = gait.plot("force")
        assert own.get_facecolor()[:3] == (0, 0, 0)
        assert own.xaxis.label.get_size() == 17
    ours = gait.plot("force")
    assert ours.xaxis.label.get_size() == 10
    assert ours.get_facecolor()[:3] == (1, 1, 1)


def test_the_ground_of_a_floor_is_under_the_feet_that_stand_on_it():
    floor = go.Floor(friction=[0.2, 0.19, 0.3], height=[0, 0.003, 0.001], slope=[0, 0.02, 0])
    motion = motion_of_walk(go.simulate(named("compass-passive-stick"), steps=3, floor=floor))
    shown, tiles = film(motion), ground_tiles(motion)
    assert [round(change, 9) for *_, change in tiles] == [0, -0.05, 0.5, 0.5]
    for n, (step, (_, place, lift), tile) in enumerate(zip(motion.steps, shown["path"], tiles, strict=False)):
        assert np.interp(place, tile[:2], tile[2:4]) == pytest.approx(lift, abs=1e-6)
        assert rise(motion, n) + observe(step.arcs[-1]).swing_foot[-1, 1] == pytest.approx(
            rise(motion, n + 1), abs=1e-9
        )
    assert shown["phases"][-1]["ground"] == [(0.3, 0.0)]
    assert film(motion_of_walk(go.simulate(named("compass-passive-stick"), steps=1)))["tiles"] == []
