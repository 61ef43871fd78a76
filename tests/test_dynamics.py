"""The dynamics of the stage: response, refusals, files, python-control. Truth comes from SciPy and python-control."""

import pickle

import numpy as np
import pytest
from late import Late
from scipy import linalg

from truestroke import Dynamics, FileError, Mode, SettingError

control = Late("control")
STAGE = Dynamics(
    sample_rate=10000.0,
    modes=(Mode(frequency=700.0, damping=0.02, share=1.08), Mode(frequency=1650.0, damping=0.01, share=-0.08)),
    amplifier_bandwidth=2500.0,
    dead_time=1.3e-4,
    sensor_delay=0.4e-4,
    sensor_bandwidth=4000.0,
    uncertainty={"frequency[0]": 0.3, "dead_time": 1e-6},
)


def simulated(stage: Dynamics, frequency: float) -> complex:
    """Pulse transfer at a frequency by a state space that holds the command and integrates the measurement.

    Each tick is cut where the delayed command changes; each part is one exponential of a matrix.
    """
    system = control.ss(stage.to_control(pade=0, sensor=True))
    n, T = system.nstates, 1 / stage.sample_rate
    # states: of the system, integral of its output; input is constant within a part
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n + 1] = system.A, system.B[:, 0]
    whole[n, :n] = system.C[0]
    late, part = divmod(stage.dead_time + stage.sensor_delay, T)
    first, second = linalg.expm(whole * part), linalg.expm(whole * (T - part))
    # z^-(late + 1) u acts during the first part of the tick, z^-late u during the rest
    z = np.exp(2j * np.pi * frequency * T)
    M = second[: n + 1, : n + 1] @ first[: n + 1, : n + 1]
    N = second[: n + 1, : n + 1] @ first[: n + 1, n + 1] * z ** -(late + 1) + second[: n + 1, n + 1] * z**-late
    states = np.linalg.solve(z * np.eye(n) - M[:n, :n], N[:n])
    return complex((M[n, :n] @ states + N[n]) / T)


@pytest.mark.parametrize("frequency", [1.0, 350.0, 700.0, 1650.0, 4900.0])
def test_response_is_that_of_held_commands_and_averaged_measurements(frequency: float) -> None:
    assert STAGE.response(frequency, sensor=True) == pytest.approx(simulated(STAGE, frequency), rel=1e-5, abs=1e-6)


def test_static_gain_is_one_and_the_sensor_is_not_in_the_true_displacement() -> None:
    assert STAGE.response(0.0) == pytest.approx(1.0, abs=1e-12)
    late = np.angle(STAGE.continuous(100.0)) - np.angle(STAGE.continuous(100.0, sensor=True))
    assert late == pytest.approx(2 * np.pi * 100.0 * 0.4e-4 + np.arctan(100.0 / 4000.0), rel=1e-9)


def test_half_of_the_sample_rate_may_be_rounded_up():
    """As `rfftfreq` does for one in six pairs of a rate and a number of samples."""
    stage = Dynamics(sample_rate=3000.0, modes=(Mode(frequency=339.0, damping=0.015),))
    highest = np.nextafter(1500.0, np.inf)
    assert stage.response(highest) == pytest.approx(stage.response(1500.0), rel=1e-9)
    with pytest.raises(SettingError, match="half of the sample rate"):
        stage.response(1500.001)


def test_python_control_has_the_same_response() -> None:
    f = np.array([10.0, 300.0, 700.0, 1650.0])
    system = STAGE.to_control(pade=6, sensor=True)
    assert system(2j * np.pi * f) == pytest.approx(STAGE.continuous(f, sensor=True), rel=1e-6)


@pytest.mark.parametrize("pade", [2, 5])
@pytest.mark.parametrize("kind", ["transfer function", "state space"])
def test_python_control_and_back(pade: int, kind: str) -> None:
    system = 3.7 * STAGE.to_control(pade=pade)
    again = Dynamics.from_control(system if kind == "transfer function" else control.ss(system), 10000.0)
    assert [m.frequency for m in again.modes] == pytest.approx([700.0, 1650.0], rel=1e-6)
    assert [m.damping for m in again.modes] == pytest.approx([0.02, 0.01], rel=1e-4)
    assert [m.share for m in again.modes] == pytest.approx([1.08, -0.08], rel=1e-4)
    assert (again.amplifier_bandwidth, again.dead_time) == pytest.approx((2500.0, 1.3e-4), rel=1e-5)


S = control.tf("s")


