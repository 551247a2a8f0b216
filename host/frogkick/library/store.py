"""The library file: the simulated transitions in HDF5, checked when it is read; and its plain table image."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from frogkick.core.arguments import typed
from frogkick.core.arrays import Bool, Float32, Float64, Int64
from frogkick.core.errors import InputError
from frogkick.core.files import existing_file, require_room
from frogkick.core.hdf5 import hdf5_to_read, hdf5_to_write
from frogkick.core.version import VERSION
from frogkick.library.transitions import HISTORY, RESTED, Failed, Transitions
from frogkick.library.wear import no_curves
from frogkick.robot import Robot, parse_robot
from frogkick.tables.layout import WEAR_KNOTS
from frogkick.tables.packing import pack_nearest
from frogkick.tables.sealing import Metadata

OVERHEAD_BYTES, STEP_BYTES, SAMPLE_BYTES = 65536, 64, 24
"""Bytes of the file: tables of contents, a transition, a recorded pose with velocity."""

FORMAT = "frogkick library"
FORMAT_VERSION = 3  # 2: recorded motions, failed transitions; 3: actions before a state
_READABLE = (2, 3)


def _attributes(units: str, where: str) -> dict[str, str]:
    return {"units": units, "frame": f"body at {where}: forward, left, counter-clockwise"}


_UNITS = {
    "initial_velocity_body": _attributes("m/s, m/s, rad/s", "the start"),
    "displacement_body": _attributes("m, m, rad", "the start"),
    "velocity_body_end": _attributes("m/s, m/s, rad/s", "the end"),
}
_RECORDED_UNITS = {
    "recorded_pose_body": _attributes("m, m, rad", "the start"),
    "recorded_velocity_body": _attributes("m/s, m/s, rad/s", "that time"),
}
_FACTS = ("robot_id", "robot_toml", "robot_sha256", "sampling", "seed", "frogkick_version", "period_s")
_TIMES = "recorded_time_s"
_PREVIOUS = "previous_actions"
_WEAR = "limb_wear"
_WEAR_MEANING = "change of a transition (m, m, rad, m/s, m/s, rad/s) by limb and by the share that it lost"
_PREVIOUS_MEANING = f"index of the action begun 1, 2, .. periods before the start; {RESTED}: limbs rested"


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Library:
    """Transitions of a robot: n states times a actions.

    Attributes:
        robot_toml: the robot's canonical text; robot() reads it.
        robot_sha256: 32 bytes, of that text.
        sampling: "box", "visited" or "planned", see ``sample_starts``.
        seed: of the sampling.
        frogkick_version: version that made it.
        period_s: simulated time of each transition.
        initial_velocity_body: (n, 3) forward, left (m/s), turn rate (rad/s).
        displacement_body: (n, a, 3) forward, left (m), turn (rad), body frame at the start.
        velocity_body_end: (n, a, 3) body frame at the end.
        previous_actions: (n, HISTORY) actions started 1, 2, .. periods before the start, then RESTED. With
            any of them, limbs are active or recover at the start.
        failed: transitions that could not be simulated, in order; only their rows are NaN.
        limb_wear: (l, WEAR_KNOTS, 6) what transitions change while a limb wears, see ``wear_curves``; (0, ..)
            where that was not simulated: the robot's tables then hold no curve, and it learns no wear.
        folder: folder of the robot's own effects; None if the library was read from a file.
    """

    robot_id: str
    robot_toml: str
    robot_sha256: bytes
    sampling: str
    seed: int
    frogkick_version: str
    period_s: float
    initial_velocity_body: Float64
    displacement_body: Float64
    velocity_body_end: Float64
    previous_actions: Int64
    failed: tuple[Failed, ...] = ()
    limb_wear: Float64 = field(default_factory=no_curves)
    folder: Path | None = None

    def __repr__(self) -> str:
        states, actions, _ = self.displacement_body.shape
        return (
            f"Library({states} states x {actions} actions of {self.robot_id!r}, {self.sampling}, "
            f"seed {self.seed}, {len(self.failed)} failed)"
        )

    def save(self, file: Path | str) -> None:
        """Write HDF5, completely or not at all. Only ``frogkick library build`` writes recorded motions.

        Raises:
            InputError: the file cannot be written.
        """
        write_library(self, file)

    def has_history(self) -> bool:
        """Whether limbs were used before any of the states."""
        return bool((self.previous_actions != RESTED).any())

    def rows(self) -> Float64:
        """(n, a, 6) displacements and velocities at the end, side by side."""
        return np.concatenate([self.displacement_body, self.velocity_body_end], axis=2)

    def whole_states(self) -> Bool:
        """(n,) whether all actions of a state could be simulated."""
        whole = np.ones(len(self.initial_velocity_body), dtype=bool)
        whole[[failure.state for failure in self.failed]] = False
        return whole

    def part(self, states: Int64) -> Library:
        """The library of some of its states, by their places."""
        place = {state: k for k, state in enumerate(states.tolist())}
        return replace(
            self,
            initial_velocity_body=self.initial_velocity_body[states],
            displacement_body=self.displacement_body[states],
            velocity_body_end=self.velocity_body_end[states],
            previous_actions=self.previous_actions[states],
            failed=tuple(replace(f, state=place[f.state]) for f in self.failed if f.state in place),
        )

    def robot(self) -> Robot:
        """The robot that was simulated."""
        return parse_robot(self.robot_toml, source="the library's robot", folder=self.folder)

    def content_sha256(self) -> bytes:
        """SHA-256 (32 bytes) of robot, transitions, period and wear: equal libraries give equal tables."""
        digest = hashlib.sha256(self.robot_sha256)
        for values in (self.initial_velocity_body, self.displacement_body, self.velocity_body_end):
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(self.previous_actions, dtype="<i8").tobytes())
        digest.update(np.float64(self.period_s).astype("<f8").tobytes())
        digest.update(np.ascontiguousarray(self.limb_wear, dtype="<f8").tobytes())
        return digest.digest()


@dataclass(frozen=True)
class Recorded:
    """Motion within each transition: (s,) times after its start, (n, a, s, 6) poses and velocities."""

    time_s: Float64
    motion: Float32


def write_library(
    library: Library,
    out: Path | str,
    recorded_time_s: Float64 | None = None,
    recorded: Iterable[Float32] = (),
) -> None:
    """Write a library, completely or not at all; equal libraries give equal bytes.

    Args:
        library: the library.
        out: the file.
        recorded_time_s: (s,) times of recorded motions; None: none.
        recorded: for each state (a, s, 6) poses and velocities at these times, see Transitions.
    """
    states, actions, _ = library.displacement_body.shape
    times = np.empty(0) if recorded_time_s is None else recorded_time_s
    require_room(out, OVERHEAD_BYTES + states * actions * (STEP_BYTES + len(times) * SAMPLE_BYTES))
    with hdf5_to_write(out, in_memory=False) as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        for name in _FACTS:
            value = getattr(library, name)
            file.attrs[name] = value.hex() if isinstance(value, bytes) else value
        for name, attributes in _UNITS.items():
            file.create_dataset(name, data=getattr(library, name), dtype="<f8").attrs.update(attributes)
        previous = file.create_dataset(_PREVIOUS, data=library.previous_actions, dtype="<i1")
        previous.attrs["meaning"] = _PREVIOUS_MEANING
        if len(library.limb_wear):
            wear = file.create_dataset(_WEAR, data=library.limb_wear, dtype="<f8")
            wear.attrs["meaning"] = _WEAR_MEANING
        failed = [(failure.state, failure.action) for failure in library.failed]
        reasons = [failure.reason.encode("ascii", "replace") for failure in library.failed]
        file.create_dataset("failed_transition", data=np.array(failed, dtype="<i4").reshape(-1, 2))
        file.create_dataset("failed_reason", data=np.array(reasons, dtype=np.bytes_ if reasons else "S1"))
        file.create_dataset(_TIMES, data=times, dtype="<f8").attrs["units"] = "s"
        motions = []
        for name, attributes in _RECORDED_UNITS.items():
            motions.append(file.create_dataset(name, shape=(states, actions, len(times), 3), dtype="<f4"))
            motions[-1].attrs.update(attributes)
        for state, motion in enumerate(recorded):
            if len(times):
                motions[0][state], motions[1][state] = motion[..., :3], motion[..., 3:]


def read_library(path: Path | str) -> Library:
    """Read and check a library.

    Raises:
        InputError: it is no library, is damaged, or was made by a later version.
    """
    source = existing_file(path, "library")
    try:
        with hdf5_to_read(source) as file:
            attributes = {key: file.attrs[key] for key in file.attrs}
            _check_format(attributes, path)
            arrays: dict[str, Any] = {name: np.asarray(file[name][()], dtype=np.float64) for name in _UNITS}
            states = len(arrays["initial_velocity_body"])
            previous = np.full((states, HISTORY), RESTED, dtype=np.int64)
            if int(attributes["format_version"]) >= 3:
                previous = np.asarray(file[_PREVIOUS][()], dtype=np.int64)
            wear = np.asarray(file[_WEAR][()], dtype=np.float64) if _WEAR in file else no_curves()
            failed = _read_failed(file)
            _check_recorded(file, arrays["displacement_body"].shape, path)
        library = Library(
            robot_id=str(attributes["robot_id"]),
            robot_toml=str(attributes["robot_toml"]),
            robot_sha256=bytes.fromhex(str(attributes["robot_sha256"])),
            sampling=str(attributes["sampling"]),
            seed=int(attributes["seed"]),
            frogkick_version=str(attributes["frogkick_version"]),
            period_s=float(attributes["period_s"]),
            **arrays,
            previous_actions=previous,
            failed=failed,
            limb_wear=wear,
        )
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"library {str(path)!r} is incomplete or not a library: {reason}; build it again"
        ) from error
    _check_content(library, path)
    return library


def read_recorded(path: Path | str) -> Recorded:
    """Read the motion within each transition of a library."""
    read_library(path)
    with hdf5_to_read(Path(path)) as file:
        motion = np.concatenate([file[name][()] for name in _RECORDED_UNITS], axis=3, dtype=np.float32)
        return Recorded(np.asarray(file[_TIMES][()], dtype=np.float64), motion)


def _read_failed(file: h5py.File) -> tuple[Failed, ...]:
    places = np.asarray(file["failed_transition"][()], dtype=np.int64).reshape(-1, 2).tolist()
    reasons = [reason.decode("ascii", "replace") for reason in file["failed_reason"][()].tolist()]
    return tuple(Failed(s, a, reason) for (s, a), reason in zip(places, reasons, strict=True))


def _check_recorded(file: h5py.File, shape: tuple[int, ...], path: Path | str) -> None:
    times = np.asarray(file[_TIMES][()], dtype=np.float64)
    rises = times.ndim == 1 and np.isfinite(times).all() and (np.diff(times, prepend=0.0) > 0.0).all()
    _require(rises, path, f"{_TIMES} does not increase from 0")
    for name in _RECORDED_UNITS:
        wanted, found = (*shape[:2], len(times), 3), file[name]
        _require(
            found.shape == wanted and found.dtype == np.float32,
            path,
            f"{name} has shape {found.shape} of {found.dtype}, not {wanted} of float32",
        )


def library_info(path: Path | str) -> dict[str, Any]:
    """Facts about a library as plain values."""
    library = read_library(path)
    with hdf5_to_read(Path(path)) as file:
        recorded_s = float(max(file[_TIMES][()], default=0.0))
        version = int(file.attrs["format_version"])
    states, actions = library.displacement_body.shape[:2]
    low, high = library.initial_velocity_body.min(axis=0), library.initial_velocity_body.max(axis=0)
    return {
        "format_version": version,
        "robot": library.robot_id,
        "robot_sha256": library.robot_sha256.hex(),
        "content_sha256": library.content_sha256().hex(),
        **{name: getattr(library, name) for name in _FACTS[3:]},
        "states": states,
        "actions": actions,
        "transitions": states * actions,
        "failed": len(library.failed),
        "wear_curves": len(library.limb_wear),
        "with_history": int((library.previous_actions[:, 0] != RESTED).sum()),
        "recorded_s": recorded_s,
        "simulated_s": states * actions * max(library.period_s, recorded_s),
        "velocity_low": low.tolist(),
        "velocity_high": high.tolist(),
        "bytes": Path(path).stat().st_size,
    }


def library_of(robot: Robot, sampling: str, seed: int, found: Transitions) -> Library:
    """A library of transitions from all of its states."""
    return Library(
        robot_id=robot.id,
        robot_toml=robot.toml,
        robot_sha256=robot.sha256,
        sampling=sampling,
        seed=seed,
        frogkick_version=VERSION,
        period_s=robot.period_s,
        initial_velocity_body=found.velocity_body,
        displacement_body=np.ascontiguousarray(found.rows[:, :, :3]),
        velocity_body_end=np.ascontiguousarray(found.rows[:, :, 3:]),
        previous_actions=found.previous,
        failed=found.failed,
    )


def _check_format(attributes: dict[str, Any], path: Path | str) -> None:
    found = attributes.get("format")
    if found != FORMAT:
        raise InputError(f"{str(path)!r} is HDF5 of format {found!r}, not {FORMAT!r}: name a library")
    version = int(attributes.get("format_version", 0))
    if version not in _READABLE:
        raise InputError(
            f"library {str(path)!r} has format version {version}, this program reads {_READABLE}: "
            "build it again or update frogkick"
        )


def _require(good: object, path: Path | str, text: str) -> None:
    """Raise InputError that says what is wrong with a library's content unless a condition holds."""
    if not good:
        raise InputError(f"library {str(path)!r}: {text}; build it again")


