"""What was asked while the process was frozen is refused when it wakes: real processes, SIGSTOP and SIGCONT."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from beam_ros import messages
from beam_ros.shell.freeze_watch import BEAT_NS, WAKING_NS, FreezeWatch

MS = 1_000_000
WATCHDOG_NS = 250 * MS


def awake_watch() -> FreezeWatch:
    watch = FreezeWatch(WATCHDOG_NS)
    for k in range(100):
        watch.beat(k * 10 * MS)
    return watch


def test_requests_in_time_are_taken() -> None:
    assert awake_watch().objection(995 * MS, 994 * MS) is None
    assert awake_watch().objection(990 * MS + WATCHDOG_NS, 990 * MS) is None
    # Nobody was frozen before the first beat.
    assert FreezeWatch(WATCHDOG_NS).objection(10**15, 0) is None


def test_a_request_after_a_gap_is_refused_whoever_notices_it_first() -> None:
    watch = awake_watch()
    assert watch.objection(3990 * MS, 2000 * MS) == "was frozen for 3.00 s; ask again"
    watch = awake_watch()
    watch.beat(3990 * MS)
    assert watch.objection(3991 * MS, 2000 * MS) == "was frozen for 3.00 s; ask again"


def test_what_was_sent_before_the_process_woke_is_refused_however_late_it_is_delivered() -> None:
    watch = awake_watch()
    for k in range(1000):
        watch.beat(3990 * MS + k * 10 * MS)
    assert watch.objection(13990 * MS, 3990 * MS) == "was frozen for 3.00 s; ask again"
    assert watch.objection(13990 * MS, 3990 * MS + 1) is None


@pytest.mark.parametrize("frozen_s", [0.3, 0.95, 1.05, 3.0])
def test_a_freeze_is_one_that_the_watchdog_does_not_outlast(frozen_s: float) -> None:
    """The axis has stopped after 0.25 s: what was asked before is as stale after 0.95 s as after 1.05 s."""
    watch = awake_watch()
    woke_ns = 990 * MS + round(frozen_s * 1e9)
    assert watch.objection(woke_ns, 990 * MS + 1) == f"was frozen for {frozen_s:.2f} s; ask again"
    # What did not wait longer than the watchdog is none for an axis that has stopped since it was asked.
    assert watch.objection(woke_ns, woke_ns - WATCHDOG_NS) is None
    assert watch.objection(woke_ns, woke_ns - WATCHDOG_NS - 1) is not None
    # By a clock ahead of ours it may look fresh, for as long as the freeze outlasted the watchdog, at most 0.5 s.
    over_ns = woke_ns + min(WAKING_NS, woke_ns - 990 * MS - WATCHDOG_NS)
    for k in range(1, 50):
        watch.beat(woke_ns + k * (over_ns - woke_ns) // 50)
    assert watch.objection(over_ns, over_ns) is not None
    assert watch.objection(over_ns + 1, over_ns) is None


def test_a_beat_that_is_late_by_another_is_no_freeze_however_short_the_watchdog_is() -> None:
    watch = FreezeWatch(40 * MS)
    watch.beat(0)
    assert watch.objection(2 * BEAT_NS, 0) is None


@pytest.mark.ros
def test_what_a_frozen_hub_was_asked_is_refused_when_it_wakes_and_nothing_moves(
    executables, graph, tmp_path: Path
) -> None:
    port = tmp_path / "controller"
    linked = ("-p", f"emulator.port_link:={port}", "-p", f"serial.port:={port}")
    executables.start("firmware_emulator", "--ros-args", *linked).wait_for("motion controller on")
    hub = executables.start("hub_driver", "--ros-args", *linked)
    _frozen_and_asked(graph, hub)


@pytest.mark.ros
def test_a_frozen_simulator_refuses_what_waited_too(executables, graph) -> None:
    hub = executables.start("simulator", "--ros-args", "-p", "simulation.images:=false")
    _frozen_and_asked(graph, hub)


def _frozen_and_asked(graph, hub) -> None:
    sentences, positions = [], []
    graph.listen("/diagnostics", lambda m: sentences.extend(s.message for s in messages.read_diagnostics(m)))
    graph.listen("hub/state", lambda m: positions.append(m.position[0]))
    graph.wait(lambda: bool(positions), "a hub that speaks", 20.0)
    assert graph.call("hub/home").success
    graph.spin(0.3)
    hub.send_signal(signal.SIGSTOP)
    try:
        graph.spin(0.2)
        futures = [
            graph.request("hub/enable", data=True),
            graph.request("hub/home"),
            graph.request("hub/stop"),
        ]
        graph.spin(3.0)
        positions.clear()
    finally:
        hub.send_signal(signal.SIGCONT)
    graph.wait(lambda: all(future.done() for future in futures), "three answers")
    for future in futures[:2]:
        assert not future.result().success
        assert "was frozen for " in future.result().message
        assert "ask again" in future.result().message
    assert futures[2].result().success, futures[2].result().message
    graph.spin(1.0)
    assert len(set(positions)) == 1, positions
    sentences.clear()
    graph.wait(lambda: any("homed" in s or "enabled" in s for s in sentences), "a state")
    assert not any("enabled" in s for s in sentences)
    assert graph.call("hub/enable", data=True).success
