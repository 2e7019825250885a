"""The page of ``loi inspect``: one self-contained file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Final

from loi_core.errors import OptionError
from loi_core.inspection.drawing import inner_image, isophote_lines, loss_colours, reduced, tonal_image
from loi_core.inspection.findings import Findings, ScaleFindings
from loi_core.inspection.packing import packed_histograms
from loi_core.inspection.pair import Pair
from loi_core.inspection.reach import MIN_RELATIVE_SLOPE
from loi_core.io.files import write_text
from loi_core.io.images import FloatImage, png_bytes
from loi_core.method.comparison import ScaleKey
from loi_core.pixels.display import Display, robust_maximum, signed_to_grey
from loi_core.report.document import asset, data_uri, document, embedded_json, is_made_by
from loi_core.support.arrays import Host
from loi_core.support.charts import sparkline

__all__ = ["check_page", "write_inspection"]

COMMAND: Final = "loi inspect"
PICTURE_SIDE_PX: Final = 640  # longest side of the pictures
SMALL_PICTURE_SIDE_PX: Final = 400  # with more than one scale or many levels
MAP_SIDE_PX: Final = 400  # of loss maps and gradients
SMALL_MAP_SIDE_PX: Final = 240  # with more than `FEW_SCALES` scales
LEVEL_SIDE_PX: Final = 120  # of the pictures of tonal levels; half of it with more than `FEW_LEVELS` levels
FEW_SCALES: Final = 4
FEW_LEVELS: Final = 12
HARD_PIXELS_BELOW_PX: Final = 300  # pictures with a smaller longest side are shown with hard pixels
LEVEL_MARGIN: Final = 1e-9  # in beta, for rounding at the bounds


def check_page(path: Path) -> None:
    """Check that a page may be written to `path`.

    Raises
    ------
    OptionError
        If the name does not end in .html, or the file there is not such a page.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        msg = f"`--output` must end in .html, got {path.name!r}"
        raise OptionError(msg)
    if not path.exists():
        return
    if not path.is_file():
        msg = f"`--output` must be a file, but {path} is not a file"
        raise OptionError(msg)
    if path.stat().st_size and not is_made_by(path, COMMAND):
        msg = f"{path} was not written by `loi inspect`; move it away, or give another `--output`"
        raise OptionError(msg)


def write_inspection(path: Path, findings: Findings) -> int:
    """Write the page and return its number of bytes.

    Raises
    ------
    OptionError
        As :func:`check_page`.
    WriteError
        If it cannot be written.
    """
    check_page(path)
    text = _Page(findings).html()
    write_text(path, text)
    return len(text.encode())


