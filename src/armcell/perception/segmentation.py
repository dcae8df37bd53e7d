"""Segmentation of depth images for object detection: clusters of pixels above the support plane.

The points of the robot, of fixed objects and of the support plane are removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armcell.collision import object_mask, robot_mask
from armcell.core import CameraImage, InputError, Plane
from armcell.core.checks import checked
from armcell.core.geometry import local_bounds
from armcell.perception.cloud import SupportPlane, clusters, find_plane, organized_cloud
from armcell.perception.depth_render import FREE, OTHER
from armcell.scene import CollisionObject, PlanningScene

F64 = NDArray[np.float64]


@dataclass(frozen=True)
@checked()
class LookSettings:
    """Settings for the segmentation of camera images and the detection of objects by `look`; lengths in
    meters.
    """

    surface: str | None = None  # fixed support object; None: the largest level plane
    max_tilt_deg: float = 15.0  # of the plane
    thickness: float = 0.006  # of the noisy plane
    least_height: float = 0.008  # lower points belong to the plane
    most_height: float = 0.5  # higher points are ignored
    gap: float = 0.015  # maximum distance between points of one object
    smallest: int = 40  # [px] smaller clusters are noise
    robot_padding: float = 0.02  # margin around the robot
    fixed_padding: float = 0.006  # margin around removed fixed objects of the scene
    most_cost: float = 0.35  # maximum cost of a valid fit (0 perfect, 1 worst)
    ring: int = 5  # [px] width of the ring around a cluster whose free rays count
    max_age: float = 0.5  # [s] older images are stale
    seed: int = 0  # random seed of the plane fit

    def __post_init__(self) -> None:
        for name in ("thickness", "least_height", "most_height", "gap", "max_age"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be positive")
        if self.smallest < 10:
            raise InputError(f"smallest is {self.smallest} px", hint="10 or more: fewer cannot be fitted")


Pixels = tuple[NDArray[np.int64], ...]
"""Pixel indices of one cluster, in each image."""


@dataclass(frozen=True, eq=False)
class View:
    """Image of one camera for the segmentation: its points in the world, with masks of the points that `look`
    uses.
    """

    image: CameraImage
    flat: F64  # (h * w, 3) [m, world]; NaN without depth
    valid: NDArray[np.bool_]  # (h * w,)
    others: NDArray[np.bool_]  # not on the robot or a fixed object
    region: NDArray[np.bool_]  # above the support surface

    @staticmethod
    def of(image: CameraImage, scene: PlanningScene | None, settings: LookSettings) -> View:
        assert image.depth is not None
        T = image.T_world_camera
        seen = organized_cloud(image.depth, image.pinhole)
        flat = seen.reshape(-1, 3) @ T.rotation.matrix.T + T.translation
        valid = np.isfinite(flat[:, 0])
        return View(image, flat, valid, *_without(flat, valid, scene, settings))

    @property
    def size(self) -> tuple[int, int]:
        return self.image.pinhole.height, self.image.pinhole.width

    def things(self, plane: SupportPlane, settings: LookSettings) -> NDArray[np.bool_]:
        """Return the segmentation mask (h * w,) of the points above the support plane."""
        height = np.where(self.valid, plane.heights(np.where(self.valid[:, None], self.flat, 0.0)), 0.0)
        least = max(settings.least_height, 3 * plane.rms)
        return self.others & self.region & (height > least) & (height < settings.most_height)

    def kinds(self, plane: SupportPlane, settings: LookSettings) -> NDArray[np.uint8]:
        """Classify each pixel (h * w,) after the segmentation: background, or a body that may hide an object.
        The pixels of the object's own cluster are not marked yet.
        """
        hides = self.valid & (~self.others | self.things(plane, settings))
        return np.where(hides, OTHER, FREE).astype(np.uint8)


def view_clusters(views: list[View], plane: SupportPlane, settings: LookSettings) -> list[Pixels]:
    """Segment the camera points above the support plane into clusters. Clusters of different cameras are
    merged if their points are close to each other.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    each = []
    for k, view in enumerate(views):
        wanted = view.things(plane, settings).reshape(view.size)
        points = view.flat.reshape(*view.size, 3)
        each += [(k, pixels) for pixels in clusters(points, wanted, settings.gap, settings.smallest)]
    near = np.zeros((len(each), len(each)), bool)
    if len(views) > 1:
        trees = [KDTree(views[k].flat[pixels]) for k, pixels in each]
        for a, b in combinations(range(len(each)), 2):
            if each[a][0] != each[b][0]:
                far, _ = trees[a].query(trees[b].data, distance_upper_bound=settings.gap)
                near[a, b] = np.isfinite(far).any()
    count, label = connected_components(coo_array(near), directed=False)
    found = []
    for n in range(count):
        members = [each[i] for i in np.flatnonzero(label == n)]
        found.append(tuple(
            np.concatenate([np.zeros(0, np.int64), *(pixels for k, pixels in members if k == view)])
            for view in range(len(views))
        ))  # fmt: skip
    return sorted(found, key=lambda pixels: -sum(len(p) for p in pixels))


