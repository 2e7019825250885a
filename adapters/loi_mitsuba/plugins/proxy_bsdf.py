"""The surface that stands in a neighbouring scene for a perfectly smooth one, where lights have no size.

A rough surface reflects light that comes straight from such a light; a smooth one does not, for no path finds it. What
stands for it is rough, and looks for light as a smooth one does: only by the direction in which a ray is reflected.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import drjit as dr
import mitsuba as mi

__all__ = ["register_proxy_bsdf"]

NAME: Final = "loi_mirror"


def register_proxy_bsdf() -> str:
    """Have the current variant of Mitsuba know the surface; its name."""
    _register(mi.variant())
    return NAME


@functools.cache
def _register(variant: str) -> None:  # noqa: ARG001  # once for each
    """Register the surface. Its class is made here, for those that it derives from and uses are the variant's own."""
    flags = mi.BSDFFlags

    class Mirror(mi.BSDF):  # type: ignore[misc]  # Mitsuba has no types
        """A rough surface, `rough`, whose glossy lobes lamps are not sampled for.

        Mitsuba's integrators sample lamps by `eval_pdf`, which has only the other lobe if there is one. Directions that
        are drawn from a glossy lobe are told to be the only ones, as those of a smooth surface are.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.rough = props["rough"]
            self.m_components = [self.rough.flags(number) for number in range(self.rough.component_count())]
            self.m_flags = self.rough.flags()
            glossy = [bool(int(one) & int(flags.Glossy)) for one in self.m_components]
            self.glossy = tuple(number for number, one in enumerate(glossy) if one)
            self.other = next((number for number, one in enumerate(glossy) if not one), None)  # that of plastic

        def traverse(self, callback: Any) -> None:
            self.rough.traverse(callback)

        def parameters_changed(self, keys: Any) -> None:
            self.rough.parameters_changed(keys)

        def sample(self, context: Any, si: Any, first: Any, second: Any, active: Any) -> tuple[Any, Any]:
            if self.other is None:
                sample, weight = self.rough.sample(context, si, first, second, active)
                return _single(sample), weight
            of_glossy, of_other = _only(context, self.glossy[0]), _only(context, self.other)
            reflects = first < 0.5
            sample, weight = self.rough.sample(of_glossy, si, 2.0 * first, second, active & reflects)
            other, other_weight = self.rough.sample(of_other, si, 2.0 * first - 1.0, second, active & ~reflects)
            drawn = dr.select(reflects, _single(sample), other)
            drawn.pdf *= 0.5
            return drawn, 2.0 * dr.select(reflects, weight, other_weight)

        def eval(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.rough.eval(context, si, wo, active)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.eval_pdf(context, si, wo, active)[1]

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
            if self.other is None:
                return mi.Spectrum(0.0), mi.Float(0.0)
            value, pdf = self.rough.eval_pdf(_only(context, self.other), si, wo, active)
            return value, 0.5 * pdf

        def to_string(self) -> str:
            return f"Mirror[{self.rough}]"

    def _single(sample: Any) -> Any:
        """A sample that is said to be of a single direction."""
        through = mi.has_flag(sample.sampled_type, flags.GlossyTransmission)
        kinds = (mi.UInt32(int(one)) for one in (flags.DeltaTransmission, flags.DeltaReflection))
        sample.sampled_type = dr.select(through, *kinds)
        return sample

    def _only(context: Any, number: int) -> Any:
        one = mi.BSDFContext(context.mode)
        one.component = number
        return one

    mi.register_bsdf(NAME, lambda props: Mirror(props))
