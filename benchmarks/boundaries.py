"""Compare gradients of moving shapes in a loop with ``mi.render``: ``python -m benchmarks.boundaries``.

The table has the cosine between the gradient with respect to a translation and central differences, and the ratio of
their norms, for an integrator of Mitsuba and for the one of `mitsuba_boundaries` that extends it. The last column names
the issue on Mitsuba's tracker that reports a wrong gradient in such a scene.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import mitsuba_boundaries  # noqa: F401 - before mitsuba

# isort: split
import mitsuba as mi

from benchmarks.gradients import use_one_thread
from loi_core.support.markdown import markdown

SAMPLES = 128


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=8, help="number of gradients that are averaged (default: 8)")
    options = parser.parse_args()
    use_one_thread()
    from tests.mitsuba.moving_scenes import SCENES

    integrators = [{"type": name, "guiding": "none"} for name in ("direct_projective", "direct_boundaries")]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in SCENES.items():
            agreements = scene.agreement(Path(folder), integrators, spp=SAMPLES, seeds=options.seeds)
            rows.append((name, *(f"{cosine:.3f}, {norm:.2f}" for cosine, norm in agreements), scene.report))
    print(f"Cosine, and norm over the norm of central differences; {mi.variant()}")
    print("\n".join(markdown(["scene", "direct_projective", "direct_boundaries", "reported in"], rows)))


if __name__ == "__main__":
    main()
