"""The headers of oscilloscopes and LabVIEW: names, units and the time of their columns."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from truestroke.identification import RecordError, read_record

T = np.arange(200) / 1000.0 - 0.05
V, Z = 5 - 5 * np.cos(90 * T), 20 - 20 * np.cos(90 * T - 0.1)
ROWS = [*zip(T.tolist(), V.tolist(), Z.tolist(), strict=True)]
SCOPE = (
    "Model,MSO58\nHorizontal Units,s,s\nSample Interval,1e-3,1e-3\nVertical Units,{},{}\nLabel,,\n,,\nTIME,CH1,CH2\n"
)
GROUPS = (
    "Model,MDO3014\nHorizontal Units,s,,Horizontal Units,s\nVertical Units,V,,Vertical Units,um\n,,,,\n"
    "TIME,CH1,,TIME,CH2\n"
)
BESIDE = ["Record Length,2e+02", "Sample Interval,1e-3", "Trigger Point,5.0e+01", ",", "Source,CH1", "Vertical Units,V"]
LABVIEW = (
    "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\t{}\n***End_of_Header***\t\n\t\nChannels\t2\t\t\n"
    "Samples\t200\t200\t\nY_Unit_Label\tmV\tmicrometers\t\nX_Dimension\tTime\tTime\t\nX0\t0.0E+0\t0.0E+0\t\nDelta_X\t1.0E-3\t1.0E-3\t\n"
    "***End_of_Header***\t\t\t\n{}\tComment\n"
)
TRACES = (
    '"Model","DL850E"\n"TraceName","drive","sensor"\n"VUnit","mV","um"\n"HResolution",1e-3,1e-3\n"HUnit","s","s"\n\n'
)


def rows(each: Callable[[int, float, float, float], str]) -> str:
    return "".join(each(k, *row) for k, row in enumerate(ROWS))


def beside(k: int, t: float, v: float, z: float) -> str:
    """As Tektronix' TDS: the header in columns of its own, of each channel."""
    head = (BESIDE[k] if k < len(BESIDE) else ",") + ",,"
    other = head.replace("CH1", "CH2").replace("Units,V", "Units,um")
    return f"{head}{t:+.9f}, {v:.6f},{other}{t:+.9f}, {z:.6f},\n"


