"""Every model that a fit can take obeys one protocol."""

import numpy as np

from physconvex.gap.base.model import EffectModel
from physconvex.identify import CorrectedModel, FullModel, LinearModel, PointModel, ReducedModel, SecantModel


class Square:
    """x = p² along each axis."""

    names = ("p",)

    def positions(self, values):
        return np.full((2, 1, 3), values[0] ** 2)

    def linearise(self, values):
        return self.positions(values), np.full((2, 1, 1, 3), 2 * values[0])


def test_all_models_obey_the_protocol():
    for kind in (ReducedModel, FullModel, LinearModel, CorrectedModel, SecantModel, EffectModel):
        assert all(hasattr(kind, name) or name in kind.__annotations__ for name in ("names", "positions", "linearise"))
    at = np.array([1.0])
    positions, tangents = Square().linearise(at)
    made = [
        Square(),
        LinearModel(("p",), at, positions, tangents),
        CorrectedModel(Square(), at, positions, tangents),
        SecantModel(Square(), at, positions, tangents, scales=np.ones(1)),
    ]
    assert all(isinstance(model, PointModel) for model in made)


def test_a_secant_is_carried_along():
    start = np.array([1.0])
    model = SecantModel(Square(), start, *Square().linearise(start), scales=np.ones(1))
    positions, tangents = model.linearise(np.array([2.0]))
    assert (positions == 4.0).all() and (tangents == 3.0).all()  # (4 − 1) / (2 − 1)
    assert model.linearise(np.array([2.0]))[1] is tangents


def test_a_correction_shifts_and_turns():
    anchor = np.array([1.0])
    model = CorrectedModel(Square(), anchor, np.full((2, 1, 3), 0.5), np.full((2, 1, 1, 3), -1.0))
    positions, tangents = model.linearise(np.array([3.0]))
    assert (positions == 9.0 + 0.5 - 2.0).all() and (tangents == 5.0).all()
