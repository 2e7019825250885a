"""Runs on a cluster of Dask."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, Final, ParamSpec, TypeVar

from loi_core.errors import ExecutorError
from loi_core.support.installed import how_to_install
from loi_core.support.wording import described, shown

__all__ = ["DaskExecutor"]

PATIENCE: Final = 10.0  # seconds until a scheduler has answered
Given = ParamSpec("Given")
Result = TypeVar("Result")


class DaskExecutor(Executor):
    """An executor whose workers are those of a Dask cluster; needs the extra ``dask``.

    Every thread of a worker carries out one run at a time. If a worker is lost, the scheduler has another one begin its
    runs again, a few times. The scheduler and all workers need this library, and the files that runs read and write
    under the same paths.

    Parameters
    ----------
    cluster : str or distributed.Client
        The address of the scheduler, such as "tcp://10.0.0.1:8786", or a client, which then stays open.

    Raises
    ------
    ExecutorError
        If ``distributed`` is not installed, or no scheduler answers.
    """

    def __init__(self, cluster: Any) -> None:
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            msg = f"runs on Dask need the package {error.name}: {how_to_install('dask')}"
            raise ExecutorError(msg) from None
        self._own = not isinstance(cluster, Client)
        try:
            self._client: Any = Client(cluster, timeout=PATIENCE, set_as_default=False) if self._own else cluster
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            msg = f"no Dask scheduler answers at {shown(cluster)} ({described(error)})"
            raise ExecutorError(msg) from None
        self._executor: Executor = self._client.get_executor(pure=False)

    def submit(self, fn: Callable[Given, Result], /, *args: Given.args, **kwargs: Given.kwargs) -> Future[Result]:
        """Have a worker call a function."""
        return self._executor.submit(fn, *args, **kwargs)

    def everywhere(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Have every worker that answers call a function once."""

        def tell() -> None:
            with contextlib.suppress(Exception):  # of a cluster that is gone nothing is left to be told
                self._client.run(function, *arguments, on_error="ignore")

        telling = threading.Thread(target=tell, daemon=True)
        telling.start()
        telling.join(PATIENCE)  # a worker that is stopped would be waited for without end

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: FBT001, FBT002 - the base's
        """Submit no more; a client that was made here is closed."""
        self._executor.shutdown(wait=wait and not cancel_futures)
        if self._own:
            self._client.close()
