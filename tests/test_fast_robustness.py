"""The fast half of the robustness study: the samples are what is stated, the metrics and baselines what they say."""

import dataclasses
import json

import numpy as np
import pytest
from click.testing import CliRunner

from truestroke import DynamicsError, SettingError, StudyError
from truestroke.cli import main
from truestroke.plant import StagePlant, StageSettings
from truestroke.studies import robustness
from truestroke.studies.engine import Row, Store
from truestroke.studies.robustness import fast
from truestroke.studies.robustness.fast import page
from truestroke.studies.robustness.fast.sample import DURATION, DYNAMICS, LEAST_SLOPE, MOTIONS, RAMP, measured
from truestroke.studies.robustness.fast.table import counts, held, straight_line

SEED = 7  # of the small study; neither half of it was used for tuning


@pytest.fixture(scope="module")
def runs():
    return [fast.sample(11, number, ["unknown"]) for number in range(100)]


def test_the_stages_are_of_the_stated_distribution(runs):
    stages = [run.plant for run in runs]
    f0 = np.array([s.resonances[0] for s in stages])
    uniform = {
        "log f0": (np.log(f0), np.log(50), np.log(2000)),
        "log damping": (np.log([s.dampings[0] for s in stages]), np.log(0.003), np.log(0.08)),
        "log amplifier": (np.log([s.amplifier_bandwidth for s in stages]), np.log(500), np.log(10_000)),
        "dead time": ([s.dead_time * s.sample_rate for s in stages], 0, 2),
        "log stroke": (np.log([s.stroke for s in stages]), np.log(5), np.log(100)),
        "noise": ([run.plant.noise / run.sampled["span"]["unknown"] * 20 for run in runs], 5e-3, 60e-3),
    }
    for name, (values, low, high) in uniform.items():
        part = (np.array(values) - low) / (high - low)
        assert part.min() > -1e-9, name
        assert part.max() < 1 + 1e-9, name
        assert abs(part.mean() - 0.5) < 5 * np.sqrt(1 / 12 / part.size), name
    assert all(f <= 0.12 * s.sample_rate for f, s in zip(f0, stages, strict=True))
    assert {s.sample_rate for s in stages} == {5e3, 10e3, 20e3}
    assert {s.hysteresis_kind for s in stages} == {"plays", "preisach", "bouc-wen"}
    assert all(StagePlant(s).least_slope >= LEAST_SLOPE for s in stages)
    second = [s.resonances[1] / s.resonances[0] for s in stages if len(s.resonances) == 2]
    assert 0.5 < len(second) / len(stages) < 0.85
    assert 2.2 <= min(second) <= max(second) <= 5
    assert {run.sampled["motion"] for run in runs} == set(MOTIONS)
    jumps = [run.plant.resonance_change for run in runs if run.sampled["jump"] is not None]
    assert {round(jump, 9) for jump in jumps} == {0.95, 1.05}
    assert 0.05 < np.mean([run.sampled["drift"] != 0 for run in runs]) < 0.25


def test_motions_are_smooth_within_reach_and_have_nothing_above_a_third_of_f0(runs):
    for run in runs[:30]:
        motion, stage = run.motions["unknown"], run.plant
        dt = 1 / stage.sample_rate
        assert motion.position[0] == motion.velocity[0] == motion.acceleration[0] == 0
        moved = (motion.velocity[1:] + motion.velocity[:-1]) / 2 * dt
        assert np.max(np.abs(np.diff(motion.position) - moved)) < 5e-3 * motion.peak_speed * dt
        gained = (motion.acceleration[1:] + motion.acceleration[:-1]) / 2 * dt
        assert np.max(np.abs(np.diff(motion.velocity) - gained)) < 1e-2 * motion.peak_acceleration * dt
        steady = motion.position[motion.time >= RAMP]
        assert 0.24 * stage.stroke < steady.min() < steady.max() < 0.91 * stage.stroke
        spectrum = np.abs(np.fft.rfft((steady - steady.mean()) * np.hanning(steady.size))) ** 2
        frequency = np.fft.rfftfreq(steady.size, dt)
        above = frequency > 1.05 * stage.resonances[0] / 3 + 4 / DURATION
        assert spectrum[above].sum() < 1e-6 * spectrum.sum()


def test_a_sample_is_its_seed_and_number():
    one, same, other = (fast.sample(seed, 5, ["unknown"]) for seed in (3, 3, 4))
    assert one.plant == same.plant != other.plant
    assert np.array_equal(one.trajectory.position, same.trajectory.position)
    with pytest.raises(SettingError, match="controller = 'paper'"):
        fast.sample(0, 0, ["paper"])


# ---- Metrics and baselines ----------------------------------------------------------------------------------------


