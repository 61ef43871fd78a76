"""A late and slow sensor as a setting. Truth: SciPy's simulation of the lag, and what StagePlant does."""

import numpy as np
import pytest
from scipy import signal

from truestroke import AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError, run, trajectories
from truestroke.control import sensor
from truestroke.plant import StagePlant, StageSettings

RATE = 10_000.0
AXIS = {"sample_rate": RATE, "stroke": 24.0, "voltage_limits": (-0.6, 3.6)}


@pytest.mark.parametrize(("delay", "bandwidth"), [(0.37e-4, 0.0), (1.6e-4, 500.0), (0.0, 30.0), (2e-4, 20_000.0)])
def test_what_the_sensor_shows_is_a_simulated_lag(delay, bandwidth) -> None:
    """Displacements that are held for a tick, 100 steps in each, and the mean over each tick."""
    fine, ticks = 100, 200
    u = np.random.default_rng(1).normal(size=ticks)
    u[:5] = u[0]
    held = np.repeat(u, fine)
    late = np.concatenate([np.full(round(delay * RATE * fine), u[0]), held])[: held.size]
    if bandwidth:
        time = np.arange(late.size) / (fine * RATE)
        system = signal.lti([2 * np.pi * bandwidth], [1.0, 2 * np.pi * bandwidth]).to_ss()
        _, out, _ = signal.lsim(system, late, time, X0=u[0] / system.C[0], interp=False)
        late = (out + np.append(out[1:], out[-1])) / 2
    wanted = late.reshape(ticks, fine).mean(axis=1)
    model = sensor.Sensor(sensor.members(RATE, delay, bandwidth))
    shown = np.array([model.sensed(np.array([value]))[0] for value in u])
    assert model.ticks == int(delay * RATE)
    late_by = ticks - model.ticks
    np.testing.assert_allclose(shown[: late_by - 1], wanted[model.ticks : -1], atol=2e-3)


@pytest.mark.parametrize(("delay", "bandwidth"), [(1.6e-4, 0.0), (0.0, 100.0), (3.3e-4, 300.0)])
def test_the_true_displacement_does_not_lead_by_what_the_sensor_lags(delay, bandwidth) -> None:
    """0.05 % of peak to peak at 10 Hz; a lag of 100 Hz that is not given costs 3.5 %."""
    told = {"sensor_delay": delay, "sensor_bandwidth": bandwidth}
    plant = StageSettings(resonances=(2000.0,), dampings=(0.05,), amplifier_bandwidth=0.0, **told)
    wave = trajectories.sine(frequency=10.0, peak_to_peak=20.0, offset=12.0, duration=1.0, sample_rate=RATE)
    controller = AdaptiveController(**AXIS, **told)
    recording = run(wave, controller, StagePlant(plant, seed=1))
    error = (recording["true"] - recording["desired"])[6000:]
    assert error.std() < 0.01
    assert controller.counters.rejected == controller.counters.changed == 0


def test_with_dynamics_the_sensor_is_theirs() -> None:
    known = Dynamics(sample_rate=RATE, modes=(Mode(frequency=700.0, damping=0.02),), sensor_delay=1e-4)
    settings = ControllerSettings(**AXIS, dynamics=known)
    assert (settings.sensor_delay, settings.sensor_bandwidth) == (1e-4, 0.0)
    with pytest.raises(SettingError, match=r"sensor_delay = 0.0002 s: must be left out, or 0.0001 .*--sensor-delay"):
        ControllerSettings(**AXIS, dynamics=known, sensor_delay=2e-4)
    with pytest.raises(SettingError, match=r"sensor_delay = 0.1 s: must be"):
        ControllerSettings(**AXIS, sensor_delay=0.1)
    with pytest.raises(SettingError, match=r"sensor_bandwidth = -5"):
        ControllerSettings(**AXIS, sensor_bandwidth=-5.0)
