"""What `import truestroke` loads, and what it offers."""

import subprocess
import sys

import pytest

import truestroke
from truestroke.runtime.realtime import config

HEAVY = ("scipy", "h5py", "matplotlib", "rich", "click", "jinja2")


def modules_after(statement):
    code = f"{statement}\nimport sys\nprint(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def test_import_loads_no_other_package():
    loaded = modules_after("import truestroke")
    assert loaded.isdisjoint({"numpy", *HEAVY})
    assert "truestroke.control.controller" not in loaded


def test_a_run_of_a_random_wave_needs_numpy_alone():
    loaded = modules_after(
        "import truestroke; truestroke.run; truestroke.Recording; truestroke.signals.trajectories.random_wave()"
    )
    assert loaded.isdisjoint(HEAVY)


def test_the_processes_beside_the_loop_load_little():
    """Four of them start with each run; each loaded the controllers, identification and the servers."""
    loaded = modules_after("from truestroke.runtime.realtime import process, recorder, status, watchdog")
    assert loaded.isdisjoint(HEAVY)
    for name in (
        "control.controller",
        "base.toml",
        "identification",
        "runtime.realtime.runner",
        "runtime.realtime.epics",
        "runtime.realtime.live_page",
        "signals.tables",
    ):
        assert f"truestroke.{name}" not in loaded


def test_a_run_of_a_configuration_identifies_nothing(tmp_path):
    """It took the reader of models from the package that identifies them: 25 modules at the start of each command."""
    (tmp_path / "run.toml").write_text(config.example())
    loaded = modules_after(
        f"from truestroke.runtime.realtime import config, runner; config.load({str(tmp_path / 'run.toml')!r})"
    )
    assert not {name for name in loaded if name.startswith("truestroke.identification")}
    assert loaded.isdisjoint({"scipy", "matplotlib", "jinja2"})


def test_what_reads_records_and_models_needs_numpy_alone():
    """scipy.signal was imported for one filter: three quarters of what `import truestroke.identification` took."""
    assert modules_after("import truestroke.identification, truestroke.identification.dynamics").isdisjoint(HEAVY)


@pytest.mark.parametrize("name", truestroke.__all__)
def test_every_public_name_is_there(name):
    assert getattr(truestroke, name) is not None
    assert name in dir(truestroke)


def test_a_wrong_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'runn'"):
        _ = truestroke.runn
