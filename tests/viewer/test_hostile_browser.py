"""A hostile page in the operator's own browser, on another port of this machine: it gets nothing."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import viser
from tests.viewer.chromium import Chromium, find_chromium
from tests.viewer.test_planning_browser import evaluated, press, says, until

from armcell.cell import load
from armcell.core import SE3
from armcell.viewer import PlanningPanel, PlanningSession

pytestmark = [
    pytest.mark.interop,
    pytest.mark.skipif(
        find_chromium() is None,
        reason="no chromium or chrome in PATH to attack the page with (Debian: apt install chromium)",
    ),
]

HOSTILE = """<html><body>hostile<script>
const found = {}, target = "%(host)s", version = "%(version)s";
function knock(name, url) {
  return new Promise(done => {
    let socket;
    try { socket = new WebSocket(url, [version]); } catch (e) { found[name] = "refused"; return done(); }
    socket.onopen = () => { found[name] = "OPEN"; done(); };
    socket.onerror = () => { found[name] = found[name] || "refused"; done(); };
  });
}
async function read(name, url) {
  try {
    const answer = await fetch(url, {credentials: "include"});
    found[name] = "READ " + (await answer.text()).slice(0, 80);
  } catch (e) { found[name] = "refused"; }
}
function frame(name, url) {
  return new Promise(done => {
    const inside = document.createElement("iframe");
    inside.onload = () => {
      // A page that may not be framed is replaced by an error page, to which nobody has access.
      found[name] = inside.contentWindow.length === undefined ? "?" : "loaded"; done();
    };
    inside.src = url;
    document.body.append(inside);
  });
}
(async () => {
  await knock("websocket", `ws://${target}/`);
  await knock("websocket at the page's path", `ws://${target}%(path)s`);
  await knock("websocket by another name", `ws://localhost:${target.split(":")[1]}%(path)s`);
  await knock("websocket, guessed token", `ws://${target}/?token=${"A".repeat(43)}`);
  await read("read the page", `http://${target}%(path)s/`);
  await read("read the root", `http://${target}/`);
  await frame("frame", `http://${target}%(path)s/`);
  await fetch("/report", {method: "POST", body: JSON.stringify(found)});
  document.title = "done";
})();
</script></body></html>"""


class Hostile(ThreadingHTTPServer):
    """Serves a page on another port; keeps what it reports and all cookies that reach it."""

    def __init__(self, host: str = "127.0.0.1"):
        self.page, self.report, self.cookies = "", {}, []
        super().__init__((host, 0), _Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/"


class _Handler(BaseHTTPRequestHandler):
    server: Hostile

    def do_GET(self) -> None:
        self.server.cookies += self.headers.get_all("Cookie") or []
        body = self.server.page.encode()
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def do_POST(self) -> None:
        self.server.report = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *arguments) -> None:
        pass


def press_until(browser, label, condition):
    """Press a button, again where the page moved it away under the click: it was loaded a moment ago."""
    for _ in range(12):
        press(browser, label)
        end = time.monotonic() + 20
        while time.monotonic() < end:
            if condition():
                return
            time.sleep(0.1)
    raise AssertionError(f"{label!r} had no effect")


def test_a_hostile_page_beside_the_operators(tmp_path):
    cell = load("panda_table")
    session = PlanningSession(
        cell.scene(), lambda scene, observers: cell.connect("fake", observers=observers, scene=scene)
    )
    hostile = Hostile()
    with (
        PlanningPanel(session, port=0, title=cell.name, folder=tmp_path) as panel,
        Chromium(find_chromium(), tmp_path / "profile", (1280, 800), scale=0.4) as browser,
    ):
        panel.viewer.server.scene.configure_default_lights(cast_shadow=False)  # the dearest part of a frame
        browser.open(panel.url)  # the operator's browser has the cookie from here on
        until(browser, says("Goal free"))
        here = evaluated(browser, "location.href")
        assert "token" not in here and "websocket=" not in here  # nothing secret where others may look
        path = evaluated(browser, "location.pathname").rstrip("/")

        # The worst case: it even knows the page's path, which it cannot find out.
        hostile.page = HOSTILE % {
            "host": f"127.0.0.1:{panel.viewer.port}", "path": path, "version": f"viser-v{viser.__version__}"
        }  # fmt: skip
        before = np.array(session.scene.positions)
        browser.open(hostile.url)
        until(browser, "document.title === 'done'")
        frames = browser.call("Page.getFrameTree")["frameTree"].get("childFrames", [])
        found = hostile.report
        assert {found[name] for name in found if "websocket" in name} == {"refused"}, found
        assert len([name for name in found if "websocket" in name]) == 4
        assert found["read the page"] == found["read the root"] == "refused"
        assert [f["frame"]["url"] for f in frames] == ["chrome-error://chromewebdata/"], frames
        assert hostile.cookies == [], "a cookie of the page reached another port"
        assert session.result is None and np.array_equal(session.scene.positions, before)

        # And a link there, with a query that would have the page talk to another server.
        browser.call(
            "Page.navigate", url=f"http://127.0.0.1:{panel.viewer.port}{path}/?websocket=ws://127.0.0.1:1"
        )
        until(browser, says("Goal free"))  # it talks to its own server alone

        session.set_goal_pose(SE3.from_xyz_rpy((0.45, -0.2, 0.4), (np.pi, 0.0, 0.0)))
        press_until(browser, "Plan", lambda: session.result is not None and not session.busy)
        press_until(browser, "Execute", lambda: session.outcome is not None and not session.busy)
        assert session.outcome is not None and session.outcome.ok
        assert np.abs(session.scene.positions - before).max() > 0.1
    hostile.shutdown()
    time.sleep(0.1)
    hostile.server_close()
