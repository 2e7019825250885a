"""A rough BSDF that replaces a perfectly smooth one in proxy scenes with delta lights.

A smooth surface shows no delta light, because no path can hit one; a rough surface reflects its emitter samples. This
BSDF is rough, but its glossy lobes are hidden from emitter sampling.
"""

from __future__ import annotations

import functools
from typing import Any, Final

import drjit as dr
import mitsuba as mi

__all__ = ["register_proxy_bsdf"]

NAME: Final = "proxy_bsdf"


def register_proxy_bsdf() -> str:
    """Register the plugin with Mitsuba's current variant and return its name."""
    _register(mi.variant())
    return NAME


@functools.cache
def _register(variant: str) -> None:  # noqa: ARG001  # once for each variant
    """Register the plugin. Its class is defined here, because the classes that it uses are the variant's own."""
    flags = mi.BSDFFlags

    class ProxyBSDF(mi.BSDF):  # type: ignore[misc]  # Mitsuba has no types
        """The BSDF `rough`, with glossy lobes that are hidden from emitter sampling.

        Mitsuba's integrators weight emitter samples by `eval_pdf`, which here has only the other lobe, if there is one.
        Samples of a glossy lobe are flagged as delta samples, so that they are not weighted against emitter samples.
        """

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.rough = props["rough"]
            self.m_components = [self.rough.flags(number) for number in range(self.rough.component_count())]
            self.m_flags = self.rough.flags()
            glossy = [bool(int(component) & int(flags.Glossy)) for component in self.m_components]
            self.glossy = tuple(number for number, is_glossy in enumerate(glossy) if is_glossy)
            self.diffuse = next(
                (number for number, is_glossy in enumerate(glossy) if not is_glossy), None
            )  # of plastic

        def traverse(self, callback: Any) -> None:
            self.rough.traverse(callback)

        def parameters_changed(self, keys: Any) -> None:
            self.rough.parameters_changed(keys)

        def sample(self, context: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> tuple[Any, Any]:
            if self.diffuse is None:
                sample, weight = self.rough.sample(context, si, sample1, sample2, active)
                return _flagged_as_delta(sample), weight
            glossy_context, diffuse_context = _only(context, self.glossy[0]), _only(context, self.diffuse)
            is_glossy = sample1 < 0.5
            glossy, glossy_weight = self.rough.sample(glossy_context, si, 2.0 * sample1, sample2, active & is_glossy)
            diffuse, diffuse_weight = self.rough.sample(
                diffuse_context, si, 2.0 * sample1 - 1.0, sample2, active & ~is_glossy
            )
            sample = dr.select(is_glossy, _flagged_as_delta(glossy), diffuse)
            sample.pdf *= 0.5
            return sample, 2.0 * dr.select(is_glossy, glossy_weight, diffuse_weight)

        def eval(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.rough.eval(context, si, wo, active)

        def pdf(self, context: Any, si: Any, wo: Any, active: Any) -> Any:
            return self.eval_pdf(context, si, wo, active)[1]

        def eval_pdf(self, context: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any]:
            if self.diffuse is None:
                return mi.Spectrum(0.0), mi.Float(0.0)
            value, pdf = self.rough.eval_pdf(_only(context, self.diffuse), si, wo, active)
            return value, 0.5 * pdf

        def to_string(self) -> str:
            return f"ProxyBSDF[{self.rough}]"

    def _flagged_as_delta(sample: Any) -> Any:
        transmitted = mi.has_flag(sample.sampled_type, flags.GlossyTransmission)
        types = (mi.UInt32(int(flag)) for flag in (flags.DeltaTransmission, flags.DeltaReflection))
        sample.sampled_type = dr.select(transmitted, *types)
        return sample

    def _only(context: Any, number: int) -> Any:
        restricted = mi.BSDFContext(context.mode)
        restricted.component = number
        return restricted

    mi.register_bsdf(NAME, lambda props: ProxyBSDF(props))
