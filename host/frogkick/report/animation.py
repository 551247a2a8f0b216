"""An animation of a swim or a run: frame, limbs, the trail of the centre, time and the path."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from frogkick.core.arrays import Float32, Float64, Int64, UInt8
from frogkick.core.errors import ConvergenceError, FrogkickError, InputError
from frogkick.core.files import atomic_path
from frogkick.core.poses import world_from_body
from frogkick.der import Batch, Rods, prepare
from frogkick.effects.acting import program_of
from frogkick.report import style
from frogkick.robot import Action, Robot, in_a_row, load_robot, parse_robot
from frogkick.runs.runlog import RunLog

ANIMATIONS = (".gif", ".mp4")
RATE_HZ = 20  # of the pictures; a GIF counts in hundredths of a second, so this one is exact
PICTURES_MAX = 400  # a longer swim is played faster: 20 s of playing time, 1 to 3 MB of GIF
WIDTH_PX = 720
HEIGHT_MIN_PX, HEIGHT_MAX_PX = 240, 720
_DPI = 100
_INKS = ("#000000", style.DESIRED, style.TRUE, style.ALARM, style.ESTIMATED)
_SHADES = 12
"""Steps from each colour to white, for smooth edges; 61 colours, the same in all pictures."""


@dataclass(frozen=True)
class Swim:
    """A simulated swim or a run to animate."""

    rods: Rods  # of the robot, with the profile of its limbs
    pulses: tuple[tuple[float, int], ...]  # (time_s, limb mask) of every group that fires, in order of time
    duration_s: float
    velocity_body: tuple[float, float, float]  # forward, left (m/s), turn rate (rad/s) at the start
    title: str  # one line
    # (k,) s and (k, 3) m, m, rad of the recorded body poses of a run; None: as simulated
    track: tuple[Float64, Float64] | None = None
    path_m: Float32 | None = None  # (p, 2) the desired path


@dataclass(frozen=True)
class Film:
    """A swim at the times of its pictures."""

    time_s: Float64  # (k,)
    nodes_m: Float64  # (k, n, 2) as Batch.nodes_world
    pose_world: Float64  # (k, 3) x, y (m), heading (rad)
    heated: Int64  # (k,) mask of the limbs whose pulse is on
    speed: float  # simulated seconds for each second shown; 1 is real time


def gait_swim(robot: Robot, egain_percent: float, frequency_hz: float, phase: float, cycles: int) -> Swim:
    """Return the swim of a gait, as in ``simulate_gaits``: the second group fires ``phase`` of a cycle
    later."""
    period_s = 1.0 / frequency_hz
    lead = [(cycle * period_s, robot.gait_lead_mask) for cycle in range(cycles)]
    lag = [((cycle + phase) * period_s, robot.gait_lag_mask) for cycle in range(cycles)]
    rods, pulses = prepare(robot, egain_percent, frequency_hz), tuple(sorted(lead + lag))
    title = f"{robot.id}: {egain_percent:g} % EGaIn, {frequency_hz:g} Hz, phase {phase:g}"
    return Swim(rods, pulses, cycles * period_s, (0.0, 0.0, 0.0), title)


def actions_swim(
    robot: Robot, actions: Sequence[Action], velocity_body: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Swim:
    """Return the swim of ``simulate_actions``: one action each period."""
    periods = [program_of(robot, action, index * robot.period_s) for index, action in enumerate(actions)]
    pulses = sorted(pulse for period in periods for pulse in period)
    names = in_a_row([action.name for action in actions])
    shown = names if len(names) <= 40 else names[:37] + "..."
    duration_s, title = len(actions) * robot.period_s, f"{robot.id}: actions {shown}"
    return Swim(prepare(robot), tuple(pulses), duration_s, velocity_body, title)


def run_swim(log: RunLog) -> Swim:
    """Return the swim of a run: the body's poses are its fixes, the limbs bend as simulated by its strokes.

    Raises:
        InputError: the run has too few fixes, or its robot is not known.
    """
    text = log.made.get("robot_toml")
    robot = load_robot(log.robot_id) if text is None else parse_robot(text, log.source)
    seen = log.fixes.usable
    if np.count_nonzero(seen) < 2:
        raise InputError(
            "this run has fewer than 2 usable position fixes, so it cannot be animated: choose another run"
        )
    begin_s = float(log.fixes.capture_time_s[seen][0])
    time_s = log.fixes.capture_time_s[seen] - begin_s
    x_m, y_m, heading_rad = log.fixes.x_m[seen], log.fixes.y_m[seen], np.unwrap(log.fixes.heading_rad[seen])
    track = (time_s, np.column_stack([x_m, y_m, heading_rad]))
    fired = zip(log.strokes.time_s - begin_s, log.strokes.limb_mask, strict=True)
    pulses = tuple((float(start_s), int(mask)) for start_s, mask in fired if start_s >= 0.0)
    title = robot.id if log.path is None else f"{robot.id} along {log.path.name}"
    path_m = None if log.path is None else np.column_stack([log.path.x_m, log.path.y_m])
    return Swim(prepare(robot), pulses, float(time_s[-1]), (0.0, 0.0, 0.0), title, track, path_m)


def film(swim: Swim) -> Film:
    """Simulate a swim and record the state for each picture, at RATE_HZ, faster than real time if it is long.

    Raises:
        ConvergenceError: the rods fail; the text gives the state.
    """
    pictures = min(PICTURES_MAX, math.floor(swim.duration_s * RATE_HZ + 1e-9) + 1)
    real_time = pictures < PICTURES_MAX
    spacing_s = 1.0 / RATE_HZ if real_time else swim.duration_s / (pictures - 1)
    time_s = spacing_s * np.arange(pictures, dtype=np.float64)
    batch = Batch([swim.rods], np.zeros((1, 3)), np.array([swim.velocity_body], dtype=np.float64), width=1)
    for start_s, mask in swim.pulses:
        for limb in range(batch.limbs):
            if mask >> limb & 1:
                batch.fire(0, limb, start_s)
    nodes, poses, heated = [], [], []
    for now_s in time_s:
        batch.advance(float(now_s))
        for failure in batch.failures.values():
            raise ConvergenceError(f"rods of {swim.rods.robot.id!r} {failure}")
        pose = batch.pose_world()[0]
        moved = pose
        if swim.track is not None:
            moved = np.array([np.interp(now_s, swim.track[0], column) for column in swim.track[1].T])
        nodes.append(moved[:2] + world_from_body(moved[2] - pose[2], batch.nodes_world()[0] - pose[:2]))
        poses.append(moved)
        on = 0
        for start_s, mask in swim.pulses:
            # At high speed a pulse may lie between two pictures, so the picture after its start shows it too.
            if start_s - 1e-9 <= now_s < start_s + max(swim.rods.robot.pulse_s, spacing_s) - 1e-9:
                on |= mask
        heated.append(on)
    return Film(np.asarray(time_s), np.array(nodes), np.array(poses), np.array(heated), spacing_s * RATE_HZ)


def require_animation_name(target: Path) -> None:
    """Raise InputError, before anything is simulated, for a name that ends in none of ``ANIMATIONS``."""
    if target.suffix.lower() not in ANIMATIONS:
        raise InputError(f"animation {str(target)!r} does not end in {' or '.join(ANIMATIONS)}: choose one")


def write_animation(
    swim: Swim, target: Path, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> dict[str, float | int]:
    """Simulate a swim and write it as a GIF or an MP4, by its name, wholly or not at all.

    Returns:
        ``pictures``, ``rate_hz``, ``speed`` (simulated seconds per second of the animation), ``bytes``.

    Raises:
        InputError: see require_animation_name, or a place that cannot be written to.
        ConvergenceError: see film.
        FrogkickError: OpenCV has no encoder.
    """
    require_animation_name(target)
    shot = film(swim)
    write = _write_mp4 if target.suffix.lower() == ".mp4" else _write_gif
    with style.styled(), atomic_path(target) as temporary:
        write(temporary, _pictures(swim, shot, progress))
    return {
        "pictures": len(shot.time_s),
        "rate_hz": RATE_HZ,
        "speed": round(shot.speed, 6),
        "bytes": target.stat().st_size,
    }


def _stage(swim: Swim, shot: Film) -> Figure:
    """Return a figure that covers the whole swim at equal scales."""
    shown_m = shot.nodes_m.reshape(-1, 2)
    if swim.path_m is not None:
        shown_m = np.concatenate([shown_m, swim.path_m])
    low, high = 100.0 * shown_m.min(axis=0) - 1.5, 100.0 * shown_m.max(axis=0) + 1.5
    wide, tall = (float(side) for side in high - low)
    room_px = 80  # space of the labels on each axis
    wanted_px = (WIDTH_PX - room_px) * tall / wide + room_px
    height_px = int(np.clip(wanted_px, HEIGHT_MIN_PX, HEIGHT_MAX_PX))
    if wanted_px < HEIGHT_MIN_PX:  # a straight swim: show more water above and below
        extra = 0.5 * (wide * (HEIGHT_MIN_PX - room_px) / (WIDTH_PX - room_px) - tall)
        low[1], high[1] = low[1] - extra, high[1] + extra
    # Video encoders want even numbers of pixels.
    figure = Figure(figsize=(WIDTH_PX / _DPI, 2 * (height_px // 2) / _DPI), dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.set_aspect("equal", adjustable="box")
    if swim.path_m is not None:
        axes.plot(*(100.0 * swim.path_m.T), color=style.DESIRED, linewidth=1.2)
    axes.set(xlabel="x (cm)", ylabel="y (cm)")
    speed = "real time" if abs(shot.speed - 1.0) < 1e-9 else f"{shot.speed:.2g} x real time"
    axes.set_title(f"{swim.title}; {speed}, {RATE_HZ} pictures/s")
    return figure


def _pictures(swim: Swim, shot: Film, progress: Callable[[int, int], None]) -> Iterator[UInt8]:
    """Yield (height, width, 3) pictures. Axes are drawn once, what moves is drawn over them."""
    figure = _stage(swim, shot)
    canvas: Any = FigureCanvasAgg(figure)  # matplotlib gives no types for what follows
    canvas.draw()
    figure.set_layout_engine("none")  # the layout is fixed now, so that it is not computed for each picture
    axes = figure.axes[0]
    still = canvas.copy_from_bbox(figure.bbox)
    robot, mesh = swim.rods.robot, swim.rods.mesh
    ring = [*range(mesh.frame_nodes), 0]
    corner_node = np.concatenate([[0], np.cumsum(robot.frame.segments)[:-1]])
    trail = Line2D([], [], color=style.ESTIMATED, linewidth=1.5)
    body = Line2D([], [], color="black", linewidth=2.0)
    nose = Line2D([], [], color="black", linewidth=1.2)
    limbs = [Line2D([], [], linewidth=2.2, solid_capstyle="round") for _ in robot.limbs]
    lines = [axes.add_line(line) for line in (trail, body, nose, *limbs)]
    clock = axes.text(0.01, 0.98, "", transform=axes.transAxes, va="top", family="monospace")
    nose_cm = 50.0 * float(np.ptp(mesh.rest_m[: mesh.frame_nodes, 0]))
    for k, now_s in enumerate(shot.time_s):
        nodes_cm = 100.0 * shot.nodes_m[k]
        x, y, heading = shot.pose_world[k]
        trail.set_data(*(100.0 * shot.pose_world[: k + 1, :2].T))
        body.set_data(*nodes_cm[ring].T)
        centre, forward = np.array([100.0 * x, 100.0 * y]), np.array([math.cos(heading), math.sin(heading)])
        nose.set_data(*np.array([centre, centre + 0.5 * nose_cm * forward]).T)
        first = mesh.frame_nodes
        for index, (limb, line) in enumerate(zip(robot.limbs, limbs, strict=True)):
            line.set_data(*nodes_cm[[corner_node[limb.corner], *range(first, first + limb.segments)]].T)
            line.set_color(style.ALARM if shot.heated[k] >> index & 1 else style.TRUE)
            first += limb.segments
        clock.set_text(f"{now_s:6.2f} s")
        canvas.restore_region(still)
        for artist in (*lines, clock):
            axes.draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[:, :, :3].copy()
        progress(k + 1, len(shot.time_s))


def _write_gif(target: Path, pictures: Iterator[UInt8]) -> None:
    inks = np.array([to_rgb(ink) for ink in _INKS])[:, None, :]
    share = np.linspace(0.0, 1.0, _SHADES + 1)[None, 1:, None]
    shades = np.round(255.0 * (1.0 - share + share * inks)).astype(np.uint8).reshape(-1, 3)
    palette = Image.new("P", (1, 1))
    palette.putpalette([255, 255, 255, *shades.ravel().tolist()])
    coded = [
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    ]
    coded[0].save(
        target, format="GIF", save_all=True, append_images=coded[1:], duration=1000 // RATE_HZ, loop=0
    )


def _write_mp4(target: Path, pictures: Iterator[UInt8]) -> None:
    cv2: Any = importlib.import_module("cv2")
    writer = None
    try:
        for picture in pictures:
            if writer is None:
                size = (picture.shape[1], picture.shape[0])
                writer = cv2.VideoWriter(str(target), cv2.VideoWriter_fourcc(*"mp4v"), float(RATE_HZ), size)
                if not writer.isOpened():
                    raise FrogkickError("this OpenCV has no MP4 encoder: name a .gif")
            writer.write(np.ascontiguousarray(picture[:, :, ::-1]))  # OpenCV's order is blue, green, red
    finally:
        if writer is not None:
            writer.release()
