"""Workers on a Ray cluster: one actor per core, equivalent to a local worker process.

Ray finds the cores, starts the actors and reports when an actor or its node dies. `Pool` decides which trial
runs where, retries trials and stores results. Ray's own retries are disabled.
"""

from __future__ import annotations

import json
import logging
import os
import platform
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from armcell import _interrupts
from armcell.campaigns.gate import changed_parts
from armcell.campaigns.pool import ONE_THREAD, Answer, Worker, Workers, cores
from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.trial import Trial, run_trial
from armcell.campaigns.worker import cell_of
from armcell.cell import cell_names, content_hashes
from armcell.core import InputError, MissingExtraError
from armcell.core.network_endpoints import Endpoint, descendants, open_sockets
from armcell.planning import warm_up

OURS = "auto"  # the running cluster, else a private cluster for this campaign
ANSWER_WITHIN = 20.0  # [s] timeout for the cluster's answer
STORE_BYTES = 100 << 20  # object store of a private cluster; rows are small and do not use it
_ASK = """
import ctypes, json, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: it ends with its parent
from ray._private.services import canonicalize_bootstrap_address
from ray._raylet import GcsClient
address = sys.argv[1] if sys.argv[1] != "auto" else canonicalize_bootstrap_address(None)
found = address and GcsClient(address=address).internal_kv_get(b"CLUSTER_METADATA", b"cluster")
print(json.dumps([address, json.loads(found or b"{}")]))
"""
"""Query script for a subprocess: for a wrong address, Ray blocks for two minutes and ends the process."""


class _Actor:
    """Ray actor that runs trials on a cluster. It loads the cell only once."""

    def __init__(self, spec: dict[str, Any], hashes: dict[str, str]):
        self._spec, self._hashes = CampaignSpec(**spec), hashes

    def load(self) -> Answer:
        logging.getLogger("armcell").setLevel(logging.ERROR)
        try:
            self._cell = cell_of(self._spec)
        except InputError as error:
            return {"cell": f"{error} (on node {platform.node()})"}
        changed = changed_parts(self._hashes, content_hashes(self._cell))
        if changed:
            return {"cell": f"node {platform.node()} has other versions of: {', '.join(changed)}"}
        warm_up()
        return {"ready": True}

    def run(self, trial: dict[str, Any]) -> Answer:
        return run_trial(self._cell, Trial(**trial))


class RayWorker(Worker):
    """Worker of a campaign on a Ray cluster: the handle of its actor and the call that is pending."""

    def __init__(self, actor: Any):
        super().__init__()
        self.actor = actor
        self.asked: Any = actor.load.remote()  # reference of the pending call, or None
        self.how = "without a word"

    def send(self, data: dict[str, Any]) -> None:
        self.asked = self.actor.run.remote(data)


