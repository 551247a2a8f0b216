"""Chunks in this process, in several and on a real Dask cluster: equal results, and errors of one line."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.conftest import REPOSITORY, count, from_ci

import frogkick.core.chunks
from frogkick.cli.main import run_command
from frogkick.core.chunks import Job, check_cluster, run_chunks
from frogkick.core.errors import FrogkickError, InputError
from frogkick.robot import load_robot
from frogkick.validation.sweep import plan_sweep, run_sweep

needs_distributed = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason="distributed is not installed: pip install 'frogkick[cluster]'",
)


def start(base: int) -> list[int]:
    return [base]


def swallow_at_start(base: int) -> list[int]:
    swallow([])
    return [base]


def add(ready: list[int], task: int) -> int:
    return ready[0] + task


def run_out(ready: list[int], task: int) -> int:
    raise FrogkickError(f"chunk {task} cannot be")


def die(ready: list[int], task: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return task


def rest_long(ready: list[int], task: int) -> int:
    time.sleep(60.0 * task)
    return task


def rest(ready: list[int], task: int) -> int:
    time.sleep(0.1)
    return task


ADDING = Job(start, (100,), add, len)


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_once_on_this_machine(workers: int) -> None:
    assert sorted(run_chunks(ADDING, range(7), workers)) == [(k, 100 + k) for k in range(7)]
    assert list(run_chunks(ADDING, [], workers)) == []


@pytest.mark.parametrize("where", ["module", "script", "lambda"])
def test_a_script_is_not_run_again_where_processes_are_spawned(where: str, tmp_path: Path) -> None:
    """What only the script describes is done in its own process, as nothing else could."""
    body = (
        "import os\ndef start(base): return [base]\n"
        "def add(ready, task): return ready[0] + task, os.getpid()\n"
    )
    (tmp_path / "mine.py").write_text(body)
    own = "from mine import add, os, start\n" if where == "module" else body
    start_it = "lambda base: [base]" if where == "lambda" else "start"
    (tmp_path / "script.py").write_text(
        "import multiprocessing\nprint('begun', flush=True)\nmultiprocessing.set_start_method('spawn')\n"
        f"{own}"
        "from frogkick.core.chunks import Job, run_chunks\n"
        f"found = dict(run_chunks(Job({start_it}, (100,), add, len), range(4), 2))\n"
        "print([found[k][0] for k in range(4)], os.getpid() in [at for _, at in found.values()])\n"
    )
    said = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (said.stdout, said.stderr) == (f"begun\n[100, 101, 102, 103] {where != 'module'}\n", "")


def swallow(_ready: list[int]) -> None:
    """Interrupt this process, and swallow the exception."""
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_counts_even_where_it_was_swallowed(workers: int) -> None:
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            list(run_chunks(Job(swallow_at_start, (100,), add, swallow), range(4), workers))
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, handler)


@pytest.mark.skipif(sys.platform == "win32", reason="sends SIGKILL")
def test_a_killed_process_is_said() -> None:
    with pytest.raises(FrogkickError, match="worker process ended unexpectedly"):
        list(run_chunks(Job(start, (0,), die, len), range(4), 2))


def test_nobody_waits_for_chunks_that_are_not_wanted_any_more() -> None:
    """A chunk of identification takes many seconds, and Ctrl-C is answered at once."""
    began_s = time.monotonic()
    for found in run_chunks(Job(start, (0,), rest_long, len), range(4), 2):
        assert found == (0, 0)
        break  # the generator is closed, as after Ctrl-C
    assert time.monotonic() - began_s < 20.0


@pytest.mark.parametrize("workers", [0, 257])
def test_workers_out_of_range(workers: int) -> None:
    with pytest.raises(InputError, match="workers"):
        list(run_chunks(ADDING, [1], workers))


@pytest.mark.parametrize(
    "address", ["", "nowhere", "host:", ":8786", "host:99999", "host:0", "http://host:8786", "a b:1", "h:1/x"]
)
def test_malformed_addresses(address: str) -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        check_cluster(address)


@needs_distributed
@pytest.mark.parametrize("address", ["127.0.0.1:8786", "tcp://node-1.lab:8786", "tls://[::1]:8786"])
def test_good_addresses(address: str) -> None:
    check_cluster(address)


def test_without_distributed_the_hint_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run_command(["sweep", "--out", str(tmp_path / "x"), "--cluster", "127.0.0.1:8786"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "pip install 'frogkick[cluster]'" in said
    assert list(tmp_path.iterdir()) == []


def test_workers_and_cluster_exclude_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["sweep", "--out", str(tmp_path / "x"), "--cluster", "127.0.0.1:8786", "--workers", "2"]
    assert run_command(options) == 2
    assert "give only one of the two" in capsys.readouterr().err


def test_distributed_is_loaded_only_when_asked_for() -> None:
    script = (
        "import sys, frogkick.cli.make, frogkick.cli.research\n"
        "sys.exit(1 if {'distributed', 'dask'} & set(sys.modules) else 0)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@from_ci
@needs_distributed
@pytest.mark.parametrize("listens", [False, True])
def test_where_no_scheduler_answers(listens: bool, tmp_path: Path) -> None:
    """Nothing listens at the address, or what listens never answers."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        script = (  # a shorter patience than a user's
            "import sys, frogkick.core.chunks\n"
            "frogkick.core.chunks.CONNECT_S = 1\n"
            "from frogkick.cli.main import run_command\n"
            f"sys.exit(run_command(['sweep', '--out', {str(tmp_path)!r}, '--cluster', {address!r}]))"
        )
        run = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300
        )
    assert run.returncode == 2, run.stderr
    complaints = [line for line in run.stderr.splitlines() if not line.startswith("sweep: gaits")]
    assert len(complaints) == 1 and f"no Dask scheduler answers at '{address}'" in complaints[0]


