"""The method of the paper. Start with :mod:`loi_core.method.reference`: the whole loss on one page, by brute force.

The steps, and the modules with their fast implementations:

1. inner scale, eq. 1: :mod:`~loi_core.method.gaussian` has the kernel, :mod:`~loi_core.method.blurs` applies it;
2. tonal scale, eq. 3: :mod:`~loi_core.method.tonal`;
3. extent scale, eq. 4: the blurs again, through a pyramid;
4. distance, and sum over scales, eq. 5: :mod:`~loi_core.method.distance`.

:mod:`~loi_core.method.scales` defines the scales. :mod:`~loi_core.method.planner` chooses the samplings and blurs of
each scale, the :mod:`~loi_core.method.plan`. :mod:`~loi_core.method.support` finds the pixels and levels that can
differ, and :mod:`~loi_core.method.sampling_error` estimates the error of a result.

Two implementations follow a plan, behind the protocol of :mod:`~loi_core.method.comparison`: whole arrays
(:mod:`~loi_core.method.array_comparison`) and compiled loops (:mod:`~loi_core.method.compiled`).
:mod:`~loi_core.method.dispatch` chooses between them.
"""
