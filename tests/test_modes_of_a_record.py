"""Resonances that a record shows: found, predicted, inverted, kept in the file, passed to a controller."""

import dataclasses

import numpy as np
import pytest
from benchmarks import foreign_records, identify_speed, sensorless
from scipy.signal import TransferFunction, lsim

import truestroke
from truestroke.control import stage
from truestroke.identification import Record, identify, load_model, refine, save_model
from truestroke.identification.fitting import modes, procedure, structure
from truestroke.identification.fitting.absorbed import absorbed
from truestroke.identification.fitting.modes import ModeSearch
from truestroke.identification.fitting.regression import Structure, even_thresholds
from truestroke.identification.fitting.select import first_prediction
from truestroke.identification.records.series import series
from truestroke.model.dynamics import Dynamics, Mode

TRUE = ((0.75, 170.0, 0.03), (0.17, 395.0, 0.02), (0.08, 710.0, 0.025))  # share, Hz, damping: of modes_excited


def first_part(maker, rows):
    whole = next(foreign_records.records(0, (maker,)))
    return Record.from_arrays(whole.volts[:rows], whole.displacement[:rows], time=whole.time[:rows])


@pytest.fixture(scope="module")
def excited():
    return first_part(foreign_records.modes_excited, 15_000)  # of 30,000 rows


@pytest.fixture(scope="module")
def found(excited):
    return identify(excited)


def test_the_modes_of_a_stage_are_found(found):
    """Behind a Bouc-Wen hysteresis; without them 4.4 % are left."""
    assert found.held_out.rmse_percent < 0.6
    modes = found.model.dynamics.modes
    assert len(modes) == 3
    for mode, (share, frequency, damping) in zip(modes, TRUE, strict=True):
        assert mode.frequency == pytest.approx(frequency, rel=0.005)
        assert mode.damping == pytest.approx(damping, rel=0.15)
        assert mode.share == pytest.approx(share, abs=0.02)
    assert found.tried[-1].parts[-1] == "3 resonances"


def test_a_record_without_resonance_has_none():
    """A lag, creep and hysteresis of another structure."""
    assert identify(first_part(foreign_records.random_wave, 8000)).model.dynamics is None


def test_hysteresis_of_another_kind_is_no_mode():
    """An asymmetric Bouc-Wen actuator in a modulated sine: behind plays alone a mode of 8 Hz helps."""
    t = np.arange(2600) / 100.0
    x = 0.5 + 0.5 * np.sin(2 * np.pi * t) * (0.55 + 0.45 * np.cos(2 * np.pi * t / 13))
    fine, h = np.interp(np.arange(0, 2599, 1 / 26), np.arange(2600), x), [0.0]
    for v, dv in zip(fine, np.diff(fine), strict=False):
        h.append(h[-1] + 0.5 * dv - 5 * abs(dv) * h[-1] - 2.5 * dv * abs(h[-1]) + 0.15 * v * abs(dv))
    noise = np.random.Generator(np.random.PCG64(0)).normal(0.0, 0.003, 2599)
    found = identify((5 * x[:-1], 6 * (x[:-1] - np.array(h)[::26][:2599]) + noise, 100.0))
    assert found.model.dynamics is None
    assert found.model.branches is not None


def test_a_mode_at_the_end_of_the_search_is_none():
    """Rasters at 40 lines/s on a stage of one mode, sampled at the end of each tick: a second mode made it earlier."""
    settings, _ = sensorless.stage_of(29, 0.0)
    (mode,) = sensorless.model_of(settings, 40.0, 29).dynamics.modes
    assert mode.frequency == pytest.approx(settings.resonances[0], rel=0.03)


def test_a_mode_that_the_weights_of_a_static_model_follow_is_found():
    """Rasters at 40 lines/s: between the strain of the static model and the displacement there is none."""
    settings, _ = sensorless.stage_of(11, 0.0)
    (mode,) = sensorless.model_of(settings, 40.0, 11).dynamics.modes
    assert mode.frequency == pytest.approx(settings.resonances[0], rel=0.005)
    assert mode.damping == pytest.approx(settings.dampings[0], rel=0.2)


def test_no_mode_is_found_that_a_static_model_has_followed_where_there_is_none(monkeypatch):
    """A lag of 12 ms and 6 ms of dead time behind the hysteresis."""
    asked = []
    monkeypatch.setattr(procedure, "absorbed", lambda *given: asked.append(absorbed(*given)))
    volts, moved = identify_speed.record(4000)
    late = identify_speed.KINDS["6 ms and a lag of 12 ms"](moved)
    assert identify((volts, late, identify_speed.RATE)).model.dynamics is None
    assert asked == [None, None]


