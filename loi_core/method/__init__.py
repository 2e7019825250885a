"""The method of the paper. Start with :mod:`loi_core.method.reference`: the whole loss on one page, by brute force.

The steps, in order, and where each is made fast:

1. inner scale, eq. 1: :mod:`~loi_core.method.gaussian` has the kernel, :mod:`~loi_core.method.blurs` applies it;
2. tonal scale, eq. 3: :mod:`~loi_core.method.tonal`;
3. extent scale, eq. 4: the blurs again, through a pyramid;
4. distance, and sum over scales, eq. 5: :mod:`~loi_core.method.distance`.

:mod:`~loi_core.method.scales` says which scales there are. :mod:`~loi_core.method.planner` decides how each is
computed and writes it down as a :mod:`~loi_core.method.plan`. :mod:`~loi_core.method.scope` leaves out what cannot
differ; :mod:`~loi_core.method.sampling_error` estimates afterwards what the plan has cost in accuracy.

Two implementations follow a plan, behind the protocol of :mod:`~loi_core.method.comparison`: whole arrays
(:mod:`~loi_core.method.array_comparison`) and compiled loops (:mod:`~loi_core.method.compiled`).
:mod:`~loi_core.method.dispatch` chooses between them.
"""
