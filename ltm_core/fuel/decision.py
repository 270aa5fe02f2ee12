"""Rules by which the evidence for life forms changes a cell's fuel code, and the layers of the fuel map."""

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import scipy  # loads scipy.special when it is first used: 0.2 s that `ltm trace` saves

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int16Array, Int64Array, UInt8Array, UInt32Array
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.life_form import FORMS, NODATA, LifeForm, forms_of, held
from ltm_core.fuel.prior import FuelPrior, system_of
from ltm_core.fuel.rules import FusionRules, supported_changes

_GRASS, _SHRUB, _BURNED = (f - 1 for f in (LifeForm.GRASS, LifeForm.SHRUB, LifeForm.BURNED))
_FLAT: Final = 0.5
"""Evidence for each life form without a prior map (Jeffreys)."""


@dataclass(frozen=True, eq=False)
class CellEvidence:
    """Evidence of (N,) cells at a time: `evidence` (N, FORMS), decayed; `log_likelihood` (N, FORMS), up to a constant,
    of all views together; `first`, `last` (N, FORMS): seconds of the frames that show each form, 0 none; `cameras` (N,
    FORMS): number that show it, 2 for more; `burned_at` (N,): seconds, 0 never."""

    evidence: Float64Array
    log_likelihood: Float64Array
    first: UInt32Array
    last: UInt32Array
    cameras: Int64Array
    burned_at: UInt32Array


def changed_cells(before: Int16Array, now: Int16Array) -> BoolArray:
    """Return (H, W) whether a cell has changed: its fuel code differs from the known one of an earlier map. This is the
    definition for maps, exports, images and reports; a life form within the same code is no change."""
    return np.asarray((now != before) & (before != NODATA), np.bool_)


@dataclass(frozen=True, eq=False)
class FuelLayers:
    """Layers of the fuel map, (H, W) each.

    `prior`, `code`: int16 fuel codes, NODATA where none. `life_form`: uint8 ids of `LifeForm`, 255 unknown; that of
    the code. `p_max`: float32 probability that the commonest life form is the new one of a changed cell, and in other
    cells the one that evidence and prior favour; NaN where nothing is known. `entropy`: float32 of the shares of life
    forms, 0 certain to 1 nothing known. `evidence`: float32, of all frames; 0 where only the prior speaks. `last_seen`:
    int64 ns, 0 never. `seen_by`: uint8 cameras, 8 for more."""

    prior: Int16Array
    code: Int16Array
    life_form: UInt8Array
    p_max: Float32Array
    entropy: Float32Array
    evidence: Float32Array
    last_seen: Int64Array
    seen_by: UInt8Array

    @property
    def changed(self) -> BoolArray:
        """Return (H, W) whether a cell has changed since the prior map."""
        return changed_cells(self.prior, self.code)

    def part(self, row: int, col: int, height: int, width: int) -> "FuelLayers":
        """Return a rectangle of the layers, as views."""
        cut = slice(row, row + height), slice(col, col + width)
        return FuelLayers(**{field.name: getattr(self, field.name)[cut] for field in fields(self)})


@dataclass(frozen=True, eq=False)
class _JudgedCells:
    """(N, ...) what evidence and prior say of each cell on its own. `base`: the prior's code, or that of what has grown
    since a burn. `agreeing` (N, FORMS): the forms that it stands for. `fresh`: burned, and not grown over yet. `alpha`
    (N, FORMS): the Dirichlet's. `challenger`: index of the likeliest other form. `log_odds` (N,): by how much looks
    make that likelier than any other form. `wants`: to change into it. `leans`: would with others about it."""

    codes: Int16Array
    base: Int16Array
    agreeing: BoolArray
    has_prior: BoolArray
    fresh: BoolArray
    alpha: Float64Array
    challenger: Int64Array
    log_odds: Float64Array
    wants: BoolArray
    leans: BoolArray


