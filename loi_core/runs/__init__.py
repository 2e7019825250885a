"""Parallel runs in worker processes that can be killed, here or on a Dask cluster, with one record per finished run.

:mod:`loi_core.sweeps` uses it for fits of scene files.
"""

from loi_core.runs.processes import RunResult
from loi_core.runs.records import read_record, write_record
from loi_core.runs.workers import Workers

__all__ = ["RunResult", "Workers", "read_record", "write_record"]
