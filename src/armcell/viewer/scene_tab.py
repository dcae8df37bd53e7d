"""The "Scene" tab of the planning panel: objects, allowed collisions and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from armcell.core import SE3, InputError, shape_name
from armcell.viewer import scene_edits
from armcell.viewer.planning_session import PlanningSession
from armcell.viewer.widgets import Callbacks, paragraph, without_callbacks

if TYPE_CHECKING:
    from viser import GuiApi

NONE = "-"
NEW_SIZE = (0.1, 0.1, 0.1)  # [m]
NEW_AT = (0.5, 0.0, 0.6)  # [m] in the world


class SceneTab:
    """Widgets of the "Scene" tab, which show and edit the objects in the scene of the session.

    Args:
        folder: folder for saving and loading scene files.
    """

    def __init__(self, gui: GuiApi, session: PlanningSession, callbacks: Callbacks, folder: Path):
        self._gui, self._session, self._on = gui, session, callbacks.wrap
        self._folder, self._ours = folder, set[Path]()
        self._pairs_of = NONE  # body whose collision pairs are shown
        on = callbacks.wrap
        none: list[str] = [NONE]
        self.tree = gui.add_html("")
        with gui.add_folder("Object"):
            self.chosen: Any = gui.add_dropdown("Chosen", none)
            self.chosen.on_update(on(self._choose))
            self.drag = gui.add_checkbox("Drag it", False)
            self.drag.on_update(on(lambda: session.say("")))  # redraws the view
            self.attach = gui.add_button("Attach to the tip")
            self.attach.on_click(on(self._attach))
            self.remove = gui.add_button("Remove")
            self.remove.on_click(on(self._remove))
        with gui.add_folder("Add", expand_by_default=False):
            self.kind = gui.add_dropdown("Shape", tuple(scene_edits.KINDS))
            self.kind.on_update(on(self._name_sizes))
            self.sizes = [
                gui.add_number(f"{i}", v, min=0.001, max=10.0, step=0.001) for i, v in enumerate(NEW_SIZE)
            ]
            self.at = gui.add_vector3("Position [m]", NEW_AT, step=0.01)
            self.name = gui.add_text("Name", "", hint="made from the shape where empty")
            self.add = gui.add_button("Add")
            self.add.on_click(on(self._add))
        with gui.add_folder("May touch", expand_by_default=False):
            self.body: Any = gui.add_dropdown("Body", none)
            self.body.on_update(on(self.refresh))
            self.pairs_folder = gui.add_folder("ignores contact with")
            self.pairs: dict[str, Any] = {}
        with gui.add_folder("File", expand_by_default=False):
            self.file = gui.add_text("Name", "scene.yaml", hint=".yaml, or .scene as MoveIt's")
            self.save = gui.add_button("Save")
            self.save.on_click(on(self._save))
            self.load = gui.add_button("Load")
            self.load.on_click(on(self._load))
        self._name_sizes()
        self.refresh()

    @property
    def dragged(self) -> str | None:
        """Return the name of the world object that the user moves with the drag control of the "Scene" tab,
        or None.
        """
        return (
            self.chosen.value
            if self.drag.value and self.chosen.value in self._session.scene.objects
            else None
        )

    # --- clicks ---
    def _name_sizes(self) -> None:
        names = scene_edits.KINDS[self.kind.value]
        for i, number in enumerate(self.sizes):
            number.visible = i < len(names)
            number.label = f"{names[i]} [m]" if i < len(names) else ""

    def _choose(self) -> None:
        self._session.say("")  # redraws the view with the control at the object
        self.refresh()

    def _add(self) -> None:
        scene = self._session.scene
        kind = self.kind.value
        name = self.name.value.strip() or scene_edits.free_name(scene, kind)
        size = tuple(float(n.value) for n in self.sizes)
        T = SE3.from_xyz(*self.at.value)
        self._session.change_scene(
            lambda now: scene_edits.with_new(now, name, kind, size, T), f"added {name}"
        )
        with without_callbacks():
            self.name.value, self.chosen.value, self.drag.value = "", name, True
        self._choose()

    def _named(self) -> str:
        if self.chosen.value == NONE:
            raise InputError("no object is chosen", hint="choose one, or add one")
        return self.chosen.value

    def _attach(self) -> None:
        name, tip = self._named(), self._session.tip_link
        if name in self._session.scene.attached:
            self._session.change_scene(lambda now: now.with_detached(name), f"detached {name}")
        else:
            self._session.change_scene(
                lambda now: scene_edits.with_attached(now, name, tip), f"attached {name} to {tip}"
            )

    def _remove(self) -> None:
        name = self._named()
        if name in self._session.scene.attached:
            raise InputError(f"{name} is held by the robot", hint="detach it first")
        self._session.change_scene(lambda now: now.without_object(name), f"removed {name}")

    def _save(self) -> None:
        scene = self._session.scene
        self._session.say(scene_edits.save(scene, self.file.value, self._folder, self._ours))

    def _load(self) -> None:
        file = self.file.value
        self._session.change_scene(
            lambda now: scene_edits.with_loaded(now, file, self._folder), f"loaded {file}"
        )

    def _allow(self, body: str, other: str) -> None:
        allow = self.pairs[other].value
        word = "may touch" if allow else "may not touch"
        self._session.change_scene(lambda now: now.with_allowed(body, other, allow), f"{body} {word} {other}")

    # --- showing ---
    def refresh(self) -> None:
        scene = self._session.scene
        with without_callbacks():
            _offer(self.chosen, (*scene.objects, *scene.attached))
            _offer(self.body, tuple(scene_edits.bodies(scene)))
            held = self.chosen.value in scene.attached
            label = "Detach" if held else "Attach to the tip"
            if self.attach.label != label:
                self.attach.label = label
            self._show_tree()
            self._show_pairs()

    def _show_tree(self) -> None:
        scene = self._session.scene
        lines = []
        for name, item in scene.objects.items():
            kinds = ", ".join(shape_name(shape) for shape, _ in item.shapes[:3])
            kinds += ", ..." if len(item.shapes) > 3 else ""
            x, y, z = item.T_world_object.translation
            lines.append(f"{name} ({kinds}) at {x:.2f} {y:.2f} {z:.2f} m")
        lines += [
            f"{name} held by {body.link}"
            + (f", may touch {', '.join(sorted(body.touch_links))}" if body.touch_links else "")
            for name, body in scene.attached.items()
        ]
        content = paragraph("\n".join(lines) or "no objects")
        if self.tree.content != content:
            self.tree.content = content

    def _show_pairs(self) -> None:
        scene, body = self._session.scene, self.body.value
        others = [] if body == NONE else scene_edits.other_bodies(scene, body)
        wanted = [f"{body}\n{other}" for other in others]
        if [f"{self._pairs_of}\n{other}" for other in self.pairs] != wanted:
            for box in self.pairs.values():
                box.remove()
            self.pairs, self._pairs_of = {}, body
            with self.pairs_folder:
                for other in others:
                    box = self._gui.add_checkbox(other, scene.is_allowed(body, other))
                    box.on_update(self._on(lambda a=body, b=other: self._allow(a, b)))
                    self.pairs[other] = box
        for other, box in self.pairs.items():
            box.value = scene.is_allowed(body, other)


def _offer(dropdown: Any, names: tuple[str, ...]) -> None:
    """Set the choices of a dropdown list in the "Scene" tab.
    The current choice is kept if it is still in the list.
    """
    options = (NONE, *names)
    if dropdown.options != options:
        if dropdown.value not in options:
            dropdown.value = NONE
        dropdown.options = options
