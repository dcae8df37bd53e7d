"""`SetupView`: browser page that shows a proposed robot setup with its collision pairs."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.viewer.geometry import add_link, node_name
from armcell.viewer.server import start_page
from armcell.viewer.widgets import paragraph

NONE = "-"


class LinkPair(Protocol):
    link_a: str
    link_b: str
    reason: str
    touching: int
    samples: int

    @property
    def links(self) -> frozenset[str]: ...


class SetupProposal(Protocol):
    """Interface (typing protocol) of a proposed robot setup that the browser page shows.
    `armcell.cell.setup.SetupProposal` implements it.
    """

    @property
    def model(self) -> RobotModel: ...
    @property
    def pairs(self) -> tuple[Any, ...]: ...
    def without(self, pair: frozenset[str]) -> Any: ...
    def disabling(self, pair: frozenset[str]) -> Any: ...


class SetupView:
    """Browser page that shows a proposed robot setup until the user clicks "Write" or "Cancel".

    Use it in a `with` block. Each pair of links has a box that selects whether it is collision-checked or
    ignored. The page shows the boxes of one link at a time, links with the most frequent contacts first.
    Selecting a named state shows it.

    Attributes:
        url: URL that opens the page on this machine, with the page's token.
        done: True after "Write" or "Cancel" was clicked.
        answer: the proposal with the user's selections; None after "Cancel".
    Args:
        names: additional host names under which browsers may request the page.
    """

    def __init__(self, proposal: Any, host: str = "127.0.0.1", port: int = 8080, names: Iterable[str] = ()):
        self.answer: Any = proposal
        self.done = False
        self._deciding = threading.Lock()  # clicks arrive in viser's threads
        self._model: RobotModel = proposal.model
        self._tree = kinematic_tree(self._model)
        self._q = self._model.default_positions()
        self.page = start_page(host, port, self._model.name, names)
        self._server, self.url = self.page.viser, self.page.url
        try:
            self._draw()
            self._panel(proposal)
            self.page.open()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> SetupView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.page.stop()

    def _draw(self) -> None:
        api = self._server.scene
        api.set_up_direction("+z")
        self._frames = {}
        for name, link in self._model.links.items():
            path = node_name("robot", name)
            self._frames[name] = api.add_frame(path, show_axes=False)
            add_link(api, path, link)
        self._place()
        Ts = self._tree.link_transforms(self._q)[:, :3, 3]
        low, high = Ts.min(axis=0), Ts.max(axis=0)
        radius = max(0.3, float(np.linalg.norm(high - low)) / 2)
        camera = self._server.initial_camera
        camera.look_at = (low + high) / 2
        camera.position = (low + high) / 2 + radius * np.array([2.0, 1.45, 1.05])
        camera.fov = float(np.deg2rad(45.0))
        api.add_grid("/floor", 4.0, 4.0, position=(0.0, 0.0, float(min(low[2], 0.0))))

    def _place(self) -> None:
        for name, T in zip(self._tree.link_names, self._tree.link_transforms(self._q), strict=True):
            pose = SE3.from_matrix(T)
            self._frames[name].wxyz, self._frames[name].position = pose.quat_wxyz, pose.translation

    def _panel(self, proposal: SetupProposal) -> None:
        gui, model = self._server.gui, self._model
        gui.set_panel_label(model.name)
        self.write = gui.add_button("Write", color="green")
        self.write.on_click(lambda _: self._finish(write=True))
        self.cancel = gui.add_button("Cancel", color="gray")
        self.cancel.on_click(lambda _: self._finish(write=False))
        self.note = gui.add_html("")
        self.states = {}
        with gui.add_folder("Groups"):
            for group in model.groups.values():
                names = tuple(model.named_states.get(group.name, {}))
                count = len(group.joint_names)
                words = f"{count} joint{'' if count == 1 else 's'}" + (
                    f" to {group.tip_link}" if group.tip_link else ""
                )
                gui.add_text(group.name, words, disabled=True)
                if names:
                    standing = next((n for n in names if self._stands(group.name, n)), NONE)
                    choices = (NONE, *names) if standing == NONE else names
                    box = gui.add_dropdown(f"{group.name} at", choices, initial_value=standing)
                    box.on_update(lambda _, g=group.name, b=box: self._show_state(g, b.value))
                    self.states[group.name] = box
        self.boxes: dict[frozenset[str], Any] = {}
        if proposal.pairs:
            self._pairs = sorted(proposal.pairs, key=lambda p: -p.share)
            with gui.add_folder("Pairs of links"):
                links = tuple(n for n in model.links if any(n in p.links for p in self._pairs))
                self.link: Any = gui.add_dropdown("Link", links)
                self.link.on_update(lambda _: self._show_pairs())
                self._pairs_folder = gui.add_folder("contact is ignored with")
            self._show_pairs()

    def _show_pairs(self) -> None:
        """Show the collision pairs of the selected link on the setup page.

        Each pair of this link and another link has a checkbox that excludes the pair from collision checks.
        The label states in which share of the samples the two links are in contact.
        """
        with self._deciding:
            for box in self.boxes.values():
                box.remove()
            self.boxes = {}
            with self._pairs_folder:
                for pair in self._pairs:
                    if self.link.value not in pair.links:
                        continue
                    (other,) = pair.links - {self.link.value}
                    share = f"{100 * pair.share:.2f} %"
                    words = f"{share} {pair.reason}".strip()
                    ignored = pair.links in self.answer.model.disabled_collisions
                    box = self._server.gui.add_checkbox(
                        f"{other} ({words})", ignored, hint=f"in contact in {share} of the samples"
                    )
                    box.on_update(lambda _, p=pair.links, b=box: self._decide(p, b.value))
                    self.boxes[pair.links] = box

    def _stands(self, group: str, state: str) -> bool:
        """Return whether the robot on the setup page is in a named state of a group,
        with a tolerance of 1e-3.
        """
        target = self._model.named_state(group, state)
        here = self._q[self._model.columns(target.joint_names)]
        return bool(np.allclose(here, target.positions, atol=1e-3))

    def _show_state(self, group: str, state: str) -> None:
        if state == NONE:
            return
        target = self._model.named_state(group, state)
        self._q = np.array(self._q)
        self._q[self._model.columns(target.joint_names)] = target.positions
        self._place()

    def _decide(self, pair: frozenset[str], ignored: bool) -> None:
        with self._deciding:
            if self.answer is not None:
                self.answer = self.answer.disabling(pair) if ignored else self.answer.without(pair)

    def _finish(self, write: bool) -> None:
        with self._deciding:
            if self.done:
                return
            if not write:
                self.answer = None
            what = "the folder is being written: see the terminal" if write else "nothing is written"
            self.note.content = paragraph(f"{what}; this page can be closed")
            self.done = True