@dataclass
class _Page:
    findings: Findings
    backdrops: list[tuple[str, str]] = field(default_factory=list)  # id and name of pictures to show under the pointer

    @property
    def pair(self) -> Pair:
        return self.findings.pair

    def html(self) -> str:
        sections = [*self._scales(), *self._pictures(), *self._reasons()]  # these fill `backdrops`
        body = "\n".join(["<main>", *self._head(), self._explorer(), *sections, "</main>"])
        facts = f'<script type="application/json" id="facts">{embedded_json(packed_histograms(self.pair))}</script>'
        ratio = f":root {{ --wide: {self.pair.width}; --high: {self.pair.height}; }}\n"
        return document(
            f"Inspection: {self.pair.names[0]}",
            f"{body}\n{facts}",
            style=asset("inspect.css", "loi_core.inspection") + ratio,
            script=asset("inspect.js", "loi_core.inspection"),
            command=COMMAND,
        )

    def _head(self) -> Iterator[str]:
        pair = self.pair
        first, second = map(escape, pair.names)
        yield "<h1>The loss, scale by scale</h1>"
        yield f'<p class="lead">{first}, compared with {second}; {pair.width} x {pair.height} pixels</p>'
        yield f'<p class="loss">The loss is <b>{self.findings.value:.4g}</b>{_largest_share(self.findings)}</p>'
        if pair.shift:
            yield (
                f"<p>There is no second image, so this one is compared with itself, shifted by {pair.shift} px: the "
                "page shows how the loss responds to that shift.</p>"
            )
        if pair.notes:
            yield f'<ul class="notes">{"".join(f"<li>{escape(note)}</li>" for note in pair.notes)}</ul>'

    def _explorer(self) -> str:
        pair = self.pair
        first, second = map(escape, pair.names)
        groups = [(sigma, beta) for sigma in pair.scales.sigma for beta in pair.scales.beta]
        select = ""
        if len(groups) > 1:
            options = "".join(f"<option>sigma {sigma:g} px, beta {beta:g}</option>" for sigma, beta in groups)
            select = f'<label>Scale <select id="group">{options}</select></label>'
        views = "".join(f'<option value="{key}">{escape(name)}</option>' for key, name in self.backdrops)
        return f"""<section aria-labelledby="look">
<h2 id="look">Histograms under the pointer</h2>
<p>Around every pixel the loss forms histograms of intensities, over the extents that the rings show, and compares those
of both images. Where they differ, the image has to change.</p>
<noscript><p>Histograms need JavaScript; everything else is below.</p></noscript>
<div class="explorer">
<div>
<div class="bar"><label>Show <select id="view"><option value="">{first}</option>{views}</select></label>{select}</div>
<div class="stage" id="stage" tabindex="0" role="application" aria-describedby="keys"
 aria-label="Image: arrow keys move the point whose histograms are shown">
{_image("backdrop", self._display(pair.image), pair.names[0])}
<svg id="overlay" aria-hidden="true" focusable="false"></svg></div>
<p class="keys soft" id="keys"><span id="place"></span>. A click fixes the point, another releases it; arrow keys
move it, with Shift farther.</p>
<div class="announced" id="announced" role="status"></div>
</div>
<div>
<div id="charts"></div>
<p class="key"><span>{_swatch("ours")}{first}</span> <span>{_swatch("theirs")}{second}</span>
<span>{_swatch("apart")}between the cumulative histograms: the distance</span></p>
</div>
</div>
</section>"""

    def _scales(self) -> Iterator[str]:
        findings = self.findings
        max_side = MAP_SIDE_PX if len(findings.scales) <= FEW_SCALES else SMALL_MAP_SIDE_PX
        yield '<section aria-labelledby="parts"><h2 id="parts">The contribution of each scale</h2>'
        yield (
            "<p>The loss map is the distance of the two histograms at every pixel; its mean is the contribution of "
            "the scale. The gradient is shown as the colour that each pixel should move to, grey where it should "
            "stay. Each map has its own range.</p>"
        )
        for index, scale in enumerate(findings.scales):
            yield self._card(index, scale, max_side)
        yield (
            "<p><b>Small object</b>: the largest distance of a bright disk, alone on a flat frame of this size, that "
            f"is still drawn to its position. <b>This image</b>: how far {escape(self.pair.names[1])} may be shifted "
            "against itself while its loss still rises, the mean over left, right, up and down; shifts up to "
            f"{findings.shifts.distances[-1]:.0f} px were tried. The curve is that loss. Both end where the slope "
            f"falls below {MIN_RELATIVE_SLOPE:.0%} of its steepest: beyond, the gradient hardly points back. In the "
            "sum of all scales the widest takes over where the narrow ones end.</p></section>"
        )

    def _card(self, index: int, scale: ScaleFindings, max_side: int) -> str:
        name = _scale_name(scale.key, self.pair)
        loss, gradient = loss_colours(reduced(scale.loss, max_side)), signed_to_grey(reduced(-scale.gradient, max_side))
        caption = f"loss map, up to {robust_maximum(scale.loss):.3g}"
        figures = self._figure(f"loss{index}", loss, f"loss map, {name}", caption)
        figures += self._figure(f"gradient{index}", gradient, f"gradient, {name}", "gradient")
        bar = (
            '<svg class="share" viewBox="0 0 100 6" preserveAspectRatio="none" aria-hidden="true">'
            '<rect class="all" width="100" height="6"/>'
            f'<rect class="part" width="{100.0 * scale.share:.1f}" height="6"/></svg>'
        )
        numbers = {
            "of the loss": f"{scale.share:.1%}",
            "adds": f"{scale.value:.4g}",
            "small object": str(scale.reach),
            "this image": str(scale.rise),
        }
        items = "".join(f"<dt>{key}</dt><dd>{escape(value)}</dd>" for key, value in numbers.items())
        shifts = self.findings.shifts
        points = list(zip(shifts.distances, shifts.values[scale.key], strict=True))
        curve = sparkline([points], f"loss by shift, {name}", height=90, shaded_to=scale.rise.distance)
        return (
            f'<article class="card panel"><div><h3>{escape(name)}</h3>{bar}<dl>{items}</dl>{curve}</div>'
            f"{figures}</article>"
        )

    def _pictures(self) -> Iterator[str]:
        pair = self.pair
        yield '<section aria-labelledby="inner"><h2 id="inner">The images at each scale</h2>'
        yield (
            "<p>The inner scale blurs; the tonal scale distinguishes intensities. Isophotes are the lines of equal "
            "intensity at the tonal levels, each channel's in its own colour, and white where all three coincide.</p>"
        )
        yield '<div class="pictures">'
        single = len(pair.scales.sigma) * len(pair.scales.beta) == 1 and self._has_few_levels()
        max_side = PICTURE_SIDE_PX if single else SMALL_PICTURE_SIDE_PX
        images = [("image", pair.image, pair.names[0]), ("reference", pair.reference, pair.names[1])]
        images = images[1:] if pair.shift else images
        yield self._figure("reference", self._display(pair.reference), pair.names[1])
        for key, image, name in images:
            for number, (sigma, computed_sigma) in enumerate(
                zip(pair.scales.sigma, pair.computed_scales.sigma, strict=True)
            ):
                inner = reduced(inner_image(image, pair.computed_scales, computed_sigma), max_side)
                if sigma > 0.0:
                    yield self._figure(f"{key}-{number}", self._display(inner), f"{name} at sigma {sigma:g} px")
                for tonal, beta in enumerate(pair.scales.beta):
                    lines = isophote_lines(inner, self._levels(beta), beta, max_side)
                    caption = f"isophotes of {name}, sigma {sigma:g} px, {beta:g} apart"
                    yield self._figure(f"{key}-lines-{number}-{tonal}", lines, caption)
        yield "</div>"
        for _, image, name in images:
            yield from self._strip(image, name)
        yield "</section>"

    def _strip(self, image: FloatImage, name: str) -> Iterator[str]:
        """Yield an image at the first inner and tonal scale, level by level."""
        scales = self.pair.computed_scales
        beta = scales.beta[0]
        max_side = LEVEL_SIDE_PX if self._has_few_levels() else LEVEL_SIDE_PX // 2
        inner = reduced(inner_image(image, scales, scales.sigma[0]), max_side)
        yield f"<h3>{escape(name)}, one picture for each tonal level: the density of that intensity</h3>"
        yield '<div class="strip">'
        for level in self._levels(beta):
            picture = _image("", tonal_image(inner, level, beta), f"{name} at level {level:g}")
            yield f"<figure>{picture}<figcaption>{level:g}</figcaption></figure>"
        yield "</div>"

    def _reasons(self) -> Iterator[str]:
        first, *lines = map(escape, self.pair.scales.describe(self.pair.height, self.pair.width).splitlines())
        items = "".join(f"<li>{line}</li>" for line in lines)
        yield f'<section aria-labelledby="why"><h2 id="why">Why these scales</h2><p>{first}</p>'
        yield f'<ul class="why">{items}</ul></section>'

    def _has_few_levels(self) -> bool:
        return all(len(self._levels(beta)) <= FEW_LEVELS for beta in self.pair.scales.beta)

    def _levels(self, beta: float) -> Host:
        """Return the tonal levels within the bounds."""
        lower, upper = self.pair.scales.bounds
        levels = self.pair.scales.levels(beta)
        return levels[(levels >= lower - LEVEL_MARGIN * beta) & (levels <= upper + LEVEL_MARGIN * beta)]

    def _display(self, image: FloatImage) -> FloatImage:
        shown: FloatImage = Display.of(self.pair.reference, None).show(reduced(image, PICTURE_SIDE_PX))
        return shown

    def _figure(self, key: str, image: Host, alt: str, caption: str = "") -> str:
        """Return a picture that can also be shown under the pointer."""
        self.backdrops.append((key, alt))
        return f"<figure>{_image(key, image, alt)}<figcaption>{escape(caption or alt)}</figcaption></figure>"


