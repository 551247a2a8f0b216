"""From picture to robot: python -m tests.bench.host_latency [seconds] with PYTHONPATH=. set.

A run as ``frogkick run --plan host`` does it: camera at 60 pictures a second, tag, planner on this computer,
log on disk, commands over a pseudo-terminal to a live robot. Said is, for each fix, the time from the
picture's hand-over to its frame's way into the wire, and for each decision from when it was due to its stroke
command's way there. The pictures are rendered before; the robot, part of this process, takes its share.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.link.live_robot import LiveRobot
from tests.link.rigged import rigged
from tests.link.swim import PATH
from tests.link.test_run_camera import SCENE, START
from tests.runs import rig
from tests.vision.scenes import calibration

from frogkick.front.bench import placed
from frogkick.paths import shape
from frogkick.planner.plan import PlanConfig
from frogkick.runs.closed_loop import run_session
from frogkick.runs.decision import warm_up
from frogkick.runs.lab_session import lab_session
from frogkick.runs.live_log import logged
from frogkick.runs.record import RunOptions
from frogkick.runs.tracked_fixes import CameraFixes
from frogkick.vision.sources import Frame

RATE_HZ = 60.0


def main(seconds: float) -> None:
    """Run, and print percentiles."""
    rng = np.random.default_rng(1)
    pictures = [SCENE.picture(START, rng) for _ in range(20)]

    def filmed() -> Iterator[Frame]:
        begin_s = time.monotonic()
        for sequence in range(10**9):
            time.sleep(max(0.0, begin_s + sequence / RATE_HZ - time.monotonic()))
            yield Frame(pictures[sequence % len(pictures)], time.monotonic(), sequence, True)

    warm_up(rig.tables(), shape(PATH), PlanConfig(depth=3))
    path = placed(shape(PATH), (), "here", START)[0]
    options = RunOptions(PlanConfig(depth=3), False, seconds)
    strokes: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        robot = LiveRobot()
        with (
            rigged("serial", robot, Path(folder), patch) as there,
            logged(Path(folder) / "run.h5", rig.recording(path, options)) as keep,
        ):
            camera = CameraFixes(filmed(), calibration(SCENE), "camera")
            camera.wait_first(10.0)
            session = lab_session(there.wire)
            post = session.post

            def timed_post(name: str, *rest: object, **more: object) -> int:
                sequence = post(name, *rest, **more)
                if name == "STROKE":
                    strokes.append((session.port.now_s, session.time_s))
                return sequence

            session.post = timed_post
            recording = run_session(session, camera, rig.recording(path, options), keep=keep)
            camera.close()
    period_s = rig.tables().period_us * 1e-6
    due_s = recording.first_decision_s + period_s * np.arange(len(recording.decisions))
    fix_ms = 1e3 * np.array([fix.sent_s - fix.capture_s for fix in recording.fixes])
    late_ms = [1e3 * min(at_s - due for due in due_s if at_s >= due) for at_s, _ in strokes]
    for what, values in (("picture to fix sent", fix_ms), ("decision due to stroke sent", late_ms)):
        half, most = np.percentile(values, [50, 99])
        print(
            f"{what}: median {half:.1f} ms, p99 {most:.1f} ms, worst {np.max(values):.1f} ms of {len(values)}"
        )
    print(f"pictures: {dict(camera.reasons)}, decisions: {len(recording.decisions)}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
