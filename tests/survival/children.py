"""Fits in children of a process that has imported everything: killed, or short of room on the disk, at any moment.

``python -m tests.survival.children FOLDER WHAT ...`` prints what came of it as JSON.
"""

from __future__ import annotations

import errno
import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loi_core.cli import main
from tests.helpers import FINISHED
from tests.survival.leftovers import different
from tests.survival.scenes import lay_out

__all__ = ["Trap", "run"]

MAKES = ("tempfile.mkstemp", "os.mkdir")
CHANGES = (*MAKES, "os.rename", "os.remove", "os.chmod", "os.rmdir")
MOST_KILLS = 4  # of one fit, before it may end


@dataclass
class Trap:
    """What happens when this process asks the file system for a change.

    Attributes
    ----------
    folder : Path
        Where.
    at : int
        From which call on; none if negative.
    how : {"kill", "full", "read-only"}
        On a full disk nothing can be made, and in a read-only folder nothing changed, from then on.
    """

    folder: Path
    at: int = -1
    how: str = "kill"
    calls: int = 0
    names: list[str] = field(default_factory=list)

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        """What Python calls before every call of the system."""
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if not (writes or event in CHANGES) or not str(arguments[0]).startswith(str(self.folder)):
            return
        if self.how == "full" and not (writes or event in MAKES):
            return
        self.calls += 1
        if not 0 <= self.at < self.calls:
            return
        if self.how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        number = errno.ENOSPC if self.how == "full" else errno.EROFS
        raise OSError(number, os.strerror(number))


def run(arguments: list[str], said: Path, trap: Trap | None = None, *, after: float = -1.0, room: int = -1) -> int:
    """Run a command in a child: its exit status, or the negative signal that killed it.

    Parameters
    ----------
    arguments : list of str
        Of ``loi``.
    said : Path
        A file for what it writes to standard error; what it was trapped by, or how often it might have been, beside it.
    trap : Trap, optional
    after : float
        Seconds after which it is killed, if that is not negative.
    room : int
        Bytes that a file may have, if that is not negative.
    """
    pid = os.fork()
    if pid == 0:
        _child(arguments, said, trap, room)
    if after >= 0.0:
        time.sleep(after)
        os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _child(arguments: list[str], said: Path, trap: Trap | None, room: int) -> None:
    code, sys.stderr, sys.stdout = 99, io.StringIO(), io.StringIO()
    try:
        if room >= 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
        if trap is not None:
            sys.addaudithook(trap)
        code = main(arguments)
    except BaseException as error:  # noqa: BLE001 - whatever it is, it is told
        sys.stderr.write(f"Traceback: {error!r}")
    finally:
        if room >= 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        said.write_text(sys.stderr.getvalue())
        if trap is not None:
            said.with_suffix(".calls").write_text(str(trap.calls))
        os._exit(code)


@dataclass
class Outcome:
    """What came of some fits that were cut short.

    Attributes
    ----------
    cut : int
        How many were.
    unlike : dict
        What an unbroken fit would have left otherwise, by what was done.
    said : dict
        What those said that could not go on, by what was done.
    """

    cut: int = 0
    unlike: dict[str, list[str]] = field(default_factory=dict)
    said: dict[str, str] = field(default_factory=dict)