class RayWorkers(Workers[RayWorker]):
    """Source of `count` campaign workers (actors) on a Ray cluster. A count of 0 means one worker per core.

    Args:
        hashes: content hashes of the local cell; a node with another cell, armcell or library is rejected.
        address: HOST:PORT of a running cluster, or "auto": the cluster that runs on this machine or that
            RAY_ADDRESS names, else a private cluster that ends with the `with` block.
    """

    def __init__(self, spec: CampaignSpec, hashes: Mapping[str, str], count: int, address: str = OURS):
        built_in = spec.cell in cell_names()
        self.spec = spec if built_in else replace(spec, cell=str(Path(spec.cell).absolute()))
        self.hashes, self.size, self.address = dict(hashes), count, address
        self.help = (
            "does `ray status` show free cores; can every node `import armcell` and read the cell file?"
        )
        self._running: list[RayWorker] = []
        self._folder: str | None = None  # folder of a private cluster

    def __enter__(self) -> RayWorkers:
        found = find_cluster(self.address)
        if found is None:
            _make_private()
        import ray
        from ray._private import utils

        utils.set_sigterm_handler = lambda handler: None  # keep the program's handler
        self._ray: Any = ray
        try:
            self._join(found)
        except (Exception, SystemExit) as error:
            self.__exit__()
            said = next(iter(str(error).strip().splitlines()), "")
            if " " not in said:  # a bare key or number needs its error type
                said = repr(error)
            raise InputError(f"Ray {found or 'here'} cannot be used: {said}") from None
        except KeyboardInterrupt:
            self.__exit__()
            raise
        self.size = self.size or max(int(self._ray.cluster_resources().get("CPU", 1.0)), 1)
        return self

    def _join(self, found: str | None) -> None:
        """Connect to the Ray cluster at the address `found`,
        or start a private cluster if the address is None.
        """
        common = {
            "log_to_driver": False, "logging_level": "error", "runtime_env": {"env_vars": dict(ONE_THREAD)},
        }  # fmt: skip
        if found is not None:
            self._ray.init(address=found, **common)
            return
        self._folder = tempfile.mkdtemp(prefix="armcell-ray-")
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage reports
        self._ray.init(
            address="local", num_cpus=self.size or cores(), include_dashboard=False,
            object_store_memory=STORE_BYTES, _temp_dir=self._folder, **common,
        )  # fmt: skip

    def __exit__(self, *exc: object) -> None:
        for worker in list(self._running):
            self.end(worker)
        self._ray.shutdown()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the open sockets of a campaign that runs its trials on Ray: the sockets of this process and,
        for a private Ray cluster, also the sockets of the cluster's processes.
        """
        pids = [os.getpid()] if self._folder is None else descendants(os.getpid())
        return tuple(replace(found, service="Ray") for found in sorted(open_sockets(pids)))

    def start(self) -> RayWorker:
        remote = self._ray.remote(_Actor).options(num_cpus=1, max_restarts=0, max_task_retries=0)
        worker = RayWorker(remote.remote(self.spec.as_dict(), self.hashes))
        self._running.append(worker)
        return worker

    def receive(self, seconds: float) -> Iterator[tuple[RayWorker, list[Answer] | None]]:
        ray = self._ray
        by_question = {worker.asked: worker for worker in self._running if worker.asked is not None}
        if not by_question:
            _interrupts.sleep(0.01)
            return
        done, rest = ray.wait(list(by_question), timeout=seconds)
        if rest:
            done += ray.wait(rest, num_returns=len(rest), timeout=0)[0]
        for question in done:
            worker = by_question[question]
            if worker not in self._running:
                continue
            try:
                answer = ray.get(question)
            except ray.exceptions.RayError as error:  # the actor or its node is gone
                worker.how = _how(str(error))
                yield worker, None
                continue
            worker.asked = None
            yield worker, [answer]

    def end(self, worker: RayWorker) -> str:
        self._running.remove(worker)
        self._ray.kill(worker.actor)
        return worker.how


def _make_private() -> None:
    """Enable token authentication for a private Ray cluster, because Ray listens on all network addresses.

    Ray reads the setting once, when a process imports it for the first time.
    """
    if "ray" not in sys.modules and "RAY_AUTH_MODE" not in os.environ:
        os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=secrets.token_hex(32))


def _version() -> str:
    """Return the version of Ray that is installed for the cluster, without importing Ray.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    try:
        return version("ray")
    except PackageNotFoundError:
        raise MissingExtraError("ray", "ray") from None


def find_cluster(address: str) -> str | None:
    """Return the address of a running, compatible Ray cluster.
    If there is none, return None; a private cluster must then be started.

    None is possible only for the address "auto".

    Raises:
        InputError: the address is wrong, or the cluster runs other versions.
        MissingExtraError: Ray is not installed on this machine.
    """
    ours = _version()
    host, colon, port = address.rpartition(":")
    if address != OURS and not (host and colon and port.isdecimal() and "//" not in host):
        raise InputError(
            f"--ray {address!r} is no address",
            hint="give auto, or HOST:PORT as `ray start --head` prints it (6379), not the client's ray://",
        )
    named = os.environ.get("RAY_ADDRESS")
    if named and address not in (OURS, named):
        raise InputError(f"RAY_ADDRESS is {named}, --ray is {address}", hint="unset RAY_ADDRESS")
    try:
        asked = subprocess.run(
            [sys.executable, "-P", "-c", _ASK, address], capture_output=True, text=True, timeout=ANSWER_WITHIN
        )
        found, about = json.loads(asked.stdout.strip().splitlines()[-1])
    except (subprocess.TimeoutExpired, ValueError, IndexError):
        if address == OURS and not named:
            return None  # stale file of a cluster that has ended
        raise InputError(
            f"--ray {named or address}: no Ray cluster answers within {ANSWER_WITHIN:g} s",
            hint="does it run (`ray start --head` there), is the port right (6379) and open to us?",
        ) from None
    if found is None:
        return None
    here = {"ray_version": ours, "python_version": platform.python_version()}
    there = {key: about.get(key, "unknown") for key in here}
    same_python = there["python_version"].split(".")[:2] == here["python_version"].split(".")[:2]
    if there["ray_version"] != here["ray_version"] or not same_python:
        raise InputError(
            f"the Ray cluster at {found} runs Ray {there['ray_version']} with Python "
            f"{there['python_version']}, here it is Ray {here['ray_version']} with Python "
            f"{here['python_version']}",
            hint=f"take the same here and on all nodes: pip install ray=={here['ray_version']}",
        )
    return found


def _how(text: str) -> str:
    """Extract from Ray's long error text why a worker on the cluster has died."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    for line in lines:
        for cause in ("Worker exit detail: ", "its node has died", "killed by"):
            if cause in line:
                cause_text = line.partition("Worker exit detail: ")[2] or line
                return f"so: {cause_text.partition('. ')[0]}"
    return f"so: {lines[-1] if lines else 'Ray does not say why'}"
