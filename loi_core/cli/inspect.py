"""``loi inspect``: the loss of one image, or of two, scale by scale."""

from __future__ import annotations

import argparse
import json
import sys

from loi_core.cli.codes import DONE
from loi_core.errors import ImageError, NonFiniteImageError, OptionError
from loi_core.inspection import Findings, inspect_pair, read_pair, write_inspection
from loi_core.inspection.page import check_page
from loi_core.io.files import check_writable
from loi_core.support.markdown import markdown
from loi_core.support.wording import printable

__all__ = ["run"]


def run(options: argparse.Namespace) -> int:
    """Write the page of one image or two, and print a summary."""
    output = options.output
    check_page(output)
    check_writable("--output", output.parent)
    for path in (options.image, options.reference):
        if path is not None and path.resolve() == output.resolve():
            msg = f"`--output` must not be one of the images, got {output}"
            raise OptionError(msg)
    bounds = None if options.bounds is None else (options.bounds[0], options.bounds[1])
    try:
        pair = read_pair(options.image, options.reference, preset=options.preset, bounds=bounds)
    except NonFiniteImageError as error:
        msg = f"{error.finding}; fix the image, or replace the values, as numpy.nan_to_num does"  # no masks here
        raise ImageError(msg) from error
    for note in pair.notes:
        print(f"loi: {printable(note)}", file=sys.stderr)
    findings = inspect_pair(pair)
    size = write_inspection(output, findings)
    if options.json:
        print(json.dumps(findings.plain() | {"page": str(output), "page_bytes": size}, indent=2, allow_nan=False))
    else:
        print("\n".join(_lines(findings)))
        print(f"\npage: {output} ({size / 1e6:.1f} MB)")
    return DONE


def _lines(findings: Findings) -> list[str]:
    pair = findings.pair
    heads = ["sigma", "beta", "extent", "adds", "of the loss", "small object", "this image"]
    cells = []
    for scale in findings.scales:
        alpha, beta, sigma = scale.key
        numbers = [f"{sigma:g}", f"{beta:g}", f"{alpha:g}", f"{scale.value:.4g}", f"{scale.share:.1%}"]
        cells.append([*numbers, str(scale.reach), str(scale.rise)])
    size = f"{pair.width} x {pair.height} pixels"
    return [
        f"{pair.names[0]}, compared with {pair.names[1]}: {size}, loss {findings.value:.4g}",
        "",
        *markdown(heads, cells),
        "",
        "small object: the largest distance of a single small object that is still drawn back.",
        "this image: how far the reference may be shifted against itself while its loss still rises.",
        "",
        *pair.scales.describe(pair.height, pair.width).splitlines(),
    ]
