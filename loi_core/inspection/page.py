"""The page of ``loi inspect``: one file with everything in it, which loads nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Final

from loi_core.errors import OptionError
from loi_core.inspection.drawing import (
    curve,
    encoded,
    fitted,
    inner_image,
    isophote_lines,
    loss_colours,
    tones,
)
from loi_core.inspection.findings import Findings, ScaleFindings
from loi_core.inspection.packing import packed_histograms
from loi_core.inspection.pair import Pair
from loi_core.inspection.reach import FAINTEST
from loi_core.io.files import write_text
from loi_core.io.images import FloatImage
from loi_core.method.comparison import ScaleKey
from loi_core.pixels.display import Display
from loi_core.pixels.signed import about_grey, brightest
from loi_core.report.document import document, embedded_json, is_made_by
from loi_core.support.arrays import Host

__all__ = ["check_page", "write_inspection"]

COMMAND: Final = "loi inspect"
LARGE: Final = 640  # longest side of the pictures, in pixels
MANY: Final = 400  # and of those at each scale, if there are more than a few
MAP: Final = 400  # of maps,
MANY_MAPS: Final = 240  # if there are more than a few
FEW_SCALES: Final = 4
STRIP: Final = 120
FEW_LEVELS: Final = 12
SMALL: Final = 300  # pictures of fewer pixels a side are shown as squares


def check_page(path: Path) -> None:
    """Raise :class:`OptionError` if a page at `path` would replace something that is not one.

    Raises
    ------
    OptionError
    """
    if path.suffix.lower() not in (".html", ".htm"):
        msg = f"`--output` must end in .html, got {path.name!r}"
        raise OptionError(msg)
    if not path.exists():
        return
    if not path.is_file():
        msg = f"`--output` must be a file, but {path} is none"
        raise OptionError(msg)
    if path.stat().st_size and not is_made_by(path, COMMAND):
        msg = f"{path} was not written by `loi inspect`; move it away, or give another `--output`"
        raise OptionError(msg)


def write_inspection(path: Path, found: Findings) -> int:
    """Write the page; how many bytes it has.

    Raises
    ------
    OptionError
        If there is a file at `path` that is no such page.
    WriteError
        If it cannot be written.
    """
    check_page(path)
    page = _Page(found)
    text = page.html()
    write_text(path, text)
    return len(text.encode())


@dataclass
class _Page:
    found: Findings
    shown: list[tuple[str, str]] = field(default_factory=list)  # what can lie behind the point: id and name

    def html(self) -> str:
        """All of it."""
        pair = self.found.pair
        body = "\n".join(
            [
                "<main>",
                *self._head(),
                "%EXPLORER%",
                *self._scales(),
                *self._pictures(),
                *self._why(),
                "</main>",
            ]
        )
        body = body.replace("%EXPLORER%", self._explorer(), 1)
        ratio = f":root {{ --wide: {pair.width}; --high: {pair.height}; }}\n"
        facts = embedded_json(packed_histograms(pair))
        return document(
            f"What the loss sees: {pair.names[0]}",
            f'{body}\n<script type="application/json" id="facts">{facts}</script>',
            style=_own("inspect.css") + ratio,
            script=_own("inspect.js"),
            command=COMMAND,
        )

    def _head(self) -> Iterator[str]:
        found, pair = self.found, self.found.pair
        first, second = (escape(name) for name in pair.names)
        yield "<h1>What the loss sees</h1>"
        yield f'<p class="lead">{first}, compared with {second}; {pair.width} x {pair.height} pixels</p>'
        yield f'<p class="loss">The loss is <b>{found.value:.4g}</b>{_mostly(found)}</p>'
        if pair.shift:
            yield (
                f"<p>There is no second picture, so this one is compared with itself, {pair.shift} px aside: what is "
                "shown is how the loss would feel that it has moved.</p>"
            )
        if pair.notes:
            yield f'<ul class="notes">{"".join(f"<li>{escape(note)}</li>" for note in pair.notes)}</ul>'

    def _explorer(self) -> str:
        pair = self.found.pair
        first, second = (escape(name) for name in pair.names)
        groups = [(sigma, beta) for sigma in pair.scales.sigma for beta in pair.scales.beta]
        chosen = ""
        if len(groups) > 1:
            options = "".join(f"<option>sigma {sigma:g} px, beta {beta:g}</option>" for sigma, beta in groups)
            chosen = f'<label>Scale <select id="group">{options}</select></label>'
        views = "".join(f'<option value="{name}">{escape(what)}</option>' for name, what in self.shown)
        return f"""<section aria-labelledby="look">
