"""Robot and obstacles in pinocchio and coal, meshes as they are; shares no code with armcell's checkers."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import trimesh
from lxml import etree
from numpy.typing import NDArray

from benchmarks.planning.problems import Problem, Robot

Array = NDArray[np.float64]


class PinocchioWorld:
    """Collision checks of one robot's joints among a problem's obstacles.

    Pairs: links against each other but those the SRDF disables or that are rigid with each other, and moving
    links against obstacles. Obstacles may touch each other and the robot's base.
    """

    def __init__(self, robot: Robot):
        urdf, folder = str(robot.urdf), str(robot.urdf.parent)
        model = pin.buildModelFromUrdf(urdf)
        geometry = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION, package_dirs=[folder])
        for item in geometry.geometryObjects:
            if item.meshPath and Path(item.meshPath).is_file():
                item.geometry = _mesh(item.meshPath, np.array(item.meshScale))
        geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(model, geometry, str(robot.srdf))
        self.model, self.data, self.q = model, model.createData(), pin.neutral(model)
        for name, value in robot.fixed.items():
            if model.existJointName(name):
                self.q[model.joints[model.getJointId(name)].idx_q] = value
        ids = [model.getJointId(name) for name in robot.joints]
        self.columns = np.array([model.joints[i].idx_q for i in ids])
        # The planned joint that moves each geometry; 0 for those that none of them moves.
        mover = [0] * model.njoints
        for i in range(1, model.njoints):
            mover[i] = i if i in ids else mover[model.parents[i]]
        self._mover = [mover[o.parentJoint] for o in geometry.geometryObjects]
        for pair in list(geometry.collisionPairs):
            if self._mover[pair.first] == self._mover[pair.second]:  # rigid with each other
                geometry.removeCollisionPair(pair)
        self._robot_geometry = geometry

    def set_problem(self, problem: Problem) -> None:
        geometry = self._robot_geometry.copy()
        for i, o in enumerate(problem.obstacles):
            if o["type"] == "box":
                shape = coal.Box(*o["size"])
            else:
                shape = coal.Cylinder(o["radius"], o["length"])
            pose = pin.XYZQUATToSE3(np.array([*o["position"], *o["quat_xyzw"]]))
            added = geometry.addGeometryObject(pin.GeometryObject(f"obstacle {i}", 0, 0, pose, shape))
            for k, mover in enumerate(self._mover):
                if mover:
                    geometry.addCollisionPair(pin.CollisionPair(k, added))
        self.geometry, self.geometry_data = geometry, pin.GeometryData(geometry)
        self._manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self.model, self.geometry, self.geometry_data
        )

    def touches(self, q: Array) -> bool:
        """Whether anything is in contact at the joints (dof,)."""
        self.q[self.columns] = q
        return pin.computeCollisions(self.model, self.data, self._manager, self.q, True)

    def contact(self, q: Array) -> str:
        """The first pair that touches, for people."""
        self.q[self.columns] = q
        pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, self.q, False)
        for pair, result in zip(self.geometry.collisionPairs, self.geometry_data.collisionResults):
            if result.isCollision():
                names = [self.geometry.geometryObjects[i].name for i in (pair.first, pair.second)]
                return " and ".join(names)
        return ""


def _mesh(file: str, scale: Array) -> coal.BVHModelOBBRSS:
    """A file's triangles, read by trimesh.

    pinocchio 4.1.0 reads an OBJ file of several materials wrongly: MBM's panda link6.obj gets 0.367 m^2 of
    surface instead of 0.099, with triangles up to 32 mm off the link.
    """
    mesh = trimesh.load(file, force="mesh", process=False)
    scale = scale * _collada_unit(file)
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    vertices, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in np.asarray(mesh.vertices) * scale:
        vertices.append(vertex)
    for face in mesh.faces:
        triangles.append(coal.Triangle(*(int(i) for i in face)))
    model.addSubModel(vertices, triangles)
    model.endModel()
    return model


def _collada_unit(file: str) -> float:
    """Unit [m] of a COLLADA file's numbers, which RViz applies and pinocchio ignores; 1 for other formats."""
    if Path(file).suffix.lower() != ".dae":
        return 1.0
    unit = etree.parse(file).getroot().find("{*}asset/{*}unit")
    return 1.0 if unit is None else float(unit.get("meter", 1.0))
