"""A headless Chromium driven by the DevTools protocol: open a page, take screenshots. For tests only."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
import urllib.request
from pathlib import Path

import numpy as np
from PIL import Image
from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
    "--no-proxy-server",
    "--remote-debugging-port=0",
    "--remote-debugging-address=127.0.0.1",
    "--remote-allow-origins=*",
)


def find_chromium() -> str | None:
    """The browser's path, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Chromium:
    """One browser with one page, of `size` (width, height) pixels; ends with its `with` block.

    Args:
        scale: of the pixels drawn for one of the page's; without a GPU a frame takes seconds.
    """

    def __init__(
        self,
        binary: str,
        profile: Path,
        size: tuple[int, int],
        start_timeout: float = 60.0,
        scale: float = 1.0,
    ):
        self._profile = profile
        self._process = subprocess.Popen(
            [
                binary,
                *FLAGS,
                f"--user-data-dir={profile}",
                f"--window-size={size[0]},{size[1]}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._count = 0
        try:
            self._socket = connect(self._page(start_timeout), max_size=64 * 1024 * 1024, open_timeout=30)
            self.call("Page.enable")
            self.call(
                "Emulation.setDeviceMetricsOverride",
                width=size[0], height=size[1], deviceScaleFactor=scale, mobile=False,
            )  # fmt: skip
        except BaseException:
            self.close()
            raise

    def _page(self, timeout: float) -> str:
        """The page's WebSocket address, once the browser is up."""
        file, end = self._profile / "DevToolsActivePort", time.monotonic() + timeout
        while time.monotonic() < end:
            if self._process.poll() is not None:
                raise RuntimeError(f"chromium ended with {self._process.returncode}")
            try:
                port = int(file.read_text().splitlines()[0])
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=5) as answer:
                    pages = [t for t in json.load(answer) if t["type"] == "page"]
                if pages:
                    return pages[0]["webSocketDebuggerUrl"]
            except (OSError, IndexError, ValueError):
                pass
            time.sleep(0.1)
        raise TimeoutError(f"chromium did not open its debugging port within {timeout:g} s")

    def call(self, method: str, timeout: float = 120.0, **params) -> dict:
        """One command of the protocol and its result."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": params}))
        end = time.monotonic() + timeout
        while True:
            answer = json.loads(self._socket.recv(timeout=max(0.0, end - time.monotonic())))
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def open(self, url: str, timeout: float = 60.0) -> None:
        """Go to a page and wait until it is loaded; a screenshot during the change would be refused.

        A URL with a token leads on to a page of the same server without it.
        """
        self.call("Page.navigate", url=url)
        asked = {"expression": "location.href + ' ' + document.readyState", "returnByValue": True}
        end, state = time.monotonic() + timeout, ""
        server, _, token = url.partition("?token=")
        while not (state.startswith(server) and state.endswith(" complete")) or (token and token in state):
            if time.monotonic() > end:
                raise TimeoutError(f"{url} did not load within {timeout:g} s, it is at: {state}")
            time.sleep(0.1)
            state = self.call("Runtime.evaluate", **asked)["result"].get("value", "")

    def screenshot(self) -> np.ndarray:
        """The page as (h, w, 3) uint8."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def close(self) -> None:
        if hasattr(self, "_socket"):
            self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Chromium:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
