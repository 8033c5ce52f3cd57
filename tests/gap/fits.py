"""Real fits on the fixture `dropped_box`, with likelihoods as a test wants them."""

from dataclasses import replace

import numpy as np

from physconvex.gap import DEFAULT_EFFECTS, Dose, Effect, ErrorModel, GapOptions
from physconvex.gap.base.cost import Cost
from physconvex.gap.search.effect_fits import derivatives_at
from physconvex.gap.search.full_order import as_reduced
from physconvex.gap.search.hypothesis import Hypothesis, base_hypothesis, hypothesis_at
from physconvex.gap.search.search_state import EffectSearch

OPTIONS = GapOptions(max_nodes=60, weights=4, iterations=1)


def effect(name):
    return next(e for e in DEFAULT_EFFECTS if e.name == name)


def inert(label):
    """An effect of that label, `name` or `name (variant)`, whose dose moves nothing."""
    name, _, variant = label.partition(" (")
    dose = Dose("amount", "", 0.0, 1.0, 0.1, lambda s: 0.3)
    return Effect(name, "external", (dose,), scene=lambda scene, _: scene, variant=variant.rstrip(")"))


def with_cost(base, cost=None):
    """The base fit with a count of its own."""
    return replace(base, model=replace(base.model, cost=cost or Cost()))


def noise(base, variance=1.0):
    rows = len(base.residual(base.positions))
    return ErrorModel(np.full(rows, variance), np.zeros((0, rows)))


def search_on(base, *, cost=None, options=OPTIONS, report=lambda text: None, variance=1.0):
    """A search that has found the base model."""
    base = with_cost(base, cost)
    cheap, errors = as_reduced(base), noise(base, variance)
    search = EffectSearch(base, cheap, errors, options, report)
    search.found.append(base_hypothesis(cheap, errors))
    return search


def fit_at(search, effects, doses):
    """The reduced model with effects at some doses, as if they had been fitted."""
    base = search.base
    model = replace(base.model, effects=tuple(effects))
    values = np.concatenate([base.fit.values, doses])
    motion = model.motion(values)
    tangents = derivatives_at(base, model, values, motion)
    return hypothesis_at(base, search.errors, model, values, np.zeros(len(values)), motion=motion, tangents=tangents)


def told(base, *labels, evidence=0.0, seen=-1.0, slight=False, left=None, fitted=2.0, selecting=2.0) -> Hypothesis:
    """A hypothesis of inert effects, by what its frames say.

    Args:
        base: a base fit.
        labels: of the effects.
        evidence: of the fit.
        seen: log-likelihood of the fitted frames.
        slight: whether its doses are smaller than is of interest.
        left: log-likelihood that is left to gain, in the place of `seen`.
        fitted, selecting: mean squares.
    """
    effects = tuple(map(inert, labels))
    model = replace(base.model, effects=effects)
    values = np.concatenate([base.fit.values, np.full(len(effects), 0.01 if slight else 0.5)])
    seen = seen if left is None else -np.log(2.0) - left  # of two independent residuals, the default
    kinds, first = base.modes.count, np.eye(base.modes.count)[0]
    tangents = np.zeros((len(base.tangents), len(values), *base.tangents.shape[2:]))
    return Hypothesis(
        effects, model, values, np.zeros(len(values)), base.positions, replace(base.motion), tangents, fitted,
        selecting, evidence, seen * first, np.zeros(kinds), 2.0 * first, np.ones(kinds, dtype=bool), np.ones(kinds),
        later=np.zeros(kinds),
    )  # fmt: skip
