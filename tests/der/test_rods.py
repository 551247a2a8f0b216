"""Forces and stiffness of the rods against energies and finite differences; the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from tests.der.energy import bending_energy, drag_power, stretching_energy
from tests.der.rig import central, forces, stiffness, straight_rod

from frogkick.der import prepare
from frogkick.der.mesh import Mesh
from frogkick.robot import load_robot

ROBOTS = ("frog2022", "streamlined", "hexapod")
RODS = prepare(load_robot("frog2022"))
MESH, PLAN = RODS.mesh, RODS.symbolic
DROP = 80.0


@dataclass
class State:
    mesh: Mesh
    x: np.ndarray
    v: np.ndarray
    activation: np.ndarray


def bent(mesh: Mesh, limbs: int) -> State:
    rng = np.random.default_rng(20221)
    n = len(mesh.rest_m)
    return State(
        mesh,
        mesh.rest_m + 2e-4 * rng.normal(size=(n, 2)),
        0.1 + 0.3 * rng.normal(size=(n, 2)),
        np.array([0.3, 1.0, 0.0, 0.6, 0.8, 0.1][:limbs]),
    )


@pytest.fixture
def state() -> State:
    return bent(MESH, 4)


def without_drag(mesh: Mesh) -> Mesh:
    zero = np.zeros_like(mesh.edge_drag_normal)
    return mesh._replace(edge_drag_normal=zero, edge_drag_tangential=zero)


def test_the_mesh_is_the_paper_robot() -> None:
    assert len(MESH.rest_m) == 128
    assert MESH.frame_nodes == 92
    corner_bends = [int((MESH.bend_nodes[:, 1] == c).sum()) for c in (0, 23, 46, 69)]
    corner_edges = [int((MESH.edge_nodes == c).sum()) for c in (0, 23, 46, 69)]
    assert corner_bends == [2, 2, 2, 2]
    assert corner_edges == [3, 3, 3, 3]
    assert MESH.mass_kg @ MESH.rest_m == pytest.approx(np.zeros(2), abs=1e-15)
    assert MESH.mass_kg.sum() == pytest.approx(0.36 * 0.866 + 4 * 0.0355 * 0.0312)


def test_a_bend_knows_its_edges() -> None:
    first, second = (MESH.edge_nodes[MESH.bend_edges[:, k]] for k in range(2))
    along = [np.where(first[b, 0] == MESH.bend_nodes[b, 0], 1, -1) for b in range(len(first))]
    onward = [np.where(second[b, 1] == MESH.bend_nodes[b, 2], 1, -1) for b in range(len(first))]
    for b, (a, m, c) in enumerate(MESH.bend_nodes):
        assert set(first[b]) == {a, m}
        assert set(second[b]) == {m, c}
    assert np.array_equal(MESH.bend_sense, np.multiply(along, onward))
    assert (MESH.bend_sense < 0).sum() in (2, 4)  # roots that bend against an edge stored the other way round


def test_rest_is_an_equilibrium() -> None:
    still = np.zeros_like(MESH.rest_m)
    force = forces(MESH, MESH.rest_m, still, np.zeros(4), DROP)
    assert np.abs(force).max() < 1e-8 * 5000  # against forces of 5000 N at strains of some per cent


@pytest.mark.parametrize("which", ROBOTS)
@pytest.mark.parametrize("part", ["stretching", "bending"])
def test_forces_are_minus_the_gradient_of_the_energy(which: str, part: str) -> None:
    robot = load_robot(which)
    mesh = without_drag(prepare(robot).mesh)
    state = bent(mesh, len(robot.limbs))
    if part == "stretching":
        mesh = mesh._replace(bend_stiffness_n_m2=np.zeros_like(mesh.bend_stiffness_n_m2))
        gradient = central(lambda x: [stretching_energy(mesh, x)], state.x, 1e-8)
    else:
        mesh = mesh._replace(edge_stiffness_n=np.zeros_like(mesh.edge_stiffness_n))
        gradient = central(lambda x: [bending_energy(mesh, x, state.activation, DROP)], state.x, 1e-8)
    force = forces(mesh, state.x, state.v, state.activation, DROP)
    assert np.abs(force.ravel() + gradient.ravel()).max() < 1e-6 * np.abs(force).max()


@pytest.mark.parametrize("which", ROBOTS)
def test_stiffness_is_minus_the_derivative_of_the_elastic_forces(which: str) -> None:
    robot = load_robot(which)
    rods = prepare(robot)
    for weak in (False, True):  # with the stretching in it, bending's share would be lost in rounding
        mesh = without_drag(rods.mesh)
        if weak:
            mesh = mesh._replace(edge_stiffness_n=np.zeros_like(mesh.edge_stiffness_n))
        state = bent(mesh, len(robot.limbs))
        matrix = stiffness(mesh, rods.symbolic, state.x, state.v, state.activation, DROP, 0.7, 0.0)
        expected = -0.7 * central(
            lambda x, m=mesh, s=state: forces(m, x, s.v, s.activation, DROP), state.x, 1e-8
        )
        assert np.abs(matrix - expected).max() < 2e-6 * np.abs(matrix).max()


def test_stiffness_is_minus_the_derivative_of_drag_by_velocity(state: State) -> None:
    mesh = MESH._replace(
        edge_stiffness_n=np.zeros_like(MESH.edge_stiffness_n),
        bend_stiffness_n_m2=np.zeros_like(MESH.bend_stiffness_n_m2),
    )
    matrix = stiffness(mesh, PLAN, state.x, state.v, state.activation, DROP, 0.0, 3.0)
    expected = -3.0 * central(lambda v: forces(mesh, state.x, v, state.activation, DROP), state.v, 1e-6)
    # |v| v has a kink in its slope where a component crosses 0: the difference quotient is off by the step.
    assert np.abs(matrix - expected).max() < 2e-6 * np.abs(matrix).max()


def test_drag_by_speed_is_the_paper_s_law_and_its_stiffness_the_symmetric_part(state: State) -> None:
    """Each component goes with |v|: at equal coefficients the drag is against the velocity."""
    mesh = MESH._replace(
        edge_stiffness_n=np.zeros_like(MESH.edge_stiffness_n),
        bend_stiffness_n_m2=np.zeros_like(MESH.bend_stiffness_n_m2),
        drag_by_speed=True,
    )
    even = mesh._replace(edge_drag_tangential=MESH.edge_drag_normal)
    force = forces(even, state.x, state.v, state.activation, DROP)
    gain = np.zeros(len(state.x))
    np.add.at(gain, MESH.edge_nodes.ravel(), np.repeat(MESH.edge_drag_normal, 2))
    speed = np.hypot(state.v[:, 0], state.v[:, 1])
    assert force == pytest.approx(-(gain * speed)[:, None] * state.v, rel=1e-12)
    matrix = stiffness(mesh, PLAN, state.x, state.v, state.activation, DROP, 0.0, 3.0)
    slope = -3.0 * central(lambda v: forces(mesh, state.x, v, state.activation, DROP), state.v, 1e-6)
    assert np.abs(matrix - 0.5 * (slope + slope.T)).max() < 1e-6 * np.abs(matrix).max()


def test_the_drag_left_out_of_the_stiffness_is_small_against_inertia(state: State) -> None:
    """What drag changes by turning with its edge, nodes at up to 1 m/s, against mass / step^2 of the tips."""
    mesh = MESH._replace(
        edge_stiffness_n=np.zeros_like(MESH.edge_stiffness_n),
        bend_stiffness_n_m2=np.zeros_like(MESH.bend_stiffness_n_m2),
    )
    left_out = central(lambda x: forces(mesh, x, state.v, state.activation, DROP), state.x, 1e-8)
    assert np.abs(left_out).max() < 0.2 * MESH.mass_kg.min() / 0.001**2


def test_drag_takes_out_the_power_it_should(state: State) -> None:
    mesh = MESH._replace(
        edge_stiffness_n=np.zeros_like(MESH.edge_stiffness_n),
        bend_stiffness_n_m2=np.zeros_like(MESH.bend_stiffness_n_m2),
    )
    force = forces(mesh, state.x, state.v, state.activation, DROP)
    power = drag_power(mesh, state.x, state.v)
    assert power > 0.0
    assert (force * state.v).sum() == pytest.approx(-power, rel=1e-12)


def test_drag_across_a_rod_is_a_hundred_times_that_along_it() -> None:
    limb = RODS.robot.limbs[0]
    edge = RODS.robot.frame.segments[0]  # first edge of the left side, along x
    i, j = MESH.edge_nodes[edge]
    assert MESH.rest_m[i, 1] == pytest.approx(MESH.rest_m[j, 1])
    assert MESH.edge_drag_normal[edge] == pytest.approx(100 * MESH.edge_drag_tangential[edge])
    # 1/2 rho D dl C v^2 at 1 m/s on a whole limb
    total = 2 * MESH.edge_drag_normal[MESH.frame_nodes :].sum() / 4
    assert total == pytest.approx(0.5 * 1000 * limb.drag_width_m * limb.length_m * limb.drag_normal)


def test_a_cantilever_bends_by_the_textbook() -> None:
    """Tip deflection F L^3 / (3 EI) of a rod held at one end, bent by 1 % of its length."""
    length, stiff = 0.2, 1e-3
    nodes = 41
    mesh, symbolic = straight_rod(nodes, length, bending_n_m2=stiff)
    still, none = np.zeros((nodes, 2)), np.zeros(0)
    load = 0.01 * length * 3.0 * stiff / length**3
    x = mesh.rest_m.copy()
    free = slice(4, None)  # the first two nodes are held: a clamped end
    for _ in range(20):
        unbalanced = forces(mesh, x, still, none, 0.0)
        unbalanced[-1, 1] += load
        matrix = stiffness(mesh, symbolic, x, still, none, 0.0, 1.0, 0.0)
        x.ravel()[free] += np.linalg.solve(matrix[free, free], unbalanced.ravel()[free])
    assert np.abs(unbalanced.ravel()[free]).max() < 1e-6 * load
    span = length - 0.5 * length / (nodes - 1)  # it is held between its first two nodes
    assert x[-1, 1] == pytest.approx(load * span**3 / (3.0 * stiff), rel=1e-3)
    assert x[-1, 0] < mesh.rest_m[-1, 0]