class Fits:
    """Fits of one scene, and the one that nothing has cut short.

    Parameters
    ----------
    folder : Path
    scene : str
    """

    def __init__(self, folder: Path, scene: str) -> None:
        self.folder = folder
        self.scene = lay_out(folder, scene)
        self.said = folder / "said.txt"
        self.whole = folder / "whole"
        main(["fit", str(self.scene), "--output", str(folder / "warm"), "--json"])  # imports what children need
        began = time.perf_counter()
        if self.fit(self.whole, trap=Trap(self.whole)) not in FINISHED:
            raise RuntimeError(self.said.read_text())
        self.seconds = time.perf_counter() - began

    def fit(self, output: Path, *more: str, **how: Any) -> int:
        """Fit the scene."""
        return run(["fit", str(self.scene), "--output", str(output), *more], self.said, **how)

    def calls(self, how: str) -> int:
        """How often a whole fit can be trapped."""
        output = self.folder / "counted"
        self.fit(output, trap=Trap(output, how=how))
        shutil.rmtree(output)
        return int(self.said.with_suffix(".calls").read_text())

    def finish(self, output: Path, what: str, outcome: Outcome) -> None:
        """Let a fit that was cut short go on to its end, and compare."""
        code = self.fit(output, "--resume")
        found = different(self.whole, output) if code in FINISHED else [f"exit {code}: {self.said.read_text()}"]
        if found:
            outcome.unlike[what] = found
        shutil.rmtree(output)


def kill(fits: Fits, count: int) -> Outcome:
    """Kill fits, each several times over, and resume them: by turns at a random moment and at a random call."""
    rng = random.Random(count)  # noqa: S311 - nothing is secret
    calls, outcome, number = fits.calls("kill"), Outcome(), 0
    while outcome.cut < count:
        number += 1
        output, done = fits.folder / f"killed-{number}", list[str]()
        resume: tuple[str, ...] = ()
        for _ in range(rng.randint(1, MOST_KILLS)):
            by_time = rng.random() < 0.5
            moment = fits.seconds * rng.random() * rng.random()
            at = rng.randrange(calls)
            trap = None if by_time else Trap(output, at)
            code = fits.fit(output, *resume, trap=trap, after=moment if by_time else -1.0)
            if code == -signal.SIGKILL:
                outcome.cut += 1
                done.append(f"after {moment:.3f} s" if by_time else f"at call {at}")
            elif code not in FINISHED:
                outcome.unlike[f"{number}: {done}"] = [f"exit {code}: {fits.said.read_text()}"]
            resume = ("--resume",)
        fits.finish(output, f"{number}: {done}", outcome)
    return outcome


def starve(fits: Fits, how: str, moments: int) -> Outcome:
    """Let the file system refuse every call from one on, and resume once it no longer does."""
    outcome, calls = Outcome(), fits.calls(how)
    for at in sorted({number * calls // moments for number in range(moments)}):
        output = fits.folder / f"{how}-{at}"
        code = fits.fit(output, trap=Trap(output, at, how))
        _note(fits, f"{how} from call {at}", output, code, outcome)
    return outcome


def squeeze(fits: Fits, rooms: int) -> Outcome:
    """Let no file have more than so many bytes, and resume once it may."""
    outcome = Outcome()
    largest = max(path.stat().st_size for path in fits.whole.rglob("*") if path.is_file())
    for number in range(rooms):
        room = round(largest ** (number / rooms)) - 1  # most files are small
        output = fits.folder / f"room-{room}"
        code = fits.fit(output, room=room)
        _note(fits, f"{room} bytes", output, code, outcome)
    return outcome


def _note(fits: Fits, what: str, output: Path, code: int, outcome: Outcome) -> None:
    outcome.cut += 1
    outcome.said[what] = f"exit {code}: {fits.said.read_text()}"
    output.mkdir(exist_ok=True)
    fits.finish(output, what, outcome)


WHAT: dict[str, Callable[..., Outcome]] = {
    "kill": lambda fits, count: kill(fits, int(count)),
    "starve": lambda fits, how, moments: starve(fits, how, int(moments)),
    "squeeze": lambda fits, rooms: squeeze(fits, int(rooms)),
}


if __name__ == "__main__":
    sys.modules["loi_core.fitting.checkpoint"].INTERVAL = 5  # type: ignore[attr-defined]  # many in a short fit
    place, of, doing, *options = sys.argv[1:]
    kept, sys.stdout = sys.stdout, sys.stderr
    came = WHAT[doing](Fits(Path(place), of), *options)
    print(json.dumps(vars(came)), file=kept)
