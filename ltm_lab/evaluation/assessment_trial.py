"""Repeat an accuracy assessment with simulated interpreters and count how often its 95 % intervals contain the truth.

The maps are a rendered one (prior, map and true life forms) and drawn ones of clustered classes with known errors. The
truth of an interval is what the interpreter would answer in a census of the map."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter

from ltm_core.assessment.estimation import Estimate, StratifiedSample, drawn
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.fuel.class_map import UNSEEN, read_fuel_map
from ltm_core.fuel.life_form import LifeForm
from ltm_ros.assessment.plan import NAMES, read_map_plan

_SIDE: Final = 120
_FORMS: Final = (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.TREE)


@dataclass(frozen=True, eq=False)
class Population:
    """All cells of a map, (H, W) each: life forms of the map and of the prior, and what the interpreter answers."""

    name: str
    map: UInt8Array
    prior: UInt8Array
    reference: UInt8Array
    observed: BoolArray


@dataclass(frozen=True)
class Coverage:
    """One figure over all samples: its true value, median events, share of the intervals that contain the true value,
    and mean half-width."""

    population: str
    figure: str
    truth: float
    events: float
    covered: float
    half_width: float


def drawn_population(
    name: str, seed: int = 1, changed: float = 0.05, cluster: float = 0.0, accuracy: float = 1.0, errors: float = 0.11
) -> Population:
    """Return a map of three clustered classes.

    `errors`: share of cells in which both the map and its prior are wrong, so that the prior does not hold.

    `changed`: true share of change; the map misses a fifth of it and shows as much false change. `cluster`: radius of
    the errors in cells; 0: independent cells. `accuracy`: of the interpreter."""
    rng = np.random.default_rng(seed)
    truth = _classes(rng)
    prior = truth.copy()
    fire = _smooth(rng, 4.0)
    burned = fire > np.quantile(fire, 1 - changed)
    prior[burned] = _other(truth[burned], rng)
    missed = burned & _marked(rng, cluster, 0.2)
    mapped = np.where(burned & ~missed, truth, prior).astype(np.uint8)
    false = ~burned & _marked(rng, cluster, 0.2 * changed)
    mapped[false] = _other(truth[false], rng)
    both = ~burned & ~false & _marked(rng, cluster, errors)
    mapped[both] = prior[both] = _other(truth[both], rng)  # errors that the map has from its prior
    return Population(name, mapped, prior, answered(truth, accuracy, rng), np.ones(truth.shape, np.bool_))


def rendered_population(name: str, plan: Path, truth: Path, seed: int, accuracy: float) -> Population:
    """Return the map of a plan (`ltm assess plan`) with its true life forms on the same grid. Raises LtmError."""
    stored, (classes, _) = read_map_plan(plan).map, read_fuel_map(truth)
    observed = stored.observed & (classes != UNSEEN)
    prior = np.where(stored.changed, stored.prior_form, stored.life_form).astype(np.uint8)
    reference = answered(classes, accuracy, np.random.default_rng(seed))
    return Population(name, stored.life_form, prior, reference, observed)


def answered(truth: UInt8Array, accuracy: float, rng: np.random.Generator) -> UInt8Array:
    """Return what an interpreter answers who is right in a share `accuracy` of the cells."""
    wrong = rng.random(truth.shape) > accuracy
    answers = truth.copy()
    answers[wrong] = _other(truth[wrong], rng)
    return answers


def coverage(population: Population, cells: int, samples: int, seed: int = 1) -> list[Coverage]:
    """Draw samples and estimate; return the coverage of each figure."""
    of = population
    changed, differs = of.map != of.prior, of.reference != of.prior
    inside = of.observed
    common = int(np.bincount(of.map[inside]).argmax())
    named = NAMES[common]
    pairs = {
        "overall accuracy": (of.map == of.reference, inside, "whole"),
        "overall accuracy of the prior": (of.prior == of.reference, inside, "whole"),
        f"user's accuracy of {named}": (of.reference == common, of.map == common, "whole"),
        f"producer's accuracy of {named}": (of.map == common, of.reference == common, "part"),
        f"area of {named}": (of.reference == common, inside, "whole"),
        "area of change": (differs, inside, "whole"),
        "user's accuracy of change": (differs, changed, "whole"),
        "producer's accuracy of change": (changed, differs, "part"),
    }
    truths = {
        name: float((part & whole & inside).sum() / (whole & inside).sum()) for name, (part, whole, _) in pairs.items()
    }
    found: dict[str, list[Estimate]] = {name: [] for name in pairs}
    for number in range(samples):
        sample = drawn(of.map, changed, inside, NAMES, cells, seed * 10**6 + number)
        at = sample.rows, sample.columns
        sizes = np.array([stratum.cells for stratum in sample.strata])
        stratified = StratifiedSample(sample.stratum, sizes)
        for name, (part, whole, of_map) in pairs.items():
            found[name].append(stratified.ratio(part[at], whole[at], of_map))
    rows = []
    for name, truth in truths.items():
        low, high = (np.array([getattr(one, end) for one in found[name]]) for end in ("low", "high"))
        covered = float(((low <= truth) & (truth <= high)).mean())
        events = float(np.median([one.events for one in found[name]]))
        rows.append(Coverage(of.name, name, truth, events, covered, float((high - low).mean()) / 2))
    return rows


def _classes(rng: np.random.Generator) -> UInt8Array:
    field = _smooth(rng, 8.0)
    return np.asarray(np.array(_FORMS, np.uint8)[np.digitize(field, np.quantile(field, [0.35, 0.7]))], np.uint8)


def _smooth(rng: np.random.Generator, radius: float) -> np.ndarray:
    noise = rng.standard_normal((_SIDE, _SIDE))
    return np.asarray(gaussian_filter(noise, radius) if radius else noise)


def _marked(rng: np.random.Generator, radius: float, share: float) -> BoolArray:
    field = _smooth(rng, radius)
    return np.asarray(field > np.quantile(field, 1 - share), np.bool_)


def _other(classes: UInt8Array, rng: np.random.Generator) -> UInt8Array:
    """Return another of the three forms for each."""
    turn = rng.integers(1, len(_FORMS), classes.shape)
    return np.asarray((classes - 1 + turn) % len(_FORMS) + 1, np.uint8)
