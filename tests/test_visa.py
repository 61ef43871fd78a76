"""The driver for instruments with VISA: through pyvisa-py against fakes on TCP, and against pyvisa-sim."""

from __future__ import annotations

import pickle
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fakes.lines import GAIN, PLANT, Instrument
from forked import ran

import truestroke
from truestroke import SettingError, plant, trajectories
from truestroke.base import toml
from truestroke.runtime.drivers import DriverError, OneAxis, connected
from truestroke.runtime.drivers.lines import LineSettings
from truestroke.runtime.drivers.registry import find
from truestroke.signals.timing import Timing

PAGE = (Path(__file__).parents[1] / "docs/visa.md").read_text()
SAFE = np.array([2.5])  # V
SOON = 1.0  # s, time-out where the test waits for it
SAID = {
    "output_range": (-20.0, 120.0),
    "axes": ("1",),
    "voltage_command": "VOLT{axis} {volts:.6f}",
    "position_query": "POS{axis}?",
    "position_answer": "POS {position} um",
    "sample_rate": 10.0,  # whatever else this machine does
    "timeout": 20.0,  # s, as long as a busy machine may stall
    "backend": "@py",
}


@pytest.fixture
def instrument():
    fake = Instrument()
    yield fake
    fake.close()


@pytest.fixture
def made(instrument: Instrument):
    """A driver of the fake, with changed settings; closed at the end."""
    drivers = []

    def make(**change: object):
        drivers.append(find("visa")(LineSettings(resource=instrument.resource, **SAID | change)))
        return drivers[-1]

    yield make
    for driver in drivers:
        driver.close()


@pytest.fixture
def driver(made):
    return made()


def step(driver: object, volts: float) -> float:
    measured = np.empty((1, 1))
    driver.exchange(np.array([[volts]]), measured)
    return float(measured[0, 0])


def steps(driver: object, volts: float) -> None:
    for _ in range(10):
        step(driver, volts)


# ---- An instrument that works --------------------------------------------------------------------------------------


def test_a_voltage_is_set_and_its_position_comes_with_the_next(instrument: Instrument, driver) -> None:
    assert driver.open() == Timing(sample_rate=10.0, block=1, latency=1)
    assert instrument.volts == 0.0
    driver.start(np.array([0.0]))
    before = [step(driver, 60.0), step(driver, 60.0)]
    assert instrument.volts == 60.0
    assert before[0] < 1.0 < before[1]  # um: the stack extends under the voltage of the tick before
    driver.stop(SAFE)
    assert instrument.volts == SAFE[0]


def test_units_of_the_instrument(instrument: Instrument, made) -> None:
    said = {"volts_per_unit": 10.0, "um_per_unit": -1e-3, "offset": 7.0}
    driver = made(**said)
    driver.open()
    driver.start(np.array([50.0]))
    z = step(driver, 50.0)
    assert instrument.volts == 5.0  # V at the input, which amplifies ten times: the question came behind it
    assert z == pytest.approx(7.0 - 1e-3 * instrument.position(), abs=1e-3)
    driver.close()


