"""Who may use a page: attacks with plain clients on every page of armcell, and what an operator does."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from contextlib import ExitStack

import numpy as np
import pytest
import viser.infra._infra as infra
import websockets.asyncio.server
from tests.cell.test_setup import small_arm
from tests.cli.helpers import NOD, cell_file
from tests.programs import Program
from tests.viewer.client import closed, get, login, press, refusal, send, websocket

from armcell.cell import load
from armcell.cell.setup import propose
from armcell.cli.main import main
from armcell.core import SE3, ArmcellError, InputError
from armcell.core.network_endpoints import Endpoint, open_sockets
from armcell.model.setup import UrdfPart
from armcell.records import read_record
from armcell.viewer import CellViewer, PlanningPanel, PlanningSession
from armcell.viewer.page_guard import MAX_CLIENTS, MAX_CONNECTIONS, MAX_MESSAGE, PageGuard
from armcell.viewer.replay import ReplayView
from armcell.viewer.server import start_page
from armcell.viewer.setup_view import SetupView

FOREIGN = "http://evil.example"


@pytest.fixture(scope="module")
def scene():
    return load("panda_table").scene()


@pytest.fixture
def page(scene):
    with CellViewer(scene, port=0) as viewer:
        yield viewer


def until(condition, timeout=120.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.01)


# --- every page ---
def replay_page(scene, tmp_path):
    options = ["--runs", str(tmp_path / "runs"), "--mode", "fake"]
    assert main(["run", str(cell_file(tmp_path, NOD)), *options]) == 0
    (folder,) = (tmp_path / "runs").iterdir()
    return ReplayView(read_record(folder), load(tmp_path).scene(0), port=0)


PAGES = {
    "view": lambda scene, tmp_path: PlanningPanel(PlanningSession(scene), port=0, folder=tmp_path),
    "run --view": lambda scene, tmp_path: CellViewer(scene, port=0),
    "setup --web": lambda scene, tmp_path: SetupView(propose([UrdfPart(small_arm(tmp_path))], 200), port=0),
    "replay": replay_page,
}


@pytest.mark.slow
@pytest.mark.cases("replay", "run --view", "setup --web")
@pytest.mark.parametrize("make", PAGES.values(), ids=PAGES)
def test_no_page_answers_a_stranger(make, scene, tmp_path):
    with make(scene, tmp_path) as page:
        url = page.url
        here = url.partition("?")[0]
        assert get(url, "/").status == 403
        assert refusal(here) == 403, "a websocket without a token was opened"
        assert refusal(here, Origin=FOREIGN) == 403, "a websocket from another origin was opened"
        me = login(url)
        assert get(url, me.path, Cookie=me.cookie).status == 200
        assert refusal(url, me) == 101
        assert refusal(url, me, Origin=FOREIGN) == 403


# --- the checks one by one ---
def test_the_page_opens_with_the_token_and_only_with_it(page, scene):
    me = login(page.url)
    answer = get(page.url, me.path, Cookie=me.cookie)
    assert answer.status == 200 and "<html" in answer.text
    for url in (
        page.url.partition("?")[0],
        page.url[:-1],
        page.url + "x",
        page.url.replace("token=", "token=x&token="),
        page.url.partition("token=")[0] + "token=%ff%fe",
    ):
        answer = get(url)
        assert answer.status == 403 and "token" in answer.text and "printed" in answer.text, url
        assert refusal(url) == 403
    with CellViewer(scene, port=0) as other:  # another session
        foreign = login(other.url)
        token = other.url.partition("?")[2]
        assert get(page.url, f"/?{token}").status == 403
        assert get(page.url, me.path, Cookie=foreign.cookie).status == 403
        assert get(page.url, foreign.path, Cookie=foreign.cookie).status == 403
        assert refusal(page.url.partition("?")[0], me, Cookie=foreign.cookie) == 403
    assert refusal(page.url.partition("?")[0], me, path="/") == 403  # the cookie counts below its path alone
    assert refusal(page.url, me) == 101


def test_a_cookie_stays_below_a_path_that_nobody_knows(page):
    """Browsers send a host's cookies to all of its ports; a server on another port must not collect ours."""
    answer = get(page.url)
    cookie = answer.headers["Set-Cookie"]
    path = login(page.url).path.rstrip("/")
    assert f"Path={path}" in cookie and len(path) > 12
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert page.url.partition("token=")[2] not in cookie