def _check_content(library: Library, path: Path | str) -> None:
    hashed = hashlib.sha256(library.robot_toml.encode("utf-8", "surrogateescape")).digest()
    _require(hashed == library.robot_sha256, path, "the robot's text does not match its hash")
    robot, wear, before = library.robot(), library.limb_wear, library.previous_actions
    n, a = len(library.initial_velocity_body), len(robot.actions)
    shapes = (no_curves().shape, (len(robot.limbs), WEAR_KNOTS, 6))
    _require(
        wear.shape in shapes and np.isfinite(wear).all(),
        path,
        f"{_WEAR} has shape {wear.shape} or a value that is not finite",
    )
    _require(
        before.shape == (n, HISTORY) and ((before >= RESTED) & (before < a)).all(),
        path,
        f"{_PREVIOUS} has shape {before.shape} or a value that is none of {RESTED} to {a - 1}",
    )
    lost = np.zeros((n, a), dtype=bool)
    for failure in library.failed:
        state, action = failure.state, failure.action
        here = 0 <= state < n and 0 <= action < a
        _require(here, path, f"failed transition {state}, {action} is none of {n} x {a}")
        lost[state, action] = True
    for name in _UNITS:
        values = getattr(library, name)
        shape = (n, 3) if name == "initial_velocity_body" else (n, a, 3)
        _require(n and values.shape == shape, path, f"{name} has shape {values.shape}, not {shape}")
        unknown = ~np.isfinite(values)
        if values.ndim == 3:
            unknown &= ~lost[:, :, None]
        bad = np.argwhere(unknown).tolist()
        _require(not bad, path, f"{name}{bad[0] if bad else ''} is not finite")
    if robot.id != library.robot_id or robot.period_s != library.period_s:
        raise InputError(
            f"library {str(path)!r} says robot {library.robot_id!r}, {library.period_s} s, its robot's text "
            f"{robot.id!r}, {robot.period_s} s: build it again"
        )


