"""The layout of the weights: one list of terms for NumPy, kernel, names, units and prior."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truestroke import ControllerSettings
from truestroke.model import prior
from truestroke.model.layout import TERMS, Layout

HEADER = (Path(__file__).parent.parent / "c" / "include" / "truestroke.h").read_text(encoding="utf-8")

layouts = st.builds(
    lambda plays, chosen, **terms: Layout(
        thresholds=tuple(0.1 * i for i in range(plays)), rate_dependent=tuple(i for i in chosen if i < plays), **terms
    ),
    plays=st.integers(1, 6),
    chosen=st.sets(st.integers(0, 5)).map(sorted),
    creep_times=st.sampled_from([(), (0.3,), (0.03, 3.0)]),
    lag=st.booleans(),
    inertia=st.booleans(),
    offset=st.booleans(),
    asymmetry=st.integers(0, 2),
    other_axes=st.integers(0, 2),
)


def test_the_kernel_has_the_same_terms_in_the_same_order() -> None:
    kernel = re.search(r"typedef enum \{(.*?)\} ts_term;", HEADER, re.S)
    assert kernel is not None
    names = [name.lower() for name in re.findall(r"TS_(\w+)", re.sub(r"/\*.*?\*/", "", kernel[1], flags=re.S))]
    assert names == [*TERMS, "terms"]
    units = [text.strip().rsplit(" ", 1)[-1] for text in re.findall(r"/\*(.*?)\*/", kernel[1], re.S)]
    assert units == [term.unit for term in TERMS.values()]
    most = re.search(r"#define TS_MOST_WEIGHTS \{(.*?)\}", HEADER)
    assert most is not None
    capacities = dict(re.findall(r"#define TS_MAX_(\w+) (\d+)", HEADER))
    numbers = [int(capacities.get(entry.strip().removeprefix("TS_MAX_"), entry)) for entry in most[1].split(",")]
    assert numbers == [term.most for term in TERMS.values()]


@given(layout=layouts)
def test_every_weight_has_one_place_one_name_and_one_unit(layout) -> None:
    places = [*layout.a, *layout.b]
    for columns in layout.columns.values():
        places += range(layout.parameters)[columns]
    assert sorted(places) == list(range(layout.parameters))
    assert len(set(layout.names)) == len(layout.names) == len(layout.units) == layout.parameters
    assert [layout.names[k] for k in layout.a] == [f"a{i}" for i in range(len(layout.thresholds))]
    assert [layout.names[k] for k in layout.b] == [f"b{i}" for i in layout.rate_dependent]
    for name, columns in layout.columns.items():
        assert all(label.startswith(name) for label in layout.names[columns])
        assert set(layout.units[columns]) <= {TERMS[name].unit}


@given(layout=layouts)
def test_a_vector_is_taken_apart_again(layout) -> None:
    n = len(layout.thresholds)
    rates = 100.0 + np.arange(len(layout.rate_dependent))
    w = layout.vector(np.arange(1.0, n + 1), rates, offset=7.0)
    a, b = layout.of_all_plays(w)
    assert a.tolist() == list(range(1, n + 1))
    assert b[list(layout.rate_dependent)].tolist() == rates.tolist()
    assert np.count_nonzero(b) == rates.size
    assert w[layout.columns["offset"]].tolist() == [7.0] * layout.offset
    assert np.count_nonzero(w) == n + rates.size + layout.offset


@pytest.mark.parametrize("name", TERMS)
def test_the_prior_of_a_term_follows_from_its_row(name) -> None:
    on = {term.setting: True for term in TERMS.values() if term.most == 1} | {"other_axes": 2}
    settings = ControllerSettings(sample_rate=2000.0, stroke=30.0, voltage_limits=(-0.6, 3.6), **on)
    scale = {"um/V": settings.q, "um": settings.stroke}.get(TERMS[name].unit, 1.0)
    P = np.array(settings.prior_covariance)
    columns = settings.columns[name]
    deviations = np.sqrt(np.diag(P))[columns]
    np.testing.assert_allclose(deviations, TERMS[name].deviation * scale, rtol=1e-12)
    assert P[columns].sum() == pytest.approx(np.sum(deviations**2))  # alone: not correlated
    assert set(settings.initial_weights[columns]) == {TERMS[name].mean}
    np.testing.assert_array_equal(
        prior.mean(settings, np.zeros(settings.plays))[columns], settings.initial_weights[columns]
    )


@pytest.mark.parametrize("law", ["kalman", "rls"])
def test_settings_among_other_axes_have_their_terms_beside_what_was_known(law) -> None:
    given = {"sample_rate": 2000.0, "stroke": 30.0, "voltage_limits": (-0.6, 3.6), "law": law}
    m = {"kalman": 41, "rls": 39}[law]  # with two states of Duhem, and without
    alone = ControllerSettings(**given, initial_weights=tuple(np.linspace(9.0, 1.0, m)))
    beside = alone.among(2)
    assert beside.initial_weights == (*alone.initial_weights, *[0.0] * 6)
    assert beside.names[-6:-2] == ("coupling 1", "coupling 2", "coupling_lag 1", "coupling_lag 2")
    assert beside.names[-1] == "coupling_inertia 2"
    assert beside.among(0) == alone
    assert law == "rls" or np.array(beside.prior_covariance)[:m, :m].tolist() == [*map(list, alone.prior_covariance)]