def _without(
    flat: F64, valid: NDArray[np.bool_], scene: PlanningScene | None, settings: LookSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks for the segmentation of camera points: points that are not on the robot or a fixed
    object, and points that are above the support surface.
    """
    others, region = valid.copy(), np.ones(len(flat), bool)
    if scene is None:
        if settings.surface is not None:
            raise InputError(f"surface is {settings.surface!r}, but there is no scene to have it")
        return others, region
    index = np.flatnonzero(valid)
    others[index] = ~robot_mask(scene, flat[index], settings.robot_padding)
    surface = settings.surface
    if surface is not None:
        region = _above(scene.object(surface), flat, valid)
    fixed = [
        n for n, o in scene.objects.items() if not o.movable and n != surface and not o.has_cloud
        and not (surface is None and _is_level(o))
    ]  # fmt: skip
    if fixed:
        index = np.flatnonzero(others)
        others[index] = ~object_mask(scene, flat[index], settings.fixed_padding, fixed)
    return others, region


def _above(item: CollisionObject, flat: F64, valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the segmentation mask of the camera points at or above the top of a support, where `look`
    searches for objects.
    """
    low, high = item.bounds()
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    top = float(item.T_world_object.apply(corners)[:, 2].max())
    found = np.zeros(len(flat), bool)
    index = np.flatnonzero(valid)
    local = item.T_world_object.inverse().apply(np.column_stack([flat[index, :2], np.full(len(index), top)]))
    margin = 0.003  # [m] outermost points mix edge and floor
    inside = np.all((local[:, :2] > low[:2] + margin) & (local[:, :2] < high[:2] - margin), axis=1)
    found[index] = inside & (flat[index, 2] > top - 0.03)
    return found


def _is_level(item: CollisionObject) -> bool:
    """Return whether a fixed object is so flat and wide that the segmentation keeps its points, because other
    objects may rest on it.
    """
    if any(isinstance(shape, Plane) for shape, _ in item.shapes):
        return True
    sizes = [2 * local_bounds(shape)[1] for shape, _ in item.shapes]
    return len(sizes) == 1 and sizes[0][2] < 0.3 * min(sizes[0][0], sizes[0][1])


def support_plane(points: F64, settings: LookSettings) -> SupportPlane | None:
    """Return the support plane above which the segmentation searches for objects, fitted to points (n, 3) [m,
    world], or None if fewer than 100 points are on it.
    """
    plane = find_plane(
        points,
        np.array([0.0, 0.0, 1.0]),
        np.deg2rad(settings.max_tilt_deg),
        settings.thickness,
        settings.seed,
    )
    return plane if plane is not None and plane.inliers >= 100 else None
