"""A kernel is taken for a device only if it draws a small scene there as the reference does."""

import warnings

import pytest
import torch

from physconvex.kernels import KernelUnavailable
from physconvex.render import composite_reference, cuda_trial
from physconvex.render.hull import planar_hulls
from physconvex.render.reference import Layers

CPU = torch.device("cpu")


@pytest.fixture
def asked(monkeypatch):
    """The trial with another function in the place of the CUDA kernel, and hulls in plain torch."""

    def ask(composite):
        monkeypatch.setattr(cuda_trial, "composite_cuda", composite)
        monkeypatch.setattr(cuda_trial, "planar_hulls_cuda", planar_hulls)
        cuda_trial.cuda_draws_rightly.cache_clear()
        return cuda_trial.cuda_draws_rightly(CPU)

    yield ask
    cuda_trial.cuda_draws_rightly.cache_clear()


def test_the_right_picture_is_accepted_without_a_word(asked):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert asked(composite_reference)


@pytest.mark.parametrize("without", [torch.no_grad, torch.inference_mode])
def test_derivatives_are_compared_even_where_the_first_to_draw_wants_none(asked, without):
    """The fit of a field draws first without gradients: on a GPU it was then done in plain torch to its end."""
    with warnings.catch_warnings(), without():
        warnings.simplefilter("error")
        assert asked(composite_reference)


def test_another_picture_is_refused_and_that_is_said(asked):
    def brighter(splats, coordinates):
        layers = composite_reference(splats, coordinates)
        return Layers(1.01 * layers.features, layers.transmittance, layers.heaviest)

    with pytest.warns(RuntimeWarning, match="a trial picture is not the reference's"):
        assert not asked(brighter)


def test_a_picture_with_other_gradients_is_refused(asked):
    def unmoved(splats, coordinates):
        layers = composite_reference(splats, coordinates)
        features = 0.9 * layers.features + 0.1 * layers.features.detach()
        return Layers(features, layers.transmittance, layers.heaviest)

    with pytest.warns(RuntimeWarning, match="its derivatives are not the reference's"):
        assert not asked(unmoved)


def test_a_picture_with_other_derivatives_forward_is_refused(asked):
    class Halved(torch.autograd.Function):
        """Itself, its gradient right, its derivative forward not."""

        @staticmethod
        def forward(ctx, value):
            return value.clone()

        @staticmethod
        def backward(ctx, gradient):
            return gradient

        @staticmethod
        def jvp(ctx, tangent):
            return 0.5 * tangent

    def halved(splats, coordinates):
        layers = composite_reference(splats, coordinates)
        return Layers(Halved.apply(layers.features), layers.transmittance, layers.heaviest)

    with pytest.warns(RuntimeWarning, match="its derivatives are not the reference's"):
        assert not asked(halved)


def test_where_it_cannot_be_had_the_reason_is_told(asked):
    def missing(splats, coordinates):
        raise KernelUnavailable("no compiler on board")

    with pytest.warns(RuntimeWarning, match="no compiler on board"):
        assert not asked(missing)
