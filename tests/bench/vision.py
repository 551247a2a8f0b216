"""What a pose costs and how good it is: python -m tests.bench.vision [frames] with PYTHONPATH=. set.

Frames per second are counted in processor time of one thread, so that a busy machine does not show.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import cv2
import numpy as np
from tests.vision.scenes import Told, aside, calibration, drawn_pose, scene

from frogkick.core.poses import wrap_angle
from frogkick.vision.scene import looking_at
from frogkick.vision.tracker import Tracker

OVER_THE_MIDDLE = "waves 1 mm, camera over the pool's middle"
CASES: dict[str, dict[str, float]] = {
    "plain": {},
    "noise 6": {"noise": 6.0},
    "blur 1 px": {"blur_px": 1.0},
    "waves 0.5 mm": {"wave_height_m": 0.0005},
    "waves 1 mm": {"wave_height_m": 0.001},
    OVER_THE_MIDDLE: {"wave_height_m": 0.001},
    "all": {"noise": 5.0, "blur_px": 0.8, "light_slope": 0.5, "wave_height_m": 0.0005},
}


def main(frames: int) -> None:
    """Measure each case: drawn places in the whole frame, and a way in a window."""
    cv2.setNumThreads(1)
    for name, conditions in CASES.items():
        one = scene(**conditions)
        if name == OVER_THE_MIDDLE:
            one = replace(one, view=looking_at(place_m=(0.6, 0.45, 1.35)))
        tracker = Tracker(calibration(one))
        rng, height_m = Told(41), one.conditions.wave_height_m
        off, left, whole_s, window_s, windows = [], [], 0.0, 0.0, 0
        for _ in range(frames):
            truth = drawn_pose(one, rng)
            picture = one.picture(truth, rng)
            tracker.forget()
            began = time.process_time()
            seen = tracker.observe(picture)
            between = time.process_time()
            again = tracker.observe(picture)
            window_s += time.process_time() - between
            whole_s += between - began
            windows += again.windowed
            if seen.pose is not None:
                pose = seen.pose
                off.append(
                    [pose.x_m - truth[0], pose.y_m - truth[1], wrap_angle(pose.heading_rad - truth[2])]
                )
                left.append(np.array(off[-1][:2]) - height_m * rng.heave * aside(one, truth[:2]))
        errors = np.array(off).reshape(-1, 3)
        place, turn = 1e3 * np.hypot(errors[:, 0], errors[:, 1]), np.degrees(np.abs(errors[:, 2]))
        print(
            f"{name}: {len(errors)} of {frames} found, place rms {np.sqrt(np.mean(place**2)):.3f} max "
            f"{place.max():.3f} mm, heading rms {np.sqrt(np.mean(turn**2)):.3f} max {turn.max():.3f} deg; "
            f"{frames / window_s:.0f} frames/s in the window ({windows} of {frames}), "
            f"{frames / whole_s:.0f} in the whole frame",
            flush=True,
        )
        if height_m:
            rest = 1e3 * np.hypot(*np.array(left).T)
            print(f"    place without the heave: rms {np.sqrt(np.mean(rest**2)):.3f} max {rest.max():.3f} mm")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
