"""Object detection in a depth image: objects with poses and fit quality, or with reasons.

Steps: compute points; remove the robot and known fixed objects; find the support plane; cluster the points
above it; match each cluster to a known object of the scene, or fit a box, cylinder or sphere.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    SE3,
    CameraImage,
    ErrorCode,
    InputError,
    Outcome,
    PointCloud,
    Shape,
    UnknownNameError,
)
from armcell.perception.cloud import SupportPlane
from armcell.perception.colors import color_distance
from armcell.perception.depth_render import OWN, DepthEvidence, cut_out, joined
from armcell.perception.image_checks import check_image
from armcell.perception.known_object_pose import (
    Match,
    closest_equivalent,
    is_primitive,
    is_symmetric,
    match_known,
    match_mesh,
    rough_match,
    rough_mesh_match,
    unexplained,
)
from armcell.perception.mesh_pose import COARSE_PIXELS, FINE_PIXELS
from armcell.perception.primitives import fit_primitives
from armcell.perception.segmentation import LookSettings, Pixels, View, support_plane, view_clusters
from armcell.perception.solid_fit import CameraEvidence
from armcell.perception.solids import solid_of
from armcell.scene import CollisionObject, PlanningScene

F64 = NDArray[np.float64]
_HOPELESS = 0.75  # maximum cost of a rough match that is refined, and of each of the clusters of a union
_OTHER_COLOR = 0.1  # extra cost of a known object with another color, for equal shapes
_MARGIN = 8  # [px] width of the surroundings of a cluster that are compared with a rendered mesh
_JOINED = 0.5  # cost factor for ranking a match of several clusters, because it explains more points
_MOST_JOINED = 12  # maximum number of clusters for which unions are evaluated
_EXPLAINED = 0.25  # maximum cost of a rough match of a mesh that explains its clusters
_REFINEMENT = 3.0  # maximum ratio of the costs of a match before and after its refinement

_Part = frozenset[int]
"""Numbers of the clusters that may be one object."""


@dataclass(frozen=True, repr=False)
class DetectedObject(Outcome):
    """Object that `look` has detected, with its pose or with the reason why its pose is unknown.

    Without a pose, `code` and `message` give the reason, and `points` remain.
    """

    name: str = ""  # name of the known object, or kind and number
    known: bool = False  # True for an object of the scene
    shapes: tuple[tuple[Shape, SE3], ...] = ()
    T_world_object: SE3 | None = None
    rms: float = np.inf  # [m] distance of the points from the surface
    cost: float = 1.0  # 0: explains all points and rays
    occluded: float = 0.0  # fraction of the outline cut off by a nearer object or the border
    points: F64 = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) [m, world]
    color: tuple[float, float, float, float] = (0.6, 0.6, 0.6, 1.0)
    symmetric: bool = (
        False  # a known object that looks the same in several poses; the one nearest to the scene's
    )
    alternatives: tuple[SE3, ...] = ()  # other poses T_world_object that explain the images about as well

    @property
    def kind(self) -> str:
        return type(self.shapes[0][0]).__name__.lower() if len(self.shapes) == 1 else "compound"

    def as_object(self, name: str | None = None, movable: bool = True) -> CollisionObject:
        """Convert an object that `look` detected to a collision object for the planning scene.

        Its shape is the fitted one, or the points without a fit.
        """
        if self.T_world_object is None or not self.shapes:
            cloud = PointCloud(self.points, 0.006)
            return CollisionObject.single(name or self.name, cloud, color=self.color)
        return CollisionObject(name or self.name, self.shapes, self.T_world_object, self.color, movable)


@dataclass(frozen=True, repr=False)
class DetectionResult(Outcome):
    """Result of `look`: the detected objects sorted by size, including those without a pose.

    The largest object comes first.
    """

    objects: tuple[DetectedObject, ...] = ()
    missing: tuple[str, ...] = ()  # known objects that were not found
    plane: SupportPlane | None = None  # world frame
    time: float = 0.0  # [s] time of the image
    cpu_time: float = 0.0  # [s] CPU time of the look

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Return the names of the known objects whose poses must not be used, such as ambiguous ones."""
        return tuple(item.name for item in self.objects if item.known and not item.ok)

    def __getitem__(self, name: str) -> DetectedObject:
        for item in self.objects:
            if item.name == name:
                return item
        raise UnknownNameError("seen object", name, [item.name for item in self.objects])


