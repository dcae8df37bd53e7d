"""Kernel packs: compiled kernels that a wheel ships are loaded on processors that can run them."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from numba.core.caching import _CacheLocator

from armcell import _kernel_pack as packs
from armcell.collision import broad_phase

V3 = "flags : fpu avx avx2 bmi1 bmi2 f16c fma abm movbe xsave"
BUILD = """
import importlib.util, os, pathlib, sys
spec = importlib.util.spec_from_file_location("armcell._kernel_pack", sys.argv[1])
packs = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(packs)
packs.PACKS = pathlib.Path(sys.argv[2])  # before armcell looks for packs
import armcell, numpy as np
from armcell import _cache
from armcell.collision.broad_phase import box_gaps
box_gaps(np.array([[0, 1]]), np.zeros((2, 3)), np.ones((2, 3)), np.empty(1))
print(sum(box_gaps.stats.cache_hits.values()), os.environ["NUMBA_CPU_NAME"])
pack = packs.PACKS / f"{_cache.source_hash()}-{os.environ['NUMBA_CPU_NAME']}.zip"
if not pack.exists():
    packs.write_pack(pack, pathlib.Path(os.environ["NUMBA_CACHE_DIR"]))
"""


@pytest.fixture
def processor(tmp_path, monkeypatch):
    """Sets the text of /proc/cpuinfo."""

    def use(text):
        (tmp_path / "cpuinfo").write_text(text)
        monkeypatch.setattr(packs, "PROCESSOR", tmp_path / "cpuinfo")
        packs.processor_levels.cache_clear()

    yield use
    packs.processor_levels.cache_clear()


@pytest.mark.parametrize(
    ("flags", "levels"),
    [
        (V3, ("x86-64-v3",)),
        (V3 + " avx512f avx512bw avx512cd avx512dq avx512vl", ("x86-64-v4", "x86-64-v3")),
        (V3.replace(" fma", "") + " avx512f avx512bw avx512cd avx512dq avx512vl", ()),
        ("Features : fp asimd", ()),
    ],
)
def test_a_level_needs_all_its_flags_and_those_below(processor, flags, levels):
    processor(f"vendor_id : any\n{flags}\n")
    assert packs.processor_levels() == levels


def test_an_unknown_processor_has_no_level(processor, tmp_path):
    processor("")
    (tmp_path / "cpuinfo").unlink()
    assert packs.processor_levels() == ()


def test_a_pack_fits_one_version_and_the_highest_level(processor, tmp_path, monkeypatch):
    monkeypatch.setattr(packs, "PACKS", tmp_path)
    for name in ("abc-x86-64-v3", "abc-x86-64-v4", "def-x86-64-v4"):
        (tmp_path / f"{name}.zip").touch()
    processor(V3)
    assert packs.matching_pack("abc") == tmp_path / "abc-x86-64-v3.zip"
    assert packs.matching_pack("def") is None
    processor(V3 + " avx512f avx512bw avx512cd avx512dq avx512vl")
    assert packs.matching_pack("abc") == tmp_path / "abc-x86-64-v4.zip"


def test_the_folders_are_those_of_numba():
    source = broad_phase.__file__
    assert packs.cached_folder(Path(source).parent) == _CacheLocator.get_suitable_cache_subpath(source)


def test_a_damaged_pack_is_named_and_left_alone(tmp_path, monkeypatch, caplog):
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)
    pack = tmp_path / "abc-x86-64-v3.zip"
    pack.write_bytes(b"PK damaged")
    packs.use_pack(pack, tmp_path)
    assert str(pack) in caplog.text and "NUMBA_CPU_NAME" not in os.environ
    assert list(tmp_path.iterdir()) == [pack]


def test_a_user_s_processor_name_has_priority(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CPU_NAME", "skylake")
    pack = tmp_path / "abc-x86-64-v3.zip"
    with zipfile.ZipFile(pack, "w") as archive:
        archive.writestr("kernel/a.nbc", b"")
    packs.use_pack(pack, tmp_path)
    assert os.environ["NUMBA_CPU_NAME"] == "skylake" and list(tmp_path.iterdir()) == [pack]


def test_a_new_machine_loads_the_kernels_of_a_pack(tmp_path):
    """The first process compiles and writes a pack, as `make wheel` does; a second one with an empty cache
    loads the kernel from it.
    """
    if not packs.processor_levels():
        pytest.skip(f"this processor supports none of {', '.join(packs.LEVELS)}")
    level = packs.processor_levels()[0]
    (tmp_path / "packs").mkdir()
    said = []
    for number, more in enumerate((packs.target_of(level), {})):
        environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        environment |= {"ARMCELL_CACHE_DIR": str(tmp_path / f"cache{number}"), **more}
        call = [sys.executable, "-c", BUILD, packs.__file__, str(tmp_path / "packs")]
        done = subprocess.run(call, env=environment, capture_output=True, text=True, check=True)
        said.append(done.stdout.split())
    assert said == [["0", level], ["1", level]]