class Cluster:
    """A scheduler and workers of this machine, as `dask scheduler` and `dask worker` start them."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        # frogkick's tests are importable there, as an installed frogkick is.
        folders = (str(Path(__file__).parent), str(REPOSITORY), os.environ.get("PYTHONPATH", ""))
        paths = os.pathsep.join(folders)
        self._environment = {**os.environ, "PYTHONPATH": paths}
        self._folder = folder
        self._log = (folder / "log").open("wb")
        self.scheduler = self._run("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        self._wait_for_scheduler(port)
        self.workers = [self.add_worker() for _ in range(workers)]

    def _wait_for_scheduler(self, port: int) -> None:
        """A slow machine takes longer to load a scheduler than a client waits for its answer."""
        while self.scheduler.poll() is None:
            with socket.socket() as caller:
                if caller.connect_ex(("127.0.0.1", port)) == 0:
                    return
            time.sleep(0.05)
        raise AssertionError(f"the scheduler ended before it listened: {self.log()}")

    def _run(self, command: str, *options: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", command, *options],
            stdout=self._log,
            stderr=self._log,
            env=self._environment,
            cwd=self._folder,
        )

    def add_worker(self) -> subprocess.Popen[bytes]:
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self._folder)]
        return self._run("worker", self.address, *options)

    def log(self) -> str:
        return (self._folder / "log").read_text(errors="replace")

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.terminate()
        for process in (*self.workers, self.scheduler):
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._log.close()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    running = Cluster(tmp_path_factory.mktemp("cluster"))
    deadline = time.monotonic() + 300
    while running.log().count("Registered to") < 2:
        if time.monotonic() > deadline:
            running.close()
            pytest.fail(f"the cluster did not start: {running.log()[-2000:]}")
        time.sleep(0.1)
    yield running
    running.close()


def chunks_of(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted((folder / "chunks").iterdir())}


@from_ci
@needs_distributed
def test_every_task_once_on_a_cluster_and_errors_come_back(cluster: Cluster) -> None:
    assert sorted(run_chunks(ADDING, range(7), 1, cluster.address)) == [(k, 100 + k) for k in range(7)]
    with pytest.raises(FrogkickError, match=r"^chunk 3 cannot be$"):
        list(run_chunks(Job(start, (0,), run_out, len), [3], 1, cluster.address))


@needs_distributed
def test_a_worker_with_other_code_is_refused(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frogkick.core.chunks, "code_stamp", lambda: "another")
    with pytest.raises(FrogkickError, match="has another frogkick"):
        list(run_chunks(ADDING, [1], 1, cluster.address))


@from_ci
@needs_distributed
def test_what_a_caller_drops_does_not_stay(cluster: Cluster) -> None:
    first, _ = next(running := run_chunks(ADDING, range(200), 1, cluster.address))
    assert first in range(200)
    running.close()
    assert len(list(run_chunks(ADDING, range(3), 1, cluster.address))) == 3


def kill_one(cluster: Cluster) -> None:
    victim = cluster.workers.pop(0)
    victim.kill()
    victim.wait()


@from_ci
@needs_distributed
def test_a_sweep_with_a_worker_killed_in_it_gives_the_same_bytes(cluster: Cluster, tmp_path: Path) -> None:
    frequencies = [1.9, 2.0, 2.1, 2.2, 2.3][: count(5, 5, 3)]
    plan = plan_sweep(load_robot("frog2022"), frequencies, phases=8, egain_percent=[50.0])
    reported: list[int] = []

    def kill_in_the_middle(done: int, total: int) -> None:
        reported.append(done)
        if len(reported) == 2:  # one chunk is done; each worker has another in hand
            kill_one(cluster)

    run_sweep(plan, tmp_path / "far", 1, kill_in_the_middle, cluster.address)
    assert reported == [8 * k for k in range(len(frequencies) + 1)]
    assert "Remove worker" in cluster.log() or "Removing" in cluster.log()
    run_sweep(plan, tmp_path / "here", 1)
    assert chunks_of(tmp_path / "far") == chunks_of(tmp_path / "here")
    cluster.workers += [cluster.add_worker() for _ in range(count(1, 1, 0))]


@from_ci
@needs_distributed
def test_the_command_gives_the_same_files(cluster: Cluster, tmp_path: Path) -> None:
    options = ["sweep", "--frequencies", "2.2,2.3", "--egain", "50", "--phases", "2", "--json"]
    assert run_command([*options, "--out", str(tmp_path / "far"), "--cluster", cluster.address]) == 0
    assert run_command([*options, "--out", str(tmp_path / "here"), "--workers", "1"]) == 0
    names = sorted(file.name for file in (tmp_path / "far").iterdir() if file.is_file())
    assert names
    for name in names:
        assert (tmp_path / "far" / name).read_bytes() == (tmp_path / "here" / name).read_bytes(), name


@from_ci
@needs_distributed
def test_a_scheduler_without_workers_and_one_that_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(frogkick.core.chunks, "WORKERS_S", 1)
    alone = Cluster(tmp_path, workers=0)
    try:
        with pytest.raises(InputError, match="has no workers"):
            list(run_chunks(ADDING, [1], 1, alone.address))
        alone.workers.append(alone.add_worker())
        monkeypatch.setattr(frogkick.core.chunks, "WORKERS_S", 300)  # however slow the day
        running = run_chunks(Job(start, (0,), rest, len), range(100), 1, alone.address)
        next(running)
        alone.scheduler.kill()
        with pytest.raises(FrogkickError, match=r"cluster at .* failed"):
            list(running)
    finally:
        alone.close()
    assert capfd.readouterr().err == ""
