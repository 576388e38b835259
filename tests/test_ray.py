"""A sweep on a Ray cluster: what it joins, what it says where it cannot, what it asks for. Ray is a stand-in here."""

from __future__ import annotations

import os
import socket
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import PATIENCE

from ecology import EcologyError
from ecology.lab.cli import main
from ecology.lab.runs import cluster, sweep

REFUSED = (
    "gcs_client.cc:210: Unauthenticated: RPC error: InvalidAuthToken: Authentication token is missing or incorrect"
)
GIB = 2.0**30


class RayError(Exception):
    pass


class AuthenticationError(RayError):
    pass


@pytest.fixture
def ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return a stand-in for the package ray: `joined` fails or not, `alive` are nodes, `asked` what tasks wanted."""
    module = SimpleNamespace(
        __version__="9.9.9",
        exceptions=SimpleNamespace(RayError=RayError, AuthenticationError=AuthenticationError),
        joined=lambda: None,
        alive=[{"CPU": 2.0, "memory": 8 * GIB}],
        asked=[],
        result=(2, "no"),
    )

    def remote(**options: Any) -> Callable[[Any], Any]:
        module.asked.append(options)
        return lambda function: SimpleNamespace(remote=lambda *task: task)

    module.init = lambda *_, **__: module.joined()
    module.nodes = lambda: [{"Alive": True, "Resources": node} for node in module.alive]
    module.cluster_resources = lambda: module.alive[0] if module.alive else {}
    module.remote, module.wait, module.get = remote, lambda tasks, timeout: (tasks, []), lambda task: module.result
    monkeypatch.setitem(sys.modules, "ray", module)
    return module


@pytest.fixture
def listening() -> Iterator[str]:
    """Return the HOST:PORT of somebody that accepts connections."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"


def fail(error: Exception, said: str = "") -> Callable[[], None]:
    """Return a way to join that fails, and says something first where Ray's compiled part does."""

    def joined() -> None:
        os.write(2, said.encode())
        raise error

    return joined


@pytest.mark.parametrize(
    "address", ["nowhere", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:99999", "http://127.0.0.1:1", "a b:1", "[::1]", ":1"]
)
def test_an_address_of_another_form_is_refused(ray: SimpleNamespace, address: str) -> None:
    """What is none of local, auto, HOST:PORT and ray://HOST:PORT is said to be none."""
    ray.joined = fail(AssertionError("nobody may join"))
    with pytest.raises(EcologyError, match=r"takes local, auto, HOST:PORT or ray://HOST:PORT") as told:
        cluster.by_ray(address)
    assert repr(address) in str(told.value)


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_at_which_nothing_answers_is_told(ray: SimpleNamespace, listening: str, scheme: str) -> None:
    """The port is tried before Ray is, which would wait for many minutes; one that answers is passed on."""
    cluster.by_ray(scheme + listening)
    with socket.create_server(("127.0.0.1", 0)) as server:
        free = f"{scheme}127.0.0.1:{server.getsockname()[1]}"
    ray.joined = fail(AssertionError("nobody may join"))
    with pytest.raises(EcologyError, match="nothing answers there"):
        cluster.by_ray(free)


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        ({}, "RAY_AUTH_MODE is not set to token"),
        ({"RAY_AUTH_TOKEN": "t"}, "RAY_AUTH_MODE is not set to token"),
        ({"RAY_AUTH_MODE": "token"}, "RAY_AUTH_TOKEN is not set"),
        ({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "t"}, "refuses the one in RAY_AUTH_TOKEN"),
    ],
)
@pytest.mark.parametrize("how", ["exception", "stderr"])
def test_a_cluster_that_wants_a_token_says_so(
    ray: SimpleNamespace,
    listening: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: dict[str, str],
    missing: str,
    how: str,
) -> None:
    """The message says which variable is wrong, whether Ray raises that or its compiled part prints it."""
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"):
        monkeypatch.delenv(name, raising=False)
    for name, value in words.items():
        monkeypatch.setenv(name, value)
    ray.joined = fail(AuthenticationError("no token")) if how == "exception" else fail(ConnectionError("no"), REFUSED)
    with pytest.raises(EcologyError, match="wants a token") as told:
        cluster.by_ray(listening)
    assert missing in str(told.value)
    assert "RAY_AUTH_MODE=token and RAY_AUTH_TOKEN=" in str(told.value)
    assert "InvalidAuthToken" not in capfd.readouterr().err
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard"  # file descriptor 2 is what it was


