"""The settings are declared once: the table, the types, the checks and both kernels agree."""

import dataclasses
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import settings_texts

from truestroke import AdaptiveController, ControllerSettings, Dynamics, Mode, SettingError, _kernel, _kernel32
from truestroke.base import declared
from truestroke.control.feedback import design
from truestroke.control.reference import ReferenceController
from truestroke.control.settings import CHANGEABLE, MAX_DEAD_ZONES, SETTINGS, kernel_settings
from truestroke.model import layout
from truestroke.model.layout import MAX_CREEPS, MAX_DUHEM, MAX_PLAYS

ROOT = Path(__file__).parents[1]
BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}
KERNELS = (_kernel.Kernel, _kernel32.Kernel)


# ---- What is written from the declaration -----------------------------------------------------------------------


def test_the_page_and_the_types_are_of_the_declaration() -> None:
    again = "write them anew: python tests/settings_texts.py"
    assert settings_texts.PAGE.read_text() == settings_texts.page(), again
    assert settings_texts.OPTIONS.read_text() == settings_texts.options(), again


def test_the_docstring_has_meaning_unit_bound_and_default_of_each() -> None:
    text = ControllerSettings.__doc__ or ""
    assert "slew_limit : float\n        Fastest change of the voltage, V/s: [1e-15, 1e15]; default: `120 * volt" in text
    assert all(f"    {name} : " in text for name in SETTINGS)


def test_a_declaration_without_a_field_is_refused() -> None:
    with pytest.raises(TypeError, match=r"Little: fields and table differ in \['plays'\]"):
        declared.documented({"plays": SETTINGS["plays"]})(dataclasses.make_dataclass("Little", []))


@pytest.mark.parametrize("bench", [BENCH, {"sample_rate": 1e4, "stroke": 12.0, "voltage_limits": (0.0, 10.0)}])
def test_the_defaults_are_what_the_table_states(bench) -> None:
    settings = ControllerSettings(**bench)
    scope = {**vars(settings), "q": settings.q, "voltage_range": settings.voltage_range}
    for name, field in settings_texts.FIELDS.items():
        text = declared.default_text(field, SETTINGS[name])
        if text.startswith("`") and text.endswith("`") and "prior." not in text:
            assert eval(text.strip("`"), scope) == pytest.approx(getattr(settings, name)), name
    assert settings.filter_frequency == 300.0
    assert settings.smoothing_time == 0.72e-3
    assert ControllerSettings(**bench, resonance=100.0).filter_frequency == 50.0
    assert ControllerSettings(**bench, resonance=100.0).smoothing_time == pytest.approx(2.16e-3)


@pytest.mark.parametrize(("first", "strokes"), [(700.0, 700.0), (30.0, 50.0)])
def test_a_rate_weight_counts_in_full_at_the_speed_of_the_stage(first, strokes) -> None:
    known = Dynamics(sample_rate=BENCH["sample_rate"], modes=(Mode(frequency=first, damping=0.02),))
    scale = ControllerSettings(**BENCH, dynamics=known).rate_scale
    assert scale * strokes * BENCH["stroke"] == pytest.approx(1.0)


BOUNDED = [name for name, setting in SETTINGS.items() if setting.bound.text.startswith("[")]


@pytest.mark.parametrize("name", BOUNDED)
def test_both_ends_of_a_bound_are_taken_and_what_lies_beyond_is_refused(name) -> None:
    ends = SETTINGS[name].bound.text[1:-1].split(",")
    low, high = (eval(end, {}, vars(ControllerSettings(**BENCH))) for end in ends)
    whole = settings_texts.FIELDS[name].type == "int"
    for end, beyond in ((low, -1), (high, 1)):
        assert getattr(ControllerSettings(**{**BENCH, name: end}), name) == end
        with pytest.raises(SettingError, match=rf"^{name} = ") as caught:
            ControllerSettings(**{**BENCH, name: end + beyond * (1 if whole else 1e-3 * max(1.0, abs(end)))})
        assert SETTINGS[name].unit in str(caught.value)


# ---- The kernel --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [ControllerSettings, ControllerSettings.paper])
def test_every_member_of_the_kernels_settings_is_given(make) -> None:
    of_export = {"prior_from"}  # where its rows begin: with zeros in them, on the desk
    for kernel in (_kernel, _kernel32):
        assert sorted({*kernel_settings(make(**BENCH))} | of_export) == sorted(kernel.SETTINGS)
    with pytest.raises(TypeError, match="an entry that the kernel has not"):
        _kernel.Kernel({**kernel_settings(make(**BENCH)), "forgeting": 0.9})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("thresholds", [0.1, 0.2], "thresholds"),
        ("thresholds", [0.0] * 33, "thresholds: the kernel holds at most 32"),
        ("dead_zone_weights", [0.0], "dead_zone_weights"),
        ("creep", [0.0] * 4, "terms"),
        ("terms", [4, 1, 1, 3], "terms"),
        ("initial_weights", [float("nan")], "initial_weights"),
        ("rate_scale", -1.0, "rate_scale"),
        ("kalman.filter", 0.0, "Kalman"),
        ("prior", [0.0], "Kalman"),
        ("slope_min", 0.0, "slope_limits"),
        ("slew", 0.0, "slew_limit"),
        ("voltage_max", -1.0, "voltage_limits"),
        ("smoothing", 1.0, "smoothing"),
        ("trim", 2.0, "trim"),
    ],
)
def test_the_kernels_check_again(name, value, words) -> None:
    good = kernel_settings(ControllerSettings(**BENCH))
    for kernel in KERNELS:
        kernel(good)
        with pytest.raises(ValueError, match=words):
            kernel({**good, name: value})


