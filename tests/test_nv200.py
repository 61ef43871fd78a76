"""The driver for nv200 of piezosystem jena: against a fake, over TCP and a pseudo terminal in place of USB."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest
from fakes.lines import Nv200

from truestroke import SettingError
from truestroke.runtime.drivers import DriverError
from truestroke.runtime.drivers.nv200 import Nv200Settings
from truestroke.runtime.drivers.registry import find

SAFE = np.array([2.5])  # V


@pytest.fixture
def controller():
    made = Nv200()
    yield made
    made.close()


def driver_of(resource: str, **change: object):
    settings = {"output_range": (-20.0, 130.0), "sample_rate": 10.0, "backend": "@py"}
    settings |= {"timeout": 20.0} | change  # s, as long as a busy machine may stall
    return find("nv200")(Nv200Settings(resource=resource, **settings))


def moves(driver: object, controller: Nv200) -> None:
    measured = np.empty((1, 1))
    driver.open()
    assert controller.volts == 0.0
    driver.start(np.array([0.0]))
    driver.exchange(np.array([[60.0]]), measured)
    driver.exchange(np.array([[60.0]]), measured)
    assert controller.volts == 60.0
    assert measured[0, 0] > 1.0
    driver.stop(SAFE)
    assert (controller.volts, controller.values["grun"]) == (SAFE[0], 0.0)
    driver.close()


def steps(driver: object) -> None:
    for _ in range(10):
        driver.exchange(np.array([[50.0]]), np.empty((1, 1)))


def test_by_network(controller: Nv200) -> None:
    moves(driver_of(controller.resource), controller)


def test_by_a_serial_port(controller: Nv200) -> None:
    ours, theirs = os.openpty()
    thread = threading.Thread(target=controller.serve, args=(ours,), daemon=True)
    thread.start()
    moves(driver_of(f"ASRL{os.ttyname(theirs)}::INSTR"), controller)
    os.close(theirs)
    thread.join(5.0)
    os.close(ours)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("cl", 1.0, "answers 'cl,1', not cl,0: the controller's own loop is closed: cl,0"),
        ("modsrc", 3.0, "set-points come from another input"),
        ("acmeasure", 0.0, "no sensor"),
        ("avmax", 120.0, "avmax is 120 V in the controller, 130 V in output_range"),
    ],
)
def test_a_controller_that_is_not_set_up_is_refused(controller: Nv200, name: str, value: float, words: str) -> None:
    controller.values[name] = value
    driver = driver_of(controller.resource)
    with pytest.raises(DriverError, match=words):
        driver.open()
    assert not [line for line in controller.heard if line.startswith("set,")]
    driver.close()


@pytest.mark.parametrize("fault", ["meas:45:silent", "meas:45:error,7", "meas:45:drop", "meas:45:garbage"])
def test_faults_end_at_the_safe_voltage(controller: Nv200, fault: str) -> None:
    controller.fault = fault
    driver = driver_of(controller.resource, timeout=1.0)  # s: one fault waits for it
    driver.open()
    driver.start(np.array([0.0]))
    with pytest.raises(DriverError, match="exchanging TCPIP"):
        steps(driver)
    driver.stop(SAFE)
    assert controller.volts == SAFE[0]
    driver.close()


def test_a_loop_that_somebody_closed_is_opened_before_the_safe_voltage(controller: Nv200) -> None:
    driver, measured = driver_of(controller.resource), np.empty((1, 1))
    driver.open()
    driver.start(np.array([0.0]))
    driver.exchange(np.array([[50.0]]), measured)
    controller.values["cl"] = 1.0  # now 2.5 would be a position
    driver.stop(SAFE)
    assert (controller.volts, controller.values["cl"]) == (SAFE[0], 0.0)
    driver.close()


@pytest.mark.parametrize("change", [{"resource": ""}, {"output_range": (130.0, -20.0)}, {"um_per_unit": 0.0}])
def test_wrong_settings(change: dict[str, object]) -> None:
    with pytest.raises(SettingError, match=next(iter(change))):
        Nv200Settings(**{"resource": "ASRL3::INSTR", "output_range": (-20.0, 130.0), **change})