class ChangeDecision:
    """Apply the rules of change; `system`: of the codes."""

    def __init__(self, system: FuelSystem, rules: FusionRules, climate: FuelClimate) -> None:
        self._rules = rules
        self._codes = climate.changed[system]
        # What a cell without evidence is depends on its code alone.
        every = np.arange(256, dtype=np.int16)
        none = np.zeros((256, FORMS), np.uint32)
        nothing = CellEvidence(none.astype(float), none.astype(float), none, none, none.astype(np.int64), none[:, 0])
        judged = self._judge(every, nothing, 0.0)
        self._untouched = self._settle(judged, judged.wants, nothing, 0.0)
        self._known = np.asarray(forms_of(every).any(axis=1))

    def decide(
        self, codes: Int16Array, touched: BoolArray, cells: CellEvidence, now_s: float, company: UInt8Array | None
    ) -> FuelLayers:
        """Return the layers of a part of the grid, except `last_seen` and `seen_by`, which are zero; near an inner edge
        (`EvidenceMap.reached_from`) they may be those of a map that ends there. `codes`: (H, W) of the prior. `cells`:
        evidence of the `touched` (H, W) cells, in row-major order. `company`: (H, W) life forms of cells that have
        changed for other reasons than evidence, 0 none."""
        index = np.where((codes >= 0) & (codes < 256), codes, 0)
        known = self._known[index]
        _, form, p_max, entropy = (values[index] for values in self._untouched)
        layers = FuelLayers(
            prior=codes.copy(),
            code=codes.copy(),
            life_form=np.where(known, form + 1, UNSEEN).astype(np.uint8),
            p_max=np.where(known, p_max, np.nan).astype(np.float32),
            entropy=np.where(known, entropy, 1.0).astype(np.float32),
            evidence=np.zeros(codes.shape, np.float32),
            last_seen=np.zeros(codes.shape, np.int64),
            seen_by=np.zeros(codes.shape, np.uint8),
        )
        if touched.any():
            judged = self._judge(codes[touched], cells, now_s)
            wanted, leaning = np.zeros(codes.shape, np.uint8), np.zeros(codes.shape, np.uint8)
            log_odds = np.zeros(codes.shape)
            wanted[touched] = np.where(judged.wants, judged.challenger + 1, 0)
            leaning[touched] = np.where(judged.leans, judged.challenger + 1, 0)
            log_odds[touched] = judged.log_odds
            changes = supported_changes(wanted, log_odds, company, self._rules, leaning)[touched]
            code, form, p_max, entropy = self._settle(judged, changes, cells, now_s)
            layers.code[touched], layers.life_form[touched] = code, form + 1
            layers.p_max[touched], layers.entropy[touched] = p_max, entropy
            layers.evidence[touched] = cells.evidence.sum(axis=1)
        return layers

    def _judge(self, codes: Int16Array, cells: CellEvidence, now_s: float) -> _JudgedCells:
        rules = self._rules
        original = forms_of(codes)
        masked = held(codes, rules.mask)
        burned = (cells.burned_at > 0) & original.any(axis=1) & ~masked
        regrown = burned & (now_s - cells.burned_at >= rules.burned_days * 86400)
        base = np.where(regrown, np.int16(self._codes.regrowth), codes)
        agreeing = forms_of(base)
        has_prior = np.asarray(agreeing.any(axis=1))
        count = agreeing.sum(axis=1, keepdims=True)
        inside, outside = rules.prior_share / np.maximum(count, 1), (1 - rules.prior_share) / (FORMS - count)
        prior = rules.prior_evidence * np.where(agreeing, inside, outside)
        alpha = cells.evidence + np.where(has_prior[:, None], prior, _FLAT)
        challenger = np.where(agreeing & has_prior[:, None], -np.inf, cells.log_likelihood).argmax(axis=1)
        here = np.arange(len(codes)), challenger
        others = cells.log_likelihood.copy()
        others[here] = -np.inf
        log_odds = cells.log_likelihood[here] - others.max(axis=1)
        seconds = cells.last[here] - cells.first[here].astype(np.int64)
        lasts = (seconds >= rules.min_interval_s) | (cells.cameras[here] > 1)
        leans = has_prior & ~masked & (cells.evidence[here] >= rules.evidence) & (log_odds >= 0)
        wants = leans & lasts & (log_odds >= np.log(rules.odds))
        fresh = burned & ~regrown
        return _JudgedCells(codes, base, agreeing, has_prior, fresh, alpha, challenger, log_odds, wants, leans)

    def _settle(
        self, judged: _JudgedCells, changes: BoolArray, cells: CellEvidence, now_s: float
    ) -> tuple[Int16Array, Int64Array, Float64Array, Float64Array]:
        """Return (N,) code, index of the life form, `p_max` and entropy of cells, of which those of `changes` (N,)
        become their challenger. The form of cells that do not change: of those that a prior's code stands for, its
        first one, unless another is the commoner and likelier by the odds that a change would need; without a prior,
        the commonest."""
        rules, codes, alpha, every = self._rules, judged.codes, judged.alpha, np.arange(len(judged.codes))
        original = forms_of(codes)
        possible = judged.agreeing | ~judged.has_prior[:, None]
        best, usual = np.where(possible, alpha, -1.0).argmax(axis=1), possible.argmax(axis=1)
        surer = cells.log_likelihood[every, best] - cells.log_likelihood[every, usual] >= np.log(rules.odds)
        form = np.where(changes, judged.challenger, np.where(judged.has_prior & ~surer, usual, best))
        faded = changes & (form == _BURNED) & (now_s - cells.last[:, _BURNED] >= rules.burned_days * 86400)
        code = np.where(changes | ~judged.has_prior, self._new_codes(form, original, cells.evidence), judged.base)
        code = np.where(judged.fresh, self._codes.burned, np.where(faded, self._codes.regrowth, code))
        form = np.where(judged.fresh, _BURNED, form)
        grown = forms_of(np.array([self._codes.regrowth], np.int16))[0]
        form = np.where(faded, np.where(grown, alpha, -1.0).argmax(axis=1), form)
        # What the prior said before it burned, and cameras now say again, is the prior's code and no other.
        back = changes & ~judged.fresh & ~faded & original[every, form]
        code = np.where(back | held(codes, rules.mask), codes, code)
        entropy = scipy.special.entr(alpha / alpha.sum(axis=1, keepdims=True)).sum(axis=1) / np.log(FORMS)
        return code.astype(np.int16), form, _probability(alpha, judged.agreeing, judged.has_prior, changes), entropy

    def _new_codes(self, form: Int64Array, original: BoolArray, evidence: Float64Array) -> Int16Array:
        """Return the codes of cells that are now of `form` (N,)."""
        c = self._codes
        total = np.maximum(evidence.sum(axis=1), 1e-12)
        both = np.minimum(evidence[:, _GRASS], evidence[:, _SHRUB]) / total > self._rules.mixture
        mixed = both & ((form == _GRASS) | (form == _SHRUB))
        return np.where(mixed, np.int16(c.grass_shrub), c.of(form, original[:, _SHRUB]))


