"""The controller of the paper and nothing else: Fig. 5 in a tick, for laws that are compared."""

from truestroke.base import checks
from truestroke.base.checks import SettingError
from truestroke.control.adaptation import Law
from truestroke.control.reference.adapt import learn_otherwise
from truestroke.control.reference.command import bounded, rate_dependent_slopes, within_limits
from truestroke.control.reference.state import State, StateShown
from truestroke.control.reference.terms import regressor, remember_voltage, through_dead_zones
from truestroke.control.settings import ControllerSettings
from truestroke.model.models import Motion, play_inverse
from truestroke.model.operators import dot


class PublishedController(StateShown):
    """`ReferenceController` of `ControllerSettings.paper`, without the parts that these settings leave idle.

    The same bits in two thirds of the time or less, where each command is followed by its measurement.

    Parameters
    ----------
    settings : ControllerSettings
        Of `ControllerSettings.paper`: no known terms, no dynamics, no trim.
    law : Law
        What adapts the weights: an object with `weights`, shape (m,), um/V, and `update(u, e_m)`.

    Raises
    ------
    SettingError
        The settings have a part that the paper does not have.

    Examples
    --------
    >>> import math
    >>> from truestroke.control.adaptation import LMS
    >>> settings = ControllerSettings.paper(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6))
    >>> controller = PublishedController(settings, LMS(settings.initial_weights, step_size=0.5))
    >>> for tick in range(200):
    ...     controller.adapt(10.0 * controller.command(10.0 * math.sin(0.05 * tick), 1000.0 * math.cos(0.05 * tick)))
    >>> round(controller.command(10.0, 0.0), 2)
    1.07
    """

    def __init__(self, settings: ControllerSettings, law: Law) -> None:
        if settings.parameters != settings.of_plays or settings.dynamics is not None or settings.trim_rate > 0:
            raise SettingError("settings", settings.summary, "those of ControllerSettings.paper")
        self.settings = settings
        self._state = State(settings, law)
        self._state.slopes, _ = rate_dependent_slopes(self._state, 0.0)
        self._motion = Motion(0.0, 0.0)

    def command(self, z_d: float, zdot_d: float) -> float:
        """Voltage, V, for the desired displacement z_d, um, and velocity zdot_d, um/s; the play states advance."""
        c = self._state
        self._motion = Motion(bounded("z_d", z_d, "um"), bounded("zdot_d", zdot_d, "um/s"))
        c.slopes, c.projected = rate_dependent_slopes(c, self._motion.zdot_d)  # (7)
        y_d = through_dead_zones(c, self._motion.z_d)  # (11)
        x = within_limits(c, play_inverse(y_d, c.slopes, c.thresholds, c.now.play))  # (12)
        remember_voltage(c, c.now, x)  # (1)
        return x

    def adapt(self, z_measured: float, ago: int = 0) -> None:
        """Adapt to the displacement, um, measured for the last command; NaN and infinity are rejected.

        Raises
        ------
        SettingError
            `ago` is not 0.
        """
        c, (z, ago) = self._state, checks.measurement(z_measured, ago)
        checks.count("ago", ago, 0, 0)
        c.rejected = not abs(z) <= c.settings.measurement_limit
        if not c.rejected:
            u = regressor(c, c.now, self._motion)  # (20)
            c.innovation = through_dead_zones(c, z) - float(dot(c.law.weights, u))  # (15)
            c.rejected = not learn_otherwise(c, u)  # (23)
