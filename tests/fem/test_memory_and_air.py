"""Full-order bodies that flow, in wind, with a dashpot across contact, of any law."""

import numpy as np
import pytest

from physconvex import InputError
from physconvex.dynamics import Plane, Timing, Wind, simulate
from physconvex.fem import ElasticBody, NodePins, Scene
from physconvex.materials import Plasticine, StandardLinearSolid, with_strain_stiffening
from physconvex.mesh import box_mesh


@pytest.fixture(scope="module")
def mesh():
    return box_mesh((0.2, 0.1, 0.1), (2, 1, 1), order=2)


def test_derivatives_of_any_law_and_flow(mesh):
    rng = np.random.default_rng(0)
    x = mesh.vertices + 2e-3 * rng.normal(size=mesh.vertices.shape)
    step = rng.normal(size=x.shape)
    for body in (
        ElasticBody(mesh, law=with_strain_stiffening("neo_hookean", 2.0)),
        ElasticBody(mesh, flow=Plasticine(2e3)),
        ElasticBody(mesh, flow=StandardLinearSolid(0.5, 0.01)),
    ):
        response = None if body.flow is None else body.flow_step(body.unflowed(), x, 1e-3)
        h = 1e-7
        energies = [body.energy_and_gradient(x + s * h * step, response=response)[0] for s in (1, -1)]
        gradient = body.energy_and_gradient(x, response=response)[1]
        assert (energies[0] - energies[1]) / (2 * h) == pytest.approx((gradient * step).sum(), rel=1e-5)


def led(mesh, flow):
    """A bar stretched by 5 % and held, 0.2 s."""
    ends = np.flatnonzero(np.isclose(mesh.vertices[:, 0] % 0.2, 0))
    start = mesh.vertices[ends]

    def motion(time):
        stretched = start.copy()
        stretched[:, 0] *= 1 + 0.05 * min(time / 0.02, 1.0)
        return stretched

    body = ElasticBody(mesh, youngs_modulus=1e5, poisson_ratio=0.3, flow=flow)
    return simulate(
        Scene(body, gravity=(0, 0, 0), node_pins=NodePins(ends, motion)), Timing(frames=5, fps=20.0, steps_per_frame=10)
    )


def test_plasticine_stays_thinner_in_the_middle(mesh):
    elastic, yielded = led(mesh, None), led(mesh, Plasticine(1e3))
    width = [np.ptp(run.positions[-1][np.isclose(mesh.vertices[:, 0], 0.1)][:, 1]) for run in (elastic, yielded)]
    assert width[1] < width[0] - 2e-4  # flow keeps the volume: ν → ½


def test_wind_blows_and_air_brakes(mesh):
    body = ElasticBody(mesh, youngs_modulus=1e5)
    timing = Timing(frames=4, fps=20.0, steps_per_frame=5)
    blown = simulate(Scene(body, wind=Wind(velocity=(20.0, 0, 0))), timing)
    mean = body.node_masses @ blown.velocities[-1] / body.total_mass
    area = mesh.node_areas.sum()
    assert mean[0] == pytest.approx(1.2 / 8 * area * 20.0**2 / body.total_mass * 3 / 20, rel=0.1)


def test_dashpot_takes_energy_and_refuses_negative(mesh):
    body = ElasticBody(mesh, youngs_modulus=5e4)
    floor = (Plane(point=(0, 0, -0.005)),)
    timing = Timing(frames=9, fps=100.0, steps_per_frame=5)
    heights = [
        simulate(Scene(body, obstacles=floor, initial_velocity=(0, 0, -1.0), contact_damping=d), timing)
        for d in (0.0, 0.02)
    ]
    up = [(body.node_masses @ run.velocities / body.total_mass)[:, 2].max() for run in heights]
    assert up[1] < up[0] - 0.02
    with pytest.raises(InputError, match="contact_damping"):
        Scene(body, contact_damping=-1.0)
