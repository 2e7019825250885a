"""Compiled loops in any number of threads, for many callers, and in forked processes."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

pytest.importorskip("numba")

from loi_core import LOIObjective, ScaleSpace
from loi_core.method.compiled import threads
from tests.helpers import program_output
from tests.strategies import FEWER_EXAMPLES


@FEWER_EXAMPLES
@given(st.integers(1, 90), st.integers(1, 90), st.sampled_from(("float32", "float64")))
@example(1, 1, "float32")
@example(90, 90, "float64")
def test_the_number_of_threads_changes_no_bit(height: int, width: int, dtype: str) -> None:
    rng = np.random.default_rng(0)
    image, reference = rng.uniform(size=(2, height, width, 3)).astype(dtype)
    objective = LOIObjective(reference, ScaleSpace.paper("path"), "balanced")
    results = []
    for count in (1, 2, 5):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(threads, "thread_count", lambda count=count: count)
            results.append(objective.value_and_grad(image))
    for value, gradient in results[1:]:
        assert value == results[0][0]
        np.testing.assert_array_equal(gradient, results[0][1])


def test_concurrent_callers_get_the_same_result_as_one_caller() -> None:
    rng = np.random.default_rng(0)
    images, reference = rng.uniform(size=(6, 80, 70, 3)), rng.uniform(size=(80, 70, 3))
    objective = LOIObjective(reference, ScaleSpace.paper("path"))
    expected = [objective.value_and_grad(image) for image in images]
    with ThreadPoolExecutor(8) as callers:
        results = list(callers.map(objective.value_and_grad, np.concat([images] * 4)))
    for (value, gradient), (expected_value, expected_gradient) in zip(results, expected * 4, strict=True):
        assert value == expected_value
        np.testing.assert_array_equal(gradient, expected_gradient)


FORKS = """
import os, numpy as np
from loi_core import LOIObjective, ScaleSpace

from loi_core.method.compiled import compiling, threads
threads.thread_count = lambda: 3
image, reference = np.random.default_rng(0).uniform(size=(2, 80, 70, 3))
objective = LOIObjective(reference, ScaleSpace.paper("path"))
before = float(objective.value(image))
child = os.fork()
if child == 0:
    os._exit(0 if float(objective.value(image)) == before else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
def test_a_forked_process_starts_its_own_threads() -> None:
    process = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKS], capture_output=True, text=True, timeout=120, check=True
    )
    assert process.stdout.strip() == "0"


LATE = """
import threading, numpy as np
from loi_core import LOIObjective, ScaleSpace

image, reference = np.random.default_rng(0).uniform(size=(2, 80, 70, 3))
def compare():
    threading.main_thread().join()
    print(float(LOIObjective(reference, ScaleSpace.paper("path")).value(image)) > 0)
threading.Thread(target=compare).start()
"""


def test_a_thread_may_compare_after_the_main_thread_has_ended() -> None:
    assert program_output(LATE) == "True"


FORKED_WHILE_PREPARING = """
import os, threading, time, numpy as np
from loi_core import LOIObjective, ScaleSpace

image, reference = np.random.default_rng(0).uniform(size=(2, 120, 90, 1))
def prepare(size):
    objective = LOIObjective(reference[:size], ScaleSpace.paper("path"), "fast")
    return float(objective.value_and_grad(image[:size])[0])
prepare(50)
hung = 0
for number in range(6):
    thread = threading.Thread(target=lambda: [prepare(60 + step) for step in range(12)])
    thread.start()
    time.sleep(0.004 * number)
    child = os.fork()
    if child == 0:
        prepare(70)
        os._exit(0)
    for _ in range(600):
        if os.waitpid(child, os.WNOHANG)[0]:
            break
        time.sleep(0.05)
    else:
        os.kill(child, 9)
        hung += 1
    thread.join()
print(hung)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not fork")
@pytest.mark.parametrize("switch", ["1", "0"])
def test_a_process_forked_while_a_thread_prepares_does_not_hang(switch: str) -> None:
    assert program_output(FORKED_WHILE_PREPARING, LOI_COMPILED=switch) == "0"


def test_an_error_in_a_thread_is_raised_in_the_caller() -> None:
    def fail(_: object) -> None:
        msg = "no"
        raise ArithmeticError(msg)

    with pytest.raises(ArithmeticError, match="no"):
        threads.run_all([fail] * 4, object)