@pytest.mark.parametrize(
    ("address", "advice"), [("HOST:PORT", "Ray 9.9.9 runs there, with Python"), ("auto", "ray start --head")]
)
def test_something_else_that_answers_is_told_apart(
    ray: SimpleNamespace, listening: str, address: str, advice: str
) -> None:
    """Where there is an answer, but no cluster that Ray can join, the message has Ray's own words."""
    ray.joined = fail(ConnectionError("Failed to connect\nand more"))
    with pytest.raises(EcologyError, match=r"Ray cannot join a cluster \(Failed to connect\)") as told:
        cluster.by_ray(listening if address == "HOST:PORT" else address)
    assert advice in str(told.value)


def test_runs_take_what_the_cluster_has(ray: SimpleNamespace, listening: str) -> None:
    """As many runs are under way as fit on the present nodes, each by its scarcest resource, and some wait."""
    ray.alive = [{"CPU": 9.0, "GPU": 1.0, "memory": 8 * GIB}, {"CPU": 9.0, "memory": 99 * GIB}]
    _, count = cluster.by_ray(listening, gpus=0.25, memory=3.0)
    assert ray.asked == [{"num_cpus": 1, "num_gpus": 0.25, "memory": 3 * 2**30, "max_retries": 0}]
    assert count() == 2 + cluster.AHEAD  # by memory; the second node has no GPU
    ray.alive.append({"CPU": 2.0, "GPU": 8.0, "memory": 99 * GIB})
    assert count() == 4 + cluster.AHEAD


def test_what_no_node_has_is_waited_for_or_refused(
    ray: SimpleNamespace, listening: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A cluster may get what a run needs, which is said; this machine alone never will."""
    cluster.by_ray(listening, gpus=1.0)
    assert "no node of the cluster has 1 CPU, 1 GPUs" in caplog.text
    with pytest.raises(EcologyError, match="this machine does not have 1 CPU, 1 GPUs"):
        cluster.by_ray("local", gpus=1.0)


def test_more_runs_start_when_there_is_room_for_more(tmp_path: Path) -> None:
    """A node that joins while a sweep is under way is used: two runs that wait for each other both end."""
    together, room = threading.Barrier(2), [1]

    def attempt(cell: Any, stop: threading.Event) -> tuple[int, str]:
        threading.Timer(0.2, lambda: room.__setitem__(0, 2)).start()
        together.wait(timeout=PATIENCE)
        return 2, "met"

    cells = sweep.cells_of("commons", tmp_path, seeds=[0, 1], settings={})
    ended: list[str] = []
    sweep.live(cells, attempt, lambda: room[0], lambda outcome, _: ended.append(outcome.failed))
    assert ended == ["met", "met"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--gpus-per-run", "1"), "--gpus-per-run requires --ray"),
        (("--memory-per-run", "4"), "--memory-per-run requires --ray"),
        (("--ray", "local", "--device", "cuda:1"), "give --device cuda with it"),
        (("--ray", "local", "--device", "cuda", "--gpus-per-run", "0"), "--gpus-per-run above 0"),
        (("--ray", "local", "--gpus-per-run", "1.5"), "a part of one GPU or a whole number"),
        (("--ray", "local", "--memory-per-run", "inf"), "--memory-per-run is a finite number"),
        (("--device", "gpu"), "got 'gpu'"),
    ],
)
def test_needs_that_contradict_each_other_are_refused(
    ray: SimpleNamespace,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    told: str,
) -> None:
    """Each is one clear error with exit code 2, and leaves nothing."""
    with pytest.raises(SystemExit) as left:
        main(["sweep", "paper", "--out", str(tmp_path / "out"), *words])
    assert left.value.code == 2
    assert told in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_gpu_that_is_elsewhere_is_asked_for(
    ray: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--device cuda works where only the cluster has a GPU: the run is given cuda, and Ray is asked for a GPU."""
    ray.alive = [{"CPU": 1.0, "GPU": 1.0, "memory": 8 * GIB}]
    with pytest.raises(SystemExit) as left:
        main(["sweep", "commons", "--seeds", "3", "--ray", "local", "--device", "cuda", "--out", str(tmp_path / "out")])
    assert left.value.code == 2
    assert "failed: no" in capsys.readouterr().err  # what the stand-in returned
    assert ray.asked[0]["num_gpus"] == 1.0
    assert tomllib.loads((tmp_path / "out/runs/seed=3/config.toml").read_text())["device"] == "cuda"
