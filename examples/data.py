"""Data: every signal keeps its own clock; gaps are NaN; nothing is resampled."""

import numpy as np
from simulated_beam import film

from beam_ident import InputSignal, OutputSignal, RecordError, TimeRecord, identify

# Hub commands: accelerations that a device holds for 1 ms. Frames: stamps as they came, each an average over 5 ms.
accelerations = np.zeros(2000)
accelerations[100:200] = 0.3
hub = InputSignal("hub", "m/s^2", (0.0, 1e-3), accelerations, hold="zoh")
stamps = np.sort(0.01 * np.arange(1, 190) + np.random.default_rng(0).uniform(-1e-3, 1e-3, 189))
tip = np.zeros(189)
tip[50:53] = np.nan  # not seen in three frames
record = TimeRecord((hub,), (OutputSignal("tip", "m", stamps, tip, exposure_s=5e-3),), name="by hand")
print(f"{record.name}: {record.output_names}, {np.sum(record.output('tip').is_valid)} of 189 frames seen")

# Parts of a record, for estimation and validation; names choose outputs.
whole = film(1)
first, second = whole.between(0.0, 6.0), whole.between(6.0, 12.0)
print(f"{len(first.output('tip').times_s)} and {len(second.output('tip').times_s)} frames in the parts")
print(f"{whole.select(['tip']).output_names} alone")

# Several experiments enter one fit as a list.
both = identify([film(1), film(2)], n_modes=2)
print("two runs together:", ", ".join(f"{f:.4f} Hz" for f in both.model.frequencies_hz))

# What cannot be right is refused where it enters.
try:
    InputSignal("hub", "m", np.array([0.0, 0.2, 0.1]), np.zeros(3))
except RecordError as error:
    print(f"refused: {error}")
