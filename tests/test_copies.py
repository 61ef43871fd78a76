"""Controllers, plants and models pickle, copy and deep-copy: the copy goes on to the same bits, and shares nothing."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

from truestroke import AdaptiveController, ControllerSettings
from truestroke.control.actuator import ActuatorModel
from truestroke.control.adaptation import RLS, BoundedKalman
from truestroke.control.baselines import ConstantGain, Pid, PidGains, ProjectedGradient
from truestroke.control.reference import ReferenceController, law_of
from truestroke.model.models import PrandtlIshlinskii
from truestroke.plant import Change, MatchedPlant, MatchedSettings, PlantSettings, RealisticPlant

BENCH = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6)}


class Counting(AdaptiveController):
    """A controller of one's own, with state of its own."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.seen = []

    def command(self, z_d, zdot_d):
        self.seen.append(z_d)
        return super().command(z_d, zdot_d) + 1e-3 * len(self.seen)


def projected() -> ReferenceController:
    settings = ControllerSettings.paper(**BENCH)
    law = ProjectedGradient(settings.initial_weights, forgetting=0.99, slope_min=0.1)
    return ReferenceController(settings, law)


def changed() -> AdaptiveController:
    controller = AdaptiveController(**BENCH)
    controller.change(trim_rate=20.0, resonance=200.0, voltage_limits=(-0.5, 3.5))
    return controller


CONTROLLERS = {
    "default": lambda: AdaptiveController(**BENCH),
    "paper": lambda: AdaptiveController.paper(**BENCH),
    "single": lambda: AdaptiveController(**BENCH, precision="single"),
    "changed": changed,
    "subclass": lambda: Counting(**BENCH),
    "NumPy": lambda: ReferenceController(ControllerSettings(**BENCH, plays=4)),
    "NumPy, RLS": lambda: ReferenceController(ControllerSettings.paper(**BENCH)),
    "projected gradient": projected,
    "PID": lambda: Pid(PidGains(k_p=0.01, k_i=20.0, k_d=0.0, T_f=1e-3), sample_rate=2000.0, voltage_limits=(-0.6, 3.6)),
    "constant gain": lambda: ConstantGain(12.5, voltage_limits=(-0.6, 3.6)),
}
WAYS = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "copy": copy.copy, "deepcopy": copy.deepcopy}

every_way = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)


def drive(controller, first: int, last: int) -> np.ndarray:
    """Voltages of ticks in closed loop with an actuator without a state of its own; some measurements are lost."""
    volts = np.zeros(last - first)
    for k in range(first, last):
        volts[k - first] = x = controller.command(15.0 - 14.0 * np.cos(0.02 * k), 560.0 * np.sin(0.02 * k))
        controller.adapt(9.0 * x + 2.0 * abs(x) if k % 7 else np.nan)
    return volts


@every_way
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_copied_controller_goes_on_to_the_same_bits_and_shares_nothing(name, way) -> None:
    controller = CONTROLLERS[name]()
    drive(controller, 0, 150)
    twin = way(controller)
    assert type(twin) is type(controller)
    on = drive(controller, 150, 300)
    np.testing.assert_array_equal(drive(twin, 150, 300), on)  # what was driven in between did not reach the copy
    again = way(twin)
    np.testing.assert_array_equal(drive(again, 300, 350), drive(controller, 300, 350))


@every_way
def test_state_counters_and_hold_of_a_controller_come_along(way) -> None:
    controller = CONTROLLERS["default"]()
    drive(controller, 0, 100)
    controller.hold()
    controller.adapt(np.inf)
    twin = way(controller)
    assert twin.settings == controller.settings
    assert twin.counters == controller.counters
    assert twin.flags == controller.flags
    assert twin.flags.held
    mine, its = controller.state(), twin.state()
    assert all(np.array_equal(mine[name], its[name]) for name in mine)
    assert twin.command.__self__ is not controller.command.__self__  # another kernel


def test_what_a_subclass_has_of_its_own_is_not_shared_by_a_copy() -> None:
    controller = Counting(**BENCH)
    drive(controller, 0, 10)
    twin = copy.copy(controller)
    drive(controller, 10, 20)
    assert (len(controller.seen), len(twin.seen)) == (20, 10)


PLANTS = {
    "realistic": lambda: RealisticPlant(PlantSettings(change=Change(time=0.05, gain=0.8)), seed=3),
    "matched": lambda: MatchedPlant(
        np.linspace(0.0, 300.0, 400),
        MatchedSettings(change=Change(time=0.08, hysteresis=1.2), weight_spread=0.1),
        seed=3,
    ),
}


