"""A lock ends with whoever holds it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from loi_core.errors import InUseError, WriteError
from loi_core.io import lock
from loi_core.io.lock import FileLock, LockWarning


def refused(path: Path) -> bool:
    try:
        with FileLock(path, path):
            return False
    except InUseError:
        return True


def test_a_lock_is_held_by_one_and_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "lock"
    with FileLock(path, path):
        assert refused(path)
        assert path.read_text().startswith(f"{os.getpid()} on ")
    assert not refused(path)
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_a_lock_stays_if_something_is_in_it(tmp_path: Path) -> None:
    path = tmp_path / "new" / "lock"
    with FileLock(path, path):
        (path.parent / "file").touch()
    assert [each.name for each in path.parent.iterdir()] == ["file"]


def test_the_file_of_a_dead_process_locks_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    program = (
        "import os, signal, sys; from pathlib import Path; from loi_core.io.lock import FileLock\n"
        "path = Path(sys.argv[1]); FileLock(path, path).acquire(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", program, str(path)], check=False).returncode == -signal.SIGKILL
    assert path.exists()
    assert not refused(path)
    assert not path.exists()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing can be forked")
def test_a_child_that_outlives_a_process_does_not_hold_its_lock(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    program = (
        "import os, sys, time; from pathlib import Path; from loi_core.io.lock import FileLock\n"
        "path = Path(sys.argv[1]); FileLock(path, path).acquire(); child = os.fork()\n"
        "if child: print(child, flush=True); os._exit(0)\n"
        "os.close(1); time.sleep(600)"
    )
    done = subprocess.run([sys.executable, "-c", program, str(path)], check=True, stdout=subprocess.PIPE, text=True)
    try:
        assert not refused(path)
    finally:
        os.kill(int(done.stdout), signal.SIGKILL)


@pytest.mark.skipif(lock.fcntl is None, reason="the stand-in for Windows is made of what others have")
def test_windows_locks_a_byte_beyond_the_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: Any = lock.fcntl

    def locking(handle: int, mode: int, count: int) -> None:
        assert (mode, count, os.lseek(handle, 0, os.SEEK_CUR)) == (7, 1, 2**30)
        kept.flock(handle, kept.LOCK_EX | kept.LOCK_NB)

    monkeypatch.setattr(lock, "fcntl", None)
    monkeypatch.setattr(lock, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=7))
    test_a_lock_is_held_by_one_and_leaves_nothing(tmp_path)


def test_a_disk_that_cannot_lock_is_told_and_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unable(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(lock, "_lock", unable)
    with (
        pytest.warns(LockWarning, match=r"this disk cannot lock files \(No locks available\)"),
        FileLock(tmp_path / "lock", tmp_path),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_file_is_no_lock(tmp_path: Path) -> None:
    (tmp_path / "target").touch()
    (tmp_path / "link").symlink_to("target")
    os.mkfifo(tmp_path / "pipe")
    for name in ("link", "pipe"):
        with pytest.raises(WriteError, match=f"{name} could not be written"):
            FileLock(tmp_path / name, tmp_path).acquire()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "pipe", "target"]
