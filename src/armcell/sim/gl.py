"""Offscreen OpenGL rendering of MuJoCo models on machines without a display.

MuJoCo's own renderer fixes its OpenGL backend when `mujoco` is first imported. `GLRenderer` creates the
OpenGL context directly, so no environment variable must be set beforehand. Run as a script, this module tests
one backend and reports the result as its exit status.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

if __name__ == "__main__":  # the test process must end with its parent, even if the parent is killed
    import ctypes
    import signal

    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG

import mujoco
import numpy as np
from numpy.typing import NDArray

_OFF = ("disable", "disabled", "off", "false", "0")
_BACKENDS = ("egl", "osmesa")
Sides = tuple[float, float, float, float]


_DRIVER_VARIABLES = ("CUDA", "DISPLAY", "DRI", "EGL", "GALLIUM", "GL", "LD_", "LIBGL", "MESA", "MUJOCO", "NV")
"""Beginnings of environment variables that select graphics drivers and devices."""


@lru_cache(maxsize=1)
def gl_backend() -> str | None:
    """Return the OpenGL backend ("egl" or "osmesa") that can render offscreen on this machine.
    Return None if there is none.

    The environment variable MUJOCO_GL selects a backend, or disables OpenGL with "off". The test runs in a
    separate process, because a broken driver may end the process. Later processes use the backend that
    passed the test, until the machine restarts, a library is installed, or a graphics device or an
    environment variable of the driver changes.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    if chosen in _OFF or not sys.platform.startswith("linux"):
        return None
    from armcell._array_store import keep, key_of, recall  # the test process needs only mujoco

    key = key_of(*_drivers())
    if (known := recall("gl", key)) is not None and (passed := str(known["backend"])) in _BACKENDS:
        return passed
    for backend in (chosen,) if chosen in _BACKENDS else _BACKENDS:
        environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            done = subprocess.run(
                [sys.executable, __file__, backend],
                env={**environment, "MUJOCO_GL": backend},  # mujoco then imports only this backend
                capture_output=True,
                timeout=30,
                check=False,
            )
            if done.returncode == 0:
                keep("gl", key, backend=np.array(backend))
                return backend
    return None


def _drivers() -> list[str]:
    """Return texts that change when this machine's OpenGL drivers or graphics devices may have changed."""
    texts = [mujoco.__version__, sys.version]
    for name, value in sorted(os.environ.items()):
        if name.lstrip("_").startswith(_DRIVER_VARIABLES):
            texts.append(f"{name}={value}")
    for folder in ("/dev", "/dev/dri"):
        with contextlib.suppress(OSError):
            texts += sorted(name for name in os.listdir(folder) if name.startswith(("card", "render", "nv")))
    for file in ("/etc/ld.so.cache", "/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d"):
        with contextlib.suppress(OSError):
            texts.append(f"{file} {os.stat(file).st_mtime_ns}")
    with contextlib.suppress(OSError), open("/proc/sys/kernel/random/boot_id", encoding="ascii") as boot:
        texts.append(boot.read())
    return texts


class GLRenderer:
    """Offscreen OpenGL renderer for one MuJoCo model, with a fixed image size (height, width, 3).

    Shadows and reflections are off: without a graphics card they take ten times as long as the rest.

    Args:
        smooth: antialias edges with four samples per pixel. Use False for depth: an antialiased depth value
            comes from one of the four samples, a quarter of a pixel away from the pixel center.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, backend: str, smooth: bool = True):
        self.size = (width, height)
        self._open = False
        self._model = model
        self._backend: Any = importlib.import_module(f"mujoco.{backend}")
        self._gl = self._backend.GLContext(width, height)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.offsamples = 4 if smooth else 0
        with self._current():
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
            self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # better resolution far away
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(model, 2000)
        self._option = mujoco.MjvOption()
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._open = True

    def render(self, data: mujoco.MjData, camera: int, sides: Sides | None = None) -> NDArray[np.uint8]:
        """Render an RGB image (height, width, 3) with one of the MuJoCo model's cameras in OpenGL.

        Args:
            camera: id of the camera in the model.
            sides: tangents of the angles to the left, right, bottom and top edge of the image, for a camera
                whose field of view differs from the model's.
        """
        width, height = self.size
        picture = np.empty((height, width, 3), dtype=np.uint8)
        with self._current():
            self._draw(data, camera, sides)
            mujoco.mjr_readPixels(picture, None, mujoco.MjrRect(0, 0, width, height), self._context)
        return np.ascontiguousarray(picture[::-1])  # OpenGL counts rows from below

    def depth(self, data: mujoco.MjData, camera: int, sides: Sides | None = None) -> NDArray[np.float32]:
        """Render a depth image (height, width) [m] with OpenGL.
        Depth is measured along the camera's optical axis.

        Pixels beyond the far plane are 0.
        """
        width, height = self.size
        buffer = np.empty((height, width), dtype=np.float32)
        with self._current():
            self._draw(data, camera, sides)
            mujoco.mjr_readPixels(None, buffer, mujoco.MjrRect(0, 0, width, height), self._context)
        return np.ascontiguousarray(self._meters(buffer)[::-1])

    @contextlib.contextmanager
    def _current(self) -> Iterator[None]:
        """Make the OpenGL context current while it is used. Between two uses no thread holds it, so arms that
        work side by side, each in its own thread, can use the same camera.
        """
        if egl := getattr(self._backend, "EGL", None):
            egl.eglBindAPI(egl.EGL_OPENGL_API)  # a setting of each thread
        with self._gl.as_current():
            yield

    def _draw(self, data: mujoco.MjData, camera: int, sides: Sides | None) -> None:
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, view, every, self._scene)
        if sides is not None:
            for eye in self._scene.camera:
                left, right, bottom, top = (tangent * eye.frustum_near for tangent in sides)
                eye.frustum_center, eye.frustum_width = (left + right) / 2, (right - left) / 2
                eye.frustum_bottom, eye.frustum_top = bottom, top
        mujoco.mjr_render(mujoco.MjrRect(0, 0, *self.size), self._scene, self._context)

    def _meters(self, buffer: NDArray[np.float32]) -> NDArray[np.float32]:
        """Convert the values of OpenGL's depth buffer (1 at the near plane and 0 at the far plane)
        to meters.
        """
        extent, clip = self._model.stat.extent, self._model.vis.map
        near, far = clip.znear * extent, clip.zfar * extent
        b = buffer.astype(np.float64)
        return np.where(b > 0, near * far / (near + b * (far - near)), 0.0).astype(np.float32)

    def close(self) -> None:
        """Free the offscreen renderer's OpenGL context and buffers.

        The renderer makes its context current first: buffer ids are numbers, so freeing them in another
        context would free the buffers of another renderer.
        """
        if self._open:
            self._open = False
            with self._current():
                self._context.free()
            self._gl.free()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # at interpreter shutdown, modules may already be gone
            self.close()


def _probe(backend: str) -> bool:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><light pos='0 0 3'/><camera pos='0 0 3'/><geom size='1'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return bool(GLRenderer(model, 16, 16, backend).render(data, 0).any())


if __name__ == "__main__":
    sys.exit(0 if _probe(sys.argv[1]) else 1)
