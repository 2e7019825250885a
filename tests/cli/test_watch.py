"""``loi fit --watch`` serves a page on this machine alone, and nothing else of it."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from loi_core.cli import main
from loi_core.cli.watch import Watched, watched
from loi_core.fitting.history import FitStep
from loi_core.scenes.reading import load_scene
from tests.helpers import FINISHED
from tests.one_disk import DISK, START, lay_out_disk

SCENE = f"""\
title = "<b>One</b> disk"
target = "target.png"
output = "result"

{DISK}
{START}
[fit]
steps = 3
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return lay_out_disk(tmp_path, SCENE)


@pytest.fixture
def served(scene: Path) -> Iterator[Watched]:
    with watched(load_scene(scene), None) as one:
        yield one


def ask(served: Watched, path: str, *, method: str = "GET", host: str = "") -> tuple[int, bytes, Any]:
    place = served.address.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(place, timeout=10)
    connection.request(method, path, headers={"Host": host or place})
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content, answer.headers


def test_the_page_is_followed_by_a_small_state(served: Watched) -> None:
    status, page, headers = ask(served, "/")
    assert status == 200
    assert b"&lt;b&gt;One&lt;/b&gt; disk" in page
    assert b"default-src 'none'; img-src data: 'self'" in page
    assert headers["Cache-Control"] == "no-store"
    assert ask(served, "/frame.png")[0] == 404
    image = np.full((16, 16, 3), 0.5)
    served.live("loi", FitStep(0, 0.5, 1.0, 1.0, 0.1), 20.0, lambda: image)
    served.live("loi", FitStep(1, float("nan"), 1.0, 1.0, 0.1), float("inf"), lambda: image)
    state = json.loads(ask(served, "/state?known=0")[1])
    assert state == {
        "total": 2,
        "from": 0,
        "done": False,
        "points": [[0, 0, 0.5, 20.0], [0, 1, None, None]],
        "frame": 1,
    }
    assert json.loads(ask(served, "/state?known=1")[1])["points"] == [[0, 1, None, None]]
    for odd in ("-1", "x", "9" * 50, "3", ""):
        assert json.loads(ask(served, f"/state?known={odd}")[1])["from"] == 0
    status, picture, headers = ask(served, "/frame.png?1")
    assert (status, headers["Content-Type"]) == (200, "image/png")
    assert picture.startswith(b"\x89PNG")
    served.live.finish("the report")
    assert ask(served, "/")[1] == b"the report"
    assert json.loads(ask(served, "/state")[1])["done"] is True


@pytest.mark.parametrize(
    "path", ["/result.json", "/../scene.toml", "/%2e%2e/scene.toml", "//etc/passwd", "/state/", "*"]
)
def test_nothing_else_is_served(served: Watched, path: str) -> None:
    assert ask(served, path)[0] == 404


def test_only_gets_of_its_own_address_are_answered(served: Watched) -> None:
    port = served.address.rstrip("/").rpartition(":")[2]
    assert ask(served, "/", host=f"localhost:{port}")[0] == 200
    for host in (
        "evil.example",
        f"evil.example:{port}",
        "127.0.0.1",
        f"127.0.0.1.evil.example:{port}",
        f"[::1]:{port}",
    ):
        for path in ("/", "/state", "/frame.png"):
            assert ask(served, path, host=host)[0] == 403
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert ask(served, "/state", method=method)[0] == 501


def test_it_listens_on_the_loopback_address_alone(served: Watched) -> None:
    assert served.address.startswith("http://127.0.0.1:")
    port = int(served.address.rstrip("/").rpartition(":")[2])
    with socket.socket() as other:  # the same port of another address of this machine is free
        other.bind(("127.0.0.2", port))


def test_a_fit_that_is_watched_ends_with_the_fit_where_nobody_looks(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fit", str(scene), "--watch", "--json"]) in FINISHED
    said = capsys.readouterr()
    assert "loi: follow the fit at http://127.0.0.1:" in said.err
    assert Path(json.loads(said.out)["report"]).exists()


def test_it_serves_the_report_until_ctrl_c_at_a_terminal(
    scene: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ctrl_c(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("loi_core.support.wording.PlainText.isatty", lambda _: True)
    monkeypatch.setattr("loi_core.cli.watch.time.sleep", ctrl_c)
    assert main(["fit", str(scene), "--watch"]) in FINISHED
    assert "is the report now; Ctrl-C ends" in capsys.readouterr().err


def test_a_port_that_cannot_be_used_is_one_line_and_nothing_written(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for arguments, says in (
            (["--watch", "--port", port], f"`--port` {port} cannot be used"),
            (["--watch", "--port", "0"], "`--port` must be from 1 to 65535, got 0"),
            (["--watch", "--port", "70000"], "`--port` must be from 1 to 65535, got 70000"),
            (["--port", port], "`--port` goes with `--watch`"),
        ):
            assert main(["fit", str(scene), *arguments]) == 2
            (line,) = capsys.readouterr().err.splitlines()
            assert says in line
    assert not (scene.parent / "result").exists()
