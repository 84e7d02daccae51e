"""The conductor's client on a real graph: who waits for an answer asks again where a hub was frozen."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("refusals", "asked", "status"),
    [(["home refused: the hub's process was frozen for 0.33 s; ask again"], 2, 0), (["not now"], 1, 2)],
)
def test_an_order_refused_for_a_freeze_is_given_anew_and_any_other_is_not(
    executables, graph, refusals: list[str], asked: int, status: int
) -> None:
    n_asked = 0

    def answer(_request, response):
        nonlocal n_asked
        n_asked += 1
        response.success, response.message = n_asked > len(refusals), (*refusals, "at home")[n_asked - 1]
        return response

    graph.node.create_service(graph.types.service_class("std_srvs/srv/Trigger"), "hub/home", answer)
    call = executables.start("beam", "call", "hub/home")
    graph.wait(lambda: call.process.poll() is not None, "the end of the call")
    assert (n_asked, call.wait()) == (asked, status), call.output()
    assert ("at home" if status == 0 else "was refused: not now") in call.output()