def look(
    image: CameraImage | Sequence[CameraImage],
    scene: PlanningScene | None = None,
    known: Sequence[CollisionObject] = (),
    settings: LookSettings = LookSettings(),
    now: float | None = None,
) -> DetectionResult:
    """Look for objects in a camera image with depth, and detect each of them with its pose.

    Args:
        scene: removed from the cloud: the robot in its present state, held objects, fixed objects.
        known: objects to recognize by shape; their poses only resolve symmetries.
        now: [s] of the image's clock; an image older than `max_age` is rejected.
    Returns:
        A `DetectionResult`. Its code is SUCCESS if every known object was found and every cluster has a pose;
        UNABLE_TO_AQUIRE_SENSOR_DATA without usable depth, SENSOR_INFO_STALE for an old image.
    """
    started = time.thread_time()
    images = (image,) if isinstance(image, CameraImage) else tuple(image)
    if not images:
        raise InputError("look needs an image", hint="give one image, or one of each camera")

    def ended(sight: DetectionResult) -> DetectionResult:
        at = max(each.time for each in images)
        return replace(sight, time=at, cpu_time=time.thread_time() - started)

    views = []
    for each in images:
        trouble = check_image(each, settings.max_age, now)
        if trouble is not None:
            return ended(
                DetectionResult(trouble.code, trouble.message, trouble.evidence, missing=_names(known))
            )
        views.append(View.of(each, scene, settings))
    plane = support_plane(np.concatenate([v.flat[v.others & v.region] for v in views]), settings)
    if plane is None:
        reason = "no level plane is seen that things could stand on"
        if settings.surface is not None:
            reason = f"the top of {settings.surface!r} is not seen"
        return ended(
            DetectionResult(
                ErrorCode.FAILURE, f"{reason} (turn the camera to it, or widen max_tilt_deg)",
                missing=_names(known),
            )
        )  # fmt: skip
    found = view_clusters(views, plane, settings)
    scale = max(0.003, 2.5 * plane.rms)
    kinds = [view.kinds(plane, settings) for view in views]

    def thing(*parts: Pixels) -> _ObjectCluster:
        together = tuple(np.concatenate(each) for each in zip(*parts, strict=True))
        return _ObjectCluster.of(together, views, kinds, plane, scale, settings)

    parts = {frozenset({i}): thing(pixels) for i, pixels in enumerate(found)}
    if known and len(found) <= _MOST_JOINED:
        reach = max(solid_of(item.shapes).diameter for item in known) + 4 * scale
        for some in (*combinations(range(len(found)), 2), *combinations(range(len(found)), 3)):
            if _span(np.concatenate([parts[frozenset({i})].points for i in some])) <= reach:
                parts[frozenset(some)] = thing(*(found[i] for i in some))
    objects = _named(parts, known, settings, any(each.rgb is not None for each in images))
    missing = tuple(n for n in _names(known) if n not in {o.name for o in objects})
    return ended(_summary(objects, missing, plane))


def _names(known: Sequence[CollisionObject]) -> tuple[str, ...]:
    return tuple(item.name for item in known)


