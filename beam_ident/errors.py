"""The exceptions of the identification library.

One small tree.  Every class is a ``ValueError`` too, because each of them means
that what was handed in cannot be worked on; numerical trouble inside a fit is not
an exception but a field of the result.
"""

from __future__ import annotations


class IdentificationError(ValueError):
    """Base class of everything that ``beam_ident`` raises on purpose."""


class RecordError(IdentificationError):
    """A record is malformed: stamps, shapes, NaN in an input, no overlap."""


class ExcitationError(IdentificationError):
    """An excitation recipe cannot be built from the numbers given."""


class ExcitationLimitError(ExcitationError):
    """An excitation leaves the travel, speed or acceleration limits of the axis."""


class EstimationError(IdentificationError):
    """An estimation cannot be started with this record and these settings."""


class ModelFormatError(IdentificationError):
    """A stored model or recipe cannot be read back."""


class ReportError(IdentificationError):
    """A page cannot be written: a table that is not one, or a file that would be lost."""
