"""Recordings: to the disk and back, to the last bit; clear refusals."""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from late import Late

import truestroke
from truestroke import Recording, SettingError
from truestroke.cli import main
from truestroke.signals.recording import Channel, RecordingError, versions

xarray = Late("xarray")


def example(ticks=5, **metadata):
    return Recording(
        {
            "time": Channel(np.arange(ticks) / 2000.0, "s", "start of each tick"),
            "measured": Channel(np.linspace(0, np.nan, ticks), "um", "measured displacement"),
            "flags": Channel(np.arange(ticks, dtype=np.uint8), "", "bits"),
            "weights_time": Channel(np.arange(2) / 100.0, "s", "every 10 ms", "weights_time"),
            "weights": Channel(np.arange(32.0).reshape(2, 16), "um/V", "w", "weights_time"),
        },
        metadata,
    )


def assert_equal_to_the_bit(a, b):
    assert list(a.channels) == list(b.channels)
    assert a.metadata == b.metadata
    for name, channel in a.channels.items():
        other = b.channels[name]
        assert (channel.unit, channel.description, channel.time) == (other.unit, other.description, other.time)
        assert (channel.data.dtype, channel.data.shape) == (other.data.dtype, other.data.shape)
        assert channel.data.tobytes() == other.data.tobytes()


@given(
    data=hnp.arrays(st.sampled_from([np.float64, np.float32, np.uint8, np.int64]), st.integers(0, 20)),
    text=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20),
    metadata=st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=9),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    ),
)
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_round_trip_to_the_bit(tmp_path, data, text, metadata):
    recording = Recording({"x": Channel(data, text, text, "x")}, {"about": metadata})
    assert_equal_to_the_bit(recording, Recording.load(recording.save(tmp_path / "run.h5")))


def test_round_trip_of_many_channels_keeps_their_order(tmp_path):
    recording = example(seed=3, limits=(-0.6, np.float64(3.6)), table=np.arange(3), versions=versions())
    assert recording.metadata["limits"] == [-0.6, 3.6]  # as JSON has it, from the start
    loaded = Recording.load(recording.save(tmp_path / "run.h5"))
    assert_equal_to_the_bit(recording, loaded)
    assert loaded.unit("weights") == "um/V"
    assert "true" not in loaded
    assert repr(loaded).splitlines()[2].split() == ["measured", "um", "(5,)", "measured", "displacement"]


def test_a_file_explains_itself_without_truestroke(tmp_path):
    path = example(created="2026-01-01", controller={"name": "paper"}).save(tmp_path / "run.h5")
    with h5py.File(path) as file:
        told = {"unit": "um", "description": "measured displacement", "time": "time"}
        assert told.items() <= dict(file["measured"].attrs).items()
        assert file.attrs["about created"] == '"2026-01-01"'
        assert json.loads(file.attrs["about controller"]) == {"name": "paper"}


def test_a_crash_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    path = example(old=True).save(tmp_path / "run.h5")
    before = path.read_bytes()

    def crash(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(h5py.Group, "create_dataset", crash)
    with pytest.raises(KeyboardInterrupt):
        example(old=False).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]  # no draft lies about