@dataclass(frozen=True, eq=False)
class _ObjectCluster:
    """Point cluster that `look` treats as one object, with camera evidence for fitting a solid to the points.

    The evidence is in the frame of the object's support.
    """

    T_world_support: SE3
    evidence: CameraEvidence
    points: F64  # (n, 3) world
    occluded: float
    color: tuple[float, float, float, float]
    depths: tuple[DepthEvidence, DepthEvidence]  # coarse and fine

    @staticmethod
    def of(
        pixels: Pixels, views: list[View], kinds: list[NDArray[np.uint8]], plane: SupportPlane,
        scale: float, settings: LookSettings,
    ) -> _ObjectCluster:  # fmt: skip
        seen = [each for each in zip(views, pixels, kinds, strict=True) if len(each[1])]
        points = np.concatenate([view.flat[own] for view, own, _ in seen])
        T = plane.frame(points.mean(axis=0))
        inverse = T.inverse()
        eyes, rays, free_to, cuts, coarse, fine, colors = [], [], [], [], [], [], []
        for view, own, others in seen:
            eye = view.image.T_world_camera.translation
            beside, free, cut = _beside(
                own, view.flat.reshape(*view.size, 3), eye, settings.ring, 2 * scale, view.size
            )
            eyes.append(np.tile(inverse.apply(eye), (len(beside), 1)))
            rays.append(beside @ T.rotation.matrix)
            free_to.append(free)
            cuts.append(cut)
            shown = others.copy()
            shown[own] = OWN
            assert view.image.depth is not None  # check_image
            for kept, most in ((coarse, COARSE_PIXELS), (fine, FINE_PIXELS)):
                kept.append(cut_out(
                    view.image.depth, shown.reshape(view.size), view.image.pinhole,
                    view.image.T_world_camera.inverse() @ T, scale, _MARGIN, most,
                ))  # fmt: skip
            if view.image.rgb is not None:
                colors.append(view.image.rgb.reshape(-1, 3)[own])
        evidence = CameraEvidence(
            inverse.apply(points), np.concatenate(eyes), np.concatenate(rays), np.concatenate(free_to), scale
        )
        color = (0.6, 0.6, 0.6, 1.0)
        if colors:
            r, g, b = np.median(np.concatenate(colors), axis=0) / 255
            color = (float(r), float(g), float(b), 1.0)
        return _ObjectCluster(T, evidence, points, min(cuts), color, (joined(coarse), joined(fine)))

    def rough(self, item: CollisionObject, partly: bool) -> Match | None:
        if is_primitive(item.shapes):
            return rough_match(self.evidence, item.shapes)
        return rough_mesh_match(self.depths[0], self.evidence, item.shapes, _span(self.points), partly)

    def match(self, item: CollisionObject, start: Match) -> Match:
        if is_primitive(item.shapes):
            return match_known(self.evidence, item.shapes, start)
        prior = self.T_world_support.inverse() @ item.T_world_object
        return match_mesh(*self.depths, item.shapes, start, prior)

    def unexplained(self, item: CollisionObject, T_world_object: SE3) -> float:
        """Return how much of the cluster a known object at a given pose does not explain, from 0 to 1."""
        T = self.T_world_support.inverse() @ T_world_object
        return unexplained(self.depths[0], self.evidence, item.shapes, T)


def _beside(
    pixels: NDArray[np.int64], points: F64, eye: F64, ring: int, margin: float, size: tuple[int, int]
) -> tuple[F64, F64, float]:
    """Return the camera rays (m, 3) that pass beside the point cluster of an object that `look` detects, the
    length (m,) [m] over which each ray is free, and the occluded fraction of the cluster's outline.

    The outline is occluded where a nearer object or the image border cuts it off.
    """
    from scipy.ndimage import binary_dilation

    h, w = size
    v, u = np.divmod(pixels, w)
    v0, v1 = max(v.min() - ring, 0), min(v.max() + ring + 1, h)
    u0, u1 = max(u.min() - ring, 0), min(u.max() + ring + 1, w)
    own = np.zeros((v1 - v0, u1 - u0), bool)
    own[v - v0, u - u0] = True
    away = points[v0:v1, u0:u1] - eye
    far = np.linalg.norm(away, axis=-1)
    seen = np.isfinite(far)
    around = binary_dilation(own, iterations=ring) & ~own & seen
    middle = float(np.median(far[own]))
    next_to = binary_dilation(own, iterations=2) & ~own
    nearer = next_to & seen & (far < middle - 0.03)
    edge = ((v == 0) | (v == h - 1) | (u == 0) | (u == w - 1)).sum()
    cut = float((nearer.sum() + 2 * edge) / max(next_to.sum() + 2 * edge, 1))
    return away[around] / far[around][:, None], far[around] - margin, min(cut, 1.0)


