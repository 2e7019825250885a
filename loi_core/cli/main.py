"""Parsing of the command line, and the exit codes: 0 done, 1 the work failed, 2 the call was wrong."""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from loi_core import __version__
from loi_core.cli.aloud import warning_aloud
from loi_core.cli.codes import DONE, FAILED, WRONG_CALL
from loi_core.cli.signals import ended_like_ctrl_c
from loi_core.errors import ExecutorError, FitError, LoiError, RendererError, WriteError
from loi_core.support.wording import PlainText, printable

__all__ = ["DONE", "FAILED", "WRONG_CALL", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``loi`` with these arguments (those of the process by default); returns the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a title or path that the terminal has no letters for
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as stop:  # argparse has printed the help, the version, or what is wrong
        return stop.code if isinstance(stop.code, int) else WRONG_CALL
    try:
        with ended_like_ctrl_c(), warning_aloud(), contextlib.redirect_stdout(PlainText(sys.stdout)):
            return _run(options)
    except KeyboardInterrupt as stop:
        return _say(str(stop) or "interrupted", FAILED)
    except BrokenPipeError:  # `loi ... | head` has read enough
        sys.stderr.close()
        return DONE
    except MemoryError:
        return _say("not enough memory; use fewer or coarser scales, or a smaller image", FAILED)
    except LoiError as error:
        failed = isinstance(error, ExecutorError | FitError | RendererError | WriteError)
        return _say(str(error), FAILED if failed else WRONG_CALL)
    except OSError as error:
        return _say(f"{error.filename or 'the file system'}: {error.strerror or error}", FAILED)


def _run(options: argparse.Namespace) -> int:
    # Each command imports what it needs, so that `loi --version` does not wait for a plotting library.
    if options.command == "fit":
        from loi_core.cli.fit import explain_scene, fit_scene

        if options.explain:
            explain_scene(options.scene, as_json=options.json)
            return DONE
        return fit_scene(
            options.scene,
            options.output,
            resume=options.resume,
            steps=options.steps,
            starts=options.starts,
            as_json=options.json,
            watch=options.watch,
            port=options.port,
        )
    if options.command == "sweep":
        from loi_core.cli.sweep import carry_out_sweep

        return carry_out_sweep(
            options.sweep,
            options.output,
            processes=options.processes,
            dask=options.dask,
            retry_failed=options.retry_failed,
            as_json=options.json,
        )
    if options.command == "demo":
        from loi_core.cli.demo import run_demo

        return DONE if run_demo(options.output, as_json=options.json) else FAILED
    if options.command == "report":
        from loi_core.cli.report import make_report

        make_report(options.folder, options.output)
        return DONE
    if options.command == "tradeoff":
        from loi_core.cli.tradeoff import show_tradeoff

        done = show_tradeoff(
            image=options.image,
            reference=options.reference,
            scene=options.scene,
            backends=options.backend,
            output=options.output,
            seconds=options.seconds,
            as_json=options.json,
        )
        return DONE if done else FAILED
    if options.command == "inspect":
        from loi_core.cli.inspect import inspect_images

        inspect_images(
            options.image,
            options.reference,
            options.output,
            preset=options.preset,
            bounds=options.bounds,
            as_json=options.json,
        )
        return DONE
    if options.command == "renderers":
        from loi_core.cli.renderers import list_renderers

        list_renderers(as_json=options.json)
        return DONE
    if options.command == "completion":
        from loi_core.cli.completion import completion_script

        print(completion_script(_parser(), options.shell))
        return DONE
    if options.stability:
        from loi_core.cli.stability import examine_stability

        return DONE if examine_stability(as_json=options.json) else FAILED
    from loi_core.cli.doctor import examine

    return DONE if examine(as_json=options.json) else FAILED


def _say(message: str, code: int) -> int:
    print(f"loi: {printable(message)}", file=sys.stderr)  # one line, whatever a file or plugin put into it
    return code


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with a call in one line, as every error is said."""

    def error(self, message: str) -> NoReturn:
        self.exit(_say(f"{message}; see `{self.prog} --help`", WRONG_CALL))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="loi", description="Locally orderless images as a loss for inverse rendering.")
    parser.add_argument("--version", action="version", version=f"loi {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="recover scenes from images, beside pixel L2 and a pyramid")
    demo.add_argument("--output", type=Path, default=Path("demo"), help="folder for the results (default: demo)")

    fit = commands.add_parser("fit", help="fit a scene to its target image")
    fit.add_argument("scene", type=Path, metavar="SCENE.toml", help="the scene file")
    fit.add_argument("--output", type=Path, help="folder for the results, instead of the scene's own")
    fit.add_argument("--resume", action="store_true", help="go on where an earlier fit stopped")

    fit.add_argument("--steps", type=int, help="how many steps, instead of the scene's own; more than were done go on")
    fit.add_argument("--starts", type=int, help="from how many places within the bounds to start")
    fit.add_argument("--explain", action="store_true", help="only say which effects would be simulated, and why")

    fit.add_argument("--watch", action="store_true", help="follow the fit on a page, served on this machine alone")
    fit.add_argument("--port", type=int, help="where `--watch` serves it (default: a free one)")

    sweep = commands.add_parser("sweep", help="fit many variants of scenes side by side")
    sweep.add_argument("sweep", type=Path, metavar="SWEEP.toml", help="the sweep file; what is done is not done again")
    sweep.add_argument("--output", type=Path, help="folder for the results, instead of the sweep's own")
    sweep.add_argument("--processes", type=int, metavar="N", help="fits side by side (default: as many as processors)")
    sweep.add_argument("--dask", metavar="ADDRESS", help="fit on a Dask cluster, by the address of its scheduler")
    sweep.add_argument("--retry-failed", action="store_true", help="carry out again what has failed")

    report = commands.add_parser("report", help="make report.html anew from a result folder, or one page of several")
    report.add_argument("folder", type=Path, nargs="+", metavar="DIR", help="a folder that `loi fit` has written")
    report.add_argument("--output", type=Path, help="the page of several folders (default: report.html, here)")

    tradeoff = commands.add_parser("tradeoff", help="what accuracy costs here, in time and memory")
    tradeoff.add_argument("--image", type=Path, help="image to compare with --reference")
    tradeoff.add_argument("--reference", type=Path, help="what the image should look like")
    tradeoff.add_argument(
        "--scene", metavar="SCENE", help="scene file, or disks or photograph (default: photograph, as in the demo)"
    )
    tradeoff.add_argument("--backend", nargs="+", default=[], metavar="NAME", help="measure these (default: all)")
    tradeoff.add_argument("--output", type=Path, default=Path("tradeoff"), help="folder (default: tradeoff)")
    tradeoff.add_argument("--seconds", type=float, default=0.5, help="how long to repeat each setting (default: 0.5)")

    inspect = commands.add_parser("inspect", help="what the loss sees in a picture, or between two, as one page")
    inspect.add_argument("image", type=Path, metavar="IMAGE", help="PNG, JPEG, EXR or NPY")
    inspect.add_argument("reference", type=Path, metavar="REFERENCE", nargs="?", help="what IMAGE should look like")
    inspect.add_argument("--output", type=Path, default=Path("inspect.html"), help="the page (default: inspect.html)")
    inspect.add_argument(
        "--preset",
        choices=["vector", "path", "raster"],
        help="the paper's scales (default: those for the image's size)",
    )
    inspect.add_argument(
        "--bounds", type=float, nargs=2, metavar=("LOW", "HIGH"), help="intensities told apart (default: 0 1)"
    )

    renderers = commands.add_parser("renderers", help="which renderers are installed")
    doctor = commands.add_parser("doctor", help="what works here, and the fix for what does not")
    doctor.add_argument(
        "--stability",
        action="store_true",
        help="run the hard cases on every backend (minutes, most of them JAX's compiler)",
    )
    completion = commands.add_parser("completion", help="print a script that completes what you type, for your shell")
    completion.add_argument("shell", choices=("bash", "zsh", "fish"), help="which shell")
    for command in (demo, fit, sweep, tradeoff, inspect, renderers, doctor):
        command.add_argument("--json", action="store_true", help="print the answer as JSON")
    return parser
