"""`SetupView`: a robot that is being set up, in the browser: its groups, states and pairs of links."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.viewer.geometry import add_link, node_name
from armcell.viewer.server import free_port, start_server, stop_server

SHOWN = 40  # pairs listed, those most often in contact first


class Pair(Protocol):
    link_a: str
    link_b: str
    reason: str
    touching: int
    samples: int

    @property
    def links(self) -> frozenset[str]: ...


class Proposed(Protocol):
    """What is shown: `armcell.cell.setup.Proposal`."""

    @property
    def model(self) -> RobotModel: ...
    @property
    def pairs(self) -> tuple[Any, ...]: ...
    def without(self, pair: frozenset[str]) -> Any: ...
    def disabling(self, pair: frozenset[str]) -> Any: ...


class SetupView:
    """Shows a proposal until its buttons are clicked, inside a `with` block.

    A pair of links is checked or ignored as its box says; a named state is shown when it is chosen.

    Attributes:
        url: where to point a browser.
        done: whether "Write" or "Cancel" was clicked.
        answer: the proposal with the boxes as they are; None after "Cancel".
    """

    def __init__(self, proposal: Any, host: str = "127.0.0.1", port: int = 8080):
        self.answer: Any = proposal
        self.done = False
        self._model: RobotModel = proposal.model
        self._tree = kinematic_tree(self._model)
        self._q = self._model.default_positions()
        self._server = start_server(host, free_port(host, port), self._model.name)
        self.url = f"http://{host}:{self._server.get_port()}"
        try:
            self._draw()
            self._panel(proposal)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> SetupView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        stop_server(self._server)

    def _draw(self) -> None:
        api = self._server.scene
        api.set_up_direction("+z")
        self._frames = {}
        for name, link in self._model.links.items():
            path = node_name("robot", name)
            self._frames[name] = api.add_frame(path, show_axes=False)
            add_link(api, path, link)
        self._place()

    def _place(self) -> None:
        for name, T in zip(self._tree.link_names, self._tree.link_transforms(self._q), strict=True):
            pose = SE3.from_matrix(T)
            self._frames[name].wxyz, self._frames[name].position = pose.quat_wxyz, pose.translation

    def _panel(self, proposal: Proposed) -> None:
        gui, model = self._server.gui, self._model
        gui.set_panel_label(model.name)
        self.write = gui.add_button("Write")
        self.write.on_click(lambda _: self._finish(write=True))
        self.cancel = gui.add_button("Cancel")
        self.cancel.on_click(lambda _: self._finish(write=False))
        self.states = {}
        with gui.add_folder("Groups"):
            for group in model.groups.values():
                names = tuple(model.named_states.get(group.name, {}))
                words = f"{len(group.joint_names)} joints" + (
                    f" to {group.tip_link}" if group.tip_link else ""
                )
                gui.add_text(group.name, words, disabled=True)
                if names:
                    box = gui.add_dropdown(f"{group.name} at", names)
                    box.on_update(lambda _, g=group.name, b=box: self._show_state(g, b.value))
                    self.states[group.name] = box
        self.boxes = {}
        with gui.add_folder("Ignored pairs (in contact, of the samples)", expand_by_default=False):
            for pair in sorted(proposal.pairs, key=lambda p: -p.touching)[:SHOWN]:
                share = 100 * pair.touching / max(pair.samples, 1)
                ignored = pair.links in model.disabled_collisions
                label = (
                    f"{pair.link_a}, {pair.link_b} ({share:.2f} %{', ' + pair.reason if pair.reason else ''})"
                )
                box = gui.add_checkbox(label, ignored)
                box.on_update(lambda _, p=pair.links, b=box: self._decide(p, b.value))
                self.boxes[pair.links] = box

    def _show_state(self, group: str, state: str) -> None:
        target = self._model.named_state(group, state)
        self._q = np.array(self._q)
        self._q[self._model.columns(target.joint_names)] = target.positions
        self._place()

    def _decide(self, pair: frozenset[str], ignored: bool) -> None:
        self.answer = self.answer.disabling(pair) if ignored else self.answer.without(pair)

    def _finish(self, write: bool) -> None:
        if not write:
            self.answer = None
        self.done = True
