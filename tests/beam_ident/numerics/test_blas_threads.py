from __future__ import annotations

import numpy as np
import pytest

from beam_ident.numerics.blas_threads import _controls, on_one_thread, one_blas_thread


def counts() -> list[int]:
    return [getter() for getter, _ in _controls()]


@pytest.mark.skipif(not _controls(), reason="no OpenBLAS in this process")
def test_threads_are_one_inside_and_as_before_afterwards_even_after_a_fault():
    np.ones((4, 4)) @ np.ones((4, 4))
    before = counts()
    with one_blas_thread():
        assert counts() == [1] * len(before)
    assert counts() == before

    @on_one_thread
    def fails():
        assert counts() == [1] * len(before)
        raise RuntimeError("inside")

    with pytest.raises(RuntimeError, match="inside"):
        fails()
    assert counts() == before


def test_a_wrapped_function_keeps_its_name_and_its_result():
    @on_one_thread
    def double(value: int) -> int:
        """Double."""
        return 2 * value

    assert double(4) == 8
    assert double.__doc__ == "Double."
