"""Fits in forked children that are killed, or meet a full disk, at any moment.

``python -m tests.survival.children FOLDER SCENE kill COUNT``, or ``starve HOW MOMENTS``, prints the outcome as JSON.
"""

from __future__ import annotations

import errno
import io
import json
import os
import random
import shutil
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loi_core.cli import main
from loi_core.io.result_folder import LOCK_FILE
from tests.helpers import FINISHED
from tests.survival.leftovers import different
from tests.survival.scenes import lay_out

CREATING = ("tempfile.mkstemp", "os.mkdir")
CHANGING = (*CREATING, "os.rename", "os.remove", "os.chmod", "os.rmdir")
MAX_KILLS = 4  # of one fit, before it may end


@dataclass
class Trap:
    """An audit hook that stops this process when it changes the file system.

    Attributes
    ----------
    folder : Path
        Changes elsewhere are ignored.
    start : int
        Index of the first call that is trapped; none if negative.
    how : {"kill", "full", "read-only"}
        Kill the process, refuse to create files as a full disk does, or refuse every change.
    """

    folder: Path
    start: int = -1
    how: str = "kill"
    calls: int = 0

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Handle an audit event of Python."""
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if not (writes or event in CHANGING) or not str(arguments[0]).startswith(str(self.folder)):
            return
        if self.how == "full" and not (writes or event in CREATING):
            return
        self.calls += 1
        if not 0 <= self.start < self.calls:
            return
        if self.how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        number = errno.ENOSPC if self.how == "full" else errno.EROFS
        raise OSError(number, os.strerror(number))


def run(arguments: list[str], log: Path, trap: Trap | None = None, *, seconds: float = -1.0) -> int:
    """Run a ``loi`` command in a child; return its exit status, or the negative signal that killed it.

    Standard error goes to `log`, and the number of trapped calls beside it. The child is killed after `seconds` unless
    that is negative.
    """
    pid = os.fork()
    if pid == 0:
        code, sys.stderr, sys.stdout = 99, io.StringIO(), io.StringIO()
        try:
            if trap is not None:
                sys.addaudithook(trap)
            code = main(arguments)
        except BaseException as error:  # noqa: BLE001 - it is reported
            sys.stderr.write(f"Traceback: {error!r}")
        finally:
            log.write_text(sys.stderr.getvalue())
            if trap is not None:
                log.with_suffix(".calls").write_text(str(trap.calls))
            os._exit(code)
    if seconds >= 0.0:
        time.sleep(seconds)
        os.kill(pid, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@dataclass
class Outcome:
    """The outcome of fits that were stopped and resumed.

    Attributes
    ----------
    stopped : int
        Number of stops.
    differences : dict
        Files that an uninterrupted fit would have left otherwise, by the way it was stopped.
    messages : dict
        Messages of fits that could not continue, by the way they were stopped.
    """

    stopped: int = 0
    differences: dict[str, list[str]] = field(default_factory=dict)
    messages: dict[str, str] = field(default_factory=dict)


class Fits:
    """Fits of one scene, beside one uninterrupted fit."""

    def __init__(self, folder: Path, scene: str) -> None:
        self.folder = folder
        self.scene = lay_out(folder, scene)
        self.log = folder / "log.txt"
        self.whole = folder / "whole"
        main(["fit", str(self.scene), "--output", str(folder / "warm"), "--json"])  # imports what children need
        began = time.perf_counter()
        if self.fit(self.whole, trap=Trap(self.whole)) not in FINISHED:
            raise RuntimeError(self.log.read_text())
        self.seconds = time.perf_counter() - began

    def fit(self, output: Path, *options: str, **stop: Any) -> int:
        """Fit the scene."""
        return run(["fit", str(self.scene), "--output", str(output), *options], self.log, **stop)

    def calls(self, how: str) -> int:
        """Return the number of calls of a whole fit that can be trapped."""
        output = self.folder / "counted"
        self.fit(output, trap=Trap(output, how=how))
        shutil.rmtree(output)
        return int(self.log.with_suffix(".calls").read_text())

    def finish(self, output: Path, stop: str, outcome: Outcome) -> None:
        """Resume a stopped fit to its end, and compare."""
        code = self.fit(output, "--resume")
        differences = different(self.whole, output) if code in FINISHED else [f"exit {code}: {self.log.read_text()}"]
        if differences:
            outcome.differences[stop] = differences
        shutil.rmtree(output)


def kill(fits: Fits, count: int) -> Outcome:
    """Kill fits, each several times, at random moments and at random calls, and resume them."""
    rng = random.Random(count)  # noqa: S311 - nothing is secret
    calls, outcome, number = fits.calls("kill"), Outcome(), 0
    while outcome.stopped < count:
        number += 1
        output, stops = fits.folder / f"killed-{number}", list[str]()
        options: tuple[str, ...] = ()
        for _ in range(rng.randint(1, MAX_KILLS)):
            seconds = fits.seconds * rng.random() * rng.random() if rng.random() < 0.5 else -1.0
            start = rng.randrange(calls)
            code = fits.fit(output, *options, trap=None if seconds >= 0.0 else Trap(output, start), seconds=seconds)
            if code == -signal.SIGKILL:
                outcome.stopped += 1
                stops.append(f"after {seconds:.3f} s" if seconds >= 0.0 else f"at call {start}")
            elif code not in FINISHED:
                outcome.differences[f"{number}: {stops}"] = [f"exit {code}: {fits.log.read_text()}"]
            options = ("--resume",)
        fits.finish(output, f"{number}: {stops}", outcome)
    return outcome


def starve(fits: Fits, how: str, moments: int) -> Outcome:
    """Let the file system refuse every call from one on, and resume once it no longer does."""
    outcome, calls = Outcome(), fits.calls(how)
    for start in sorted({number * calls // moments for number in range(moments)}):
        output, stop = fits.folder / f"{how}-{start}", f"{how} from call {start}"
        code = fits.fit(output, trap=Trap(output, start, how))
        if code in FINISHED:  # with every file written, and only the lock left to remove
            (output / LOCK_FILE).unlink(missing_ok=True)
            if differences := different(fits.whole, output):
                outcome.differences[stop] = differences
            continue
        outcome.stopped += 1
        outcome.messages[stop] = f"exit {code}: {fits.log.read_text()}"
        output.mkdir(exist_ok=True)
        fits.finish(output, stop, outcome)
    return outcome


if __name__ == "__main__":
    sys.modules["loi_core.fitting.checkpoint"].INTERVAL = 5  # type: ignore[attr-defined]  # many in a short fit
    folder_name, scene_name, action, *options = sys.argv[1:]
    stdout, sys.stdout = sys.stdout, sys.stderr
    stopped_fits = Fits(Path(folder_name), scene_name)
    if action == "kill":
        outcome = kill(stopped_fits, int(options[0]))
    else:
        outcome = starve(stopped_fits, options[0], int(options[1]))
    print(json.dumps(vars(outcome)), file=stdout)
