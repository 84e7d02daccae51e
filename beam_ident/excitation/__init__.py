"""Excitations as recipes, from which the motion of the hub follows exactly.

``Recipe.sample`` gives accelerations held over a period, whose exact integration ends at rest at
home; ``Recipe.sample_input`` gives a held force or voltage.  Both are checked against limits, and against
the amplitudes that a known modal model predicts, before anything moves.
"""

from beam_ident.excitation.crest_optimisation import crest_factor as crest_factor
from beam_ident.excitation.levels import DRIVES as DRIVES
from beam_ident.excitation.levels import Doublet as Doublet
from beam_ident.excitation.levels import LevelRecipe as LevelRecipe
from beam_ident.excitation.levels import Prbs as Prbs
from beam_ident.excitation.levels import Pulse as Pulse
from beam_ident.excitation.moves import PROFILES as PROFILES
from beam_ident.excitation.moves import PointToPoint as PointToPoint
from beam_ident.excitation.moves import Step as Step
from beam_ident.excitation.multisine import PHASES as PHASES
from beam_ident.excitation.multisine import Multisine as Multisine
from beam_ident.excitation.multisine import ShapedMultisine as ShapedMultisine
from beam_ident.excitation.noise import BandLimitedNoise as BandLimitedNoise
from beam_ident.excitation.recipe import RECIPES as RECIPES
from beam_ident.excitation.recipe import Recipe as Recipe
from beam_ident.excitation.recipe import describe_recipe as describe_recipe
from beam_ident.excitation.sampled import AxisLimits as AxisLimits
from beam_ident.excitation.sampled import HeldInput as HeldInput
from beam_ident.excitation.sampled import Quantity as Quantity
from beam_ident.excitation.sampled import SampledExcitation as SampledExcitation
from beam_ident.excitation.shaped_move import ShapedMove as ShapedMove
from beam_ident.excitation.sines import Sine as Sine
from beam_ident.excitation.sines import SteppedSine as SteppedSine
from beam_ident.excitation.sweeps import LinearChirp as LinearChirp
from beam_ident.excitation.sweeps import LogChirp as LogChirp
from beam_ident.excitation.trajectory import Trajectory as Trajectory
