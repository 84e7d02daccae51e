from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.gate.sequence_assembly import BLOCK_TICKS, Sequence


def test_coarser_samples_are_held_or_joined_as_the_mode_does_it():
    assert Sequence("s", 1, np.array([1.0, 2.0]), 3).ticks(0, 99).tolist() == [1, 1, 1, 2, 2, 2]
    assert Sequence("s", 1, np.array([0.0, 3.0]), 3, "linear").ticks(0, 99).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("hold", ["zoh", "linear"])
@pytest.mark.parametrize("multiple", [1, 7])
def test_ticks_from_anywhere_are_those_of_the_whole(hold, multiple):
    values = np.random.default_rng(1).standard_normal(5000)
    sequence = Sequence("s", 1, values, multiple, hold)
    k = np.arange(sequence.n_ticks)
    whole = values[k // multiple] if hold == "zoh" else np.interp(k / multiple, np.arange(5000), values)
    for first, end in ((0, 1), (3, 11), (4321, 4999), (sequence.n_ticks - 2, sequence.n_ticks + 50)):
        assert sequence.ticks(first, end) == pytest.approx(whole[first:end], abs=1e-12)
    blocks = list(sequence.blocks())
    assert max(map(len, blocks)) <= BLOCK_TICKS
    assert np.concatenate(blocks) == pytest.approx(whole, abs=1e-11)