T18 = foreign_records.clock(18.0, 1e3)


def searched(damping, hum, steps):
    """18 s of a wave and steps behind a mode of 50 Hz, or none, and hum of that frequency; found, and the search."""
    rng = np.random.Generator(np.random.PCG64(70))
    strain = 12 * foreign_records.wave(T18, rng, 4.0) + steps * rng.uniform(-1, 1, 7)[(T18 / 3).astype(int)]
    true = Dynamics(sample_rate=1e3, modes=(Mode(frequency=50.0, damping=damping or 6e-4),))
    z = stage.through(true, strain) if damping else strain
    z = z + hum * np.sin(2 * np.pi * 50.0 * T18 + 1.0) + rng.normal(0, 0.005, T18.size)
    search = ModeSearch(strain, z, np.ones(T18.size, dtype=bool), 1e3)
    return search._refined(modes._vector(true))[0], search


@pytest.mark.parametrize("damping", [0.0006, 0.006])
def test_a_mode_that_rings_throughout_is_no_hum(damping):
    """That of 0.06 Hz is as narrow as a line of the spectrum."""
    found, search = searched(damping, 0.0, 0.2)
    assert found.modes[0].damping == pytest.approx(damping, rel=0.2)
    assert not search.hums(found)


def test_hum_is_no_mode():
    """A mode that is fitted to it is as narrow, but nothing in the motion has the phase of the hum."""
    found, search = searched(0.0, 0.15, 0.0)
    assert found.modes[0].damping < 0.002
    assert search.hums(found)


def test_a_stage_that_rings_longer_than_a_ninth_of_the_record_is_modelled():
    """60 Hz with a damping of 0.002 in 6 s, random steps; with no mode so narrow 15 % of the motion were left."""
    rng = np.random.default_rng(3)
    t = foreign_records.clock(6.0, 1e3)
    volts = foreign_records.low_pass(rng.uniform(0.2, 2.8, 26)[(t / 0.24).astype(int)], 1e3, 100.0)
    moved = 12 * foreign_records.resonance(foreign_records.preisach(volts / 3, rng), 1e3, 60.0, 0.002)
    found = identify(Record.from_arrays(volts, moved + rng.normal(0, 0.005, t.size), sample_rate=1e3))
    first = found.model.dynamics.modes[0]
    assert (first.frequency, first.damping) == pytest.approx((60.0, 0.002), rel=0.05)
    assert found.held_out.rmse_percent < 1.5


def test_the_inverse_is_that_of_the_stage_too(found):
    """What its voltage strains, through the true modes by scipy's simulation of them: a third of the first."""
    fs = 5000.0
    t = np.arange(3500) / fs
    desired = 12 + 4.0 * np.minimum(t / 0.3, 1) ** 2 * (1 - np.cos(2 * np.pi * 60.0 * t))

    def error(model):
        strain = model.strain(model.invert(desired, fs, voltage_limits=(-50.0, 150.0)), fs)
        moved = desired[0]
        for share, f, damping in TRUE:
            w = 2 * np.pi * f
            system = TransferFunction([w * w], [1, 2 * damping * w, w * w])
            moved = moved + share * lsim(system, strain - strain[0], t)[1]
        return np.std((moved - desired)[2000:-500]) / 8.0

    assert error(found.model.replace(dynamics=None)) > 0.03
    assert error(found.model) < 0.008


def test_the_modes_are_in_the_file_and_a_controller_starts_with_them(found, tmp_path):
    save_model(tmp_path / "model.toml", found.model)
    read = load_model(tmp_path / "model.toml")
    assert read.dynamics == found.model.dynamics
    volts = 40 + 10 * np.sin(np.arange(300) / 5)
    np.testing.assert_array_equal(read.predict(volts, 5e3), found.model.predict(volts, 5e3))
    controller = truestroke.AdaptiveController.from_model(read, sample_rate=10_000.0)
    assert controller.settings.dynamics.modes == read.dynamics.modes
    assert truestroke.AdaptiveController.from_model(read, sample_rate=500.0).settings.dynamics is None


