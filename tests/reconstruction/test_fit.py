"""Fitting: better than the start, resumable bit for bit, within the budget."""

import math

import numpy as np
import pytest
import torch

from physconvex import InputError
from physconvex.convex import ConvexField, FreeParameters
from physconvex.reconstruction import (
    ReconstructionConfig,
    RowAdam,
    begin,
    fit_field,
    load_fit,
    refine_field,
    save_fit,
    score_views,
    simplify,
    start_field,
)
from physconvex.reconstruction.observation import gather
from tests.reconstruction.scenes import ball_mesh, striped_ball, views

SMALL = ReconstructionConfig(budget=700, steps=60, levels=(0.5, 1.0), level_shares=(0.25, 0.75), refinements=2)


def mean_psnr(field: ConvexField, observations) -> float:
    return float(np.mean([one.psnr for one, _ in score_views(field, observations)]))


@pytest.mark.slow
def test_a_fit_from_the_hull_reaches_a_stated_quality_also_in_views_it_did_not_see():
    training, held_out = views(8, size=64), views(3, size=64, phase=0.4)
    config = ReconstructionConfig(budget=1500, steps=160, start="hull", refinements=3)
    start = start_field(training, config)
    field = fit_field(begin(start), training, config).field()
    before, after = (mean_psnr(one, held_out) for one in (start.field, field))
    assert after > before + 3 and after > 24
    assert mean_psnr(field, training) > after - 1
    assert len(field) <= config.budget


def test_a_few_steps_already_help(seen):
    start = start_field(seen, SMALL, mesh=ball_mesh())
    state = fit_field(begin(start), seen, SMALL)
    assert mean_psnr(state.field(), seen) > mean_psnr(start.field, seen) + 1
    assert state.step == 60 and len(state.losses) == 60
    assert len(start.field) < len(state.field()) <= SMALL.budget
    state.field().check_values()


def test_a_fit_that_was_stopped_goes_on_to_the_same_bits(seen, tmp_path):
    start = start_field(seen, SMALL, mesh=ball_mesh())
    whole = fit_field(begin(start), seen, SMALL)

    class Stopped(Exception):
        pass

    def stop(progress, state):
        if progress.step == 31:
            save_fit(state, tmp_path / "state.safetensors", claim="this")
            raise Stopped

    with pytest.raises(Stopped):
        fit_field(begin(start), seen, SMALL, on_step=stop)
    state = load_fit(tmp_path / "state.safetensors", claim="this")
    assert state is not None and state.step == 31
    again = fit_field(state, seen, SMALL)
    assert again.losses == whole.losses
    for one, other in zip(again.field().tensors(), whole.field().tensors(), strict=True):
        assert torch.equal(one, other)


def test_all_that_a_fit_makes_is_on_the_device_of_its_state(seen):
    """Another default device stands in for a GPU: what does not name its device lands there and cannot be mixed."""
    start = start_field(seen, SMALL, mesh=ball_mesh())
    whole = fit_field(begin(start), seen, SMALL)
    with torch.device("meta"):
        moved = fit_field(begin(start).to("cpu"), seen, SMALL)
        scores = score_views(moved.field(), seen)
    assert moved.losses == whole.losses
    assert [one for one, _ in scores] == [one for one, _ in score_views(whole.field(), seen)]


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_device_fits_as_well_as_the_cpu(seen):
    start = start_field(seen, SMALL, mesh=ball_mesh())
    fields = [fit_field(begin(start).to(device), seen, SMALL).field() for device in ("cpu", "cuda")]
    assert fields[1].points.device.type == "cuda"
    on_cpu, on_gpu = (mean_psnr(field, seen) for field in fields)
    assert abs(on_gpu - on_cpu) < 0.3


def test_states_of_others_and_broken_ones_are_refused(seen, tmp_path):
    path = tmp_path / "state.safetensors"
    assert load_fit(path, claim="this") is None
    save_fit(begin(start_field(seen, SMALL, mesh=ball_mesh())), path, claim="that")
    with pytest.raises(InputError, match="another capture or other settings"):
        load_fit(path, claim="this")
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="no state"):
        load_fit(path, claim="that")


def test_fillers_keep_their_place(seen):
    config = ReconstructionConfig(budget=900, filler_share=0.2, steps=6, levels=(1.0,), level_shares=(1.0,))
    start = start_field(seen, config, mesh=ball_mesh())
    state = fit_field(begin(start), seen, config)
    found = state.field()
    assert start.fillers > 5 and int(state.fixed.sum()) >= start.fillers
    assert torch.equal(found.points[found.opacity < 0.01], start.field.points[-start.fillers :])


