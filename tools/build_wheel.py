"""Build a wheel with kernel packs, so that armcell compiles nothing on common processors: `make wheel`.

For each processor level that this machine supports, the script compiles the kernels for the level in an
empty cache folder and writes them into a pack. The packs fit the Python and the library versions that run
this script. For a wheel with packs for several versions of Python, run the script with each Python, with the
option `--keep` after the first.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from armcell._cache import source_hash
from armcell._kernel_pack import PACKS, processor_levels, target_of, write_pack

ROOT = Path(__file__).resolve().parent.parent


def compiled_folder(level: str, root: str) -> Path:
    """Compile the kernels for a processor level below the folder `root`. Return Numba's cache folder."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= target_of(level) | {"ARMCELL_CACHE_DIR": root}
    subprocess.run([sys.executable, "-m", "tests.prepare"], cwd=ROOT, env=environment, check=True)
    return Path(root) / "kernels" / source_hash()


def main(keep: bool) -> None:
    for pack in [] if keep else PACKS.glob("*.zip"):
        pack.unlink()
    for level in processor_levels():
        pack = PACKS / f"{source_hash()}-{level}.zip"
        print(f"compiling the kernels for {level}", flush=True)
        with tempfile.TemporaryDirectory() as root:
            write_pack(pack, compiled_folder(level, root))
        print(f"{pack.relative_to(ROOT)}: {pack.stat().st_size / 1e6:.1f} MB")
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", "dist", "."]
    subprocess.run(pip, cwd=ROOT, check=True)


if __name__ == "__main__":
    main("--keep" in sys.argv[1:])
