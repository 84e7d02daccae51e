"""Excitations as recipes, from which the motion of the hub follows exactly.

``Recipe.sample`` gives accelerations held over a period, whose exact integration ends at rest at
home; ``Recipe.sample_input`` gives a held force or voltage.  Both are checked against limits, and against
the amplitudes that a known modal model predicts, before anything moves.
"""

from beam_ident.excitation.crest_optimisation import crest_factor
from beam_ident.excitation.levels import DRIVES, Doublet, LevelRecipe, Prbs, Pulse
from beam_ident.excitation.moves import PROFILES, PointToPoint, Step
from beam_ident.excitation.multisine import PHASES, Multisine
from beam_ident.excitation.noise import BandLimitedNoise
from beam_ident.excitation.recipe import RECIPES, Recipe, describe_recipe
from beam_ident.excitation.sampled import AxisLimits, HeldInput, Quantity, SampledExcitation
from beam_ident.excitation.sines import Sine, SteppedSine
from beam_ident.excitation.sweeps import LinearChirp, LogChirp

__all__ = [
    "DRIVES",
    "PHASES",
    "PROFILES",
    "RECIPES",
    "AxisLimits",
    "BandLimitedNoise",
    "Doublet",
    "HeldInput",
    "LevelRecipe",
    "LinearChirp",
    "LogChirp",
    "Multisine",
    "PointToPoint",
    "Prbs",
    "Pulse",
    "Quantity",
    "Recipe",
    "SampledExcitation",
    "Sine",
    "Step",
    "SteppedSine",
    "crest_factor",
    "describe_recipe",
]
