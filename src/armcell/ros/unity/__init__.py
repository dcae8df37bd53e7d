"""Export of a cell as files for Unity: a flattened URDF, a scene file and the C# package."""

from armcell.ros.unity.export import UnityExport, copy_package, export_unity, package_source, write_urdf

__all__ = ["UnityExport", "copy_package", "export_unity", "package_source", "write_urdf"]
