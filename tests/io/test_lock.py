"""A lock ends with the process that holds it."""

from __future__ import annotations

import errno
import fcntl
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from loi_core.errors import InUseError, WriteError
from loi_core.io.lock import exclusive_use


def test_a_lock_has_one_holder_and_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "lock"
    with exclusive_use(path, tmp_path), pytest.raises(InUseError, match="is in use by another fit"):
        exclusive_use(path, tmp_path).__enter__()
    with exclusive_use(path, tmp_path):
        pass
    assert list(path.parent.iterdir()) == []


def test_the_lock_file_of_a_killed_process_locks_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    program = (
        "import os, signal, sys; from pathlib import Path; from loi_core.io.lock import exclusive_use\n"
        "path = Path(sys.argv[1]); held = exclusive_use(path, path); held.__enter__()\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", program, str(path)], check=False).returncode == -signal.SIGKILL
    assert path.exists()
    with exclusive_use(path, path):
        pass
    assert not path.exists()


def test_a_link_is_not_used_as_a_lock_file(tmp_path: Path) -> None:
    (tmp_path / "target").touch()
    (tmp_path / "link").symlink_to("target")
    with pytest.raises(WriteError, match="link could not be written"):
        exclusive_use(tmp_path / "link", tmp_path).__enter__()


def test_a_file_system_without_flock_has_locks_that_do_not_warn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with exclusive_use(tmp_path / "lock", tmp_path), pytest.raises(InUseError, match="is in use by another fit"):
        exclusive_use(tmp_path / "lock", tmp_path).__enter__()
    assert list(tmp_path.iterdir()) == []