def run_on(**changes):
    """A run on a stage of this kind."""
    run = next(r for n in range(50) if (r := fast.sample(0, n, ["unknown"])).sampled["motion"] == "multi-tone")
    quiet = StageSettings(
        sample_rate=run.plant.sample_rate, stroke=run.plant.stroke, voltage_limits=(-2.0, 5.0), creep=0.0, noise=0.0,
        resonances=(0.4 * run.plant.sample_rate,), dampings=(0.7,), amplifier_bandwidth=0.0,
    )  # fmt: skip
    law = dataclasses.replace(run.controllers["unknown"], voltage_limits=(-2.0, 5.0))
    stage = dataclasses.replace(quiet, **changes)
    return dataclasses.replace(run, plant=stage, controllers={"unknown": law})


def channels(run, true, **more):
    motion = run.motions["unknown"]
    flags = np.zeros(len(motion), np.uint8)
    return {"time": motion.time, "desired": motion.position, "true": true, "flags": flags, **more}


def test_the_straight_line_is_exact_on_a_straight_stage_and_has_the_loop_of_a_bent_one():
    for width, error in ((0.0, (0.0, 0.6)), (0.15, (2.0, 8.0))):
        run = run_on(loop_width=width)
        desired = run.motions["unknown"].position
        judged, _ = counts(run, run.motions["unknown"].time)
        true = straight_line(run, desired, judged)
        a, b = np.polyfit(true[judged], desired[judged], 1)  # no other gain or offset is better
        assert a == pytest.approx(1, abs=0.02)
        assert b == pytest.approx(0, abs=0.08 * run.plant.stroke)
        rms = 100 * np.std((true - desired)[judged]) / run.sampled["span"]["unknown"]
        assert error[0] <= rms < error[1]


def test_the_held_controller_follows_a_stage_without_dynamics():
    """Whose waves are all slow: what it learned on the slow wave holds for the fast one."""
    run = run_on(loop_width=0.12)
    error = held(run, "unknown") - run.motions["unknown"].position
    judged, _ = counts(run, run.motions["unknown"].time)
    assert 100 * np.std(error[judged]) / run.sampled["span"]["unknown"] < 2.5


def test_metrics_are_per_cent_of_the_motion_and_leave_out_what_they_say():
    run = run_on(loop_width=0.0)
    run = dataclasses.replace(run, sampled=run.sampled | {"jump": 1.5})
    motion, span = run.motions["unknown"], run.sampled["span"]["unknown"]
    true = motion.position.copy()
    rate = run.plant.sample_rate
    true[: round(0.4 * rate)] += span  # the start
    true[round(1.6 * rate) : round(2.4 * rate)] += span  # within a second after the jump
    true[round(1.0 * rate)] += 0.1 * span
    true[round(3.0 * rate) : round(3.5 * rate)] += 0.02 * span
    found = fast.metrics(run, "unknown", channels(run, true))
    assert found["largest"] == pytest.approx(10.0)
    assert found["largest_at"] == pytest.approx(1.0)
    assert found["maximum"] == pytest.approx(2.0)
    assert found["rms"] == pytest.approx(2.0 * np.sqrt(0.5 / 1.5), rel=1e-3)


def rows_with(*metrics, jump=None, kind="plays"):
    base = {"maximum": 1.0, "largest": 1.0, "largest_at": 1.0, "changes": 0}
    sampled = {"kind": kind, "jump": jump, "what": "", "f0": 100.0, "span": {"unknown": 1.0}}
    return [
        Row(k, sampled, {"unknown": base | dict(zip(("rms", "straight", "held"), m, strict=True))})
        for k, m in enumerate(metrics)
    ]


def test_a_run_worse_than_a_baseline_has_failed():
    good, line, frozen = (0.1, 5.0, 0.2), (0.6, 0.5, 9.0), (0.6, 9.0, 0.49)
    assert [fast.failed(dict(zip(("rms", "straight", "held"), m, strict=True))) for m in (good, line, frozen)] == [
        False, True, True,
    ]  # fmt: skip
    (result,) = fast.results(rows_with(good, good, line, good))
    assert (result.name, result.runs, result.failed) == ("dynamics unknown, to f0/3", 4, (2,))
    assert result.missed == ("95 %",)
    levels = [fast.judge(rows_with(*some)).level for some in ((good,), (good,) * 9 + (line,), (good, frozen))]
    assert levels == ["good", "doubtful", "bad"]
    assert [one.name for one in fast.results(rows_with(good, kind="bouc-wen") + rows_with(good, jump=1.3))] == [
        "after f0 jumps, dynamics unknown", "Bouc-Wen, dynamics unknown",
    ]  # fmt: skip


# ---- The study -----------------------------------------------------------------------------------------------------


