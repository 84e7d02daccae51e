"""The next experiment, designed from the last: what leaves the smallest uncertainty; see docs/excitation.md."""

import numpy as np
from simulated_beam import film

from beam_ident import (
    AxisLimits,
    ExcitationLimits,
    LimitedResponse,
    LogChirp,
    Observation,
    design_experiment,
    identify,
)

# What is known so far: a short chirp of little level.
first = LogChirp(start_frequency=1.0, end_frequency=45.0, duration=6.0, still=2.0, acceleration=0.3)
known = identify(film(1, first)).model

# As long again, within what axis and tip bear.
design = design_experiment(
    known,
    ExcitationLimits(
        AxisLimits(travel=0.05, speed=0.5, acceleration=5.0), [LimitedResponse(known, {"tip": 0.03})]
    ),
    Observation(rate_hz=100.0, exposure_s=5e-3, noise_sd={"root": 4e-6, "tip": 4e-6}),
    duration_s=8.0,
    band_hz=(1.0, 45.0),
    frequency_sd=5e-4,
    damping_sd=0.05,
)
print(design)

# What the design promises, and what the record of the next experiment then states.
found = identify(film(2, design.recipe)).model
promised, stated = design.optimal.predicted.damping_ratio_sd, found.damping_ratio_sd
print("damping ratios", found.damping_ratios, "+-", stated, ", promised", promised)
assert np.all(np.abs(stated / promised - 1.0) < 0.15)