def _image(key: str, image: Host, alt: str) -> str:
    height, width, channels = image.shape
    attributes = (f'id="{key}" ' if key else "") + (
        'class="pixels" ' if max(height, width) < HARD_PIXELS_BELOW_PX else ""
    )
    uri = data_uri(png_bytes(image if channels == 3 else image[..., 0]))
    return f'<img {attributes}width="{width}" height="{height}" alt="{escape(alt)}" src="{uri}" draggable="false">'


def _scale_name(key: ScaleKey, pair: Pair) -> str:
    """Return the name of a scale: its extent, and sigma and beta where there are several."""
    alpha, beta, sigma = key
    labels = [f"extent {alpha:g} px"]
    labels += [f"sigma {sigma:g} px"] if len(pair.scales.sigma) > 1 else []
    labels += [f"beta {beta:g}"] if len(pair.scales.beta) > 1 else []
    return ", ".join(labels)


def _largest_share(findings: Findings) -> str:
    if findings.value == 0.0:
        return ": the two are equal at every scale"
    if len(findings.scales) == 1:
        return ""
    largest = max(findings.scales, key=lambda scale: scale.share)
    return f", {largest.share:.0%} of it from {_scale_name(largest.key, findings.pair)}"


def _swatch(series: str) -> str:
    path = "M0 4H16" if series == "theirs" else "M0 0H16V8H0Z"
    return f'<svg viewBox="0 0 16 8" aria-hidden="true"><path class="{series}" d="{path}"/></svg>'
