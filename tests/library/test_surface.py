"""Local regression and limb history: known systems are found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.library.synthetic import ACTIONS, LIMBS, ROBOT, Known

from frogkick.core.errors import InputError
from frogkick.library import Library
from frogkick.library.surface import RIDGES, STATES_MIN, History, Surface, fit_history, fit_surface, limb_use
from frogkick.library.transitions import RESTED

RESOLUTION = np.array(ROBOT.velocity_resolution)


def surface_of(library: Library) -> Surface:
    return fit_surface(ROBOT, library.initial_velocity_body, library.rows(), library.previous_actions)


@pytest.mark.parametrize("states", [STATES_MIN, 400])
def test_a_quadratic_system_is_found_exactly(states: int) -> None:
    known = Known(1, degree=2)
    surface = surface_of(known.library(states, 2))
    unseen = known.library(50, 3)
    found = surface.at(unseen.initial_velocity_body / RESOLUTION)
    found += surface.history.added(ROBOT, unseen.previous_actions)
    assert found == pytest.approx(unseen.rows(), abs=1e-5 if states == STATES_MIN else 1e-7)
    assert not surface.history.effect.any()


@pytest.mark.parametrize(("decay", "gain"), [(0.0, 1.0), (0.4, 1.0), (0.4, 0.6), (0.7, 0.3)])
def test_what_use_adds_is_told_apart_from_what_velocity_does(decay: float, gain: float) -> None:
    effect = np.random.default_rng(5).uniform(-2e-3, 2e-3, (ACTIONS, LIMBS, 6))
    known = Known(1, 2, History(effect, decay, gain))
    surface = surface_of(known.library(500, 2))
    assert (surface.history.decay, surface.history.gain) == (decay, pytest.approx(gain))
    assert surface.history.effect == pytest.approx(effect, abs=1e-5)
    unseen = known.library(50, 3)
    found = surface.at(unseen.initial_velocity_body / RESOLUTION)
    found += surface.history.added(ROBOT, unseen.previous_actions)
    assert found == pytest.approx(unseen.rows(), abs=2e-5)


def test_neighbours_in_a_plane_are_no_obstacle() -> None:
    """Swims along a line have no sideways velocity at all."""
    known = Known(1, 2)
    library = known.library(300, 2)
    library.initial_velocity_body[:, 1] = 0.0
    flat = known.rows(library.initial_velocity_body, library.previous_actions)
    surface = fit_surface(ROBOT, library.initial_velocity_body, flat, library.previous_actions)
    at = library.initial_velocity_body[:100] + np.array([1e-3, 0.0, 0.01])
    right = known.rows(at, library.previous_actions[:100])
    assert surface.at(at / RESOLUTION) == pytest.approx(right, abs=1e-6)


def test_noise_makes_no_slopes_out_of_a_thin_cloud() -> None:
    """Swims fill a thin sheet of velocities; what a table is not asked with is noise there."""
    rng, known = np.random.default_rng(7), Known(1, 2)
    library = known.library(600, 2)
    library.initial_velocity_body[:, 1] *= 0.01
    plain = known.rows(library.initial_velocity_body, library.previous_actions)
    noisy = plain + 2e-4 * rng.standard_normal(plain.shape)
    assert surface_of(known.library(600, 2)).ridge == RIDGES[-1], "smooth ones are followed closely"
    surface = fit_surface(ROBOT, library.initial_velocity_body, noisy, library.previous_actions)
    assert surface.ridge == RIDGES[0]
    thick = 0.01 * np.ptp(known.library(600, 2).initial_velocity_body[:, 1])
    beside = library.initial_velocity_body[:200] + np.array([0.0, 3.0 * thick, 0.0])
    right = known.rows(beside, library.previous_actions[:200])
    loose = replace(surface, ridge=RIDGES[-1])
    off, wild = (np.abs(one.at(beside / RESOLUTION) - right).max() for one in (surface, loose))
    assert off < 0.02 and off < 0.5 * wild


def test_too_few_states_are_refused() -> None:
    with pytest.raises(InputError, match=f"{STATES_MIN - 1} complete states.*needs {STATES_MIN}.*--states"):
        surface_of(Known(1, 2).library(STATES_MIN - 1, 2))


def test_use_tells_how_long_ago_or_how_often() -> None:
    front_left, nothing = ROBOT.actions.index(ROBOT.action("G")), ROBOT.actions.index(ROBOT.action("I"))
    limb = next(i for i, one in enumerate(ROBOT.limbs) if one.name == "front_left")
    previous = np.array(
        [
            [RESTED, RESTED, RESTED],
            [front_left, RESTED, RESTED],
            [nothing, front_left, RESTED],
            [front_left, front_left, front_left],
        ]
    )
    assert limb_use(ROBOT, previous, 0.5, 1.0)[:, limb].tolist() == [0.0, 1.0, 0.5, 1.0]
    assert limb_use(ROBOT, previous, 0.5, 0.5)[:, limb].tolist() == [0.0, 0.5, 0.25, 0.875]
    assert not np.delete(limb_use(ROBOT, previous, 0.5, 1.0), limb, axis=1).any()


def test_without_earlier_actions_nothing_is_fitted() -> None:
    library = Known(1, 2).library(100, 2)

    def never(values: np.ndarray) -> np.ndarray:
        raise AssertionError("smoothed")

    found = fit_history(ROBOT, library.rows(), library.previous_actions, np.ones(6), never)
    assert (found.decay, found.gain, found.effect.any()) == (0.0, 0.0, False)