FULL = """
import resource, sys
import numpy as np
from truestroke import Recording, scans
from truestroke.signals.recording import Channel

time = Channel(np.arange(9000) / 2000.0, "s", "start of each tick")
measured = Channel(np.random.default_rng(0).normal(size=9000), "um", "measured displacement")
long = Recording({"time": time, "measured": measured})
image = scans.Image(data=np.ones((90, 90)), name="a", unit="nm", size=(1.0, 1.0))
for size in (0, 100, 700, 5000, 20_000, 60_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    for save, file in ((long.save, "run.h5"), (lambda name: scans.save_images(name, [image]), "scan.nxs")):
        try:
            save(file)
        except OSError as error:
            assert error.filename == file, error
        else:
            raise AssertionError(f"{file}: {size} bytes were enough")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of a file")
def test_a_disk_that_refuses_a_part_is_an_error_that_names_the_file_and_no_crash_of_hdf5(tmp_path):
    done = subprocess.run([sys.executable, "-c", FULL], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, "")
    assert not list(tmp_path.iterdir())


def test_metadata_may_be_long(tmp_path):
    recording = example(table=list(range(100_000)))
    assert_equal_to_the_bit(recording, Recording.load(recording.save(tmp_path / "run.h5")))


def test_saving_replaces(tmp_path):
    example(old=True).save(tmp_path / "run.h5")
    assert Recording.load(example(ticks=9).save(tmp_path / "run.h5"))["time"].size == 9


def test_refusals_say_why(tmp_path):
    text, foreign, newer, cut = (tmp_path / name for name in ("text.h5", "foreign.h5", "newer.h5", "cut.h5"))
    text.write_text("time,z\n")
    with h5py.File(foreign, "w") as file:
        file["x"] = 1
    with h5py.File(example().save(newer), "r+") as file:
        file.attrs["format_version"] = 99
    cut.write_bytes(example(ticks=5000).save(tmp_path / "whole.h5").read_bytes()[:5000])
    for path, message in [
        (text, "not an HDF5 file"),
        (foreign, "not a truestroke recording"),
        (newer, "format 99, newer than 2"),
        (cut, "damaged"),
    ]:
        with pytest.raises(RecordingError, match=f"{path.name}: .*{message}"):
            Recording.load(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        Recording.load(tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        example().save(tmp_path / "no" / "run.h5")


def test_a_folder_in_the_place_of_a_file_is_called_one(tmp_path):
    """`Recording.load` and `read_record` said "no such file", `load_model` and `Dynamics.load` "[Errno 21]"."""
    for read in (Recording.load, truestroke.read_record, truestroke.scans.read_images):
        with pytest.raises(IsADirectoryError, match="is a folder; name a file"):
            read(tmp_path)
    for read in (truestroke.load_model, truestroke.Dynamics.load):
        with pytest.raises(truestroke.FileError, match="the file = a folder: must be a file of TOML"):
            read(tmp_path)


def test_channels_must_fit_their_time():
    time = Channel(np.arange(3.0), "s", "")
    with pytest.raises(SettingError, match="channel volts = array of shape \\(4,\\): must be 3 entries long"):
        Recording({"time": time, "volts": Channel(np.zeros(4), "V", "")})
    with pytest.raises(SettingError, match="time of channel volts = 'clock'"):
        Recording({"time": time, "volts": Channel(np.zeros(3), "V", "", "clock")})
    with pytest.raises(SettingError, match="metadata"):
        example(weird=object())
    with pytest.raises(KeyError, match="no channel 'z'; there are time, measured"):
        example()["z"]


# ---- A recording in Python's own terms, and in those of pandas and xarray --------------------------------------------


def test_a_recording_is_a_mapping_of_names_to_arrays():
    recording = example()
    assert isinstance(recording, Mapping)
    assert list(recording) == list(recording.keys()) == ["time", "measured", "flags", "weights_time", "weights"]
    assert len(recording) == 5
    assert dict(recording.items())["flags"] is recording["flags"]
    assert recording.get("true") is None
    assert recording == recording
    assert recording != example()  # arrays do not tell
    page = recording._repr_html_()
    assert all(name in page for name in recording)
    assert "µm/V" in page


def test_a_data_frame_has_the_channels_of_one_time_axis():
    recording = example()
    frame = recording.to_dataframe()
    assert frame.index.name == "time"
    assert list(frame.columns) == ["measured", "flags"]
    np.testing.assert_array_equal(frame["measured"], recording["measured"])
    slow = recording.to_dataframe("weights_time")
    assert slow.shape == (2, 16)
    np.testing.assert_array_equal(slow["weights[3]"], recording["weights"][:, 3])
    with pytest.raises(SettingError, match="time = 'clock': must be 'time' or 'weights_time'"):
        recording.to_dataframe("clock")


def test_xarray_shows_the_time_of_a_file_and_what_is_in_memory(tmp_path):
    recording = example()
    shown = recording.to_xarray()
    assert shown["weights"].dims == ("weights_time", "weights_index")
    assert shown["measured"].attrs == {"units": "um", "long_name": "measured displacement"}
    with xarray.open_dataset(recording.save(tmp_path / "run.h5")) as file:
        assert dict(file.sizes) == dict(shown.sizes) == {"time": 5, "weights_time": 2, "weights_index": 16}
        for name in recording:
            assert file[name].dims == shown[name].dims
            np.testing.assert_array_equal(file[name], recording[name])


def test_a_plot_has_a_panel_for_each_unit_and_names_what_there_is():
    figure = example().plot()
    assert [axes.get_ylabel() for axes in figure.axes] == ["measured\n(µm)", "flags", "weights\n(µm/V)"]
    assert len(figure.axes[2].get_lines()) == 16
    assert len(example().plot("measured").axes) == 1
    with pytest.raises(SettingError, match="channel = 'true': must be one of time, measured"):
        example().plot("true")


def test_a_file_without_dimension_scales_is_still_read(tmp_path):
    """As versions before wrote them: the same channels, no scales."""
    path = example().save(tmp_path / "run.h5")
    with h5py.File(path, "r+") as file:
        for name in ("measured", "flags"):
            file[name].dims[0].detach_scale(file["time"])
        file["weights"].dims[1].detach_scale(file["weights_index"])
        del file["weights_index"]
    assert_equal_to_the_bit(example(), Recording.load(path))


def test_a_recording_without_the_channels_of_a_run_is_refused_in_one_line(tmp_path: Path) -> None:
    ticks = np.arange(50) / 1000.0
    lacking = Recording({"time": Channel(ticks, "s", "t"), "volts": Channel(0 * ticks, "V", "v")})
    words = "the recording has no channel 'desired'; there are time, volts"
    for verb in (truestroke.judge, lambda recording: truestroke.save_page(recording, tmp_path / "run.html")):
        with pytest.raises(truestroke.TruestrokeError, match=words):
            verb(lacking)
    file = lacking.save(tmp_path / "run.h5")
    done = CliRunner().invoke(main, ["report", str(file)])
    assert (done.exit_code, done.stderr) == (1, f"truestroke: {words}\n")
