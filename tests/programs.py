"""Starts programs for tests as forks of a process that has imported armcell: saves 2 to 4 CPU-s each.

`Program` and `run` take the arguments of `subprocess.Popen` and `subprocess.run`. They start a new
interpreter where a fork could differ: for interpreter options and for environment variables that imports
read. Tests of imports and of the start itself use `subprocess`.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import os
import pickle
import runpy
import select
import signal
import socket
import subprocess
import sys
import warnings
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
PATHS = {str(ROOT), str(ROOT / "src")}  # what PYTHONPATH may name: nothing that imports differently
LIVE = (
    "PYTHONPATH", "ROS_", "CYCLONEDDS_URI", "PYTEST_", "RAY_", "ARMCELL_GATE_KEY", "ARMCELL_DEBUG",
    "ARMCELL_ALLOW_ENV", "ARMCELL_XACRO_ARGS", "ARMCELL_PACKAGES", "LD_LIBRARY_PATH", "PYOPENGL_PLATFORM",
)  # fmt: skip
"""Environment variables that programs read when they run, not when they import. OpenCV and MuJoCo's renderer
set the last two in the process that imports them.
"""
PRELOADED = (
    "armcell.cli.main", "armcell.cell.live", "armcell.cell.task_run", "armcell.records",
    "armcell.records.plots", "armcell.ros.tcp", "armcell.ros.ros1", "armcell.campaigns", "armcell.viewer",
    "armcell.emulators.ur", "armcell.emulators.franka", "trimesh", "matplotlib.figure",
    "matplotlib.backends.backend_agg", "viser",
)  # fmt: skip
MESSAGE = 1 << 20  # bytes of a request
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_servers: dict[tuple[str | None, ...], _Server] = {}  # by the numbers of threads, which libraries read early


class Program(subprocess.Popen):
    """`subprocess.Popen` that forks Python programs from this process's server of programs."""

    def __init__(self, command, **options):
        self._status: socket.socket | None = None
        self._request = _request([os.fspath(part) for part in command], options)
        super().__init__(command, **options)

    def _execute_child(self, *args, **kwargs):
        if self._request is None:
            return super()._execute_child(*args, **kwargs)
        pipes = args[10:16]  # p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite
        streams = [fd if fd >= 0 else k for k, fd in enumerate((pipes[0], pipes[3], pipes[5]))]
        try:
            self.pid, self._status = self._request.pop("server").start(self._request, streams)
            self._child_created = True
        finally:
            self._close_pipe_fds(*pipes)

    def _try_wait(self, wait_flags):
        if self._status is None:
            return super()._try_wait(wait_flags)
        if wait_flags & os.WNOHANG and not select.select([self._status], [], [], 0)[0]:
            return 0, 0
        said = self._status.recv(16)
        self._status.close()
        return self.pid, int(said or b"9")  # a killed server takes its programs' statuses with it

    def _internal_poll(self, _deadstate=None, **names):
        if self._status is None:
            return super()._internal_poll(_deadstate, **names)
        if self.returncode is None and self._waitpid_lock.acquire(False):
            try:
                if self.returncode is None:
                    pid, status = self._try_wait(os.WNOHANG)
                    if pid:
                        self._handle_exitstatus(status)
            finally:
                self._waitpid_lock.release()
        return self.returncode


def run(command, *, timeout=None, check=False, input=None, capture_output=False, **options):
    """`subprocess.run` with a `Program`."""
    if capture_output:
        options.update(stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if input is not None:
        options["stdin"] = subprocess.PIPE
    with Program(command, **options) as process:
        try:
            out, err = process.communicate(input, timeout)
        except BaseException:
            process.kill()
            raise
    done = subprocess.CompletedProcess(command, process.returncode, out, err)
    if check:
        done.check_returncode()
    return done


def _request(command: list[str], options: dict) -> dict | None:
    """What the server needs to start a program, or None if it has to start from nothing."""
    known = {"stdin", "stdout", "stderr", "text", "encoding", "bufsize", "cwd", "env", "start_new_session"}
    if command[0] != sys.executable or any(value for key, value in options.items() if key not in known):
        return None
    flags = {flag for flag in command[1:3] if flag in ("-u", "-P")}
    rest = command[1 + len(flags) :]
    if rest[0].startswith("-") and rest[0] not in ("-m", "-c"):
        return None
    env = dict(os.environ if options.get("env") is None else options["env"])
    server = _running(env)
    changed = {key for key in env.keys() | server.env.keys() if env.get(key) != server.env.get(key)}
    paths = {os.path.abspath(path) for path in env.get("PYTHONPATH", "").split(os.pathsep) if path}
    if any(not key.startswith(LIVE) for key in changed) or not paths <= PATHS:
        return None
    return {
        "server": server, "rest": rest, "flags": flags, "env": env,
        "cwd": os.path.abspath(options.get("cwd") or "."),
        "session": bool(options.get("start_new_session")), "nice": os.getpriority(os.PRIO_PROCESS, 0),
        "scheduler": (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority),
        "mask": signal.pthread_sigmask(signal.SIG_BLOCK, ()),
    }  # fmt: skip


class _Server:
    """This process's end of the server."""

    def __init__(self, threads: tuple[str | None, ...]) -> None:
        given = dict(zip(THREADS, threads, strict=True))
        self.env = {key: value for key, value in {**os.environ, **given}.items() if value is not None}
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, __file__, str(theirs.fileno())]
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(),), env=self.env
            )
        self.pid, self._process = process.pid, process
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MESSAGE)

    def start(self, request: dict, streams: list[int]) -> tuple[int, socket.socket]:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            socket.send_fds(self._socket, [pickle.dumps(request)], [*streams, theirs.fileno()])
        return int(ours.recv(16)), ours