def _probability(alpha: Float64Array, agreeing: BoolArray, has_prior: BoolArray, changes: BoolArray) -> Float64Array:
    """Return (N,) the probability `FuelLayers.p_max`. Two shares of a Dirichlet distribution stand to each other as a
    beta variable to its complement: share b is the larger of a and b with probability I_1/2(alpha_a, alpha_b)."""
    others = np.where(agreeing & has_prior[:, None], -np.inf, alpha)
    first, second = (np.partition(others, -k, axis=1)[:, -k] for k in (1, 2))
    held = np.where(has_prior, np.where(agreeing, alpha, 0.0).sum(axis=1), second)
    over_prior = scipy.special.betainc(held, first, 0.5)
    over_all = np.minimum(over_prior, scipy.special.betainc(np.maximum(second, 1e-9), first, 0.5))
    over_all = np.where(changes, over_all, np.maximum(over_all, 1 - over_prior))
    return np.asarray(np.where(has_prior, over_all, over_prior))


def layers_of_classes(classes: UInt8Array, prior: FuelPrior | None, climate: FuelClimate) -> FuelLayers:
    """Return the layers for a map of label classes (H, W), 255 unseen, which are taken as certain. For maps without
    evidence, such as a majority vote: a cell whose class agrees with the prior keeps its code."""
    codes = np.full(classes.shape, NODATA, np.int16) if prior is None else prior.codes
    rules = FusionRules(min_interval_s=0.0, support=0.0, block_cells=1)
    seen = (classes >= 1) & (classes <= FORMS)
    certain = np.zeros((int(seen.sum()), FORMS))
    certain[np.arange(len(certain)), classes[seen].astype(np.int64) - 1] = 1000.0
    shown = (certain > 0).astype(np.uint32)
    cells = CellEvidence(certain, certain, shown, shown, 2 * shown.astype(np.int64), np.zeros(len(certain), np.uint32))
    return ChangeDecision(system_of(prior), rules, climate).decide(codes, seen, cells, 0.0, None)