@pytest.mark.parametrize(
    ("system", "words"),
    [
        (1 / (S**2 / 1e6 - 2e-5 * S + 1), "a pole at 159.2 Hz that does not decay: must be stable: fit it again with"),
        ((1 - S / 900) / (S**2 / 1e6 + 2e-5 * S + 1), "a zero at 143.2 Hz: must be minimum-phase, for its inverse"),
        (1 / (S / 1e3 + 1), "0 pairs and 1 real poles: must be 1 to 3 pairs of complex poles"),
        ((1 + S / 900) / (S**2 / 1e6 + 2e-5 * S + 1), "a response that modes meet within"),
        (-1 / (S**2 / 1e6 + 2e-5 * S + 1), "a static gain of -1: must be above 0"),
        (control.tf([1.0], [1.0, 0.2, 0.5], 1e-4), "one with dt = 0.0001: must be continuous in time"),
        ("G", "must be a control.TransferFunction"),
    ],
)
def test_a_system_that_is_no_stage_is_refused(system: object, words: str) -> None:
    with pytest.raises(SettingError, match=words.replace(".", r"\.").replace("(", r"\(")):
        Dynamics.from_control(system, 10000.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"modes": ()}, "the number of modes = 0: must be a whole number from 1 to 3"),
        ({"modes": (Mode(frequency=4500.0, damping=0.1),)}, "below 4500 Hz, 0.45 of the sample rate"),
        ({"modes": STAGE.modes[::-1]}, "above 1650 Hz, that of the mode before: sort the modes"),
        ({"modes": STAGE.modes[:1]}, "the sum of the shares = 1.08: must be 1"),
        (
            {
                "modes": (
                    Mode(frequency=700.0, damping=0.02, share=3.0),
                    Mode(frequency=900.0, damping=0.02, share=-2.0),
                )
            },
            "must be minimum-phase, for its inverse would be unstable: leave out the mode with the negative share",
        ),
        ({"dead_time": 0.0021}, "dead_time = 0.0021 s: must be from -5e-05 to 0.002 s"),
        ({"uncertainty": {"frequency[3]": 1.0}}, "uncertainty.frequency[3] = 1.0: must be left out; did you mean"),
        ({"trusted_to": 5001.0}, "trusted_to = 5001.0 Hz: must be from 0 to 5000 Hz"),
    ],
)
def test_dynamics_that_cannot_be_are_refused(given: dict, words: str) -> None:
    with pytest.raises(SettingError) as error:
        Dynamics(**{**STAGE.to_dict(), "modes": STAGE.modes, **given})
    assert words in str(error.value)


@pytest.mark.parametrize("damping", [0.0, 1.0, -0.1])
def test_a_mode_resonates(damping: float) -> None:
    with pytest.raises(SettingError, match=r"damping = .*: must be above 0 and below 1"):
        Mode(frequency=700.0, damping=damping)


def test_another_sample_rate() -> None:
    slower = STAGE.at(5000.0)
    f = np.array([10.0, 700.0])
    assert slower.continuous(f).tobytes() == STAGE.continuous(f).tobytes()
    assert slower.check_rate(5000.0) is slower
    with pytest.raises(SettingError, match="below 900 Hz"):
        STAGE.at(2000.0)
    with pytest.raises(SettingError, match=r"measure them at this rate, or convert them by `Dynamics\.at`"):
        STAGE.check_rate(5000.0)


def test_a_file_comes_back_to_the_last_bit_and_says_what_is_wrong(tmp_path) -> None:
    path = tmp_path / "dynamics.toml"
    STAGE.save(path)
    STAGE.save(path)
    assert Dynamics.load(path) == STAGE == pickle.loads(pickle.dumps(STAGE))
    for old, new, words in [
        ("damping = 0.02", "dampling = 0.02", "modes.dampling = 0.02: must be left out; did you mean damping"),
        ("dead_time = 0.00013", "dead_time = 'x'", "dead_time = 'x' s: must be a number, without quotes"),
        ("version = 1", "version = 2", "version = 2: must be 1"),
        ("damping = 0.02", "damping = 1.02", "must be above 0 and below 1"),
    ]:
        text = path.read_text()
        assert old in text
        (tmp_path / "bad.toml").write_text(text.replace(old, new))
        with pytest.raises(FileError) as error:
            Dynamics.load(tmp_path / "bad.toml")
        assert str(error.value).startswith(f"{tmp_path / 'bad.toml'}: ")
        assert words in str(error.value)
    with pytest.raises(FileError, match="there is no such file; truestroke bode writes it"):
        Dynamics.load(tmp_path / "none.toml")
    path.write_text("mine")
    with pytest.raises(FileExistsError, match="is there and is not dynamics that truestroke wrote"):
        STAGE.save(path)


def test_it_shows_values_with_their_deviations() -> None:
    lines = [" ".join(line.split()) for line in repr(STAGE).splitlines()]
    assert lines[0] == "Dynamics: 2 modes, first resonance 700 Hz"
    assert "mode 0 700 +- 0.3 Hz, damping 0.02, share 1.08" in lines
    assert "dead_time 0.00013 +- 1e-06 s" in lines


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('format = "truestroke model"\nversion = 1\n', "format = 'truestroke model': must be 'truestroke dynamics'"),
        ("gain = 2\n", "format = 'no format'.*no file of truestroke bode"),
        ('format = "truestroke dynamics"\nversion = 9\n', "version = 9.*measure again"),
    ],
)
def test_a_file_that_has_no_dynamics_says_what_it_is(text, words, tmp_path) -> None:
    path = tmp_path / "other.toml"
    path.write_text(text)
    with pytest.raises(FileError, match=words):
        Dynamics.load(path)