<h2 id="look">Histograms under the pointer</h2>
<p>Around every pixel the loss makes a histogram of intensities, wide or narrow: the rings show how wide. It compares
those of both pictures. Where they lie apart, there is something to mend.</p>
<noscript><p>Histograms need JavaScript; all else is below.</p></noscript>
<div class="explorer">
<div>
<div class="bar"><label>Show <select id="view"><option value="">{first}</option>{views}</select></label>{chosen}</div>
<div class="stage" id="stage" tabindex="0" role="application" aria-describedby="keys"
 aria-label="Picture: arrow keys move the point whose histograms are shown">
{self._image("backdrop", self._display(pair.image), pair.names[0])}
<svg id="overlay" aria-hidden="true" focusable="false"></svg></div>
<p class="keys soft" id="keys"><span id="place"></span>. A click holds the point, another lets it go; arrow keys
move it, with Shift farther.</p>
<div class="told" id="told" role="status"></div>
</div>
<div>
<div id="charts"></div>
<p class="key"><span>{_swatch("ours")}{first}</span> <span>{_swatch("theirs")}{second}</span>
<span>{_swatch("apart")}between the
cumulative histograms: the distance</span></p>
</div>
</div>
</section>"""

    def _scales(self) -> Iterator[str]:
        found, pair = self.found, self.found.pair
        side = MAP if len(found.scales) <= FEW_SCALES else MANY_MAPS
        yield '<section aria-labelledby="parts"><h2 id="parts">What each scale adds</h2>'
        yield (
            "<p>The loss map has the distance of both histograms at every pixel; its mean is what the scale adds. The "
            "gradient is shown as the colour that each pixel is asked to go to, grey where it may stay as it is. Each "
            "map is as bright as it can be.</p>"
        )
        for index, one in enumerate(found.scales):
            yield self._card(index, one, side)
        last = found.shifts.distances[-1]
        yield (
            "<p><b>Small object</b>: how far a bright disk, alone on a flat frame of this size, may be from its place "
            "and is still drawn back. <b>This picture</b>: how far "
            f"{escape(pair.names[1])} may be moved against itself, and its loss rises all the way, the mean over left, "
            f"right, up and down; moves up to {last:.0f} px were tried. The curve is that loss. Both end where the "
            f"slope falls below {FAINTEST:.0%} of its steepest: beyond, the gradient no longer points back, or hardly "
            "does. In the sum of all scales the widest takes over where the narrow ones end.</p></section>"
        )

    def _card(self, index: int, one: ScaleFindings, side: int) -> str:
        pair = self.found.pair
        name = _name(one.key, pair)
        loss = loss_colours(fitted(one.loss, side))
        gradient = about_grey(fitted(-one.gradient, side))
        maps = [
            self._figure(f"loss{index}", loss, f"loss map, {name}", f"loss map, up to {brightest(one.loss):.3g}"),
            self._figure(f"gradient{index}", gradient, f"gradient, {name}", "gradient"),
        ]
        alpha = one.key[0]
        width = 100.0 * one.share
        bar = (
            '<svg class="share" viewBox="0 0 100 6" preserveAspectRatio="none" aria-hidden="true">'
            f'<rect class="all" width="100" height="6"/><rect class="part" width="{width:.1f}" height="6"/></svg>'
        )
        numbers = {
            "of the loss": f"{one.share:.1%}",
            "adds": f"{one.value:.4g}",
            "small object": str(one.reach),
            "this picture": str(one.rise),
        }
        listed = "".join(f"<dt>{key}</dt><dd>{escape(value)}</dd>" for key, value in numbers.items())
        shifts = self.found.shifts
        return (
            f'<article class="card panel"><div><h3>{escape(_name(one.key, pair))}</h3>{bar}<dl>{listed}</dl>'
            f"{curve(shifts.distances, shifts.values[alpha, one.key[1], one.key[2]], one.rise)}</div>"
            f"{''.join(maps)}</article>"
        )

    def _pictures(self) -> Iterator[str]:
        pair = self.found.pair
        yield '<section aria-labelledby="inner"><h2 id="inner">The pictures at each scale</h2>'
        yield (
            "<p>The inner scale blurs; the tonal scale tells intensities apart. Isophotes are the lines of equal "
            "intensity at the tonal levels, each channel by itself in its own colour: white where all three have one."
            "</p>"
        )
        yield '<div class="pictures">'
        side = LARGE if len(pair.scales.sigma) * len(pair.scales.beta) == 1 and self._few_levels() else MANY
        pictures = [("image", pair.image, pair.names[0]), ("reference", pair.reference, pair.names[1])]
        yield self._figure("reference", self._display(pair.reference), pair.names[1], pair.names[1])
        for key, image, name in pictures[1:] if pair.shift else pictures:
            for number, sigma in enumerate(pair.scales.sigma):
                inner = fitted(inner_image(image, pair.computed_scales, pair.computed_scales.sigma[number]), side)
                if sigma > 0.0:
                    what = f"{name} at sigma {sigma:g} px"
                    yield self._figure(f"{key}-{number}", self._display(inner), what, what)
                for tonal, beta in enumerate(pair.scales.beta):
                    lines = isophote_lines(inner, self._inside(beta), beta, side)
                    what = f"isophotes of {name}, sigma {sigma:g} px, {beta:g} apart"
                    yield self._figure(f"{key}-lines-{number}-{tonal}", lines, what, what)
        yield "</div>"
        for key, image, name in pictures[1:] if pair.shift else pictures:
            yield from self._strip(key, image, name)
        yield "</section>"

    def _strip(self, key: str, image: FloatImage, name: str) -> Iterator[str]:
        """An image at the first inner and tonal scale, level by level."""
        pair = self.found.pair
        beta = pair.scales.beta[0]
        side = STRIP if self._few_levels() else STRIP // 2
        inner = fitted(inner_image(image, pair.computed_scales, pair.computed_scales.sigma[0]), side)
        told = f"{name}, one picture for each level: how much of a pixel has that intensity"
        yield f'<h3>{escape(told)}</h3><div class="strip">'
        for number, level in enumerate(self._inside(beta)):
            what = f"{level:g}"
            yield self._figure(
                f"{key}-level-{number}", tones(inner, level, beta), f"{name} at level {what}", what, offered=False
            )
        yield "</div>"

    def _why(self) -> Iterator[str]:
        pair = self.found.pair
        first, *lines = pair.scales.describe(pair.height, pair.width).splitlines()
        yield f'<section aria-labelledby="why"><h2 id="why">Why these scales</h2><p>{escape(first)}</p><ul class="why">'
        for line in lines:
            yield f"<li>{escape(line)}</li>"
        yield "</ul></section>"

    def _few_levels(self) -> bool:
        return all(len(self._inside(beta)) <= FEW_LEVELS for beta in self.found.pair.scales.beta)

    def _inside(self, beta: float) -> Host:
        """The tonal levels within the bounds."""
        low, high = self.found.pair.scales.bounds
        levels = self.found.pair.scales.levels(beta)
        return levels[(levels >= low - 1e-9 * beta) & (levels <= high + 1e-9 * beta)]

    def _display(self, image: FloatImage) -> FloatImage:
        shown: FloatImage = Display.of(self.found.pair.reference, None).show(fitted(image, LARGE))
        return shown

    def _figure(self, name: str, image: Host, alt: str, caption: str, *, offered: bool = True) -> str:
        if offered:
            self.shown.append((name, alt))
        return f"<figure>{self._image(name, image, alt)}<figcaption>{escape(caption)}</figcaption></figure>"

    def _image(self, name: str, image: Host, alt: str) -> str:
        kind = ' class="pixels"' if max(image.shape[:2]) < SMALL else ""
        height, width = image.shape[:2]
        return (
            f'<img id="{name}"{kind} width="{width}" height="{height}" alt="{escape(alt)}" src="{encoded(image)}" '
            'draggable="false">'
        )


def _name(key: ScaleKey, pair: Pair) -> str:
    """What to call a scale: by what differs between them."""
    alpha, beta, sigma = key
    parts = [f"extent {alpha:g} px"]
    parts += [f"sigma {sigma:g} px"] if len(pair.scales.sigma) > 1 else []
    parts += [f"beta {beta:g}"] if len(pair.scales.beta) > 1 else []
    return ", ".join(parts)


def _mostly(found: Findings) -> str:
    if found.value == 0.0:
        return ": the two are equal at every scale"
    if len(found.scales) == 1:
        return ""
    most = max(found.scales, key=lambda one: one.share)
    return f", {most.share:.0%} of it from {_name(most.key, found.pair)}"


def _swatch(kind: str) -> str:
    drawn = "M0 4H16" if kind == "theirs" else "M0 0H16V8H0Z"
    return f'<svg viewBox="0 0 16 8" aria-hidden="true"><path class="{kind}" d="{drawn}"/></svg>'


def _own(name: str) -> str:
    return files("loi_core.inspection").joinpath(name).read_text(encoding="utf-8")
