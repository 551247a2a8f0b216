"""Forces and derivatives of the rods against finite differences; the direct solver against numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from frogkick.der import prepare
from frogkick.der.elimination import factor_and_solve
from frogkick.der.forces import (
    add_bending,
    add_drag,
    add_stretching,
    bending_energy,
    stretching_energy,
    total_force,
)
from frogkick.robot import load_robot

RODS = prepare(load_robot("frog2022"))
MESH, PLAN = RODS.mesh, RODS.plan
N = len(MESH.rest_m)
DROP = 80.0
NO_JACOBIAN = np.empty((0, 4))


@dataclass
class State:
    x: np.ndarray
    v: np.ndarray
    activation: np.ndarray


@pytest.fixture
def state() -> State:
    rng = np.random.default_rng(20221)
    return State(
        MESH.rest_m + 2e-4 * rng.normal(size=(N, 2)),
        0.1 + 0.3 * rng.normal(size=(N, 2)),
        np.array([0.3, 1.0, 0.0, 0.6]),
    )


def dense(jacobian: np.ndarray) -> np.ndarray:
    """The blocks of edges and bends as one matrix."""
    full = np.zeros((2 * N, 2 * N))
    for nodes, blocks in ((MESH.edge_nodes, PLAN.edge_block), (MESH.bend_nodes, PLAN.bend_block)):
        for group, row in zip(nodes, blocks, strict=True):
            pairs = [(i, j) for i in group for j in group]
            for (i, j), block in zip(pairs, row, strict=True):
                full[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = jacobian[block].reshape(2, 2)
    return full


def central(function, at: np.ndarray, step: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    columns = []
    for i in range(at.size):
        d = np.zeros(at.size)
        d[i] = step
        d = d.reshape(at.shape)
        columns.append((np.asarray(function(at + d)) - np.asarray(function(at - d))).ravel() / (2 * step))
    return np.array(columns).T


def test_the_mesh_is_the_paper_robot() -> None:
    assert N == 128
    assert MESH.frame_nodes == 92
    corner_bends = [int((MESH.bend_nodes[:, 1] == c).sum()) for c in (0, 23, 46, 69)]
    corner_edges = [int((MESH.edge_nodes == c).sum()) for c in (0, 23, 46, 69)]
    assert corner_bends == [2, 2, 2, 2]
    assert corner_edges == [3, 3, 3, 3]
    assert MESH.mass_kg @ MESH.rest_m == pytest.approx(np.zeros(2), abs=1e-15)
    assert MESH.mass_kg.sum() == pytest.approx(0.36 * 0.9625 + 4 * 0.0355 * 0.0312)


def test_rest_is_an_equilibrium() -> None:
    force = np.zeros((N, 2))
    total_force(MESH, PLAN, MESH.rest_m, np.zeros((N, 2)), np.zeros(4), DROP, 0.0, 0.0, force, NO_JACOBIAN)
    assert np.abs(force).max() < 1e-8 * 5000  # against forces of 5000 N at strains of some per cent


@pytest.mark.parametrize("which", ["stretching", "bending"])
def test_forces_are_minus_the_gradient_of_the_energy(state: State, which: str) -> None:
    force = np.zeros((N, 2))
    if which == "stretching":
        add_stretching(MESH, PLAN, state.x, 1.0, force, NO_JACOBIAN)
        gradient = central(lambda x: [stretching_energy(MESH, x)], state.x, 1e-8)
    else:
        add_bending(MESH, PLAN, state.x, state.activation, DROP, 1.0, force, NO_JACOBIAN)
        gradient = central(lambda x: [bending_energy(MESH, x, state.activation, DROP)], state.x, 1e-8)
    assert np.abs(force.ravel() + gradient.ravel()).max() < 1e-6 * np.abs(force).max()


@pytest.mark.parametrize("which", ["stretching", "bending", "drag_position", "drag_velocity"])
def test_jacobians_match_finite_differences(state: State, which: str) -> None:
    jacobian, unused = np.zeros((PLAN.blocks, 4)), np.zeros((N, 2))

    def force_of(x: np.ndarray, v: np.ndarray, out: np.ndarray = NO_JACOBIAN) -> np.ndarray:
        force = np.zeros((N, 2))
        if which == "stretching":
            add_stretching(MESH, PLAN, x, 1.0, force, out)
        elif which == "bending":
            add_bending(MESH, PLAN, x, state.activation, DROP, 1.0, force, out)
        else:
            gains = (1.0, 0.0) if which == "drag_position" else (0.0, 1.0)
            add_drag(MESH, PLAN, x, v, *gains, force, out)
        return force

    unused += force_of(state.x, state.v, jacobian)
    if which == "drag_velocity":
        expected = -central(lambda v: force_of(state.x, v), state.v, 1e-6)
    else:
        expected = -central(lambda x: force_of(x, state.v), state.x, 1e-8)
    full = dense(jacobian)
    # |v| v has a kink in its slope where a component crosses 0: the difference quotient is off by the step.
    assert np.abs(full - expected).max() < 2e-6 * np.abs(full).max()
    if which != "drag_position":
        assert np.abs(full - full.T).max() < 1e-12 * np.abs(full).max()


def test_drag_takes_energy_out(state: State) -> None:
    force = np.zeros((N, 2))
    add_drag(MESH, PLAN, state.x, state.v, 0.0, 0.0, force, NO_JACOBIAN)
    assert (force * state.v).sum() < 0.0


def test_drag_across_a_rod_is_a_hundred_times_that_along_it() -> None:
    limb = RODS.robot.limbs[0]
    edge = RODS.robot.frame.segments[0]  # first edge of the left side, along x
    i, j = MESH.edge_nodes[edge]
    assert MESH.rest_m[i, 1] == pytest.approx(MESH.rest_m[j, 1])
    assert MESH.edge_drag_normal[edge] == pytest.approx(100 * MESH.edge_drag_tangential[edge])
    # 1/2 rho D dl C v^2 at 1 m/s on a whole limb
    total = 2 * MESH.edge_drag_normal[MESH.frame_nodes :].sum() / 4
    assert total == pytest.approx(0.5 * 1000 * limb.drag_width_m * limb.length_m * limb.drag_normal)


def test_the_direct_solver_agrees_with_numpy(state: State) -> None:
    jacobian, force = np.zeros((PLAN.blocks, 4)), np.zeros((N, 2))
    total_force(MESH, PLAN, state.x, state.v, state.activation, DROP, 1.0, 500.0, force, jacobian)
    jacobian[:N, 0] += 1e6 * MESH.mass_kg
    jacobian[:N, 3] += 1e6 * MESH.mass_kg
    full = dense(jacobian)
    right = force.copy()
    assert factor_and_solve(PLAN, jacobian, right)
    expected = np.linalg.solve(full, force.ravel())
    assert np.abs(right.ravel() - expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.parametrize("poison", [0.0, np.nan])
def test_the_direct_solver_reports_a_bad_pivot(poison: float) -> None:
    values = np.full((PLAN.blocks, 4), poison)
    assert not factor_and_solve(PLAN, values, np.ones((N, 2)))