def test_a_question_does_not_wait_behind_a_command(driver) -> None:
    driver.open()
    network = driver._device.visalib.sessions[driver._device.session].interface
    assert network.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_it_is_as_accurate_as_without_the_wire(instrument: Instrument, made, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same stack at the same rate; the wire has six decimals, and the first position is asked for by `open`."""
    monkeypatch.setattr(connected, "require_time", lambda *_: None)  # late ticks do not matter to it
    wave = trajectories.sine(frequency=1.0, peak_to_peak=10.0, duration=4.0, sample_rate=100.0)
    driver = made(**{"sample_rate": 100.0})

    def controller() -> truestroke.AdaptiveController:
        limits = {"voltage_limits": (-20.0, 120.0), "slew_limit": 20_000.0}
        return truestroke.AdaptiveController(sample_rate=100.0, stroke=40.0, **limits)

    class Wire:
        def open(self) -> Timing:
            self.stack = plant.RealisticPlant(PLANT, seed=3)
            self.stack.open()
            self.stack.exchange(np.zeros(1))  # what `open` has asked for
            self.volts = 0.0
            return Timing(sample_rate=100.0, latency=1)

        def exchange(self, volts: np.ndarray) -> np.ndarray:
            z = self.stack.exchange(np.array([self.volts / GAIN]))
            self.volts = float(volts[0])
            return z

    driver.open()
    driver.start(np.array([0.0]))
    run, errors, wire = controller(), [], Wire()
    wire.open()
    for z_d, zdot_d in zip(wave.position, wave.velocity, strict=True):
        volts = float(run.command(z_d, zdot_d))
        z = step(driver, volts)
        errors.append(z - wire.exchange(np.array([volts]))[0])
        run.adapt(z, ago=1)
    driver.stop(SAFE)
    assert np.max(np.abs(errors)) < 2e-6


# ---- An instrument that does not -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("POS1?:45:silent", "[Tt]ime"),
        ("POS1?:45:garbage", "."),
        ("POS1?:45:POS 3.1", r"to POS1\? the instrument answers 'POS 3.1', not POS {position} um"),
        ("POS1?:45:POS nan um", "not POS {position} um"),
        ("POS1?:45:drop", "."),
    ],
)
def test_a_fault_is_an_error_and_ends_at_the_safe_voltage(instrument: Instrument, made, fault, words) -> None:
    instrument.fault, driver = fault, made(timeout=SOON)
    driver.open()
    driver.start(np.array([0.0]))
    with pytest.raises(DriverError, match=f"exchanging {re.escape(instrument.resource)}: .*{words}"):
        steps(driver, 50.0)
    assert instrument.volts == 50.0
    with pytest.raises(DriverError, match="the driver is failed; call start first"):
        step(driver, 60.0)
    for _ in range(2):
        driver.stop(SAFE)
        assert instrument.volts == SAFE[0]


def test_a_late_answer_is_not_taken_for_another(instrument: Instrument, made) -> None:
    """After a time-out a new connection is made, on which no old answer can come."""
    instrument.fault, driver = "POS1?:45:silent", made(timeout=SOON)
    driver.open()
    driver.start(np.array([0.0]))
    with pytest.raises(DriverError):
        steps(driver, 50.0)
    driver.stop(SAFE)
    with pytest.raises(DriverError, match="call open first"):
        driver.start(SAFE)
    assert driver.open().channels == 1


def test_infinity_of_scpi_is_a_lost_sample(instrument: Instrument, driver) -> None:
    instrument.fault = "POS1?:41:POS 9.91E37 um"
    driver.open()
    driver.start(np.array([0.0]))
    assert np.isnan(step(driver, 1.0))
    assert np.isfinite(step(driver, 1.0))


def test_the_safe_voltage_is_confirmed_where_the_instrument_can_tell(instrument: Instrument, made) -> None:
    told = {"voltage_query": "VOLT{axis}?"}
    driver = made(**told)
    driver.open()
    driver.stop(SAFE)
    assert instrument.heard[-1] == "VOLT1?"
    instrument.fault = "VOLT1?:0:80.0"  # it says once that it did not go there
    driver.stop(SAFE)
    assert instrument.heard.count("VOLT1 2.500000") == 3


def test_a_reply_to_the_voltage_is_read(instrument: Instrument, made) -> None:
    instrument.reply = "OK"
    driver = made(**{"voltage_reply": "OK"})
    driver.open()
    driver.start(np.array([0.0]))
    step(driver, 3.0)
    instrument.fault = "VOLT1 :0:LIMIT"
    with pytest.raises(DriverError, match=r"to VOLT1 4.000000 the instrument answers 'LIMIT', not OK"):
        step(driver, 4.0)
    driver.stop(SAFE)
    assert instrument.volts == SAFE[0]


def test_another_instrument_is_refused_before_anything_is_sent(instrument: Instrument, made) -> None:
    said = {"checks": (("*IDN?", "ACME,Amp 2.*"),), "setup": ("STOP",)}
    driver = made(**said)
    with pytest.raises(DriverError, match=r"answers 'ACME,Amp 1,42,1\.0', not ACME,Amp 2"):
        driver.open()
    assert instrument.heard == ["*IDN?"]
    driver.close()


def test_the_watchdog_has_a_connection_of_its_own(instrument: Instrument, driver) -> None:
    driver.open()
    driver.start(np.array([0.0]))
    step(driver, 50.0)
    code = "import pickle, sys, numpy; pickle.load(sys.stdin.buffer)(numpy.array([2.5]))"
    subprocess.run([sys.executable, "-c", code], input=pickle.dumps(driver.rescue()), check=True, timeout=60)
    assert instrument.volts == SAFE[0]


def test_a_voltage_out_of_range_is_not_sent(instrument: Instrument, driver) -> None:
    driver.open()
    for wrong in (np.nan, 120.1):
        with pytest.raises(DriverError, match=r"not finite|outside of output_range"):
            driver.start(np.array([wrong]))
        driver.open()
    assert instrument.volts == 0.0


def test_nobody_answers(instrument: Instrument, driver) -> None:
    resource = instrument.resource
    instrument.close()
    with pytest.raises(DriverError, match=f"opening {re.escape(resource)}: "):
        driver.open()


def test_a_connection_that_is_too_slow_is_told_which_rate_works(instrument: Instrument, made) -> None:
    driver = made(**{"sample_rate": 1e6})
    driver.open()
    with pytest.raises(DriverError, match=r"sample_rate = 1e\+06 Hz: .* so at most [0-9.e+]+ Hz"):
        driver.start(np.array([0.0]))
    driver.close()


# ---- Settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"voltage_command": "VOLT"}, r"voltage_command = 'VOLT': must be with {volts} once"),
        ({"voltage_command": "VOLT {volts:.6f"}, "text whose braces are closed"),
        ({"voltage_command": "VOLT {volt}"}, "with {volts} once"),
        ({"voltage_command": "VOLT {volts:d}"}, "a number as text"),
        ({"voltage_command": "VOLT {volts:.0f}", "output_range": (0.0, 9.0)}, "with more digits: it makes 1 V of 1.28"),
        ({"position_answer": "POS"}, "with {position} once"),
        ({"position_query": "POS{axis}{position}"}, "with no field but {axis}"),
        ({"checks": (("*IDN?", "("),)}, "a regular expression"),
        ({"resource": ""}, "a VISA resource such as"),
        ({"um_per_unit": 0.0}, "um_per_unit = 0"),
        ({"axes": "12"}, "a list of different names"),
        ({"read_termination": ""}, "the end of a line"),
    ],
)
def test_wrong_settings(change: dict[str, object], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        LineSettings(**{"resource": "ASRL1::INSTR", **SAID, **change})


# ---- pyvisa-sim, an instrument of other people's making ------------------------------------------------------------

SIMULATED = """
spec: "1.0"
devices:
  amplifier:
    eom:
      GPIB INSTR: {q: "\\n", r: "\\n"}
    dialogues:
      - {q: "*IDN?", r: "SCPI,MOCK,VERSION_1.0"}
      - {q: "POS?", r: "3.25"}
    error: ERROR
    properties:
      voltage:
        default: 1.0
        getter: {q: ":VOLT?", r: "{:+.8E}"}
        setter: {q: ":VOLT {:.4f}"}
        specs: {min: -20, max: 120, type: float}
resources:
  GPIB0::4::INSTR: {device: amplifier}
"""


def test_an_instrument_of_pyvisa_sim(tmp_path: Path) -> None:
    import pyvisa

    (tmp_path / "bench.yaml").write_text(SIMULATED)
    backend = f"{tmp_path / 'bench.yaml'}@sim"
    settings = LineSettings(
        resource="GPIB0::4::INSTR",
        backend=backend,
        output_range=(-20.0, 120.0),
        voltage_command=":VOLT {volts:.4f}",
        voltage_query=":VOLT?",
        position_query="POS?",
        checks=(("*IDN?", "SCPI,MOCK.*"),),
        sample_rate=10.0,
    )
    meter = pyvisa.ResourceManager(backend).open_resource(
        "GPIB0::4::INSTR", read_termination="\n", write_termination="\n"
    )
    try:
        axis = OneAxis(find("visa")(settings), voltage_limits=(-20.0, 120.0), slew=1000.0, safe_voltage=2.5)
        with axis:
            axis.open()
            axis.exchange(np.array([30.0]))
            assert axis.exchange(np.array([40.0])) == [3.25]
            assert float(meter.query(":VOLT?")) == 40.0
        assert float(meter.query(":VOLT?")) == 2.5
    finally:
        meter.close()


# ---- The page ------------------------------------------------------------------------------------------------------

RUN = """
[axis.trajectory]
kind = "sine"
frequency = 0.5
sample_rate = 10.0
peak_to_peak = 5.0
duration = 1.0
[realtime]
watchdog_timeout = 5.0
overrun_streak = 0
[recording]
file = "run.h5"
"""


def test_the_configuration_of_the_page_runs_until_the_connection_is_lost(
    instrument: Instrument, tmp_path: Path
) -> None:
    config = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1]
    config = re.sub('resource = "[^"]*"', f'resource = "{instrument.resource}"', config)
    config = config.replace("sample_rate = 50.0", "sample_rate = 10.0").replace(
        "safe_voltage = 0.0", "safe_voltage = 2.5"
    )
    (tmp_path / "run.toml").write_text(config + RUN)
    assert toml.read(tmp_path / "run.toml")["driver"]["name"] == "visa"
    instrument.fault = "POS1?:60:drop"
    command = [Path(sys.executable).with_name("truestroke"), "run", "--config", "run.toml", "--json"]
    done = ran(command, cwd=tmp_path, timeout=120)
    assert (done.returncode, instrument.volts) == (12, SAFE[0]), done.stderr
