"""The reference work's lists of figures and tables (2020), line by line, and what this document has for each line."""

from __future__ import annotations

from dataclasses import dataclass

REFERENCE = "Nguyen Van Thuat, Identification of a flexible cantilever beam, master's thesis, HCMC 2020"


@dataclass(frozen=True)
class Entry:
    """One line of the reference work's lists.

    Attributes
    ----------
    number : str -- "Table 4.1", "Figure 4.12"
    title : str -- as it is listed there
    here : str -- what stands here for it
    beyond : str -- what this says that the reference work could not; empty for lines that no data can produce
    """

    number: str
    title: str
    here: str
    beyond: str = ""


_PHOTOGRAPH = "a photograph of the set-up; the drawing of the rig stands in its place"

ENTRIES = (
    Entry("Figure 1.1", "Cantilever beam structures.", "examples from other fields; no data"),
    Entry(
        "Figure 2.1",
        "Configuration of vibration cantilever beam.",
        "a sketch; the drawing of the rig shows it",
    ),
    Entry("Figure 3.1", "Interrelation among dynamic models.", "a scheme; no data"),
    Entry("Figure 3.2", "Measurement system with noise sources.", "a scheme; no data"),
    Entry(
        "Figure 4.1",
        "Time response of the chirp excitation and output signal.",
        "the same, by the beam's model alone, without noise",
        "What left-out modes add statically is in it; without that the deflection at 10 mm errs by percents.",
    ),
    Entry(
        "Figure 4.2",
        "Simulation frequencies response of the system.",
        "the same, from the hub's position to both points",
        "Modes above half the camera's frame rate are there too, each at its own frequency.",
    ),
    Entry(
        "Figure 4.3",
        "Comparison of the response obtained by the experiment and the numerical simulation",
        "the same, on one clock, with the difference",
        "The difference is drawn to its own scale: an overlay hides what is smaller than a line is wide.",
    ),
    Entry("Figure 4.4", "Schematic diagram of the experimental set-up.", _PHOTOGRAPH),
    Entry("Figure 4.5", "The studied beam with a dark background.", _PHOTOGRAPH),
    Entry("Figure 4.6", "Measured points in the beam.", "the drawing of the rig shows their heights"),
    Entry("Figure 4.7", "Calibration procedure set-up", _PHOTOGRAPH),
    Entry(
        "Figure 4.8",
        "Curve fitting line converting the pixels value (from camera) to mm value (from laser sensor).",
        "the same for every marker; the reference is the sensor that the bag was calibrated against",
        "Every point has its residual, the line its standard deviation, and curvature and hysteresis are tested.",
    ),
    Entry(
        "Figure 4.9",
        "Measured chirp input and output signal in time domain.",
        "the same",
        "The output at 10 mm is the hub's motion to a fraction of a percent: what the beam adds is drawn by itself.",
    ),
    Entry(
        "Figure 4.10",
        "The two resonance frequencies with the chirp input signal.",
        "the same: the response of the deflection, with the identified frequencies",
        "A standard deviation for both frequencies, smaller than the distance of two lines of the spectrum.",
    ),
    Entry("Figure 4.11", "Experimental measured input and output signals.", "the same, of the multisine E2"),
    Entry(
        "Figure 4.12",
        "Signal spectrum analyzing.",
        "the same, of the multisine E2",
        "The floor of the noise stands beside the signal, so that one sees where the experiment says nothing.",
    ),
    Entry(
        "Figure 4.13",
        "Bode diagram of estimated model at 10mm.",
        "the same: models from E1 and E2, with theory and with the measured response",
        "95 % bands; at 10 mm only the deflection tells models apart, and it is what is drawn.",
    ),
    Entry(
        "Figure 4.14",
        "Bode diagram of estimated model at 225mm.",
        "the same as figure 4.13, at the upper point",
        "225 mm lies near the node of mode 2: its small residue there is known, not lost.",
    ),
    Entry(
        "Figure 4.15",
        "Model predicted output y10 using dataset E1 vs. validation output V2",
        "the same, with the residual",
        "How well the hub alone would predict this output is said beside it.",
    ),
    Entry(
        "Figure 4.16",
        "Model predicted output y225 using dataset E1 vs. validation output V2",
        "the same, with the residual",
        "The residual is compared with the noise of the estimation, and tested for what it still holds of the input.",
    ),
    Entry(
        "Figure 4.17",
        "Comparison of estimated models' responses vs. the validation step signal.",
        "the same",
        "Residuals of every model to one scale.",
    ),
    Entry(
        "Table 4.1",
        "System Parameters.",
        "the rig that the bags describe, with the frequencies that follow from it",
        "The reference work's tip-load energy T_t (2.6), announced there and not written out, is in the model; its "
        "modal damping (2.43) prints K where C belongs.",
    ),
    Entry(
        "Table 4.2",
        "Model order selection results using dataset E2 for output at 10mm.",
        "transfer functions of 2 to 6 poles and zeros",
        "The criterion YIC of the reference work stands beside AIC and BIC; for lightly damped modes it takes orders "
        "that are too low. Orders whose poles mean nothing are refused, with the reason.",
    ),
    Entry(
        "Table 4.3",
        "Model order selection results using dataset E2 for output at 225mm.",
        "the same at the upper point",
        "As table 4.2. Six poles win where the flank of a third mode is felt that the excitation does not reach.",
    ),
    Entry(
        "Table 4.4",
        "Excitation signal and its function.",
        "every recording with its recipe and what it is for",
        "What each was predicted to do to the beam before anything moved.",
    ),
    Entry(
        "Table 4.5",
        "Estimated model parameters and validation results at 10mm.",
        "coefficients from E1 and from E2, and both models on V1, V2 and the step",
        "A standard deviation for every coefficient, and whether the two data sets agree within them.",
    ),
    Entry(
        "Table 4.6",
        "Estimated model parameters and validation results at 225mm.",
        "the same at the upper point",
        "As table 4.5.",
    ),
    Entry(
        "Table 4.7",
        "Modal parameters for the identified models.",
        "frequency and damping ratio of both modes, by every model, beside theory",
        "Intervals; a fit of all points at once with common poles; the amplitude for which a damping ratio holds.",
    ),
    Entry(
        "Table 4.8",
        "The fitness percentage (FP) of identified models with step signal.",
        "fit of every model to the measured step, and to each other's response",
        "The fit of the plain simulation from rest as well: nothing of the record is fitted there.",
    ),
)
"""Every line of the two lists, in their order."""

BY_NUMBER = {entry.number: entry for entry in ENTRIES}
