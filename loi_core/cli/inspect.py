"""``loi inspect``: what the loss sees in a picture, or between two."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from loi_core.errors import ImageError, NonFiniteImageError, OptionError
from loi_core.inspection import Findings, inspect_pair, read_pair, write_inspection
from loi_core.inspection.page import check_page
from loi_core.io.files import check_writable
from loi_core.method.scales import Preset
from loi_core.support.markdown import markdown
from loi_core.support.wording import printable

__all__ = ["PRESETS", "inspect_images"]

PRESETS: tuple[Preset, ...] = get_args(Preset)


def inspect_images(
    image: Path,
    reference: Path | None,
    output: Path,
    *,
    preset: Preset | None,
    bounds: Sequence[float] | None,
    as_json: bool,
) -> None:
    """Write the page of one picture or two, and print a summary."""
    check_page(output)
    check_writable("--output", output.parent)
    for each in (image, reference):
        if each is not None and each.resolve() == output.resolve():
            msg = f"`--output` must not be one of the images, got {output}"
            raise OptionError(msg)
    limits = None if bounds is None else (bounds[0], bounds[1])
    try:
        pair = read_pair(image, reference, preset=preset, bounds=limits)
    except NonFiniteImageError as error:
        msg = f"{error.finding}; fix the picture, or fill them in, as numpy.nan_to_num does"  # nothing is masked here
        raise ImageError(msg) from error
    for note in pair.notes:
        print(f"loi: {printable(note)}", file=sys.stderr)
    found = inspect_pair(pair)
    size = write_inspection(output, found)
    if as_json:
        print(json.dumps(found.plain() | {"page": str(output), "page_bytes": size}, indent=2, allow_nan=False))
    else:
        print("\n".join(_lines(found)))
        print(f"\npage: {output} ({size / 1e6:.1f} MB)")


def _lines(found: Findings) -> list[str]:
    pair = found.pair
    heads = ["sigma", "beta", "extent", "adds", "of the loss", "small object", "this picture"]
    cells = [
        [f"{sigma:g}", f"{beta:g}", f"{alpha:g}", f"{one.value:.4g}", f"{one.share:.1%}", str(one.reach), str(one.rise)]
        for one in found.scales
        for alpha, beta, sigma in [one.key]
    ]
    return [
        f"{pair.names[0]}, compared with {pair.names[1]}: {pair.width} x {pair.height} pixels, loss {found.value:.4g}",
        "",
        *markdown(heads, cells),
        "",
        "small object: from how far away a small object alone is drawn back.",
        "this picture: how far the reference may be moved against itself, and its loss rises all the way.",
        "",
        *pair.scales.describe(pair.height, pair.width).splitlines(),
    ]