def _running(env: dict[str, str]) -> _Server:
    threads = tuple(env.get(key) for key in THREADS)
    if threads not in _servers or _servers[threads]._process.poll() is not None:
        _servers[threads] = _Server(threads)
    return _servers[threads]


# ---- the server: no threads, no GL context; what it imports, its programs have imported ----------------


def _serve(link: socket.socket) -> tuple[dict, list[int]]:
    """Fork a program for each request; returns in the program."""
    woken, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    running: dict[int, socket.socket] = {}
    while True:
        ready, _, _ = select.select([link, woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            with contextlib.suppress(ChildProcessError):
                while (ended := os.waitpid(-1, os.WNOHANG))[0]:
                    with running.pop(ended[0]) as status, contextlib.suppress(OSError):
                        status.send(str(ended[1]).encode())
        if link not in ready:
            continue
        data, streams, _, _ = socket.recv_fds(link, MESSAGE, 4)
        if not data:
            os._exit(0)
        status = socket.socket(fileno=streams.pop())
        pid = os.fork()
        if not pid:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            for file in (link, status, *running.values()):
                file.close()
            os.close(woken)
            os.close(wake)
            return pickle.loads(data), streams
        running[pid] = status
        status.send(str(pid).encode())
        for fd in streams:
            os.close(fd)


def _become(request: dict, streams: list[int]) -> None:
    """Run a program in this process, as `python REST` does."""
    kept = {key: os.environ[key] for key in os.environ.keys() - request["before"]}  # that imports have set
    os.environ.clear()
    os.environ.update(kept | request["env"])
    os.chdir(request["cwd"])
    signal.pthread_sigmask(signal.SIG_SETMASK, request["mask"])
    if request["session"]:
        os.setsid()
    if os.sched_getscheduler(0) != request["scheduler"][0]:
        os.sched_setscheduler(0, request["scheduler"][0], os.sched_param(request["scheduler"][1]))
    if os.getpriority(os.PRIO_PROCESS, 0) != request["nice"]:
        os.setpriority(os.PRIO_PROCESS, 0, request["nice"])
    for number, fd in enumerate(streams):
        os.dup2(fd, number)
        os.close(fd)
    if "-u" in request["flags"]:
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(line_buffering=False, write_through=True)
    elif not sys.stdout.write_through:
        sys.stdout.reconfigure(line_buffering=sys.stdout.isatty())
    sys.path[:0] = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    first, *rest = request["rest"]
    if first == "-m":
        if "-P" not in request["flags"]:
            sys.path.insert(0, os.getcwd())
        sys.argv = rest
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
        return
    sys.path.insert(0, "" if first == "-c" else str(Path(first).resolve().parent))
    if first == "-c":
        code, rest = compile(rest[0], "<string>", "exec"), rest[1:]
    else:
        code = compile(Path(first).read_bytes(), first, "exec")
    sys.argv = [first, *rest]
    module = sys.modules["__main__"] = ModuleType("__main__")
    module.__builtins__ = __builtins__
    if first != "-c":
        module.__file__ = first
    exec(code, module.__dict__)


def _silence() -> None:
    """Drop what C++ libraries say at the very end: that the frozen imports are not collected."""
    sys.stderr.flush()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def main() -> None:
    """Be the server whose socket is the given file descriptor, then one of its programs."""
    del sys.path[0]
    before = set(os.environ)
    for name in PRELOADED:
        importlib.import_module(name)
    import armcell

    for mode in ("fake", "sim"):  # loads the kernels
        with armcell.load("panda_pick").connect(mode) as live:
            live.arm.move_to("home")
    gc.collect()
    gc.freeze()
    warnings.filterwarnings("ignore", "This process .* is multi-threaded", DeprecationWarning)  # OpenBLAS's
    request, streams = _serve(socket.socket(fileno=int(sys.argv[1])))
    request["before"] = before
    atexit.register(_silence)
    _become(request, streams)


if __name__ == "__main__":
    main()
