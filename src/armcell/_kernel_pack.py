"""Kernel packs: compiled kernels that ship in a wheel, so that a new machine need not compile them.

A pack is a zip archive of Numba cache files for one version of the sources, Python and Numba, compiled for a
processor level of the x86-64 psABI, not for one model of processor. The file name contains the cache version
(`_cache.source_hash`) and the level. If no pack matches, armcell compiles the kernels. `tools/build_wheel.py`
builds the packs.
"""

from __future__ import annotations

import hashlib
import logging
import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path, PurePosixPath

PACKAGE = Path(__file__).parent
PACKS = PACKAGE / "kernel_packs"
PROCESSOR = Path("/proc/cpuinfo")
LEVELS = {
    "x86-64-v4": "avx512f avx512bw avx512cd avx512dq avx512vl",
    "x86-64-v3": "avx avx2 bmi1 bmi2 f16c fma abm movbe xsave",
}
"""Flags of Linux that each level adds to the level below, highest level first (x86-64 psABI, 3.1.1).

Processors below x86-64-v3, which were sold until about 2015, compile the kernels.
"""

log = logging.getLogger("armcell")


@cache
def processor_levels() -> tuple[str, ...]:
    """Return the processor levels (x86-64-v3, x86-64-v4) for which this machine can use a kernel pack,
    highest first. The result is empty if the levels are unknown.
    """
    try:
        text = PROCESSOR.read_text()
    except OSError:
        return ()  # not Linux
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    flags, levels, needed = set(line.split()), [], set()
    for level in reversed(LEVELS):
        needed |= set(LEVELS[level].split())
        if needed <= flags:
            levels.insert(0, level)
    return tuple(levels)


def matching_pack(version: str) -> Path | None:
    """Return the fastest kernel pack for this processor and a cache version, or None."""
    packs = (PACKS / f"{version}-{level}.zip" for level in processor_levels())
    return next((pack for pack in packs if os.path.isfile(pack)), None)


def use_pack(pack: Path, folder: Path) -> None:
    """Unpack a kernel pack into Numba's cache folder, once, and let Numba compile for the pack's level.

    Numba finds a cached kernel only if it was compiled for the same processor name. A user's
    `NUMBA_CPU_NAME` has priority; the pack then has no effect. A damaged pack is ignored with a warning.
    """
    if os.environ.get("NUMBA_CPU_NAME", level_of(pack)) != level_of(pack):
        return
    unpacked = folder / f"{pack.stem}-{cached_folder(PACKAGE)}"  # other installations have other folders
    if not os.path.exists(unpacked):
        import zipfile  # most starts unpack nothing

        try:
            with zipfile.ZipFile(pack) as archive:
                for name in archive.namelist():
                    _write(cached_place(name, folder), archive.read(name))
        except (OSError, zipfile.BadZipFile) as error:
            log.warning("armcell: the kernel pack %s is not used, because it cannot be read: %s", pack, error)
            return
        unpacked.touch(0o600)
    os.environ.update(target_of(level_of(pack)))
    if "numba" in sys.modules:
        sys.modules["numba"].config.CPU_NAME, sys.modules["numba"].config.CPU_FEATURES = level_of(pack), ""


def target_of(level: str) -> dict[str, str]:
    """Return the environment variables that make Numba compile for the processor level of a kernel pack."""
    return {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ""}  # no features beyond those of the level


def level_of(pack: Path) -> str:
    """Return the processor level in the file name of a kernel pack."""
    return pack.stem.partition("-")[2]


def cached_place(name: str, folder: Path) -> Path:
    """Return the path in Numba's cache folder to which a file of a kernel pack is unpacked."""
    path = PurePosixPath(name)
    if path.parent == PurePosixPath():
        return folder / name
    return folder / cached_folder(PACKAGE / path.parent) / path.name


def cached_folder(sources: Path) -> str:
    """Return the name of the folder in which Numba caches the kernels of a source folder, to pack and unpack
    the kernels.

    The name is that of Numba's `_CacheLocator.get_suitable_cache_subpath`.
    """
    return f"{sources.name}_{hashlib.sha1(str(sources).encode()).hexdigest()}"


def write_pack(pack: Path, folder: Path) -> None:
    """Write armcell's compiled kernels from Numba's cache folder to a kernel pack."""
    import zipfile

    pack.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(pack, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, file in sorted(_cached_files(folder)):
            archive.write(file, name)


def _cached_files(folder: Path) -> Iterable[tuple[str, Path]]:
    """Yield each file of a kernel pack to write: its name in the pack, and its path. These are the cached
    kernels and the files beside them.
    """
    for sources in (PACKAGE, *(path for path in PACKAGE.rglob("*") if os.path.isdir(path))):
        for file in (folder / cached_folder(sources)).glob("*.nb[ic]"):
            yield (sources.relative_to(PACKAGE) / file.name).as_posix(), file
    for file in folder.iterdir():
        if os.path.isfile(file):
            yield file.name, file


def _write(file: Path, content: bytes) -> None:
    """Write a file of a kernel pack atomically, so that no process reads a partly written file."""
    file.parent.mkdir(mode=0o700, exist_ok=True)
    new = file.with_name(f"{file.name}.tmp.{os.getpid()}")
    new.touch(0o600)
    new.write_bytes(content)
    new.replace(file)
