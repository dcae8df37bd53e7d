"""Campaigns on a real Ray: two nodes on this machine; workers, a node and the head killed; same table."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.campaigns.test_campaign import QUICK, VARIED, alive, kill, table, unbroken, workers_of
from tests.cli.helpers import call, cell_file, start

from armcell.campaigns import CampaignSpec, begin, ray_workers, resume, rows_of, run
from armcell.campaigns.store import TRIALS
from armcell.core import InputError
from armcell.core.network_endpoints import open_sockets


def test_without_ray_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setattr(sys, "path", [p for p in sys.path if not (Path(p) / "ray").is_dir()])
    said = call(capsys, "campaign", "panda_pick", "--ray", "auto")
    assert said.status == 1 and "pip install 'armcell[ray]'" in said.err


@pytest.fixture
def ray():
    return pytest.importorskip("ray", reason="Ray is not installed: pip install 'armcell[ray]'")


@pytest.mark.slow
def test_wrong_addresses(ray, monkeypatch):
    for address in ("garbage", "ray://127.0.0.1:10001", "127.0.0.1:", ":6379", "a:b"):
        with pytest.raises(InputError, match="HOST:PORT as `ray start --head` prints it"):
            ray_workers.find_cluster(address)


@pytest.mark.slow
def test_an_address_where_something_else_answers(ray, monkeypatch):
    monkeypatch.setattr(ray_workers, "ANSWER_WITHIN", 5.0)  # it would never answer
    told = "no Ray cluster answers within 5 s.*ray start --head"
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(InputError, match=told):
        ray_workers.find_cluster(f"127.0.0.1:{server.getsockname()[1]}")


def below(pid: int) -> Iterator[int]:
    """All descendants of a process."""
    for child in workers_of(pid):
        yield child
        yield from below(child)


def actors() -> list[int]:
    """Ray's workers below this process that hold an actor of ours."""
    return [pid for pid in below(os.getpid()) if b"ray::_Actor" in words_of(pid)[0]]


def words_of(pid: int) -> list[bytes]:
    """A process's command line."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return [b""]


@pytest.mark.interop
def test_two_nodes_a_worker_is_killed_then_a_node(ray, tmp_path, monkeypatch):
    """No trial is lost, none counted twice, and the table is that of an unbroken campaign without Ray."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    spec = CampaignSpec(str(cell_file(tmp_path, QUICK)), VARIED, trials=60)
    want = unbroken(spec, tmp_path / "unbroken", workers=1)
    node = {"num_cpus": 1, "object_store_memory": 100 << 20, "include_dashboard": False}
    nodes = Cluster(initialize_head=True, head_node_args=node)
    try:
        second = nodes.add_node(**node)
        nodes.wait_for_nodes()
        killed: list[int] = []

        def tell(store, count):
            if count == 10 or (count == 20 and not killed):
                killed.extend(actors()[:1])
                kill(killed[0])
            if count == 35:
                nodes.remove_node(second, allow_graceful=False)

        store = begin(spec, tmp_path / "ray")
        told = run(store, 0, tell, ray=nodes.address)
        store.close()
        assert told == "all 60 trials are done" and len(killed) == 1 and not alive(killed[0])
        assert table(store.folder) == want
        assert not ray.is_initialized()
        monkeypatch.setattr(ray_workers, "version", lambda name: "1.2.3")
        with pytest.raises(
            InputError, match=r"runs Ray 2\..* here it is Ray 1\.2\.3.*pip install ray==1\.2\.3"
        ):
            ray_workers.find_cluster(nodes.address)
    finally:
        nodes.shutdown()


def wait_for_rows(folder: Path, more_than: int) -> Path:
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        for file in folder.glob("*-campaign-*/trials.jsonl"):
            if len(rows_of(file)[0]) > more_than:
                return file.parent
        time.sleep(0.1)
    raise AssertionError("no trial came")


@pytest.mark.interop
def test_ctrl_c_and_a_killed_head_leave_no_ray(ray, tmp_path, monkeypatch):
    """`--resume` goes on after both, with Ray or without."""
    monkeypatch.setenv(
        "TMPDIR", short := f"/tmp/armcell-test-{os.getpid()}"
    )  # Ray's sockets want short names
    Path(short).mkdir()
    cell, options = cell_file(tmp_path, QUICK), ("--workers", 2, "--ray", "auto")
    vary = [w for path, (low, high) in VARIED.items() for w in ("--vary", f"{path}={low},{high}")]
    process = start("campaign", cell, "--trials", 100000, *vary, *options, "--runs", tmp_path / "r")
    folder = wait_for_rows(tmp_path / "r", 0)
    family = list(below(process.pid))
    assert sum(words_of(pid)[0].endswith(b"/raylet") for pid in family) == 1
    theirs = [p for p in family if words_of(p)[0].endswith((b"/raylet", b"/gcs_server"))]
    open_now = open_sockets(theirs)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    lines = [line for line in out.splitlines() if line.startswith("listening on ")]
    told = set(" ".join(lines).removeprefix("listening on ").replace(",", "").split())
    assert len(open_now) >= 3 and {f"[{e.host}]:{e.port}" for e in open_now} <= told, (open_now, out)
    assert process.returncode == 130 and "--resume" in err and "Traceback" not in err, (out, err)
    assert not gone(family) and not list(Path(short).glob("armcell-ray-*"))

    kept = len(rows_of(folder / TRIALS)[0])
    process = start("campaign", "--resume", folder, *options)
    wait_for_rows(tmp_path / "r", kept)
    family = [pid for pid in below(process.pid) if b"agent" not in b" ".join(words_of(pid)[:3]).lower()]
    assert sum(b"ray::_Actor" in words_of(pid)[0] for pid in family) == 2
    kill(process.pid)
    process.communicate(timeout=120)
    assert not gone(family), "something outlived the head"  # Ray's two agents do, for a minute

    total = len(rows_of(folder / TRIALS)[0]) + 10
    store = resume(folder)
    store.spec = CampaignSpec(**{**store.spec.as_dict(), "trials": total})
    run(store, 1)
    store.close()
    assert table(folder)[:total] == unbroken(store.spec, tmp_path / "u", workers=1)
    shutil.rmtree(short)


def gone(family: list[int]) -> list[int]:
    """Those that are left after a while."""
    deadline = time.monotonic() + 60
    while (left := [pid for pid in family if alive(pid)]) and time.monotonic() < deadline:
        time.sleep(0.1)
    return left