def test_a_refined_model_keeps_its_modes(found, excited):
    """The gain of the stage is 5 % larger: weights follow, modes stay, and the residual is as small as before."""
    record = Record.from_arrays(excited.volts[:8000], 1.05 * excited.displacement[:8000], sample_rate=5000.0)
    again = refine(found.model, record)
    assert again.model.dynamics == found.model.dynamics
    assert again.after < 0.3 * again.before
    assert again.after < 0.02 * found.model.stroke


@pytest.mark.parametrize("dead_time", [0.0, 3.3e-4])
def test_a_stage_answers_as_scipy_has_it(dead_time):
    """Sine below and above the resonance, against the closed form of its steady state."""
    dynamics = Dynamics(sample_rate=10_000.0, modes=(Mode(frequency=300.0, damping=0.05),), dead_time=dead_time)
    t = np.arange(8000) / 1e4
    for frequency in (40.0, 290.0, 700.0):
        moved = stage.through(dynamics, np.sin(2 * np.pi * frequency * t))
        s = 2j * np.pi * frequency
        w = 2 * np.pi * 300.0
        held = np.sinc(frequency / 1e4) ** 2  # straight lines between the samples
        G = w * w / (s * s + 2 * 0.05 * w * s + w * w) * np.exp(-s * dead_time) * held
        expected = (G * np.exp(s * t)).imag
        np.testing.assert_allclose(moved[4000:], expected[4000:], atol=6e-3 * abs(G))


def test_a_second_mode_is_found_behind_dead_time():
    """340 Hz beside 110 Hz, 6 ticks late: without these the phase of a candidate is wrong."""
    rng = np.random.Generator(np.random.PCG64(5))
    strain = foreign_records.low_pass(rng.uniform(0, 10, 50)[np.arange(4000) // 80], 2e3, 400.0)
    pair = Mode(frequency=110.0, damping=0.03, share=0.85), Mode(frequency=340.0, damping=0.03, share=0.15)
    z = stage.through(Dynamics(sample_rate=2e3, modes=pair, dead_time=3e-3), strain) + rng.normal(0, 0.01, 4000)
    alone = Dynamics(sample_rate=2e3, modes=(Mode(frequency=110.0, damping=0.03),), dead_time=3e-3)
    search = ModeSearch(strain, z, np.ones(4000, dtype=bool), 2e3)
    assert np.exp(search._next(alone)[1]) == pytest.approx(340.0, rel=0.05)


def test_modes_that_ring_are_alone():
    """With the shares that they have among each other; none where they have hardly any of the motion."""
    flat = Mode(frequency=40.0, damping=0.5, share=0.2)
    ringing = Mode(frequency=110.0, damping=0.03, share=0.6), Mode(frequency=340.0, damping=0.03, share=0.2)
    found = Dynamics(sample_rate=2e3, modes=(flat, *ringing))
    assert [mode.share for mode in modes.resonant(found).modes] == pytest.approx([0.75, 0.25])
    assert modes.resonant(Dynamics(sample_rate=2e3, modes=(Mode(frequency=40.0, damping=0.5),))) is None


def test_a_fit_goes_on_from_another_and_ends_where_nothing_changes(monkeypatch):
    """The strain behind modes is about the one behind others: one step, in place of three from a first prediction."""
    steps, linearised = [], structure._linearised
    monkeypatch.setattr(structure, "_linearised", lambda *given: (steps.append(1), linearised(*given))[1])
    volts, z = identify_speed.record(2000)
    s = series(Record.from_arrays(volts, stage.through(identify_speed.MODE, z), sample_rate=2000.0))
    data = dataclasses.replace(procedure.data_of(s, 2000, 2000), dynamics=identify_speed.MODE)
    terms = Structure(thresholds=even_thresholds(16, 0.9), creep_times=(0.03,), asymmetry=2)
    whole = structure.fit_structure(data, terms, 1e-3, first_prediction(data))
    assert len(steps) == structure.STEPS + 1
    again = structure.fit_structure(data, terms, 1e-3, whole, certain=False)
    assert len(steps) == structure.STEPS + 2
    assert np.std(again.strain - whole.strain) < 0.1 * whole.model.noise
    assert again.model.noise == pytest.approx(whole.model.noise, rel=1e-3)
    # of other rows it begins with what its model predicts
    other = dataclasses.replace(
        data, volts=volts[:1500], displacement=data.displacement[:1500], known=data.known[:1500]
    )
    np.testing.assert_allclose(whole.before(other)[:1400], whole.before(data)[:1400], atol=1e-3)
