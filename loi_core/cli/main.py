"""The parser of the command line and its exit codes: 0 done, 1 the work failed, 2 the call was wrong."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from loi_core import __version__
from loi_core.cli.codes import DONE, FAILED, WRONG_CALL
from loi_core.cli.signals import sigterm_as_ctrl_c
from loi_core.cli.warning_lines import one_line_warnings
from loi_core.errors import ExecutorError, FitError, LoiError, RendererError, WriteError
from loi_core.support.wording import PlainText, printable

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``loi`` with these arguments, by default the arguments of the process, and return the exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # for a title or path that the terminal cannot encode
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as stop:  # argparse has printed the help, the version, or the error
        return stop.code if isinstance(stop.code, int) else WRONG_CALL
    try:
        with sigterm_as_ctrl_c(), one_line_warnings(), contextlib.redirect_stdout(PlainText(sys.stdout)):
            # Only the module of the command is imported, so that `loi --version` is fast.
            code: int = importlib.import_module(f"loi_core.cli.{options.command}").run(options)
            return code
    except KeyboardInterrupt as stop:
        return _fail(str(stop) or "interrupted", FAILED)
    except BrokenPipeError:  # `loi ... | head` has read enough
        sys.stderr.close()
        return DONE
    except MemoryError:
        return _fail("not enough memory; use fewer or coarser scales, or a smaller image", FAILED)
    except LoiError as error:
        failed = isinstance(error, ExecutorError | FitError | RendererError | WriteError)
        return _fail(str(error), FAILED if failed else WRONG_CALL)
    except OSError as error:
        return _fail(f"{error.filename or 'the file system'}: {error.strerror or error}", FAILED)


def _fail(message: str, code: int) -> int:
    print(f"loi: {printable(message)}", file=sys.stderr)  # one line, whatever a file or plugin put into it
    return code


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as all errors of ``loi``."""

    def error(self, message: str) -> NoReturn:
        self.exit(_fail(f"{message}; see `{self.prog} --help`", WRONG_CALL))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="loi", description="Locally orderless images as a loss for inverse rendering.")
    parser.add_argument("--version", action="version", version=f"loi {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="recover scenes from images, beside pixel L2 and a pyramid")
    demo.add_argument("--output", type=Path, default=Path("demo"), help="folder for the results (default: demo)")

    fit = commands.add_parser("fit", help="fit a scene to its target image")
    fit.add_argument("scene", type=Path, metavar="SCENE.toml", help="the scene file")
    fit.add_argument("--output", type=Path, help="folder for the results, instead of the scene's own")
    fit.add_argument("--resume", action="store_true", help="continue an earlier fit from its checkpoint")
    fit.add_argument("--overwrite", action="store_true", help="replace the result of an earlier fit of over a minute")
    fit.add_argument("--steps", type=int, help="number of steps, instead of the scene's own")
    fit.add_argument("--starts", type=int, help="number of starting points within the bounds")
    fit.add_argument("--explain", action="store_true", help="only print which effects would be simulated, and why")
    fit.add_argument("--watch", action="store_true", help="let the page of the report follow the fit while it runs")

    sweep = commands.add_parser("sweep", help="fit many variants of scenes side by side")
    sweep.add_argument("sweep", type=Path, metavar="SWEEP.toml", help="the sweep file; finished runs are not repeated")
    sweep.add_argument("--output", type=Path, help="folder for the results, instead of the sweep's own")
    sweep.add_argument("--processes", type=int, metavar="N", help="fits side by side (default: number of processors)")
    sweep.add_argument("--dask", metavar="ADDRESS", help="fit on a Dask cluster, by the address of its scheduler")
    sweep.add_argument("--retry-failed", action="store_true", help="repeat failed runs")

    report = commands.add_parser("report", help="rewrite report.html of a result folder, or write one page of several")
    report.add_argument("folder", type=Path, nargs="+", metavar="DIR", help="a folder that `loi fit` has written")
    report.add_argument("--output", type=Path, help="the page of several folders (default: report.html, here)")

    tradeoff = commands.add_parser("tradeoff", help="the cost of accuracy here, in time and memory")
    tradeoff.add_argument("--image", type=Path, help="image to compare with --reference")
    tradeoff.add_argument("--reference", type=Path, help="the reference of the image")
    tradeoff.add_argument(
        "--scene", metavar="SCENE", help="scene file, or disks or photograph (default: photograph, as in the demo)"
    )
    tradeoff.add_argument("--backend", nargs="+", default=[], metavar="NAME", help="measure these (default: all)")
    tradeoff.add_argument("--output", type=Path, default=Path("tradeoff"), help="folder (default: tradeoff)")
    tradeoff.add_argument("--seconds", type=float, default=0.5, help="time to repeat each setting (default: 0.5)")

    inspect = commands.add_parser("inspect", help="the loss of an image, or of two, scale by scale, as one page")
    inspect.add_argument("image", type=Path, metavar="IMAGE", help="PNG, JPEG, EXR or NPY")
    inspect.add_argument("reference", type=Path, metavar="REFERENCE", nargs="?", help="the reference of IMAGE")
    inspect.add_argument("--output", type=Path, default=Path("inspect.html"), help="the page (default: inspect.html)")
    inspect.add_argument(
        "--preset",
        choices=["vector", "path", "raster"],
        help="the paper's scales (default: those for the image's size)",
    )
    inspect.add_argument(
        "--bounds",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="range of distinguished intensities (default: 0 1)",
    )

    renderers = commands.add_parser("renderers", help="list the installed renderers")
    doctor = commands.add_parser("doctor", help="check every part of the installation, and print the fixes")
    doctor.add_argument(
        "--stability",
        action="store_true",
        help="run the hard cases on every backend (minutes, most of them JAX's compiler)",
    )
    completion = commands.add_parser("completion", help="print a completion script for your shell")
    completion.add_argument("shell", choices=("bash", "zsh", "fish"), help="the shell")
    completion.set_defaults(root=parser)
    for command in (demo, fit, sweep, tradeoff, inspect, renderers, doctor):
        command.add_argument("--json", action="store_true", help="print the answer as JSON")
    return parser