FILES = {
    "MSO": SCOPE.format("V", "um") + rows(lambda _, t, v, z: f"{t:.6e},{v:.7g},{z:.7g}\n"),
    "commented": "#" + SCOPE.format("V", "um").replace("\n", "\n#")[:-1]
    + rows(lambda _, t, v, z: f"{t:.6e},{v:.7g},{z:.7g}\n"),
    "mV and nm": SCOPE.format("mV", "nm") + rows(lambda _, t, v, z: f"{t:.6e},{1e3 * v:.8g},{1e3 * z:.8g}\n"),
    "MDO": GROUPS + rows(lambda _, t, v, z: f"{t:.6e},{v:.7g},,{t:.6e},{z:.7g}\n"),
    "TDS": rows(beside),
    "Rigol": "X,CH1,CH2,Start,Increment,\nSequence,Volt,um,-5.0e-02,1.0e-3\n"
    + rows(lambda k, _, v, z: f"{k},{v:.7e},{z:.7e},\n"),
    "later Rigol": "CH1V,z(um),t0 = -0.05, tInc = 0.001,\n" + rows(lambda _k, _t, v, z: f"{v:.7e},{z:.7e},,\n"),
    "one time": LABVIEW.format("One", "X_Value\tA\tB") + rows(lambda _, t, v, z: f"{t:.6f}\t{1e3 * v:.5f}\t{z:.7f}\n"),
    "no time": LABVIEW.format("No", "X_Value\tA\tB") + rows(lambda _k, _t, v, z: f"\t{1e3 * v:.5f}\t{z:.7f}\n"),
    "times": LABVIEW.format("Multi", "X_Value\tA\tX_Value\tB")
    + rows(lambda _, t, v, z: f"{t:.6f}\t{1e3 * v:.5f}\t{t:.6f}\t{z:.7f}\n"),
    "x": "Vertical Units,V,um\nSample Interval,1e-3\nvoltage,x\n" + rows(lambda _k, _t, v, z: f"{v:.7g},{z:.7g}\n"),
    "Siglent": "Record Length,Analog:200\nVertical Units,CH1:mV,CH2:um\nHorizontal Units,s\nTime,CH1,CH2\n"
    + rows(lambda _, t, v, z: f"{t:.6e},{1e3 * v:.8g},{z:.7g}\n"),
    "Yokogawa in ms": TRACES.replace("1e-3,1e-3", "1.0,1.0").replace('"s","s"', '"ms","ms"')
    + rows(lambda _k, _t, v, z: f",{1e3 * v:.8e},{z:.7e}\n"),
    "Yokogawa": TRACES + rows(lambda _k, _t, v, z: f",{1e3 * v:.8e},{z:.7e}\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_names_units_and_time_are_those_of_the_header(tmp_path: Path, name: str) -> None:
    """Units of such a header were ignored, rows beside it refused with a remedy that lost them."""
    (tmp_path / "a.csv").write_text(FILES[name])
    record = read_record(tmp_path / "a.csv")
    assert (record.time.size, record.sample_rate) == (T.size, pytest.approx(1000.0))
    np.testing.assert_allclose(record.volts, V, atol=1e-5)
    np.testing.assert_allclose(record.displacement, Z, atol=1e-5)
    assert all(column.stated for column in record.columns.values())


def test_columns_keep_the_numbers_of_the_file_where_the_time_is_in_its_header(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(FILES["later Rigol"])
    assert read_record(tmp_path / "a.csv", volts=1, displacement=2).columns["volts"].heading == "CH1"


def test_a_single_channel_is_no_record(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(rows(lambda k, t, v, z: ",".join(beside(k, t, v, z).split(",")[:5]) + ",\n"))
    with pytest.raises(
        RecordError, match="'CH1' \\(V\\) is its only signal; put voltage and displacement side by side"
    ):
        read_record(tmp_path / "a.csv")


def test_a_column_without_a_name_may_be_the_other_signal(tmp_path: Path) -> None:
    """The voltage was called the only signal, and no column was asked for."""
    (tmp_path / "a.csv").write_text("t,V,\n" + rows(lambda _, t, v, z: f"{t},{v},{z}\n"))
    with pytest.raises(RecordError, match="which column is displacement"):
        read_record(tmp_path / "a.csv")


def test_two_signals_that_begin_alike_are_two(tmp_path: Path) -> None:
    """The first was taken of two that rest in the rows that are looked at."""
    (tmp_path / "a.csv").write_text("V,z,z\n" + 250 * "0,0,0\n" + rows(lambda _k, _t, v, z: f"{v},{z},{z + 5}\n"))
    with pytest.raises(RecordError, match="several columns could be it"):
        read_record(tmp_path / "a.csv", sample_rate=1000.0)


def test_a_step_without_names_leaves_the_rows_as_they_are(tmp_path: Path) -> None:
    """Such a file was called damaged."""
    (tmp_path / "a.csv").write_text("t0 = -0.5, tInc = 1e-3\n" + rows(lambda _k, _t, v, z: f"{v:.5f},{z:.5f}\n"))
    np.testing.assert_allclose(
        read_record(tmp_path / "a.csv", sample_rate=1e3, volts=1, displacement=2).volts, V, atol=1e-5
    )


@pytest.mark.parametrize("step", ["e", "-1e-3", "0"])
def test_a_step_that_is_none_is_not_used(tmp_path: Path, step: str) -> None:
    """Times of NaN, and such as descend, were held against the rows."""
    text = f"voltage (V),z (um),tInc = {step},\n" + rows(lambda _k, _t, v, z: f"{v:.5f},{z:.5f},,\n")
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordError, match="which column is time"):
        read_record(tmp_path / "a.csv")


def test_a_text_and_cells_of_matlab_are_refused_by_their_names(tmp_path: Path) -> None:
    """The one was damaged, of the other a column was asked for."""
    np.savetxt(tmp_path / "a.mat", np.column_stack([T, V, Z]))
    with pytest.raises(RecordError, match=r"this is text; call it \.txt"):
        read_record(tmp_path / "a.mat")
    cells = np.empty(3, dtype=object)
    cells[:] = [T, V, Z]
    savemat(tmp_path / "b.mat", {"c": cells})
    with pytest.raises(RecordError, match="only arrays of structs, or cells"):
        read_record(tmp_path / "b.mat")
