"""Made-up tables and paths: smooth transitions without any physics."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from frogkick.tables import layout
from frogkick.tables.image import Tables, open_image
from frogkick.tables.packing import pack_affine, pack_nearest
from frogkick.tables.sealing import Metadata

VELOCITY_SCALE = (1e-5, 1e-5, 1.745329e-4)
LOW = np.array([0.0, -0.03, -0.5236])
HIGH = np.array([0.04, 0.03, 0.5236])


@dataclass(frozen=True)
class WavePath:
    """A sine over one metre."""

    x_m: npt.NDArray[np.float32]
    y_m: npt.NDArray[np.float32]
    tangent_rad: npt.NDArray[np.float32]


def wave_path(points: int = 100) -> WavePath:
    """Return a path with its true tangents."""
    s = np.linspace(0.0, 1.0, points)
    tangent = np.arctan2(0.6 * np.cos(6.0 * s), 1.0)
    return WavePath(
        s.astype(np.float32), (0.1 * np.sin(6.0 * s)).astype(np.float32), tangent.astype(np.float32)
    )


def transitions(states: int, actions: int, seed: int) -> tuple[npt.NDArray[np.float64], ...]:
    """Return (velocities, displacements, velocities_end): smooth in the velocity, different by action."""
    rng = np.random.default_rng(seed)
    velocity = rng.uniform(LOW, HIGH, (states, 3))
    gain = rng.normal(0.0, 0.3, (actions, 3, 3)) + 0.8 * np.eye(3)
    push = rng.uniform([0.0, -0.02, -0.3], [0.04, 0.02, 0.3], (actions, 3))
    mixed = np.einsum("ni,aij->naj", velocity, gain)
    motion = velocity[:, None, :] * 0.9 + push + 0.2 * np.sin(mixed)
    end = np.clip(mixed * 0.4 + 0.5 * push, LOW, HIGH)
    return velocity, motion, end


def metadata(actions: int, arguments: dict[str, object]) -> Metadata:
    """Plausible metadata; takes those fields out of ``arguments`` that are there."""
    plausible: dict[str, object] = {
        "robot_id": "frog2022",
        "provenance": bytes(range(32)),
        "period_us": 1_425_000,
        "pulse_us": 80_000,
        "second_delay_us": 80_000,
        "limbs": 4,
        "action_rows": [(chr(ord("A") + i), i % 16, (3 * i) % 16) for i in range(actions)],
        "velocity_resolution": VELOCITY_SCALE,
    }
    return Metadata(**{name: arguments.pop(name, value) for name, value in plausible.items()})


def pack(velocity: npt.ArrayLike, motion: npt.ArrayLike, end: npt.ArrayLike, **changes: object) -> bytes:
    """Pack with plausible metadata; ``changes`` replace its fields and arguments of pack_nearest."""
    about = metadata(np.asarray(motion).shape[1], changes)
    arguments = {"velocities": velocity, "displacements": motion, "velocities_end": end}
    return pack_nearest(about, **(arguments | changes))


def image(states: int = 300, actions: int = 9, seed: int = 1) -> bytes:
    """Return the image of a made-up table."""
    return pack(*transitions(states, actions, seed))


def alike(states: int, levels: int, closer: bool = False, actions: int = 9, **changes: object) -> bytes:
    """Return the image of a table whose actions all do the same in all states.

    Args:
        states: how many, all of one velocity: a look-up visits each of them.
        levels: of the search tree; a packer makes fewer.
        closer: they lie on a line instead, each further forward than the one before it; ``levels`` is 0.
        actions: how many.
        changes: as of ``pack``.
    """
    velocities = np.zeros((states, 3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "tree_levels_for", lambda _states: levels)
        if closer:
            velocities[:, 0] = np.linspace(-0.06, 0.06, states)
            patch.setattr(layout, "kd_order", lambda codes, _levels: (np.arange(len(codes)), ()))
        motion = np.full((states, actions, 3), 1e-4)
        return pack(velocities, motion, np.zeros_like(motion), **changes)


def affine_parts(states: int, actions: int, seed: int) -> dict[str, npt.NDArray[np.float64]]:
    """Return velocities, base, jacobian and history as pack_affine takes them: smooth, and of no physics."""
    velocity, motion, end = transitions(states, actions, seed)
    rng = np.random.default_rng([seed, 1])
    size = np.array(VELOCITY_SCALE)  # derivatives of about as many codes per code
    slope = rng.normal(0.0, 0.25, (actions, 6, 3)) * np.tile(size, 2)[:, None] / size
    slope = slope * np.cos(20.0 * velocity[:, None, None, :])
    return {
        "velocities": velocity,
        "base": np.concatenate([motion, end], axis=2),
        "jacobian": slope,
        "history": rng.normal(0.0, 0.004, (actions, 4, 6)),
    }


def affine_image(states: int = 120, actions: int = 9, seed: int = 1, **changes: object) -> bytes:
    """Return the image of a made-up table of kind affine; ``changes`` replace fields and arguments."""
    about = metadata(actions, changes)
    arguments = {"use_decay": 0.61, "use_gain": 0.43, **affine_parts(states, actions, seed)}
    return pack_affine(about, **(arguments | changes))


def wear_curves(limbs: int, knots: int, seed: int, size: float = 1.0) -> npt.NDArray[np.float64]:
    """Return wear curves of some millimetres: crooked, and of no physics."""
    rng = np.random.default_rng([seed, limbs, knots])
    steps = rng.normal(-0.2, 1.0, (limbs, knots, 6)) * np.array([4e-3, 4e-3, 0.06, 4e-3, 4e-3, 0.06])
    return np.asarray(size * steps.cumsum(axis=1) / knots)


def bent_curves() -> npt.NDArray[np.float64]:
    """Return wear curves of four limbs that are bent as real ones are, of about a stroke's size."""
    share = np.arange(1, 9)[:, None] / 8
    most = -np.array(
        [
            [0.007, -0.005, -0.12, 0.004, -0.002, -0.05],
            [0.007, 0.005, 0.12, 0.004, 0.002, 0.05],
            [0.010, -0.002, 0.06, 0.006, -0.001, 0.03],
            [0.010, 0.002, -0.06, 0.006, 0.001, -0.03],
        ]
    )
    return np.asarray(share * (0.6 + 0.4 * share) * most[:, None, :])


def grid_tables(seed: int = 3, states: int = 200) -> Tables:
    """Return a table whose velocities stand on a coarse grid: equal distances and equal rows abound."""
    velocity, motion, end = transitions(states, 5, seed)
    step = np.array([20e-5, 20e-5, 20 * 1.745329e-4])
    return open_image(pack(np.round(velocity / step / 40) * 40 * step, motion, np.round(end / step) * step))


def resealed(content: bytes, offset: int, replacement: bytes) -> bytes:
    """Return an image with some bytes replaced and its CRC made right again."""
    changed = bytearray(content)
    changed[offset : offset + len(replacement)] = replacement
    changed[12:16] = struct.pack("<I", zlib.crc32(bytes(changed[16:])))
    return bytes(changed)
