"""The law of `harmonics` for corrections of a controller: small changes of many harmonics at once.

A controller is near its end already, and three things count that do not where a voltage is learned from nothing:

- The error is small beside the noise of a batch. It is estimated from all batches: by a Kalman filter for each
  harmonic, whose variance is what is in the error beside the noise, of a harmonic by itself where that is sure, else as
  its neighbours have it.
- Hysteresis moves what is changed at one harmonic to others, up to half of it. The first change is nine tenths of what
  it should be; what it has moved, r, is then known for its direction d, and by it a change dU moves::

      sum_i a_i r_i,    a: the part of dU along the earlier changes d_i

  So the change of U that leaves nothing is found with what it moves. What no earlier change has shown counts as noise.
- Harmonics beyond the bandwidth are excited by the controller, and by hysteresis, and may meet a further mode. What the
  controller outputs there is taken away in the first changes; what then remains is learned, once they have shown R.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from truestroke.base.typing import ComplexArray, FloatArray
from truestroke.control.repeating.harmonics import KEPT, PAIRS, POWER, BoolArray, HarmonicLaw, Spectra, summed
from truestroke.control.repeating.steps import Steps

TAMED = 0.25  # of what a change may harm elsewhere counts, as the next pass corrects it; of the first one, FIRST
FIRST = 2.0
HALF = 0.9  # of a change, the first time
WORSE = 1.5  # times the rmse of the best pass: at a resonance a harmonic may become worse before it becomes better
SHOWN, SHOWN_BEYOND = 5.0, 12.0  # times the variance of the noise: power that is surely none
BESIDE = 4  # harmonics on either side, whose power says what that of one may be
WANDERS = 3e-4  # of the motion: hysteresis that drifts from batch to batch, / (1 + h)^1.5 in the strain of harmonic h
REMOVED = 2  # changes that take away what is put out beyond the bandwidth


class OnlineLaw(HarmonicLaw):
    """The law for corrections of a controller; `beyond` are the learned harmonics beyond the bandwidth."""

    worse = WORSE

    def __init__(self, *given: Any, beyond: BoolArray, **named: Any) -> None:
        super().__init__(*given, **named)
        self._beyond = beyond
        self._followed, self._first = 0, 0.0

    @property
    def first(self) -> float:
        """Error of the first batch, or of the best one since the stage has changed if that is larger, um."""
        return self._first if self._base is None else max(self._first, self._base[0])

    # ---- The error --------------------------------------------------------------------------------------------------

    def _estimate_error(self, before: Spectra | None, this: Spectra) -> Steps[None]:
        U, Z, noise2 = this
        E = self.desired - Z
        if before is None or self._changed:
            self._pairs, self._error, self._spread = [], np.zeros_like(E), np.zeros(E.size)
        else:
            x = self.response * self.ratio * (U - before[0])
            self._error = self._error - x
            self._spread = self._spread / KEPT + np.abs(x) ** 2 * self._doubt
        yield
        beside = yield from self._beside_noise(E - self._error, noise2)
        yield
        spread = np.maximum(self._spread, beside)
        share = spread / np.maximum(spread + noise2, 1e-300)
        self._error = self._error + share * (E - self._error)
        self._error[0] = E[0]  # it creeps
        self._spread = (1 - share) * spread
        self._pairs = [*self._pairs[-PAIRS:], (U, E, noise2)]

    def _beside_noise(self, x: ComplexArray, noise2: FloatArray) -> Steps[FloatArray]:
        """Mean square of what is in x beside noise."""
        power, near = np.abs(x) ** 2, self._moving & ~self._beyond
        window = np.ones(2 * BESIDE + 1)
        around, many = summed(np.where(near, power - noise2, 0.0), window), summed(1.0 * near, window)
        yield
        less = np.where(near, around / np.maximum(many, 1.0), 0.0)
        sure = power > np.where(self._beyond, SHOWN_BEYOND, SHOWN) * noise2
        return np.maximum(np.where(sure, power - noise2, less), 0.0)

    def _weight(self, E: ComplexArray, noise2: FloatArray) -> FloatArray:
        """The noise that the estimate still has counts where hysteresis moves it to others."""
        own = np.abs(self.response * self.ratio) ** 2 * (1 + self._doubt)
        return super()._weight(E, self._spread * (self._louder(own) - 1))

    # ---- The change -------------------------------------------------------------------------------------------------

    def _change(self, U: ComplexArray, E: ComplexArray, step: FloatArray) -> Steps[ComplexArray]:
        first = self._followed == 0
        B, B2 = self.response * self.ratio, np.abs(self.response * self.ratio) ** 2
        assert self._base is not None
        self._first = self._base[0] if first else self._first
        moved = self._moves(self._beyond)
        own = B2 * (1 + self._doubt)
        yield
        step = step * own / (own + moved)  # a harmonic that takes much voltage for little displacement moves the others
        T = np.where(self._moving, step * np.conj(B) / np.maximum(B2, 1e-300), 0.0)
        change = T * E
        change[0] = step[0] * E[0] / B[0]
        yield
        removes = self._beyond & (self._followed < REMOVED)
        change, T = np.where(removes, -U, change), np.where(removes, 0.0, T)
        if first:
            self._pairs = self._pairs[-1:]  # those before are of a controller that learned
        self._followed += 1
        change, fresh = yield from self._with_moved(change, U, T)
        yield
        made = (FIRST if first else TAMED) * self._crossed(np.where(removes, 0.0, B * fresh))
        yield
        won = float(np.sum((np.abs(E) ** 2 * step)[self._moving]))
        lost = float(np.sum((np.abs(E) ** 2 * step**2 * (1 + self._doubt) + made)[self._moving]))
        share = min(1.0, won / max(lost, 1e-300))
        return np.asarray(change * (min(share, HALF) if first else share))

    @property
    def least(self) -> FloatArray:
        """As of `HarmonicLaw`, and of the drift of the hysteresis, which a resonance amplifies."""
        share = WANDERS * np.abs(self.response / self.response[0]) / (1.0 + np.arange(self.response.size)) ** POWER
        return np.asarray(super().least + share**2 * np.sum(np.abs(self.desired[1:]) ** 2))

    # ---- Hysteresis -------------------------------------------------------------------------------------------------

    def _hidden(self, crossed: FloatArray) -> FloatArray:
        return crossed

    def _crossed(self, x: ComplexArray) -> FloatArray:
        """As of `HarmonicLaw`: it reaches the neighbours, and the stage amplifies it there."""
        size = np.abs(self.response[1:])
        return np.append(0.0, size**2 * summed(np.abs(x[1:] / size) ** 2, self._neighbours))