def table_metadata(robot: Robot, provenance: bytes) -> Metadata:
    """Metadata of a robot's table image."""
    return Metadata(
        robot_id=robot.id,
        provenance=provenance,
        period_us=round(robot.period_s * 1e6),
        pulse_us=round(robot.pulse_s * 1e6),
        second_delay_us=round(robot.second_delay_s * 1e6),
        limbs=len(robot.limbs),
        action_rows=[
            (code, action.first_mask, action.second_mask)
            for code, action in zip(robot.action_codes, robot.actions, strict=True)
        ],
        velocity_resolution=robot.velocity_resolution,
    )


def quantise(library: Library) -> bytes:
    """Round a library's transitions to the codes of a table image of kind ``nearest``.

    States in which an action could not be simulated are left out.

    Returns:
        The image; equal libraries give equal bytes.

    Raises:
        InputError: no state has all of its actions.
    """
    robot = library.robot()
    whole = library.whole_states()
    if not whole.any():
        raise InputError(
            f"{len(library.failed)} transitions of the library failed, and no state has all of its actions: "
            "build it again"
        )
    return pack_nearest(
        table_metadata(robot, library.content_sha256()),
        velocities=library.initial_velocity_body[whole],
        displacements=library.displacement_body[whole],
        velocities_end=library.velocity_body_end[whole],
        limb_wear=library.limb_wear,
    )
