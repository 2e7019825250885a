"""Parallel runs: each in a worker process that can be killed, over any executor, with one record per finished run.

:mod:`loi_core.sweeps` uses it for fits of scene files.
"""

from loi_core.runs.dask import DaskExecutor
from loi_core.runs.processes import RunResult
from loi_core.runs.records import read_record, write_record
from loi_core.runs.workers import Workers

__all__ = ["DaskExecutor", "RunResult", "Workers", "read_record", "write_record"]
