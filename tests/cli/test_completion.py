"""Shells complete what `loi` takes, each by the script that `loi completion` prints for it."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from loi_core.cli import main
from loi_core.cli.main import _parser

BEGIN = {
    "bash": ["bash", "--norc", "--noprofile", "-i"],
    "zsh": ["zsh", "-f", "-i"],
}
SETUP = {"bash": "", "zsh": "autoload -U compinit; compinit -u -D; "}


def commands() -> dict[str, argparse.ArgumentParser]:
    (action,) = (one for one in _parser()._actions if isinstance(one, argparse._SubParsersAction))
    return dict(action.choices)


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script of each shell and a scene file."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "my-scene.toml").touch()
    for shell in ("bash", "zsh", "fish"):
        with (folder / shell).open("w") as script, contextlib.redirect_stdout(script):
            assert main(["completion", shell]) == 0
    return folder


def typed(shell: str, folder: Path, lines: Iterable[str]) -> list[str]:
    """What `loi` is called with, by a person at a terminal who types each line, Tab and Enter."""
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    # By a program of its own that makes the terminal: this one may have threads, and must not be forked.
    command = [sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])", *BEGIN[shell]]
    environment = os.environ | {"TERM": "dumb", "HOME": str(folder), "PS1": "$ "}
    person = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=folder, env=environment)
    assert person.stdin is not None
    assert person.stdout is not None
    keyboard, screen = person.stdin.fileno(), person.stdout.fileno()

    def said(wanted: str) -> str:
        text, end = "", time.monotonic() + 60.0
        while not re.search(wanted, text) and time.monotonic() < end:
            if select.select([screen], [], [], 0.1)[0]:
                text += os.read(screen, 4096).decode(errors="replace")
        return text

    try:
        # Said in two parts, so that the echo of the line is not taken for its answer.
        line = f'{SETUP[shell]}loi() {{ echo "CALLED:$*:"; }}; eval "$(cat ./{shell})"; echo REA\'\'DY\n'
        os.write(keyboard, line.encode())
        assert "READY" in said("READY")
        called = []
        for keys in lines:
            os.write(keyboard, f"loi {keys}\t\n".encode())
            found = re.search(r"CALLED:(.*?):", said(r"CALLED:.*?:"))
            assert found is not None
            called.append(found.group(1).strip())
        return called
    finally:
        person.kill()
        person.communicate()


CASES = {
    "rend": "renderers",
    "doctor --stab": "doctor --stability",
    "fit --expl": "fit --explain",
    "fit my-sc": "fit my-scene.toml",
    "fit my-scene.toml --output my-sc": "fit my-scene.toml --output my-scene.toml",
    "completion fi": "completion fish",
}


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_tab_completes_commands_options_files_and_choices(shell: str, scripts: Path) -> None:
    assert typed(shell, scripts, CASES) == list(CASES.values())


def test_fish_completes_them_too(scripts: Path) -> None:
    fish = shutil.which("fish")
    if fish is None:
        pytest.skip("no fish here")
    asks = "source ./fish; " + "; echo ---; ".join(f"complete -C 'loi {keys}'" for keys in CASES)
    done = subprocess.run(
        [fish, "--no-config", "-c", asks],
        capture_output=True,
        text=True,
        check=True,
        cwd=scripts,
        env={**os.environ, "HOME": str(scripts)},
    )
    for offered, whole in zip(done.stdout.split("---"), CASES.values(), strict=True):
        assert whole.split()[-1] in [line.split("\t")[0] for line in offered.splitlines()]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_command_and_option_of_the_parser_is_in_each_script(shell: str, scripts: Path) -> None:
    script = (scripts / shell).read_text()
    assert len(commands()) >= 8
    for command, parser in commands().items():
        assert re.search(rf"\b{command}\b", script)
        for option in (one for action in parser._actions for one in action.option_strings):
            assert option.lstrip("-") in script


def test_another_shell_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "csh"]) == 2
    said = capsys.readouterr().err
    assert "invalid choice: 'csh'" in said
    assert said.count("\n") == 1