def test_a_small_study_has_its_table_and_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["robustness", "--fast", "--plants", "2", "--seed", str(SEED), "--controllers", "unknown", "--json"]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code in (0, 4), done.stderr
    told = json.loads(done.stdout)
    assert [run["number"] for run in told["runs"]] == [0, 1]
    study = fast.FastRobustness(seed=SEED, numbers=range(3), controllers=("unknown",))
    with Store(tmp_path / told["store"], study) as store:  # the same command with more plants continues
        assert store.missing(study.numbers) == [2]
    assert sum(line["runs"] for line in told["table"]) == 2
    html = (tmp_path / told["page"]).read_text()
    assert html.count("<svg") == 6  # each as a phone shows it, too
    number = told["runs"][0]["number"]
    recording = fast.record(SEED, number, "unknown")  # in the loop of Python: the bits of the batch
    run = fast.sample(SEED, number, ["unknown"])
    names = ("time", "desired", "true", "flags")
    again = fast.metrics(run, "unknown", {name: recording[name] for name in names})
    assert again == told["runs"][0]["unknown"]


def test_a_soft_stage_whose_lag_and_dead_time_are_told_apart_badly_is_measured():
    """The fit has a dead time of -0.98 ticks, 0.9 at one standard deviation: it was refused."""
    stage = fast.sample(6, 38, ["unknown"]).plant
    found = measured(stage, 38)
    assert found.modes[0].frequency == pytest.approx(stage.resonances[0], rel=1e-3)
    assert -0.5 - 1e-9 < found.dead_time * stage.sample_rate < 0.5  # -0.43 or -0.5: rounding decides, of another CPU
    late = found.dead_time + 1 / (2 * np.pi * found.amplifier_bandwidth)
    assert late == pytest.approx(
        stage.dead_time + 1 / (2 * np.pi * stage.amplifier_bandwidth), abs=0.5 / stage.sample_rate
    )


def test_the_command_names_wrong_controllers():
    for arguments in (["--fast", "--controllers", "paper"], ["--controllers", "unknown"]):
        done = CliRunner().invoke(main, ["robustness", *arguments])
        assert done.exit_code == 2
        assert "is not one of" in done.stderr


def test_the_tables_have_a_row_for_each_line():
    rows = rows_with((0.1, 5.0, 0.2), (0.6, 0.5, 9.0))
    assert page.table(rows)[1][0][:4] == ["dynamics unknown, to f0/3", "2", "0.35 / 0.575 / 0.6", "0.15 / 0.5 / 1"]
    assert page.compared(rows)[1][0][-1] == "1"
    assert robustness.numbers(5, "unseen") == range(1, 5, 2)


@pytest.mark.parametrize(
    ("seed", "number"),
    [
        (31415, 75),  # 53 Hz at 20 kHz: 274 of 15,993 lines were seen, fewer than a fiftieth, and it was refused
        (555, 145),  # damping 0.06 behind an amplifier of 598 Hz: the peak is twice the static response, its phase
        (
            555,
            27,
        ),  # is a quarter turn at three quarters of f0: refused, or a first resonance of 1524 in place of 1626 Hz
    ],
)
def test_a_stage_whose_peak_is_low_or_hardly_seen_is_measured(seed, number):
    stage = fast.sample(seed, number, ["unknown"]).plant
    mode = measured(stage, number).modes[0]
    assert mode.frequency == pytest.approx(stage.resonances[0], rel=2e-3)
    assert mode.damping == pytest.approx(stage.dampings[0], rel=0.1)


def test_a_stage_that_is_refused_is_a_row_and_a_sentence(monkeypatch):
    """A study of hundreds is not lost by one measurement; where each is refused that is an error."""

    def refuse_odd(stage, seed):
        if seed % 2:
            raise DynamicsError(f"no resonance of stage {seed}")
        return stage.dynamics()

    monkeypatch.setitem(DYNAMICS, "measured", refuse_odd)
    study = fast.FastRobustness(seed=SEED, numbers=range(2, 5), controllers=("measured",))
    rows = robustness.run(study, 1, with_refused=True)
    assert [row.error for row in rows] == ["", "no resonance of stage 3", ""]
    assert fast.sentences(rows)[0] == "1 of 3 stages were refused, the first is run 3: no resonance of stage 3."
    assert fast.judge(rows).level == "bad"  # a fifth or more
    assert sum(one.runs for one in fast.results(rows)) == 2
    assert sorted(row.number for row, _ in page.worst_first(rows)) == [2, 4]
    alone = fast.FastRobustness(seed=SEED, numbers=range(3, 4), controllers=("measured",))
    with pytest.raises(StudyError, match=r"^run 3: no resonance of stage 3$"):
        robustness.run(study, 1)
    with pytest.raises(DynamicsError, match=r"^no resonance of stage 3$"):
        robustness.run(alone, 1, with_refused=True)