@pytest.mark.slow
@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example", "", "a b"])
def test_dns_rebinding(page, host):
    """A name of the attacker's that points here, asked for by a browser that has even got the cookie."""
    me, name = login(page.url), host.format(port=page.port)
    asked = {"Cookie": me.cookie, "Host": name}
    assert get(page.url, me.path, **asked).status == 403
    assert get(page.url, Host=name).status == 403  # even the token does not help
    if name and " " not in name:
        assert refusal(page.url, me, Host=name, Origin=f"http://{name}") == 403


@pytest.mark.slow
@pytest.mark.parametrize("origin", [FOREIGN, "http://127.0.0.1:1", "http://localhost", "null", "file://", ""])
def test_another_origin(page, origin):
    me = login(page.url)
    assert refusal(page.url, me, Origin=origin) == 403
    assert refusal(page.url, None, Origin=origin) == 403  # with the token in the URL
    assert get(page.url, me.path, Cookie=me.cookie, Origin=origin).status == 403


def test_a_program_without_an_origin_needs_the_token(page):
    assert refusal(page.url.partition("?")[0]) == 403
    assert refusal(page.url) == 101  # programs send no Origin, browsers always do


def test_names_of_this_machine_and_those_that_are_permitted(scene):
    with CellViewer(scene, port=0, names=["cell.example.org"]) as page:
        me = login(page.url)
        forwarded = "localhost:9000"
        for name in ("localhost", "127.0.0.1", f"LOCALHOST:{page.port}", forwarded, "cell.example.org"):
            assert get(page.url, me.path, Cookie=me.cookie, Host=name).status == 200, name
        proxied = {"Host": "cell.example.org", "Origin": "https://cell.example.org"}
        assert refusal(page.url, me, **proxied) == 101
    with pytest.raises(InputError, match="not a host name"):
        start_page("127.0.0.1", 0, "x", ["http://cell"])


def test_every_interface(scene, caplog):
    """The network may come in, with the token; the warning says that the wire can be read."""
    with CellViewer(scene, host="0.0.0.0", port=0) as page:
        assert "plain HTTP" in caplog.text and page.url.partition("token=")[2] not in caplog.text
        assert page.page.endpoints == (Endpoint("tcp", "0.0.0.0", page.port, "page"),)
        at = f"http://127.0.0.2:{page.port}/"  # another address of this machine
        assert get(at).status == 403
        assert login(at + page.url[page.url.index("?") :]).host == f"127.0.0.2:{page.port}"
        assert get(at, Host="evil.example").status == 403
        assert refusal(at, Origin=FOREIGN) == 403


def test_what_the_page_may_do_in_a_browser(page):
    """No frames around it (clickjacking), no websocket elsewhere: there a server could send scripts."""
    me = login(page.url)
    for answer in (get(page.url, me.path, Cookie=me.cookie), get(page.url), get(page.url, "/")):
        policy = answer.headers["Content-Security-Policy"]
        assert "frame-ancestors 'none'" in policy and "connect-src 'self'" in policy
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert answer.headers["X-Frame-Options"] == "DENY"
    led = get(page.url, f"{me.path}?websocket=ws://evil.example", Cookie=me.cookie)
    assert "<html" not in led.text and led.headers["Refresh"] == f"0; url={me.path}"
    assert page.server.request_share_url() is None  # no tunnel to the internet


@pytest.mark.slow
def test_too_many_and_too_large(page):
    me = login(page.url)
    with ExitStack() as stack:
        links = [stack.enter_context(websocket(page.url, me)) for _ in range(MAX_CLIENTS)]
        assert refusal(page.url, me) == 503
        links[0].send(b"\0" * (MAX_MESSAGE + 1))
        assert closed(links[0])
        until(lambda: refusal(page.url, me) == 101, 10)


def test_connections_that_say_nothing_use_up_no_descriptors(page):
    def mine() -> int:
        return len(os.listdir("/proc/self/fd"))

    before = mine()
    with ExitStack() as stack:
        for _ in range(3 * MAX_CONNECTIONS):
            stack.enter_context(socket.create_connection(("127.0.0.1", page.port), timeout=10))
        until(lambda: mine() - before - 3 * MAX_CONNECTIONS <= MAX_CONNECTIONS, 20)  # its ends, without ours

    def answers() -> bool:
        try:
            return get(page.url).status == 200
        except OSError:  # the others have not been seen to go yet
            return False

    until(answers, 20)