@every_way
@pytest.mark.parametrize("name", PLANTS)
def test_a_copied_plant_goes_on_to_the_same_bits_and_shares_nothing(name, way) -> None:
    plant, volts = PLANTS[name](), np.sin(np.arange(400) / 30.0)
    plant.exchange(volts[:80])
    twin = way(plant)
    np.testing.assert_array_equal(twin.truth, plant.truth)
    on = plant.exchange(volts[80:300])
    np.testing.assert_array_equal(twin.exchange(volts[80:300]), on)
    assert twin.describe() == plant.describe()
    assert twin.open() == plant.open()
    np.testing.assert_array_equal(twin.exchange(volts), plant.exchange(volts))


@every_way
@pytest.mark.parametrize("kind", ["kalman", "rls"])
def test_a_copied_law_learns_by_itself(kind, way) -> None:
    law = law_of(ControllerSettings(**BENCH, plays=3, law=kind, creep_times=()))
    assert isinstance(law, (BoundedKalman, RLS))
    rng = np.random.default_rng(0)
    steps = [(rng.normal(size=law.weights.size), rng.normal()) for _ in range(40)]
    for u, e in steps[:20]:
        law.update(u, e)
    twin = way(law)
    for each in (law, twin):  # one after the other: shared arrays would be updated twice
        for u, e in steps[20:]:
            each.update(u, e)
    np.testing.assert_array_equal(twin.weights, law.weights)


MODELS = {
    "actuator": lambda: ActuatorModel(
        thresholds=(0.0, 0.5), weights=[8.0, 2.0, 0.0, 0.5], covariance=np.eye(4), stroke=20.0, voltage_range=(0.0, 2.0)
    ),
    "PI": lambda: PrandtlIshlinskii(r=[0.0, 0.5], w_h=[8.0, 2.0]),
}


@every_way
@pytest.mark.parametrize("name", MODELS)
def test_a_copied_model_predicts_the_same_bits(name, way) -> None:
    model, volts = MODELS[name](), np.sin(np.arange(100) / 9.0) + 1.0
    arguments = (volts, 1000.0) if name == "actuator" else (volts,)
    np.testing.assert_array_equal(way(model).predict(*arguments), model.predict(*arguments))


def test_another_process_goes_on(tmp_path) -> None:
    """As a study on a cluster does: controllers and plants leave this process and come back."""
    names = ("default", "paper", "single", "NumPy")
    controllers = [CONTROLLERS[name]() for name in names]
    for controller in controllers:
        drive(controller, 0, 100)
    plants = [PLANTS[name]() for name in PLANTS]
    for plant in plants:
        plant.exchange(np.linspace(0.0, 1.0, 50))
    (tmp_path / "there").write_bytes(pickle.dumps((controllers, plants)))
    program = (
        "import pickle, sys, pathlib, numpy as np\n"
        "here = pathlib.Path(sys.argv[1])\n"
        "controllers, plants = pickle.loads((here / 'there').read_bytes())\n"
        "volts = [c.process(np.full(50, 12.0), np.zeros(50)) if hasattr(c, 'process') else\n"
        "         np.array([c.command(12.0, 0.0) for _ in range(50)]) for c in controllers]\n"
        "z = [p.exchange(np.full(50, 1.0)) for p in plants]\n"
        "(here / 'back').write_bytes(pickle.dumps((controllers, plants, volts, z)))\n"
    )
    subprocess.run([sys.executable, "-c", program, tmp_path], check=True, timeout=60)
    returned, returned_plants, volts, z = pickle.loads((tmp_path / "back").read_bytes())
    for name, mine, its, x in zip(names, controllers, returned, volts, strict=True):
        np.testing.assert_array_equal(x, [mine.command(12.0, 0.0) for _ in range(50)], err_msg=name)
        np.testing.assert_array_equal(drive(its, 150, 200), drive(mine, 150, 200), err_msg=name)
    for mine, its, measured in zip(plants, returned_plants, z, strict=True):
        np.testing.assert_array_equal(measured, mine.exchange(np.full(50, 1.0)))
        np.testing.assert_array_equal(its.exchange(np.full(50, 0.5)), mine.exchange(np.full(50, 0.5)))


def test_a_plant_of_another_version_is_refused() -> None:
    plant = RealisticPlant()._plant
    with pytest.raises(ValueError, match="pickled by another version"):
        type(plant).__new__(type(plant)).__setstate__(plant.__getstate__()[:-1])
