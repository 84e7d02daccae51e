"""A gate as plain words."""

from __future__ import annotations

import json

from beam_ident.report.gates import Gate


def test_a_gate_goes_into_json_and_back() -> None:
    gate = Gate("gaps", "doubtful", "2 gaps, 31 ms at 4.2 s", "none", "record with less load")
    assert Gate(**json.loads(json.dumps(gate.to_dict()))) == gate  # type: ignore[arg-type]