def test_refinement_divides_what_is_wrong_and_drops_what_is_nothing(seen):
    field = striped_ball()
    weight = torch.stack([gather(field, one.view, torch.ones_like(one.image)).weights for one in seen]).sum(dim=0)
    wrong = torch.zeros(len(field), dtype=torch.bool)
    wrong[(weight > 3).nonzero()[:10, 0]] = True
    faint = torch.zeros_like(wrong)
    faint[500:520] = True
    harmonics = torch.where(wrong[:, None, None], -field.harmonics, field.harmonics)
    opacity = torch.where(faint, 0.001, field.opacity)
    field = ConvexField(field.points, field.smoothness, field.sharpness, opacity, harmonics)
    made = refine_field(
        field, seen, budget=1600, footprint=1e-4, fixed=torch.zeros_like(wrong), generator=torch.Generator()
    )
    assert made.pruned == 20 and made.split == 256 and len(made.field) == 1516 and made.cloned == 0
    assert not faint[made.sources].any()
    assert wrong[made.sources[made.fresh]].sum() == 2 * wrong.sum()  # all that were wrong are among those divided
    assert torch.equal(made.fresh, torch.bincount(made.sources)[made.sources] > 1)


def test_what_no_view_sees_stays_where_it_is(seen):
    outer = striped_ball()
    inner = outer.select(torch.arange(0, len(outer), 4))
    inner = inner.with_points(0.7 * inner.points)
    field = ConvexField.joined([outer, inner])
    nothing = torch.zeros(len(field), dtype=torch.bool)
    made = refine_field(
        field, seen, budget=len(field) + 150, footprint=1e-4, fixed=nothing, generator=torch.Generator()
    )
    assert made.split == 150
    hidden = made.sources >= len(outer)
    assert hidden.sum() == len(inner) and made.fixed[hidden].all() and not made.fresh[hidden].any()
    assert made.fixed.float().mean() < 0.5


def test_a_field_is_simplified_to_a_budget_at_the_least_cost_to_its_images(seen):
    field = striped_ball()
    hidden = field.select(torch.arange(200)).with_points(0.5 * field.points[:200])
    both = ConvexField.joined([hidden, field])
    assert torch.equal(simplify(both, seen, budget=len(field)).points, field.points)
    few = simplify(field, seen, budget=1000)
    at_random = field.select(torch.randperm(len(field), generator=torch.Generator().manual_seed(0))[:1000])
    assert len(few) == 1000 and mean_psnr(few, seen) > mean_psnr(at_random, seen) + 1
    with pytest.raises(InputError, match="budget"):
        simplify(field, seen, budget=0)


def test_a_convex_and_its_clone_are_as_opaque_as_it_was(seen):
    field = striped_ball()
    field = ConvexField(*(0.6 * tensor if at == 3 else tensor for at, tensor in enumerate(field.tensors())))
    made = refine_field(
        field, seen, budget=1600, footprint=1.0, fixed=torch.zeros(len(field), dtype=torch.bool),
        generator=torch.Generator().manual_seed(0),
    )  # fmt: skip
    assert made.cloned == 256 and made.split == 0
    doubled = torch.bincount(made.sources)[made.sources] == 2
    together = 1 - (1 - made.field.opacity[doubled]) ** 2
    torch.testing.assert_close(together, torch.full_like(together, 0.6))


def test_adam_takes_the_steps_of_the_paper():
    field = striped_ball().select(torch.arange(3))
    free = FreeParameters.of(field)
    mine, other = free.points, free.points.detach().clone()
    adam = RowAdam.of([mine])
    first = second = torch.zeros_like(other)
    for step in range(1, 5):
        mine.grad = 2 * mine.detach() * math.cos(step)
        adam.step([mine], [0.1])
        gradient = 2 * other * math.cos(step)
        first, second = 0.9 * first + 0.1 * gradient, 0.99 * second + 0.01 * gradient**2
        other = other - 0.1 * (first / (1 - 0.9**step)) / ((second / (1 - 0.99**step)).sqrt() + 1e-15)
    torch.testing.assert_close(mine.detach(), other)
    chosen = adam.select(torch.tensor([2, 0, 0]), torch.tensor([False, False, True]))
    assert torch.equal(chosen.first[0][0], adam.first[0][2]) and not chosen.second[0][2].any()
