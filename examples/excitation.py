"""Excitation: recipes, limits, predicted amplitudes, crest factors; see docs/excitation.md."""

import json

from simulated_beam import TRUTH

from beam_ident import (
    AxisLimits,
    ExcitationLimitError,
    LogChirp,
    Multisine,
    PointToPoint,
    Recipe,
    excitation_report,
)

# A chirp that the axis can follow and the beam can bear.
axis = AxisLimits(travel=0.05, speed=0.5, acceleration=10.0)
chirp = LogChirp(start_frequency=1.0, end_frequency=45.0, duration=20.0, still=10.0)
excitation = chirp.sample(1e-3, axis)
print(excitation_report(excitation, TRUTH, amplitude_limits={"tip": 0.05}))

# The recipe is the signal: whoever has these numbers has every sample.
again = Recipe.from_dict(json.loads(json.dumps(chirp.to_dict())))
assert (again.sample(1e-3).accelerations == excitation.accelerations).all()

# A periodic signal with lines left out, on which nonlinear distortion would show.
lines = Multisine(end_frequency=45.0, lines="random_odd", detection_group=4, phases="crest", seed=2)
print(f"random-odd multisine: {len(lines.lines_hz)} lines, crest factor {lines.crest_factor():.2f}")

# Too much is refused before anything moves.
try:
    PointToPoint(waypoints=(0.08, 0.0), speed=0.3).sample(1e-3, axis)
except ExcitationLimitError as error:
    print(f"refused: {error}")
