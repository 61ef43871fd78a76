"""A motion that grows makes an error that grows slowly, which is no sudden change of the actuator: decision 359."""

import numpy as np
import pytest
from benchmarks.growing_motion import controller_of, errors, sampled, wave_of

from truestroke.control.reference import ReferenceController
from truestroke.plant import StagePlant


@pytest.mark.parametrize(
    "number", [20, 28, 116, 260], ids=["80 % before", "324 % before", "26 % before", "146 % before"]
)
def test_an_error_that_grows_slowly_is_no_change_after_another(number) -> None:
    _, _, largest = errors(number, "nothing")
    assert largest < 5


@pytest.mark.parametrize(("number", "ticks"), [(16, 250), (68, 150)])
def test_kernel_and_text_where_what_a_change_made_is_no_change(number, ticks) -> None:
    case = sampled(number)
    kernel, plant, wave = controller_of(case, "nothing"), StagePlant(case.stage, seed=number), wave_of(case)
    text, none = ReferenceController(kernel.settings), 0
    plant.open()
    for k in range(ticks):
        motion = wave.position[k], wave.velocity[k], wave.acceleration[k]
        volts, before = kernel.command(*motion), kernel.counters.changed
        assert text.command(*motion) == volts
        z = float(plant.exchange(np.array([volts]))[0])
        kernel.adapt(z)
        text.adapt(z)
        none += kernel.counters.changed == before and kernel.state()["since_change"][0] == 0
        np.testing.assert_array_equal(kernel.weights, text.weights, err_msg=f"tick {k}")
        assert kernel.flag_bits == text.flag_bits
    assert none > 0, "an innovation that was no change was met"