def test_what_is_no_request_is_no_traceback(page, caplog):
    """A port scan, TLS, another protocol; and messages of a page that viser does not understand."""
    for data in (b"", b"GARBAGE\r\n\r\n", b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"\x16\x03\x01\0"):
        with socket.create_connection(("127.0.0.1", page.port), timeout=10) as link:
            link.sendall(data)
            link.shutdown(socket.SHUT_WR)
            link.recv(100)
    me = login(page.url)
    for message in (b"\xff\xff", b"\x80", "text"):
        with websocket(page.url, me) as link:
            link.send(message)
            assert closed(link)
    assert not any(record.exc_info for record in caplog.records) and "Traceback" not in caplog.text
    assert "handshake" not in caplog.text and caplog.text.count("connection handler failed") == 3
    assert refusal(page.url, me) == 101


def test_a_page_says_that_it_is_starting(scene):
    with CellViewer(scene, port=0, starting=True) as page:
        answer = get(page.url)
        assert answer.status == 503 and "starting" in answer.text and answer.headers["Refresh"] == "1"
        assert refusal(page.url) == 503
        assert get(page.url, "/").status == 403  # not even that is said to strangers
        page.open()
        assert refusal(page.url) == 101


def test_refusals_are_logged_once_each(page, caplog):
    for _ in range(5):
        refusal(page.url, None, Origin=FOREIGN)
    assert caplog.text.count(FOREIGN) == 1


# --- what is at stake: an arm ---
@pytest.mark.slow
def test_only_the_operator_moves_the_arm(tmp_path):
    cell = load("panda_table")
    session = PlanningSession(
        cell.scene(), lambda scene, observers: cell.connect("fake", observers=observers, scene=scene)
    )
    with PlanningPanel(session, port=0, folder=tmp_path) as panel:
        session.set_goal_pose(SE3.from_xyz_rpy((0.45, -0.2, 0.4), (np.pi, 0.0, 0.0)))
        before = np.array(session.scene.positions)
        me = login(panel.url)
        attacks = [
            {"Origin": FOREIGN}, {"Cookie": "armcell=0"}, {"Host": "evil.example", "Origin": FOREIGN}
        ]  # fmt: skip
        for attack in attacks:
            try:
                with websocket(panel.url, me, **attack) as link:
                    press(link, panel.plan.plan)
                    time.sleep(1.0)
                    press(link, panel.plan.execute)
                    time.sleep(1.0)
            except Exception as error:
                assert "403" in str(error)
            assert session.result is None and np.array_equal(session.scene.positions, before), attack
        with websocket(panel.url, me) as link:
            press(link, panel.plan.plan)
            until(lambda: session.result is not None and not session.busy)
            assert session.result is not None and session.result.ok
            send(link, {"type": "GuiUpdateMessage", "uuid": "nothing", "updates": {"value": 1}})  # no harm
            press(link, panel.plan.execute)
            until(lambda: session.outcome is not None and not session.busy)
        assert session.outcome is not None and session.outcome.ok
        assert np.abs(session.scene.positions - before).max() > 0.1


# --- viser could change ---
def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    """Its server has no check before requests, or it does not go through `websockets`: nothing stays open."""
    real = websockets.asyncio.server.serve

    def other(*arguments, **options):  # as if viser called something else
        return real(*arguments, **options)

    class Elsewhere:
        def __getattr__(self, name):
            return getattr(websockets, name)

        class asyncio:
            class server:
                serve = staticmethod(other)
                ServerConnection = websockets.asyncio.server.ServerConnection

    before = open_sockets()
    monkeypatch.setattr(infra, "websockets", Elsewhere())
    with pytest.raises(ArmcellError, match=r"viser .* armcell does not serve a page that it cannot guard"):
        start_page("127.0.0.1", 0, "x")
    monkeypatch.undo()
    monkeypatch.setattr(
        PageGuard, "wrap_request_handler", lambda self, serve: serve
    )  # the guard is passed by
    with pytest.raises(ArmcellError, match="answers 200 to a request without the token"):
        start_page("127.0.0.1", 0, "x")
    until(lambda: open_sockets() <= before, 10)


def test_other_users_of_websockets_are_left_alone(page):
    """What armcell changes of `websockets` while a page starts is changed back, and was for viser alone."""
    assert websockets.asyncio.server.serve.__module__ == "websockets.asyncio.server"


@pytest.mark.slow
def test_a_page_of_another_process_on_the_same_port_is_another_session(page):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    code = f"""
from armcell.viewer.server import start_page
page = start_page("127.0.0.1", {port}, "x"); page.open(); print(page.url, flush=True); input()
"""
    urls = []
    for _ in range(2):
        process = Program(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        urls.append(process.stdout.readline().strip())
        if len(urls) == 2:
            assert get(urls[0]).status == 403 and get(urls[1]).status == 200
        process.communicate("\n", timeout=20)
