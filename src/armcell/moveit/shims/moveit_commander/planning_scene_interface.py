"""Shim of moveit_commander.PlanningSceneInterface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armcell.core import SE3, InputError
from armcell.model.urdf import load_mesh
from armcell.moveit.session import current_session
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.ros.bus import ServiceError
from armcell.ros.moveit_convert import Components
from armcell.ros.moveit_convert.objects import REMOVE, ShapeMessages, primitive_type

GEOMETRY = Components.WORLD_OBJECT_NAMES | Components.WORLD_OBJECT_GEOMETRY
ATTACHED = Components.ROBOT_STATE_ATTACHED_OBJECTS


class PlanningSceneInterface:
    """Interface for changing and querying the planning scene, like moveit_commander.PlanningSceneInterface.

    Every change is complete when its call returns, so scripts need not wait. With `synchronous=False`,
    changes are published on topics, as in MoveIt.
    """

    def __init__(self, ns: str = "", synchronous: bool = True, service_timeout: float = 5.0):
        self._session = current_session()
        self._ns, self._synchronous = ns.strip("/"), synchronous
        if not synchronous:
            bus = self._session.bus
            self._objects = bus.advertise(self._name("collision_object"), "moveit_msgs/CollisionObject")
            self._attached = bus.advertise(
                self._name("attached_collision_object"), "moveit_msgs/AttachedCollisionObject"
            )

    def _name(self, name: str) -> str:
        return f"/{self._ns}/{name}" if self._ns else f"/{name}"

    def _new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        return self._session.new(name, *values, **fields)

    def _submit(self, message: Any, attach: bool = False) -> None:
        if not self._synchronous:
            (self._attached if attach else self._objects).publish(self._session.messages.local(message))
            return
        scene = self._new("moveit_msgs/PlanningScene", is_diff=True)
        scene.robot_state.is_diff = True
        if attach:
            scene.robot_state.attached_collision_objects = [message]
        else:
            scene.world.collision_objects = [message]
        if not self.apply_planning_scene(scene):
            what = message.object.id if attach else message.id
            self._session.say(
                "WARN", f"the planning scene did not take {what!r}; the reason is in the line above"
            )

    # --- adding ---
    def add_object(self, collision_object: Any) -> None:
        self._submit(collision_object)

    def add_sphere(self, name: str, pose: Any, radius: float = 1) -> None:
        self._submit(self.make_sphere(name, pose, radius))

    def add_cylinder(self, name: str, pose: Any, height: float, radius: float) -> None:
        self._submit(self.make_cylinder(name, pose, height, radius))

    def add_cone(self, name: str, pose: Any, height: float, radius: float) -> None:
        self._submit(self.make_cone(name, pose, height, radius))

    def add_mesh(self, name: str, pose: Any, filename: str, size: Any = (1, 1, 1)) -> None:
        self._submit(self.make_mesh(name, pose, filename, size))

    def add_box(self, name: str, pose: Any, size: Any = (1, 1, 1)) -> None:
        self._submit(self.make_box(name, pose, size))

    def add_plane(self, name: str, pose: Any, normal: Any = (0, 0, 1), offset: float = 0) -> None:
        self._submit(self.make_plane(name, pose, normal, offset))

    # --- attaching ---
    def attach_object(self, object: Any, link: str | None = None, touch_links: Any = None) -> None:
        """Attach an object to a link of the robot, like PlanningSceneInterface.attach_object.

        Args:
            object: an AttachedCollisionObject, a CollisionObject, or the name of an object in the world.
            link: name of the link; None uses the link in the message.
            touch_links: links that may touch the object; None allows only the link itself.
        """
        if isinstance(object, str):
            object = self._new("moveit_msgs/CollisionObject", id=object)
        if object._type == "moveit_msgs/CollisionObject":
            object = self._new("moveit_msgs/AttachedCollisionObject", object=object)
        if link is not None:
            object.link_name = link
        object.touch_links = [object.link_name] if touch_links is None else list(touch_links)
        self._submit(object, attach=True)

    def attach_mesh(
        self, link: str, name: str, pose: Any = None, filename: str = "", size: Any = (1, 1, 1),
        touch_links: Any = None,
    ) -> None:  # fmt: skip
        new = pose is not None and filename
        self.attach_object(self.make_mesh(name, pose, filename, size) if new else name, link, touch_links)

    def attach_box(
        self, link: str, name: str, pose: Any = None, size: Any = (1, 1, 1), touch_links: Any = None
    ) -> None:
        self.attach_object(name if pose is None else self.make_box(name, pose, size), link, touch_links)

    def attach_sphere(
        self, link: str, name: str, pose: Any = None, radius: float = 1, touch_links: Any = None
    ) -> None:
        self.attach_object(name if pose is None else self.make_sphere(name, pose, radius), link, touch_links)

    def attach_cylinder(
        self, link: str, name: str, pose: Any = None, height: float = 1, radius: float = 1,
        touch_links: Any = None,
    ) -> None:  # fmt: skip
        item = name if pose is None else self.make_cylinder(name, pose, height, radius)
        self.attach_object(item, link, touch_links)

    # --- removing ---
    def clear(self) -> None:
        self.remove_attached_object()
        self.remove_world_object()

    def remove_world_object(self, name: str | None = None) -> None:
        self._submit(self._new("moveit_msgs/CollisionObject", id=name or "", operation=REMOVE))

    def remove_attached_object(self, link: str | None = None, name: str | None = None) -> None:
        """Detach an object from the robot and leave the object in the world, as MoveIt's
        PlanningSceneInterface does.
        """
        item = self._new("moveit_msgs/CollisionObject", id=name or "", operation=REMOVE)
        message = self._new("moveit_msgs/AttachedCollisionObject", link_name=link or "", object=item)
        self._submit(message, attach=True)

    # --- queries ---
    def get_known_object_names(self, with_type: bool = False) -> list[str]:
        return [o.id for o in self._world() if not with_type or o.type.key]

    def get_known_object_names_in_roi(
        self,
        minx: float,
        miny: float,
        minz: float,
        maxx: float,
        maxy: float,
        maxz: float,
        with_type: bool = False,
    ) -> list[str]:
        """Return the names of the objects whose origin is inside a given box in the planning frame,
        like PlanningSceneInterface.
        """
        low, high = (minx, miny, minz), (maxx, maxy, maxz)
        found = []
        for item in self._world():
            p = item.pose.position
            inside = all(a <= v <= b for a, v, b in zip(low, (p.x, p.y, p.z), high))
            if inside and (not with_type or item.type.key):
                found.append(item.id)
        return found

    def get_object_poses(self, object_ids: Any) -> dict[str, Any]:
        return {o.id: o.pose for o in self._world() if o.id in list(object_ids)}

    def get_objects(self, object_ids: Any = ()) -> dict[str, Any]:
        return {o.id: o for o in self._world() if not object_ids or o.id in list(object_ids)}

    def get_attached_objects(self, object_ids: Any = ()) -> dict[str, Any]:
        bodies = self.get_planning_scene(int(ATTACHED)).robot_state.attached_collision_objects
        return {b.object.id: b for b in bodies if not object_ids or b.object.id in list(object_ids)}

    def _world(self) -> list[Any]:
        return self.get_planning_scene(int(GEOMETRY)).world.collision_objects

    def get_planning_scene(self, components: Any) -> Any:
        """Return a PlanningScene message that contains the requested components, as MoveIt's
        PlanningSceneInterface does.

        Args:
            components: a bit mask, or a PlanningSceneComponents message.
        """
        wanted = self._new(
            "moveit_msgs/PlanningSceneComponents", int(getattr(components, "components", components))
        )
        request = self._new("moveit_msgs/GetPlanningSceneRequest", wanted)
        try:
            return self._session.call(self._name("get_planning_scene"), request).scene
        except ServiceError as error:
            raise MoveItCommanderException(str(error)) from None

    def apply_planning_scene(self, planning_scene_message: Any) -> bool:
        request = self._new("moveit_msgs/ApplyPlanningSceneRequest", planning_scene_message)
        try:
            return bool(self._session.call(self._name("apply_planning_scene"), request).success)
        except ServiceError as error:
            raise MoveItCommanderException(str(error)) from None

    # --- creation of messages ---
    @staticmethod
    def make_box(name: str, pose: Any, size: Any) -> Any:
        return _solid(name, pose, "box", size)

    @staticmethod
    def make_sphere(name: str, pose: Any, radius: float) -> Any:
        return _solid(name, pose, "sphere", [radius])

    @staticmethod
    def make_cylinder(name: str, pose: Any, height: float, radius: float) -> Any:
        return _solid(name, pose, "cylinder", [height, radius])

    @staticmethod
    def make_cone(name: str, pose: Any, height: float, radius: float) -> Any:
        return _solid(name, pose, "cone", [height, radius])

    @staticmethod
    def make_plane(name: str, pose: Any, normal: Any = (0, 0, 1), offset: float = 0) -> Any:
        session = current_session()
        plane = session.new("shape_msgs/Plane", [*map(float, normal), float(offset)])
        return session.new(
            "moveit_msgs/CollisionObject", header=pose.header, id=name,
            planes=[plane], plane_poses=[pose.pose],
        )  # fmt: skip

    @staticmethod
    def make_mesh(name: str, pose: Any, filename: str, scale: Any = (1, 1, 1)) -> Any:
        """Load a mesh file (STL, DAE, ...), scale the mesh, and return it as a CollisionObject, as MoveIt's
        PlanningSceneInterface does.
        """
        session = current_session()
        try:
            mesh = load_mesh(Path(filename.removeprefix("file://")), tuple(float(s) for s in scale))
        except InputError as error:
            raise MoveItCommanderException(str(error)) from None
        lists = ShapeMessages(session.bus.schema)
        lists.add(mesh, SE3.identity())
        return session.new(
            "moveit_msgs/CollisionObject", header=pose.header, pose=pose.pose, id=name,
            meshes=[session.messages.local(m) for m, _ in lists.meshes],
            mesh_poses=[session.new("geometry_msgs/Pose", orientation=_upright())],
        )  # fmt: skip


def _upright() -> Any:
    return current_session().new("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)


def _solid(name: str, pose: Any, shape: str, dimensions: Any) -> Any:
    session = current_session()
    sizes = [float(v) for v in dimensions]
    primitive = session.new("shape_msgs/SolidPrimitive", type=primitive_type(shape), dimensions=sizes)
    return session.new(
        "moveit_msgs/CollisionObject", header=pose.header, pose=pose.pose, id=name, primitives=[primitive],
        primitive_poses=[session.new("geometry_msgs/Pose", orientation=_upright())],
    )  # fmt: skip
