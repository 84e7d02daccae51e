"""Width of the strip and blur of the lens, as the rows of the first frames show them.

Both change the cross-section alike on either side of its middle, so that neither moves the position; but a wrong one
passes for noise, and edges that are not where they are expected are not found. The width is a parabola along the
strip: a taper, or a camera that looks at it aslant. Gauss-Newton in the three of it and the logarithm of the blur,

    residual = a dT/dw dw(z) + a dT/dln(blur) dln(blur)       beyond what ground, height and shift explain,

starts at the stated width, with a blur so large that edges elsewhere still overlap with those expected. What the
frames tell is added up as information, beginning with how far the stated width may be wrong: a strip narrower than
its blur shows no width of its own, and keeps the stated one.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ros.arrays import Float32Array, FloatArray, IndexArray
from beam_ros.vision.strip.profile import ProfileTable

_DEGREE = 2
_DOUBTS = (0.05, 0.05, 0.02)
"""Standard deviations of mean, taper and bend of the stated width, as shares of it; wide strips soon know better."""
_LEAST, _MOST = 0.5, 1.5
"""Narrower or wider than so many stated widths is not the strip, or not the strip alone."""
_BLURS_PX = (0.3, 4.0)
_FIRST_BLUR_PX, _FIRST_BLUR_DOUBT = 1.0, 1.0
_CERTAINTY = 1e-6
_COARSE = 0.1
"""Blur to begin with, as a share of the width: either edge is off by so much where the width is by a fifth."""
_STEP = math.log(2.0)
"""Longest step of the logarithm of the blur in a turn; the width's is as many blurs."""
_OUTLIER = 4.0
"""A row counts no more than one with so many times the median misfit: it may show something else."""
_SAME = 0.01
"""Changes of either edge and of the blur by so small a share of the blur change nothing."""
_WIDTH_STEP, _MOST_WIDTHS = 0.15, 64
"""Widths are tabulated so many blurs apart."""


class CrossSection:
    """Estimates width and blur from frames that are offered one by one.

    Parameters
    ----------
    width_px : float -- of the strip, as stated [px]
    along : ndarray, shape (n_rows,) -- place of every row along the strip, from -1 to 1
    is_certain : bool -- the stated width stands, and the blur alone is estimated

    Attributes
    ----------
    blur_px : float -- standard deviation of the lens's Gaussian [px]
    widths_px : ndarray, shape (n_rows,) -- width of the strip in every row [px]
    is_plausible : bool -- the frames show widths that may be those of the strip
    """

    def __init__(self, width_px: float, along: FloatArray, *, is_certain: bool = False) -> None:
        self._stated = width_px
        self._terms = np.asarray(np.polynomial.chebyshev.chebvander(along, _DEGREE))
        doubts = _CERTAINTY * np.array(_DOUBTS) if is_certain else np.array(_DOUBTS)
        self._prior = 1.0 / np.concatenate([[_FIRST_BLUR_DOUBT], doubts * width_px]) ** 2
        self._expected = np.array([math.log(_FIRST_BLUR_PX), width_px, 0.0, 0.0])
        self.forget()
        self._take(np.array([math.log(math.hypot(_FIRST_BLUR_PX, _COARSE * width_px)), width_px, 0.0, 0.0]))

    def forget(self) -> None:
        """Forget what the frames told, but not the estimate that is the next one's start."""
        self._information, self._told = np.diag(self._prior), self._prior * self._expected

    def _take(self, found: FloatArray) -> None:
        self._found, self.blur_px = found, math.exp(found[0])
        widths, least, most = self._terms @ found[1:], _LEAST * self._stated, _MOST * self._stated
        self.is_plausible = bool(least < widths.min() and widths.max() < most)
        self.widths_px = np.clip(widths, least, most)

    def learn(
        self,
        table: ProfileTable,
        entry: IndexArray,
        pixels: Float32Array,
        rows: IndexArray,
        seen: np.ndarray | None = None,
    ) -> bool:
        """Add what rows of a strip at rest tell.

        Parameters
        ----------
        table : ProfileTable -- with the present width and blur
        entry : ndarray of int, shape (n,) -- of the rows in the table
        pixels : ndarray, shape (n, size) -- about their columns, near zero [grey levels]
        rows : ndarray of int, shape (n,) -- their indices
        seen : ndarray of bool, shape (n, size), optional -- pixels that are not cut off at white

        Returns
        -------
        bool -- width or blur are other ones, by as much as could be seen
        """
        fits, changes = table.fit(entry, pixels, seen), table.changes()
        misfit = np.maximum(fits.misfit, 0.0)
        usual = max(float(np.median(misfit)), 1e-9)
        weight = (table.size - 3) / np.maximum(usual, misfit / _OUTLIER)
        # Per row: the residual along the changes of T, and these among themselves.
        along = np.einsum("rcw,rw->rc", changes.take(entry, axis=0), table.residual(entry, pixels, seen))
        among = np.einsum("ecw,edw->ecd", changes, changes).take(entry, axis=0).astype(np.float64)
        if seen is not None:
            basis, inverse = table.seen_basis(entry, seen)
            there = changes.take(entry, axis=0) * seen[:, None, :]
            shared = np.einsum("rcw,rkw->rck", there, basis)
            among = there @ there.transpose(0, 2, 1) - shared @ inverse @ shared.transpose(0, 2, 1)
        terms = self._terms[rows]
        start = self._found
        design = np.zeros((len(rows), 2, len(start)))
        design[:, 0, 0], design[:, 1, 1:] = 1.0, terms
        design *= fits.height[:, None, None]
        information = np.einsum("r,rci,rcd,rdj->ij", weight, design, among, design, optimize=True)
        gradient = np.einsum("r,rci,rc->i", weight, design, along.astype(np.float64), optimize=True)
        self._information += information
        self._told += information @ start + gradient
        step = np.linalg.solve(self._information, self._told) - start
        longest = max(abs(step[0]) / _STEP, float(np.sum(np.abs(step[1:]))) / (2.0 * self.blur_px), 1.0)
        found = start + step / longest
        found[0] = np.clip(found[0], *np.log(_BLURS_PX))
        apart = 0.5 * float(np.max(np.abs(self._terms @ (found - start)[1:])))
        if abs(found[0] - start[0]) < _SAME and apart < _SAME * self.blur_px:
            return False
        self._take(found)
        return True

    def tabulated_widths(self) -> tuple[FloatArray, IndexArray]:
        """Return widths for a table, and the index of every row among them.

        Returns
        -------
        widths_px : ndarray, shape (n_widths,) -- ascending [px]
        index : ndarray of int, shape (n_rows,)
        """
        least, most = float(self.widths_px.min()), float(self.widths_px.max())
        count = min(math.ceil((most - least) / (_WIDTH_STEP * self.blur_px)), _MOST_WIDTHS)
        if count <= 1:
            return np.array([0.5 * (least + most)]), np.zeros(len(self.widths_px), dtype=np.intp)
        widths = least + (np.arange(count) + 0.5) * (most - least) / count
        index = np.minimum(((self.widths_px - least) * count / (most - least)).astype(np.intp), count - 1)
        return widths, index
