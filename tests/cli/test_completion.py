"""Shells complete the arguments of `loi` with the script that `loi completion` prints."""

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
    (action,) = (action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction))
    return dict(action.choices)


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the script of each shell, and a scene file."""
    folder = tmp_path_factory.mktemp("completion")
    (folder / "my-scene.toml").touch()
    for shell in ("bash", "zsh", "fish"):
        with (folder / shell).open("w") as script, contextlib.redirect_stdout(script):
            assert main(["completion", shell]) == 0
    return folder


def typed(shell: str, folder: Path, lines: Iterable[str]) -> list[str]:
    """Return the arguments that `loi` gets when a person types each line, Tab and Enter at a terminal."""
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    # A separate program makes the terminal: this process may have threads, and must not be forked.
    command = [sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])", *BEGIN[shell]]
    environment = os.environ | {"TERM": "dumb", "HOME": str(folder), "PS1": "$ "}
    person = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=folder, env=environment)
    assert person.stdin is not None
    assert person.stdout is not None
    keyboard, screen = person.stdin.fileno(), person.stdout.fileno()

    def read_until(pattern: str) -> str:
        text, deadline = "", time.monotonic() + 60.0
        while not re.search(pattern, text) and time.monotonic() < deadline:
            if select.select([screen], [], [], 0.1)[0]:
                text += os.read(screen, 4096).decode(errors="replace")
        return text

    try:
        # The word is split, so that the echo of the line is not mistaken for its output.
        line = f'{SETUP[shell]}loi() {{ echo "CALLED:$*:"; }}; eval "$(cat ./{shell})"; echo REA\'\'DY\n'
        os.write(keyboard, line.encode())
        assert "READY" in read_until("READY")
        called = []
        for keys in lines:
            os.write(keyboard, f"loi {keys}\t\n".encode())
            call = re.search(r"CALLED:(.*?):", read_until(r"CALLED:.*?:"))
            assert call is not None
            called.append(call.group(1).strip())
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
def test_the_tab_key_completes_commands_options_files_and_choices(shell: str, scripts: Path) -> None:
    assert typed(shell, scripts, CASES) == list(CASES.values())


def test_fish_completes_commands_options_files_and_choices(scripts: Path) -> None:
    fish = shutil.which("fish")
    if fish is None:
        pytest.skip("no fish here")
    script = "source ./fish; " + "; echo ---; ".join(f"complete -C 'loi {keys}'" for keys in CASES)
    done = subprocess.run(
        [fish, "--no-config", "-c", script],
        capture_output=True,
        text=True,
        check=True,
        cwd=scripts,
        env={**os.environ, "HOME": str(scripts)},
    )
    for offered, whole in zip(done.stdout.split("---"), CASES.values(), strict=True):
        assert whole.split()[-1] in [line.split("\t")[0] for line in offered.splitlines()]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_script_has_every_command_and_option_of_the_parser(shell: str, scripts: Path) -> None:
    script = (scripts / shell).read_text()
    assert len(commands()) >= 8
    for command, parser in commands().items():
        assert re.search(rf"\b{command}\b", script)
        for option in (name for action in parser._actions for name in action.option_strings):
            assert option.lstrip("-") in script


def test_an_unknown_shell_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "csh"]) == 2
    message = capsys.readouterr().err
    assert "invalid choice: 'csh'" in message
    assert message.count("\n") == 1
