"""The folder of compiled kernels: old ones go, those in use stay, those of other users are not loaded."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

import numpy as np
import pytest

from armcell import _cache


def test_kernels_nobody_uses_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # put back afterwards
    for name, days in (("old", 31), ("recent", 20)):
        (tmp_path / "kernels" / name).mkdir(parents=True)
        then = time.time() - days * 86400
        os.utime(tmp_path / "kernels" / name, (then, then))
    numba_s = __import__("numba").config.CACHE_DIR
    try:
        used = _cache.use_cache()
    finally:
        __import__("numba").config.CACHE_DIR = numba_s
    assert sorted(p.name for p in (tmp_path / "kernels").iterdir()) == sorted([used.name, "recent"])


@pytest.fixture
def caches(tmp_path, monkeypatch):
    """Folders of its own for every cache; what was set before is put back."""
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir(mode=0o700)
    before = __import__("numba").config.CACHE_DIR
    for remembered in (_cache._trusted_root, _cache.private_folder):
        remembered.cache_clear()
    yield tmp_path
    __import__("numba").config.CACHE_DIR = before
    for remembered in (_cache._trusted_root, _cache.private_folder):
        remembered.cache_clear()


def again(monkeypatch):
    """The folder that the next process would use."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    _cache._trusted_root.cache_clear()
    _cache.private_folder.cache_clear()
    return _cache.use_cache()


OTHER = 12345  # a user's number that is not ours


def others_file(folder):
    (folder / "deep").mkdir()
    (folder / "deep" / "kernel.nbi").touch()
    os.chown(folder / "deep" / "kernel.nbi", OTHER, -1)


def link(folder):
    target = folder.parents[2] / "target.nbi"
    target.touch()
    (folder / "kernel.nbi").symlink_to(target)


def open_file(folder):
    (folder / "kernel.nbi").touch()
    (folder / "kernel.nbi").chmod(0o666)


CHANGES = {
    "folder open to all": (lambda f: f.chmod(0o777), "other users can write"),
    "folder open to the group": (lambda f: f.chmod(0o770), "other users can write"),
    "sticky folder": (lambda f: f.chmod(0o1777), "other users can write"),
    "file open to all": (open_file, "other users can write"),
    "link": (link, "is not a regular file"),
    "folder above": (lambda f: f.parent.chmod(0o777), "other users can write"),
    "folder two above": (lambda f: f.parents[1].chmod(0o770), "other users can write"),
    "another user's file": (others_file, f"uid {OTHER}"),
    "another user's folder": (lambda f: os.chown(f, OTHER, -1), f"uid {OTHER}"),
    "another user's folder above": (lambda f: os.chown(f.parents[1], OTHER, -1), f"uid {OTHER}"),
}


@pytest.mark.slow
@pytest.mark.cases(
    "file open to all", "folder open to all", "link", "another user's file", "another user's folder above"
)
@pytest.mark.parametrize("change", CHANGES)
def test_kernels_that_another_user_may_have_written_are_not_used(caches, monkeypatch, caplog, change):
    if "another user" in change and os.geteuid() != 0:
        pytest.skip("only root gives files away")
    used = _cache.use_cache()
    assert used.is_relative_to(caches / "cache" / "kernels") and used.stat().st_mode & 0o777 == 0o700
    assert again(monkeypatch) == used and not caplog.messages
    alter, said = CHANGES[change]
    alter(used)
    instead = again(monkeypatch)
    assert not instead.is_relative_to(caches / "cache") and instead.is_relative_to(caches / "tmp")
    assert os.environ["NUMBA_CACHE_DIR"] == str(instead)
    assert _cache.doubt(instead, contents=True) is None and instead.stat().st_mode & 0o777 == 0o700
    (line,) = caplog.messages
    assert said in line and str(instead.parents[1]) in line and "chmod go-w" in line and "\n" not in line
    assert again(monkeypatch) == instead  # the private folder is kept for the next run


def test_a_private_folder_that_another_user_made_first_is_not_used(caches, monkeypatch):
    """Its name in the shared temporary folder can be guessed."""
    (caches / "cache").mkdir(mode=0o777)
    (caches / "cache").chmod(0o777)
    guessed = caches / "tmp" / f"armcell-{os.geteuid()}"
    guessed.mkdir()
    guessed.chmod(0o777)
    used = _cache.use_cache()
    assert not used.is_relative_to(guessed) and used.is_relative_to(caches / "tmp")
    guessed.rmdir()
    (caches / "elsewhere").mkdir(mode=0o777)
    (caches / "elsewhere").chmod(0o777)
    guessed.symlink_to(caches / "elsewhere")
    assert not again(monkeypatch).is_relative_to(caches / "elsewhere")


def test_a_folder_given_to_numba_is_examined_too(caches, monkeypatch, caplog):
    given = caches / "given"
    given.mkdir()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(given))
    assert _cache.use_cache() == given
    given.chmod(0o777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(given))
    assert _cache.use_cache().is_relative_to(caches / "tmp") and str(given) in caplog.text


def test_a_group_of_one_s_own_does_not_cost_the_kernels(caches, monkeypatch, caplog):
    """With umask 002 Numba's files are writable by the group, in a folder that the group cannot enter."""
    used = _cache.use_cache()
    (used / "kernel.nbi").touch()
    (used / "kernel.nbi").chmod(0o664)
    assert again(monkeypatch) == used and not caplog.messages
    used.chmod(0o755)
    assert again(monkeypatch) != used


def test_arrays_that_another_user_may_have_written_are_computed_again(caches):
    from armcell import _array_store as store

    def kept():
        found = store.recall("covers", "key")
        return None if found is None else found["a"].tolist()

    store.keep("covers", "key", a=np.arange(3))
    file = _cache.cache_root() / "covers" / "key.npz"
    assert kept() == [0, 1, 2] and file.stat().st_mode & 0o777 == 0o600
    for place, bad, good in ((file, 0o666, 0o600), (file, 0o620, 0o600), (file.parent, 0o777, 0o700)):
        place.chmod(bad)
        assert kept() is None
        place.chmod(good)
        assert kept() == [0, 1, 2]
    file.rename(file.with_name("other.npz"))
    file.symlink_to(file.with_name("other.npz"))
    assert kept() is None
    file.unlink()
    np.savez(file, a=np.array([{"a": 1}], dtype=object))  # a pickle
    file.chmod(0o600)
    assert kept() is None
    if os.geteuid() == 0:
        store.keep("covers", "key", a=np.arange(3))
        os.chown(file, OTHER, -1)
        assert kept() is None


def test_a_new_process_says_so_in_one_line(tmp_path):
    root = tmp_path / "cache"
    root.mkdir()
    root.chmod(0o777)
    environment = {**os.environ, "ARMCELL_CACHE_DIR": str(root), "TMPDIR": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    code = "import os, armcell; print(os.environ['NUMBA_CACHE_DIR'])"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.startswith(f"{tmp_path}/armcell-") and done.stderr.count("\n") == 1
    assert f"the cache {root} is not used, because other users can write {root} (mode 777)" in done.stderr