def test_capacities_are_one() -> None:
    for kernel in (_kernel, _kernel32):
        assert (kernel.MAX_PLAYS, kernel.MAX_DEAD_ZONES, kernel.MAX_CREEPS) == (MAX_PLAYS, MAX_DEAD_ZONES, MAX_CREEPS)
        assert kernel.MAX_DUHEM == MAX_DUHEM


# ---- Changes while running ---------------------------------------------------------------------------------------

# Another value of each, where 0.9 times the default is none.
STAGE = Dynamics(sample_rate=2000.0, modes=(Mode(frequency=200.0, damping=0.02),))
OTHERS = {
    "voltage_limits": (-0.5, 3.0),
    "resonance": 500.0,
    "dynamics": STAGE,
    "sensor_delay": 2.5e-4,
    "hum": (50.0,),
    "plays": 23,
    "thresholds": tuple(np.linspace(0.0, 2.0, 26)),
    "rate_dependent": (0, 3, 6, 9, 13),
    "creep_times": (0.004, 0.03, 0.3, 3.0),
    "asymmetry": 1,
    "dead_zone_thresholds": (0.0, 3.0),
    "dead_zone_weights": (0.9,),
    "law": "rls",
    "outliers": 2,
    "precision": "single",
}


def other(settings: ControllerSettings, name: str) -> ControllerSettings:
    """Settings in which this one differs, and what has to go with it."""
    value = getattr(settings, name)
    if name in ("initial_weights", "slope_limits", "duhem_lengths"):
        changed = tuple(0.9 * w for w in value)
    elif name == "prior_covariance":
        changed = tuple(tuple(0.9 * entry for entry in row) for row in value)
    elif name == "feedback":
        changed = design(STAGE, stroke=25.0)
    elif name in OTHERS:
        changed = OTHERS[name]
    else:
        changed = not value if isinstance(value, bool) else 0.9 * value or 1.0
    given = {f.name: getattr(settings, f.name) for f in dataclasses.fields(settings)} | {name: changed}
    if name in ("plays", "rate_dependent", "law", *layout.SETTINGS.keys() - {"creep_times", "duhem_lengths"}):
        given |= dict.fromkeys(("initial_weights", "prior_covariance"))
    if name == "hum":
        given |= dict.fromkeys(("feedback", "change_threshold"))
    if name == "plays":
        given |= dict.fromkeys(("thresholds", "rate_dependent"))
    if name == "initial_sensitivity":
        given["initial_weights"] = (changed, *settings.initial_weights[1:])
    if name == "dead_zone_thresholds":
        given["dead_zone_weights"] = (1.0, 0.0)
    return ControllerSettings(**given)


@pytest.mark.parametrize("name", SETTINGS)
def test_controller_numpy_text_and_kernel_change_the_same_settings(name) -> None:
    settings = ControllerSettings(**BENCH, dynamics=STAGE if name in ("hum", "feedback") else None)
    changed = other(settings, name)
    controller, text = AdaptiveController.from_settings(settings), ReferenceController(settings)
    kernel = _kernel.Kernel(kernel_settings(settings))
    if name in CHANGEABLE:
        controller.change(**{name: getattr(changed, name)})
        text.change(changed)
        kernel.change(kernel_settings(changed))
        assert getattr(controller.settings, name) == getattr(changed, name)
        return
    with pytest.raises(SettingError, match=rf"^{name} = .* fixed while a controller runs"):
        controller.change(**{name: getattr(changed, name)})
    with pytest.raises(SettingError, match="keeps its law, model and prior"):
        text.change(changed)
    assert controller.settings == text.settings == settings
    if name not in ("precision", "regularization"):  # the first is no member of it, the second not of this law
        with pytest.raises(ValueError, match="the kernel refuses the terms"):
            kernel.change(kernel_settings(changed))


def test_the_kernel_keeps_delta_of_rls() -> None:
    settings = ControllerSettings.paper(**BENCH)
    kernel = _kernel.Kernel(kernel_settings(settings))
    with pytest.raises(ValueError, match="the kernel refuses the terms"):
        kernel.change(kernel_settings(dataclasses.replace(settings, regularization=2e-3)))


def test_a_wrong_name_says_which_was_meant() -> None:
    controller = AdaptiveController(**BENCH)
    for call in (controller.change, lambda **wrong: AdaptiveController(**BENCH, **wrong)):
        with pytest.raises(SettingError, match=r"forgeting = 0\.9: must be left out; did you mean forgetting\?"):
            call(forgeting=0.9)


def test_a_type_checker_refuses_a_wrong_name_or_type(tmp_path) -> None:
    """Strict mypy, on what a user writes."""
    user = tmp_path / "user.py"
    user.write_text(
        textwrap.dedent("""\
        from truestroke import AdaptiveController
        c = AdaptiveController(sample_rate=2e3, stroke=30.0, voltage_limits=(0.0, 5.0), forgetting=0.9, plays=8)
        c.change(forgetting=0.9, voltage_limits=(0.0, 4.0))
        AdaptiveController(sample_rate=2e3, stroke=30.0, voltage_limits=(0.0, 5.0), forgeting=0.9)
        AdaptiveController.from_model("model.toml", sample_rate=2e3, forgeting=0.9)
        AdaptiveController.paper(sample_rate=2e3, stroke=30.0, voltage_limits=(0.0, 5.0), plays=8)
        c.change(plays=8)
        c.change(trim_rate="20")
        """)
    )
    # A process of its own: what a checker leaves in memory is looked through before each run in real time that follows.
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--hide-error-context", str(user)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert not done.stderr
    lines = [int(line.split(":")[1]) for line in done.stdout.splitlines() if ": error:" in line]
    assert lines == [4, 5, 6, 7, 8], done.stdout
