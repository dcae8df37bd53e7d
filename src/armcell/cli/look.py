"""`armcell look`: detect objects in the pictures of a camera, in a cell or from files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from armcell.cli.console import check_writable, console, write_json
from armcell.core import SE3, CameraImage, InputError, UnknownNameError

EXAMPLES = """
Examples:

  armcell look six_axis_camera --camera above          objects with poses, sizes and residuals

  armcell look panda_pick --picture seen.png           and the picture with them drawn in

  armcell look shot.yaml                               shot.yaml, shot_rgb.png and shot_depth.png

  armcell look --info cam.yaml --depth d.png --rgb c.png --place 0.5 0 1 180 0 90

  armcell look run.mcap --json seen.json               the newest picture of a record

  armcell look shelf.ply --place 0 0 1.2 -120 0 -90    a cloud, seen from where the sensor was

  armcell look my_cell --markers apriltag_36h11 --marker-size 0.05
"""
CLOUDS = (".ply", ".pcd", ".xyz", ".npy")
Place = tuple[float, float, float, float, float, float]


def look(
    source: str | None = typer.Argument(
        None, help="Cell, or a file: NAME.yaml with its pictures, .mcap, or a cloud (.ply .pcd .xyz .npy)."
    ),
    camera: str | None = typer.Option(None, help="Camera of the cell, or frame in the record."),
    seed: int | None = typer.Option(None, min=0, help="Draw of the cell's randomised values."),
    info: Path | None = typer.Option(None, help="Camera info (YAML of ROS's camera_calibration)."),
    rgb: Path | None = typer.Option(None, help="Color picture, with --info."),
    depth: Path | None = typer.Option(None, help="Depth with --info: 16 bit PNG of mm, or .npy of m."),
    place: Place | None = typer.Option(
        None, metavar="X Y Z R P Y", help="Where the camera is [m, deg]; its z axis looks, y is down."
    ),
    surface: str | None = typer.Option(None, help="Object of the cell that things stand on."),
    markers: str | None = typer.Option(None, metavar="FAMILY", help="Look for markers: apriltag_36h11, ..."),
    marker_size: float = typer.Option(0.05, min=0.001, help="Edge of their black squares [m]."),
    picture: Path | None = typer.Option(None, metavar="FILE", help="Write the picture with what is seen."),
    save: Path | None = typer.Option(
        None, metavar="NAME", help="Write NAME.yaml, NAME_rgb.png, NAME_depth.png."
    ),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the numbers as JSON."),
) -> int:
    """Look for objects (or markers) with a camera, and print for each its pose,
    its size and the quality of the fit.

    In a cell the picture is simulated, and "off" is the deviation from the true pose in the simulator.
    Exit status 0 if everything has a pose, 1 if not.
    """
    for file in (json_file, picture):
        if file is not None:
            check_writable(file)
    from armcell.perception import draw_detections, find_markers, save_image
    from armcell.perception import look as look_for

    image, scene, known, truth, surface = _source(source, camera, seed, info, rgb, depth, place, surface)
    if save is not None:
        check_writable(save.with_suffix(".yaml"))
        for written in save_image(save, image):
            console.print(f"written: {written}", soft_wrap=True)
    result: Any
    if markers is not None:
        result = find_markers(image, markers, marker_size)
        rows = [_marker(m) for m in result.markers]
        picture_of = draw_detections(image, None, result.markers)
    else:
        from armcell.perception import LookSettings

        result = look_for(image, scene, known, LookSettings(surface=surface))
        rows = [_object(o, truth) for o in result.objects]
        picture_of = draw_detections(image, result)
    _print(rows, result)
    if picture is not None:
        from PIL import Image

        try:
            Image.fromarray(picture_of).save(picture)
        except (ValueError, OSError) as error:
            raise InputError(f"cannot be written: {error}", file=picture, hint="name it .png") from None
    if json_file is not None:
        write_json(json_file, {
            "ok": result.ok, "code": result.code.name, "message": result.message, "camera": image.camera,
            "time_s": image.time, "seen": rows, "missing": list(result.missing),
            "cpu_time_s": getattr(result, "cpu_time", None),
        })  # fmt: skip
    return 0 if result.ok else 1


def _source(
    source: str | None, camera: str | None, seed: int | None, info: Path | None, rgb: Path | None,
    depth: Path | None, place: Place | None, surface: str | None,
) -> tuple[CameraImage, Any, tuple, dict[str, SE3], str | None]:  # fmt: skip
    """Return the camera picture for `armcell look`.
    For a cell, also return the scene, the objects to find and their true poses.

    The last item is the support surface.
    """
    from armcell.perception import cloud_image, load_image, load_record
    from armcell.scene import load_points

    T = None if place is None else SE3.from_xyz_rpy(place[:3], np.deg2rad(place[3:]))
    if info is not None:
        if source is not None:
            raise InputError("give a cell or file, or --info with pictures, not both")
        if rgb is None and depth is None:
            raise InputError(
                "--info alone is no picture", hint="give --depth FILE and, if there is one, --rgb FILE"
            )
        return load_image(info, rgb, depth, T), None, (), {}, surface
    if source is None:
        raise InputError("nothing to look at", hint="give a cell, a file, or --info with --depth")
    file = Path(source)
    suffix = file.suffix.lower()
    if suffix == ".mcap":
        record = load_record(file)
        frames = sorted(set(record.rgb) | set(record.depth))
        if not frames and record.clouds:
            frame = camera or next(iter(sorted(record.clouds)))
            if frame not in record.clouds:
                raise InputError(
                    f"has no cloud of {frame!r}", file=file, hint=f"known: {sorted(record.clouds)}"
                )
            pose = T if T is not None else record.pose(frame)
            return cloud_image(pose.apply(record.clouds[frame][1]), pose, frame), None, (), {}, surface
        image = record.image(camera)
        if T is not None:
            image = CameraImage(image.camera, image.pinhole, T, image.time, image.rgb, image.depth)
        return image, None, (), {}, surface
    if suffix in CLOUDS:
        if T is None:
            raise InputError("a cloud does not say where it was seen from", hint="give --place X Y Z R P Y")
        return cloud_image(load_points(file), T, file.stem), None, (), {}, surface
    if suffix == ".yaml" and os.path.exists(file) and "image_width" in file.read_text(errors="replace"):
        return load_image(file, T_world_camera=T), None, (), {}, surface
    return _cell(source, camera, seed, surface)


def _cell(
    name: str, camera: str | None, seed: int | None, surface: str | None
) -> tuple[CameraImage, Any, tuple, dict[str, SE3], str | None]:
    from armcell.cell import load
    from armcell.sim import SimWorld, take_image

    cell = load(name)
    cameras = {c.name: c for c in cell.cameras}
    seen = cell.spec.perception
    if camera is None:
        camera = seen.camera if seen is not None else next(iter(cameras), None)
    if camera is None:
        raise InputError("the cell has no camera", file=cell.file, hint="add 'cameras:' to it")
    if camera not in cameras:
        raise UnknownNameError("camera", camera, cameras, file=cell.file)
    scene = cell.scene(seed)
    world = SimWorld(scene, cell.physics, cell.cameras, seed or 0, cell.decals)
    known = tuple(o.at(SE3.identity()) for o in scene.objects.values() if o.movable)
    truth = {o.name: world.object_pose(o.name) for o in known}
    if surface is None and seen is not None:
        surface = seen.surface
    return take_image(world, cameras[camera]), scene, known, truth, surface


def _object(item: Any, truth: dict[str, SE3]) -> dict[str, Any]:
    from armcell.perception import pose_error

    T = item.T_world_object
    row: dict[str, Any] = {
        "name": item.name, "kind": item.kind if item.shapes else "", "known": item.known, "ok": item.ok,
        "message": item.message, "pixels": len(item.points), "rms_m": _number(item.rms), "cost": item.cost,
        "occluded": item.occluded, "position": None, "rpy": None, "size": None,
        "off_m": None, "off_rad": None, "symmetric": item.symmetric,
        "alternatives": [{"position": o.translation.tolist(), "rpy": o.rotation.rpy.tolist()}
                         for o in item.alternatives],
    }  # fmt: skip
    if T is not None:
        row["position"], row["rpy"] = T.translation.tolist(), T.rotation.rpy.tolist()
        low, high = item.as_object().bounds()
        row["size"] = (high - low).tolist()
        if item.name in truth:
            row["off_m"], row["off_rad"] = pose_error(item.shapes, T, truth[item.name])
    return row


def _marker(m: Any) -> dict[str, Any]:
    T = m.T_world_marker
    kind = "partly hidden" if m.hidden else "ambiguous" if m.ambiguous else ""
    return {
        "name": f"marker {m.id}", "kind": kind, "ok": True, "message": "",
        "position": T.translation.tolist(), "rpy": T.rotation.rpy.tolist(), "size": None,
        "error_px": m.error_px, "off_m": None, "off_rad": None,
    }  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _print(rows: list[dict[str, Any]], result: Any) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("seen", "kind", "x y z [mm]", "r p y [deg]", "size [mm]", "fit", "off", ""):
        table.add_column(title, overflow="fold")
    for row in rows:
        fit = f"{row['error_px']:.2f} px" if "error_px" in row else _mm(row["rms_m"])
        off = (
            ""
            if row["off_m"] is None
            else f"{row['off_m'] * 1e3:.2f} mm {np.rad2deg(row['off_rad']):.2f} deg"
        )
        table.add_row(
            row["name"], row["kind"], _triple(row["position"], 1e3), _triple(row["rpy"], 180 / np.pi),
            _triple(row["size"], 1e3), fit, off, row["message"],
        )  # fmt: skip
    console.print(table)
    if result.message:
        console.print(result.message, markup=False)
    if hasattr(result, "cpu_time"):
        console.print(f"{len(rows)} seen, {result.cpu_time * 1000:.0f} ms of processor time")


def _mm(value: float | None) -> str:
    return "" if value is None else f"{value * 1e3:.2f} mm"


def _triple(values: list[float] | None, factor: float) -> str:
    return "" if values is None else " ".join(f"{v * factor:.1f}" for v in values)
