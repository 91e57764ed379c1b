"""The atlas of the passive compass at 200 random places: its regions against the gaits that ``find`` finds there.

Run a part with ``-k``, for example ``-k "batch3]"``. The atlas and every search are stored below pytest's cache, so
that an interrupted test goes on where it ended as long as no code has changed. All of it takes half an hour of one
processor.
"""

import json
from hashlib import sha256
from pathlib import Path as File

import numpy as np
import pytest
from matplotlib.path import Path

import gaitopt as go
from gaitopt.gait.regions import NO_GAIT, Region, unstable_count

OVER = {"friction": (0.05, 0.35), "walker.slope": ("0.2 deg", "5 deg")}
SEED, PLACES, BATCH = 42, 200, 10
WITHIN = {"theta1": (-0.3, 0.0), "dtheta1": (0.2, 1.3), "dtheta2": (-1.5, 0.3), "dx": (-0.3, 1.3)}
"""Start states of the searches, around those of all gaits of the compass over these ranges."""
EFFORTS = ((500, 0), (4000, 1))
"""Number of starts and seed of the searches; the next one only if a region's gait is not among those found."""
ON_CURVE = 2e-3
"""Distance from a curve, relative to the ranges, within which a place may belong to the regions on both sides of it."""
HARD_TO_FIND = 100.0
"""Spectral radius above which a gait may be missing among those found, if the simulator confirms it: deviations grow a
hundredfold in one step, so that hardly any random start is near enough. At low friction the radius reaches 20,000."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(pytestconfig) -> File:
    """The folder of stored results, one for every state of the code."""
    sources = sorted(File(go.__file__).parent.rglob("*.py"))
    return pytestconfig.cache.mkdir(f"atlas-{sha256(b''.join(map(File.read_bytes, sources))).hexdigest()[:12]}")


@pytest.fixture(scope="module")
def atlas(folder) -> go.Atlas:
    return go.atlas("compass-passive-a", OVER, workers=1, output=folder / "atlas", progress=False)


def random_places(atlas: go.Atlas) -> np.ndarray:
    low, high = np.array([(axis.lower, axis.upper) for axis in atlas.axes]).T
    return np.random.default_rng(SEED).uniform(low, high, (PLACES, 2))


def regions_at(atlas: go.Atlas, place: np.ndarray) -> list[Region]:
    return [
        region
        for region in atlas.arrangement.regions
        if any(Path(piece).contains_point(place) for piece in region.pieces)
    ]


def is_near_a_curve(atlas: go.Atlas, place: np.ndarray) -> bool:
    sizes = np.array([axis.upper - axis.lower for axis in atlas.axes])
    near = place + sizes * ON_CURVE * np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])
    return len({id(region) for each in near for region in regions_at(atlas, each)}) > 1


def label(gait: go.Gait) -> tuple[str, int]:
    return str(gait.problem.cycle), unstable_count([gait.to_record()])


def family_of(place: np.ndarray, bound: float) -> go.Gait:
    """The sticking gait of the family at the upper bound of friction and the slope of a place."""
    problem = go.load_problem("compass-passive-stick").replace({"friction": bound, "walker.slope": float(place[1])})
    gait = go.solve(problem, progress=False)
    assert gait.converged, gait.message
    return gait


def followed(gait: go.Gait, friction: float) -> go.Gait | None:
    """The gait of the same family at another friction; None if the branch does not reach it."""
    last = go.continuation(gait, "friction", to=friction, verify_every=0, progress=False).points[-1]
    return last.gait if abs(last.value - friction) < 1e-9 else None


def compare(atlas: go.Atlas, folder: File, number: int) -> dict[str, object]:
    """What the atlas and ``find`` say about one place."""
    place = random_places(atlas)[number]
    problem = go.load_problem("compass-passive-a").replace(
        {axis.key: value for axis, value in zip(atlas.axes, place.tolist(), strict=True)}
    )
    regions = regions_at(atlas, place)
    stated = {(region.modes, region.unstable) for region in regions}
    result = {"number": number, "place": place.tolist(), "stated": sorted(map(str, stated))}
    for starts, seed in EFFORTS:
        gaits = go.find(
            problem, starts=starts, seed=seed, within=WITHIN, output=folder / f"{number}-{seed}", progress=False
        )
        found = {label(gait) for gait in gaits}
        if stated <= found or stated == {(NO_GAIT, None)}:
            break
    result |= {"found": sorted(map(str, found)), "starts": starts}
    bound = atlas.axes[0].upper
    if stated == {(NO_GAIT, None)}:
        reached = [followed(gait, bound) for gait in gaits]
        state = family_of(place, bound).state
        on_sheet = [gait is not None and np.allclose(gait.state, state, atol=1e-8) for gait in reached]
        return result | {"verdict": "wrong: a gait continues to the sheet" if any(on_sheet) else "agrees"}
    if stated <= found:
        return result | {"verdict": "agrees" if len(stated) == 1 else "several regions"}
    known = followed(family_of(place, bound), float(place[0]))
    confirmed = known is not None and go.verify(known).passed and {label(known)} == stated
    confirmed = confirmed and known.spectral_radius > HARD_TO_FIND
    near = is_near_a_curve(atlas, place)
    verdict = "missed" if confirmed else "near a curve" if near else f"wrong: {known and label(known)}"
    return result | {"verdict": verdict}


@pytest.mark.filterwarnings("ignore:start states had")  # about gaits of another family beyond the ranges
@pytest.mark.parametrize("batch", range(PLACES // BATCH), ids="batch{}".format)
def test_the_gaits_of_regions_are_among_those_that_find_finds(atlas, folder, batch: int) -> None:
    results = list[dict[str, object]]()
    for number in range(batch * BATCH, (batch + 1) * BATCH):
        results.append(compare(atlas, folder, number))
        (folder / f"places-{batch}.json").write_text(json.dumps(results, indent=1))
    verdicts = [result["verdict"] for result in results]
    assert set(verdicts) <= {"agrees", "missed", "near a curve"}, results
    assert verdicts.count("near a curve") <= 1
