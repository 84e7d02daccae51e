"""An estimate that is still growing, made of the model of the packaged rig: all that the page can show of one."""

from __future__ import annotations

from typing import Any

import numpy as np

from beam_ros.rig.rig import Rig


def live_example(record_s: float = 12.0) -> dict[str, Any]:
    """Return the content of ``identification/live`` after some seconds of record; its band shrinks as their root."""
    rig = Rig.from_file()
    model = rig.beam_model()
    frequencies = np.linspace(1.0, 45.0, 200)
    share = 0.5 / np.sqrt(record_s)
    rng = np.random.default_rng(1)
    outputs = {}
    for name, height in zip(rig.markers.names, rig.markers.heights, strict=True):
        response = model.frequency_response(2 * np.pi * frequencies, [height])
        magnitude = np.abs(np.ravel(response.values))
        noise = 1.0 + 0.1 * rng.standard_normal(len(frequencies))
        measured = [float(value) if k % 3 else None for k, value in enumerate(magnitude * noise)]
        outputs[name] = {
            "model": magnitude.tolist(),
            "model_sd": (share * magnitude).tolist(),
            "measured": measured,
        }
    shapes = model.shape(np.array(rig.markers.heights))[:, :2].T
    found = zip(model.natural_frequencies[:2] / (2 * np.pi), model.damping_ratios[:2], strict=True)
    return {
        "version": 1,
        "state": "growing",
        "sentence": "two modes so far.",
        "record_s": record_s,
        "samples": {"input": round(1000 * record_s), "z225": round(100 * record_s)},
        "started": 1_700_000_000.0,
        "modes": [
            {
                "frequency_hz": float(frequency),
                "frequency_sd_hz": float(1e-3 * share * frequency),
                "damping_ratio": float(ratio),
                "damping_ratio_sd": float(0.1 * share * ratio),
            }
            for frequency, ratio in found
        ],
        "response": {"input": "hub/measured", "frequency_hz": frequencies.tolist(), "outputs": outputs},
        "shape": {"heights_m": list(rig.markers.heights), "modes": shapes.tolist()},
        "tests": [
            {"assumption": "residuals are white", "test": "portmanteau, z225", "p": 0.4, "verdict": "holds"},
            {
                "assumption": "residuals do not follow the hub",
                "test": "correlation",
                "p": 1e-4,
                "verdict": "fails",
            },
            {"assumption": "modes do not change", "test": "score", "p": None, "verdict": "not tested"},
        ],
        "aims": [
            {"name": "f1", "relative_sd_asked": 1e-4, "relative_sd": 9e-5, "seconds_to_go": 0.0, "met": True},
            {
                "name": "zeta1",
                "relative_sd_asked": 0.02,
                "relative_sd": 0.06,
                "seconds_to_go": 41.0,
                "met": False,
            },
        ],
        "cost": {"share_of_core": 0.12, "seconds_of_last_fit": 0.4},
    }