def _span(points: F64) -> float:
    """Return the largest distance [m] between any two points of a detected cluster,
    estimated from a subset of the points.
    """
    some = points[:: max(len(points) // 150, 1)]
    return float(np.linalg.norm(some[:, None] - some[None], axis=-1).max())


def _named(
    things: dict[_Part, _ObjectCluster],
    known: Sequence[CollisionObject],
    settings: LookSettings,
    image_has_color: bool,
) -> tuple[DetectedObject, ...]:
    """Assign the best-matching known object to each cluster that `look` found.
    If none matches, assign a primitive shape.

    Among equal shapes, the one with the matching color wins. A known object may consist of several clusters
    if parts of it are hidden; a match that explains several clusters is preferred to a similar match of one.
    A known mesh that is not found is searched again as an object of which the remaining clusters are a part.
    """
    taken: dict[_Part, tuple[int, Match]] = {}
    used: _Part = frozenset()
    for partly in (False, True):
        named = {k for k, _ in taken.values()}
        left = [
            k for k, item in enumerate(known) if k not in named and not (partly and is_primitive(item.shapes))
        ]
        free = {part: thing for part, thing in things.items() if not part & used}
        rough = _rough_matches(free, known, left, partly)
        taken |= _assigned(rough, things, known, settings, image_has_color)
        used = frozenset().union(*taken)
    found, counts = [], dict.fromkeys((item.name for item in known), 1)
    for part, thing in things.items():
        if part in taken:
            k, match = taken[part]
            found.append(_recognized(thing, known[k], match))
        elif len(part) == 1 and not part & used:
            found.append(_unknown(thing, settings, counts))
    return tuple(sorted(found, key=lambda item: -len(item.points)))


def _rough_matches(
    things: dict[_Part, _ObjectCluster], known: Sequence[CollisionObject], wanted: list[int], partly: bool
) -> dict[tuple[_Part, int], Match]:
    """Return the rough matches of known objects with clusters and unions of clusters that `look` found.

    The largest unions are first: if a mesh explains one, `look` searches no smaller union of its clusters for
    this mesh.
    """
    rough: dict[tuple[_Part, int], Match] = {}
    for part, thing in sorted(things.items(), key=lambda each: -len(each[1].points)):
        for k in wanted:
            item = known[k]
            if not is_primitive(item.shapes) and any(
                which == k and part & other and match.cost <= _EXPLAINED
                for (other, which), match in rough.items()
            ):
                continue
            match = thing.rough(item, partly)
            if match is not None and match.cost <= _HOPELESS and _explains_each(match, item, part, things):
                rough[part, k] = match
    return rough


def _explains_each(
    match: Match, item: CollisionObject, part: _Part, things: dict[_Part, _ObjectCluster]
) -> bool:
    """Return whether a match of a known object explains each cluster of a union. If it does not, one of the
    clusters is another object.
    """
    if len(part) == 1:
        return True
    T = things[part].T_world_support @ match.T
    return all(things[frozenset({i})].unexplained(item, T) <= _HOPELESS for i in part)


def _assigned(
    rough: dict[tuple[_Part, int], Match], things: dict[_Part, _ObjectCluster],
    known: Sequence[CollisionObject], settings: LookSettings, image_has_color: bool,
) -> dict[_Part, tuple[int, Match]]:  # fmt: skip
    """Refine matches of known objects, and assign each object to the clusters that it explains best.

    The best match is always next. A rough match counts as if its refinement reduced its cost to a third; next
    in line, it is refined. A refined match that is next is accepted, and all other matches of its object and
    of its clusters are dropped.
    """
    taken: dict[_Part, tuple[int, Match]] = {}
    queue: list[tuple[float, list[int], int, bool, Match]] = []

    def put(part: _Part, k: int, refined: bool, match: Match) -> None:
        rank = match.cost if refined else match.cost / _REFINEMENT
        if len(part) > 1:
            rank *= _JOINED
        if image_has_color:
            rank += _OTHER_COLOR * color_distance(things[part].color, known[k].color)
        heappush(queue, (rank, sorted(part), k, refined, match))

    for (part, k), match in rough.items():
        put(part, k, False, match)
    while queue:
        _, numbers, k, refined, match = heappop(queue)
        part = frozenset(numbers)
        if any(part & other or k == which for other, (which, _) in taken.items()):
            continue
        if refined:
            taken[part] = (k, match)
            continue
        match = things[part].match(known[k], match)
        if match.cost <= settings.most_cost:
            put(part, k, True, match)
    return taken


def _recognized(thing: _ObjectCluster, item: CollisionObject, match: Match) -> DetectedObject:
    T = thing.T_world_support @ match.T
    if is_primitive(item.shapes):
        T = closest_equivalent(item.shapes, T, item.T_world_object)
    others = tuple(thing.T_world_support @ other for other in match.alternatives)
    doubt = ""
    if others:
        turns = ", ".join(f"{np.rad2deg(T.distance_to(other)[1]):.0f}" for other in others)
        doubt = (
            f"the pose of {item.name} is ambiguous: turned by {turns} deg, it explains the images about as "
            "well (use a second camera, or look from a side that shows the difference)"
        )
    return DetectedObject(
        ErrorCode.FAILURE if doubt else ErrorCode.SUCCESS, doubt,
        {"alternatives": [(o.translation.tolist(), o.quat_wxyz.tolist()) for o in others]} if others else {},
        name=item.name, known=True, shapes=item.shapes, T_world_object=T,
        rms=match.rms, cost=match.cost, occluded=thing.occluded, points=thing.points, color=thing.color,
        alternatives=others, symmetric=is_symmetric(item.shapes),
    )  # fmt: skip


def _unknown(thing: _ObjectCluster, settings: LookSettings, counts: dict[str, int]) -> DetectedObject:
    guesses = fit_primitives(thing.evidence)
    best = guesses[0]
    fits = best.cost <= settings.most_cost
    kind = best.kind if fits else "thing"
    counts[kind] = counts.get(kind, 0) + 1
    costs = ", ".join(f"{g.kind} {g.cost:.2f}" for g in guesses)
    return DetectedObject(
        ErrorCode.SUCCESS if fits else ErrorCode.FAILURE,
        "" if fits else f"no box, cylinder or ball explains it (cost {costs}; at most "
        f"{settings.most_cost:g}): name its mesh, or part it from what it touches",
        {"costs": {g.kind: g.cost for g in guesses}},
        name=f"{kind}_{counts[kind]}",
        shapes=((best.shape, SE3.identity()),) if fits else (),
        T_world_object=thing.T_world_support @ best.T if fits else None,
        rms=best.rms, cost=best.cost, occluded=thing.occluded, points=thing.points, color=thing.color,
    )  # fmt: skip


def _summary(
    objects: tuple[DetectedObject, ...], missing: tuple[str, ...], plane: SupportPlane
) -> DetectionResult:
    without = [item.name for item in objects if item.T_world_object is None]
    reasons = []
    if missing:
        seen = ", ".join(f"{o.name} ({o.cost:.2f})" for o in objects) or "nothing"
        reasons.append(
            f"{', '.join(missing)} not found among what is seen: {seen} "
            "(is it hidden, outside the picture, or of another size than its description?)"
        )
    if without:
        reasons.append(f"{', '.join(without)} without a pose")
    reasons += [item.message for item in objects if item.known and not item.ok]
    code = ErrorCode.FAILURE if reasons else ErrorCode.SUCCESS
    return DetectionResult(code, "; ".join(reasons), {}, objects=objects, missing=missing, plane=plane)
