"""Why something came too late is said with figures, and a computer at rest is not accused."""

from __future__ import annotations

import os

from beam_ros.process.processor_load import ProcessorLoad, processor_load


def test_a_busy_computer_is_named_with_its_load_and_what_the_nodes_got() -> None:
    sentence = ProcessorLoad(12.34, 2, 0.71).sentence()
    assert "2 processors and a load of 12.3" in sentence
    assert "71%" in sentence
    assert "end other programs" in sentence


def test_a_computer_at_rest_is_not_said_to_be_busy() -> None:
    for load in (ProcessorLoad(0.8, 2), ProcessorLoad(3.0, 2, 0.05)):
        assert "end other programs" not in load.sentence()
        assert "logs" in load.sentence()


def test_without_the_kernels_figures_the_load_alone_decides() -> None:
    assert ProcessorLoad(2.5, 2).is_busy
    assert not ProcessorLoad(1.5, 2).is_busy
    assert "%" not in ProcessorLoad(2.5, 2).sentence()


def test_this_process_is_looked_at_and_one_that_has_ended_is_passed_over() -> None:
    load = processor_load([os.getpid(), 2**22 + 1])
    assert load.load >= 0.0
    assert 1 <= load.n_processors <= (os.cpu_count() or 1)
    assert load.waiting_share is None or 0.0 <= load.waiting_share <= 1.0
